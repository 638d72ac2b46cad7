"""Extreme cultivars give finite organs that are connected."""

from collections.abc import Callable

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar, Distribution, OrganModel, load_cultivar
from pepperscene.grammar import Plant, grow

Change = Callable[[Distribution], Distribution]


def constant(distribution: Distribution) -> Distribution:
    """The mean, without variance."""
    mean = distribution.mean
    return Distribution(family="value", mean=mean, sd=0.0, low=mean, high=mean, chosen="for a test")


def widened(distribution: Distribution) -> Distribution:
    """Ten times the standard deviation about the same mean, whatever the bounds were."""
    mean, sd = distribution.mean, 10.0 * max(distribution.sd, 0.1 * abs(distribution.mean))
    low, high = mean - 3.0 * sd, mean + 3.0 * sd
    return Distribution(family="normal", mean=mean, sd=sd, low=low, high=high, chosen="for a test")


def with_organ(cultivar: Cultivar, name: str, **values: object) -> Cultivar:
    """A cultivar with other parameters of a kind, without validation."""
    model = cultivar.organs[name]
    fields = {n: getattr(model, n) for n in type(model).model_fields}
    changed = type(model).model_construct(**fields | values)
    return cultivar.model_copy(update={"organs": {**cultivar.organs, name: changed}})


def with_stem(cultivar: Cultivar, **values: object) -> Cultivar:
    return cultivar.model_copy(update={"stem": cultivar.stem.model_copy(update=values)})


def change_all(cultivar: Cultivar, change: Change) -> Cultivar:
    names = ("diameter", "top_diameter", "lean", "zigzag")
    cultivar = with_stem(cultivar, **{name: change(getattr(cultivar.stem, name)) for name in names})
    for name, model in cultivar.organs.items():
        values = {key: change(value) for key, value in model.distributions.items()}
        cultivar = with_organ(cultivar, name, **values, bears=change_slots(model, change))
    return cultivar


def change_slots(model: OrganModel, change: Change) -> tuple[object, ...]:
    slots = []
    for slot in model.bears:
        names = [name for name in ("spread", "aside", "step") if getattr(slot, name) is not None]
        slots.append(slot.model_copy(update={name: change(getattr(slot, name)) for name in names}))
    return tuple(slots)


def assert_is_sound(plant: Plant) -> None:
    for index, organ in enumerate(plant.organs):
        curve, measures = organ.curve, organ.measures
        assert organ.parent < index
        assert np.isfinite(curve).all()
        assert np.isfinite(organ.up).all()
        assert np.isfinite(list(measures.values())).all()
        assert np.linalg.norm(np.diff(curve, axis=0), axis=1).min() > 0
        assert organ.up @ organ.up == pytest.approx(1.0)
        assert abs(organ.up @ (curve[1] - curve[0])) < 1e-6 * np.linalg.norm(curve[1] - curve[0])
        positive = ("radius_m", "radius_tip_m", "radius_end_m", "length_m", "width_m", "diameter_m")
        assert all(measures[name] > 0 for name in positive if name in measures)
        fractions = ("seed", "state_mean", "state_tip", "state_spread", "ripeness", "point", "open")
        assert all(0.0 <= measures[name] <= 1.0 for name in fractions if name in measures)


@pytest.mark.parametrize("name", ["kaite", "tomato"])
@pytest.mark.parametrize("change", [constant, widened])
@pytest.mark.parametrize("parts", [1, 40])
def test_zero_and_tenfold_variance(name: str, change: Change, parts: int) -> None:
    cultivar = with_stem(change_all(load_cultivar(name), change), parts=parts)
    for seed in range(2):
        plant = grow(cultivar, np.random.default_rng(seed))
        assert_is_sound(plant)
        if change is constant:
            # Mature organs are equal.
            lengths = [o.measures["length_m"] for o in plant.of_kind("lamina") if o.phytomer < parts - 4]
            assert not lengths or np.ptp(lengths) == 0.0


@pytest.mark.parametrize("name", ["kaite", "tomato"])
@pytest.mark.parametrize(("parts", "young"), [(1, 0), (1, 4), (3, 3), (200, 4)])
def test_any_number_of_nodes(name: str, parts: int, young: int) -> None:
    plant = grow(with_stem(load_cultivar(name), parts=parts, young_nodes=young), np.random.default_rng(7))
    assert_is_sound(plant)
    assert len(plant.of_form("node")) == len(plant.of_form("internode")) == parts

"""Every plant that a file can state, and some that none can, has finite organs that hang together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar, Distribution, OrganModel, load_cultivar
from pepperscene.grammar import Plant, grow

Spread = Callable[[Distribution], Distribution]


def fixed(law: Distribution) -> Distribution:
    """The law without variance."""
    return Distribution(law="value", mean=law.mean, sd=0.0, low=law.mean, high=law.mean, chosen="for a test")


def widened(law: Distribution) -> Distribution:
    """Ten times the standard deviation about the same mean, whatever the bounds were."""
    reach = 10.0 * max(law.sd, 0.1 * abs(law.mean))
    low, high = law.mean - 3.0 * reach, law.mean + 3.0 * reach
    return Distribution(law="normal", mean=law.mean, sd=reach, low=low, high=high, chosen="for a test")


def edited(model: OrganModel, spread: Spread) -> OrganModel:
    fields = {name: getattr(model, name) for name in type(model).model_fields}
    laws = {name: spread(law) for name, law in model.distributions.items()}
    slots = []
    for slot in model.bears:
        turned = {
            name: spread(law)
            for name in ("spread", "aside", "step")
            if (law := getattr(slot, name)) is not None
        }
        slots.append(slot.model_copy(update=turned))
    return type(model).model_construct(**fields | laws | {"bears": tuple(slots)})


def with_stem(cultivar: Cultivar, **values: object) -> Cultivar:
    return cultivar.model_copy(update={"stem": cultivar.stem.model_copy(update=values)})


def with_spread(cultivar: Cultivar, spread: Spread) -> Cultivar:
    names = ("diameter", "top_diameter", "lean", "zigzag")
    stem = {name: spread(getattr(cultivar.stem, name)) for name in names}
    organs = {name: edited(model, spread) for name, model in cultivar.organs.items()}
    return with_stem(cultivar, **stem).model_copy(update={"organs": organs})


def is_sound(plant: Plant) -> bool:
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
        shares = ("seed", "state_mean", "state_tip", "state_spread", "ripeness", "point", "open")
        assert all(0.0 <= measures[name] <= 1.0 for name in shares if name in measures)
    return True


@pytest.mark.parametrize("name", ["kaite", "tomato"])
@pytest.mark.parametrize("spread", [fixed, widened])
@pytest.mark.parametrize("parts", [1, 2, 40])
def test_zero_and_tenfold_variance(name: str, spread: Spread, parts: int) -> None:
    cultivar = with_stem(with_spread(load_cultivar(name), spread), parts=parts)
    assert all(is_sound(grow(cultivar, np.random.default_rng(seed))) for seed in range(4))


def test_without_variance_organs_are_alike(kaite: Cultivar) -> None:
    plant = grow(with_spread(kaite, fixed), np.random.default_rng(0))
    grown = [o.measures["length_m"] for o in plant.of_kind("lamina") if o.phytomer < 36]
    assert np.ptp(grown) == 0.0


@pytest.mark.parametrize("name", ["kaite", "tomato", "kaite_february", "kaite_september", "red_blocky"])
@pytest.mark.parametrize(("parts", "young"), [(1, 0), (1, 4), (3, 3), (200, 4), (200, 200)])
def test_any_number_of_nodes(name: str, parts: int, young: int) -> None:
    plant = grow(with_stem(load_cultivar(name), parts=parts, young_nodes=young), np.random.default_rng(7))
    assert is_sound(plant)
    assert len(plant.of_form("node")) == len(plant.of_form("internode")) == parts


@pytest.mark.parametrize(
    ("kind", "parameter", "value"), [("lamina", "length", 1e-3), ("fruit", "diameter", 0.3)]
)
def test_tiny_leaves_and_huge_fruit(kaite: Cultivar, kind: str, parameter: str, value: float) -> None:
    law = fixed(kaite.organs[kind].distributions[parameter]).model_copy(
        update={"mean": value, "low": value, "high": value}
    )
    model = kaite.organs[kind].model_copy(update={parameter: law})
    model.__dict__.pop("laws", None)
    plant = grow(kaite.model_copy(update={"organs": {**kaite.organs, kind: model}}), np.random.default_rng(1))
    assert is_sound(plant)
    found = [o.measures[f"{parameter}_m"] for o in plant.of_kind(kind) if o.phytomer < 36]
    assert found == [value] * len(found)


def test_sections_shorter_than_their_nodes_still_run_upwards(kaite: Cultivar) -> None:
    short = Distribution(law="uniform", mean=0.05, sd=0.028, low=0.001, high=0.1, chosen="for a test")
    fields = {n: getattr(kaite.organs["internode"], n) for n in type(kaite.organs["internode"]).model_fields}
    model = type(kaite.organs["internode"]).model_construct(**fields | {"length": short})
    plant = grow(
        kaite.model_copy(update={"organs": {**kaite.organs, "internode": model}}), np.random.default_rng(3)
    )
    assert is_sound(plant)
    line = np.concatenate([o.curve for o in plant.organs if o.kind in ("internode", "node")])
    assert (np.diff(line[:, 2]) > -1e-12).all()

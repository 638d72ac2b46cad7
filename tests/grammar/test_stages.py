"""A plant at two dates is the same plant, grown: growth stages share every random number."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar, Distribution, interpolate_cultivars
from pepperscene.grammar import Plant, draw_parameters, grow


def scaled(cultivar: Cultivar, factor: float) -> Cultivar:
    """The same cultivar with all its lengths and diameters larger, and another droop."""
    organs = {}
    for name, model in cultivar.organs.items():
        fields = {n: getattr(model, n) for n in type(model).model_fields}
        larger = {
            n: _times(law, factor)
            for n, law in model.distributions.items()
            if n in ("length", "width", "diameter")
        }
        organs[name] = type(model).model_construct(**fields | larger)
    stem = cultivar.stem.model_copy(update={"diameter": _times(cultivar.stem.diameter, factor)})
    return cultivar.model_copy(update={"organs": organs, "stem": stem})


def _times(law: Distribution, factor: float) -> Distribution:
    return law.model_copy(
        update={
            **{name: factor * getattr(law, name) for name in ("mean", "sd", "low", "high")},
            "bins": tuple((factor * low, factor * high, weight) for low, high, weight in law.bins),
        }
    )


def topology(plant: Plant) -> list[tuple[str, int, int]]:
    return [(organ.kind, organ.parent, organ.phytomer) for organ in plant.organs]


def test_stages_between_have_the_same_organs_and_lengths_between(kaite: Cultivar) -> None:
    old = scaled(kaite, 1.6)
    half = interpolate_cultivars(kaite, old, 0.5)
    first, middle, last = (draw_parameters(c, np.random.default_rng(9)) for c in (kaite, half, old))
    for name in kaite.organs:
        young, mean, grown = (one.organs[name] for one in (first, middle, last))
        assert np.array_equal(young.number, mean.number)
        assert np.array_equal(young.parent, grown.parent)
        for column in set(young.values) & {"length", "width", "diameter"}:
            assert (young.values[column] <= mean.values[column] + 1e-12).all()
            assert (mean.values[column] <= grown.values[column] + 1e-12).all()
            np.testing.assert_allclose(
                mean.values[column], 0.5 * (young.values[column] + grown.values[column]), rtol=0.01
            )
        # What does not differ between the dates is the same to the bit.
        for column in set(young.values) & {"seed", "roll", "lobes", "azimuth"} - {"azimuth"}:
            assert np.array_equal(young.values[column], grown.values[column]), (name, column)
    assert topology(grow(kaite, np.random.default_rng(9))) == topology(grow(old, np.random.default_rng(9)))


def test_a_stage_moves_little_when_its_share_does(kaite: Cultivar) -> None:
    old = scaled(kaite, 1.6)
    curves = [
        [
            organ.curve
            for organ in grow(interpolate_cultivars(kaite, old, share), np.random.default_rng(4)).organs
        ]
        for share in (0.5, 0.501)
    ]
    moved = [np.abs(one - other).max() for one, other in zip(*curves, strict=True)]
    assert 0.0 < max(moved) < 0.02


def test_a_taller_plant_carries_the_same_organs_below(kaite: Cultivar) -> None:
    tall = kaite.model_copy(update={"stem": kaite.stem.model_copy(update={"parts": 50})})
    counted = []
    for cultivar in (kaite, tall):
        plant = grow(cultivar, np.random.default_rng(6))
        counted.append([sorted(o.kind for o in plant.organs if o.phytomer == i) for i in range(40)])
    # Cuts descend with the height, so one in some places; all else is the same.
    plain = [
        [[k for k in kinds if k in ("petiole", "lamina", "side_shoot")] for kinds in one] for one in counted
    ]
    assert plain[0] == plain[1]


def test_more_fruit_is_more_fruit_at_the_same_nodes(kaite: Cultivar) -> None:
    node = kaite.organs["node"]
    slot = next(one for one in node.bears if one.name == "fruit")
    few = slot.model_copy(
        update={
            "what": slot.what.model_copy(
                update={"probabilities": {"peduncle": 0.19, "cut": 0.08, "none": 0.73}}
            )
        }
    )
    bears = tuple(few if one.name == "fruit" else one for one in node.bears)
    sparse = kaite.model_copy(
        update={"organs": {**kaite.organs, "node": node.model_copy(update={"bears": bears})}}
    )
    for seed in range(10):
        at = [
            {
                o.phytomer
                for form in ("peduncle", "cut")
                for o in grow(c, np.random.default_rng(seed)).of_form(form)
            }
            for c in (sparse, kaite)
        ]
        assert at[0] < at[1]


@pytest.mark.parametrize("share", [0.25, 0.75])
def test_shipped_stages_grow_in_between(kaite: Cultivar, share: float) -> None:
    from pepperscene.cultivar import load_cultivar

    february = load_cultivar("kaite_february")
    heights = [
        grow(cultivar, np.random.default_rng(1)).of_kind("node")[-1].curve[-1, 2]
        for cultivar in (february, interpolate_cultivars(february, kaite, share), kaite)
    ]
    assert heights == sorted(heights)

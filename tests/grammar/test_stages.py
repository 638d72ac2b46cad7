"""A plant at two dates is the same plant, grown: growth stages share every random number."""

import numpy as np

from pepperscene.cultivar import Cultivar, Distribution, interpolate_cultivars, load_cultivar
from pepperscene.grammar import Plant, draw_parameters, grow


def scale_sizes(cultivar: Cultivar, factor: float) -> Cultivar:
    """The same cultivar with all its lengths, widths and diameters scaled."""
    organs = {}
    for name, model in cultivar.organs.items():
        fields = {n: getattr(model, n) for n in type(model).model_fields}
        scaled = {
            n: _scale(distribution, factor)
            for n, distribution in model.distributions.items()
            if n in ("length", "width", "diameter")
        }
        organs[name] = type(model).model_construct(**fields | scaled)
    stem = cultivar.stem.model_copy(update={"diameter": _scale(cultivar.stem.diameter, factor)})
    return cultivar.model_copy(update={"organs": organs, "stem": stem})


def _scale(distribution: Distribution, factor: float) -> Distribution:
    update = {name: factor * getattr(distribution, name) for name in ("mean", "sd", "low", "high")}
    bins = tuple((factor * low, factor * high, weight) for low, high, weight in distribution.bins)
    return distribution.model_copy(update={**update, "bins": bins})


def topology(plant: Plant) -> list[tuple[str, int, int]]:
    return [(organ.kind, organ.parent, organ.phytomer) for organ in plant.organs]


def test_intermediate_stages_have_the_same_organs_and_intermediate_sizes(kaite: Cultivar) -> None:
    old = scale_sizes(kaite, 1.6)
    middle = interpolate_cultivars(kaite, old, 0.5)
    stages = [draw_parameters(c, np.random.default_rng(9)) for c in (kaite, middle, old)]
    for name in kaite.organs:
        first, between, last = (stage.organs[name] for stage in stages)
        assert np.array_equal(first.number, between.number)
        assert np.array_equal(first.parent, last.parent)
        for column in set(first.values) & {"length", "width", "diameter"}:
            low, value, high = (group.values[column] for group in (first, between, last))
            assert (low <= value + 1e-12).all()
            assert (value <= high + 1e-12).all()
            np.testing.assert_allclose(value, 0.5 * (low + high), rtol=0.01)
        # Numbers with the same distribution are bit-identical.
        for column in set(first.values) & {"seed", "roll", "lobes"}:
            assert np.array_equal(first.values[column], last.values[column]), (name, column)
    assert topology(grow(kaite, np.random.default_rng(9))) == topology(grow(old, np.random.default_rng(9)))


def test_a_small_step_in_time_moves_organs_a_little(kaite: Cultivar) -> None:
    old = scale_sizes(kaite, 1.6)
    before, after = (
        grow(interpolate_cultivars(kaite, old, fraction), np.random.default_rng(4))
        for fraction in (0.5, 0.501)
    )
    moved = [np.abs(a.curve - b.curve).max() for a, b in zip(before.organs, after.organs, strict=True)]
    assert 0.0 < max(moved) < 0.02


def test_more_fruit_keeps_the_nodes_of_less_fruit(kaite: Cultivar) -> None:
    node = kaite.organs["node"]
    fruit = next(slot for slot in node.bears if slot.name == "fruit")
    less = {"probabilities": {"peduncle": 0.19, "cut": 0.08, "none": 0.73}}
    few = fruit.model_copy(update={"what": fruit.what.model_copy(update=less)})
    bears = tuple(few if slot is fruit else slot for slot in node.bears)
    organs = {**kaite.organs, "node": node.model_copy(update={"bears": bears})}
    sparse = kaite.model_copy(update={"organs": organs})
    for seed in range(5):
        sparse_nodes, nodes = (
            {o.phytomer for form in ("peduncle", "cut") for o in plant.of_form(form)}
            for plant in (grow(c, np.random.default_rng(seed)) for c in (sparse, kaite))
        )
        assert sparse_nodes < nodes


def test_shipped_stages_grow_taller(kaite: Cultivar) -> None:
    february = load_cultivar("kaite_february")
    heights = [
        grow(cultivar, np.random.default_rng(1)).of_kind("node")[-1].curve[-1, 2]
        for cultivar in (february, interpolate_cultivars(february, kaite, 0.75), kaite)
    ]
    assert heights == sorted(heights)

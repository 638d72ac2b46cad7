"""Grown plants have the shapes, azimuths and branch counts that their cultivar states.

Curves of grown organs are measured, without the young top; sizes are measured on meshes, in
`laws/test_measured_plants.py`. Chi-squared and Kolmogorov-Smirnov tests at the significance 0.001.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from pepperscene.cultivar import Cultivar, Slot
from pepperscene.cultivar.notation import Choice
from pepperscene.grammar import Organ, Plant

SIGNIFICANCE = 1e-3


def mature(kaite: Cultivar) -> int:
    """Number of mature phytomers."""
    return kaite.stem.parts - kaite.stem.young_nodes


def organs_of(plants: list[Plant], kaite: Cultivar, kind: str) -> Iterator[Organ]:
    """Mature organs of a kind."""
    for plant in plants:
        yield from (organ for organ in plant.of_kind(kind) if organ.phytomer < mature(kaite))


def measures(kind: str, name: str, factor: float = 1.0) -> Callable[[list[Plant], Cultivar], list[float]]:
    return lambda plants, kaite: [factor * organ.measures[name] for organ in organs_of(plants, kaite, kind)]


SHAPES = [
    *(("lamina", name) for name in ("fold", "curl", "margin_wave", "blister", "vein", "asymmetry", "state")),
    *(("side_shoot", "state"), ("fruit", "taper"), ("fruit", "shoulder"), ("fruit", "ripeness_spread")),
]
MEASURE_NAMES = {"fold": "fold_rad", "curl": "curl_rad", "state": "state_mean"}


@pytest.mark.parametrize(("kind", "parameter"), SHAPES)
def test_shapes_follow_their_distributions(
    kaite: Cultivar, plants: list[Plant], kind: str, parameter: str
) -> None:
    stated = kaite.organs[kind].distributions[parameter]
    suffix = "_m" if parameter in ("margin_wave", "blister", "vein") else ""
    values = measures(kind, MEASURE_NAMES.get(parameter, parameter + suffix))(plants, kaite)
    # Kolmogorov-Smirnov test, with the quantile function inverted on a fine grid.
    grid = np.linspace(0.0, 1.0, 4001)
    probabilities = np.interp(values, stated.quantiles(grid), grid)
    assert stats.kstest(probabilities, "uniform").pvalue > SIGNIFICANCE


def test_width_and_length_of_leaves_are_correlated(kaite: Cultivar, plants: list[Plant]) -> None:
    model = kaite.organs["lamina"]
    sizes = np.array(
        [(o.measures["length_m"], o.measures["width_m"]) for o in organs_of(plants, kaite, "lamina")]
    )
    # Both correlate with the height (r) and, given that, with each other (c): r^2 + (1 - r^2) c. The standard
    # error of the estimate is (1 - correlation^2) / sqrt(n).
    height = 2.0 * math.sin(math.pi * model.distributions["length"].with_height / 6.0)
    expected = height**2 + (1.0 - height**2) * model.size_correlation
    assert np.corrcoef(sizes.T)[0, 1] == pytest.approx(
        expected, abs=4 * (1 - expected**2) / np.sqrt(len(sizes))
    )


def azimuths(organs: list[Organ]) -> NDArray[np.float64]:
    """Azimuths at which organs leave their nodes, degrees counter-clockwise from the aisle."""
    first = np.array([organ.curve[1] - organ.curve[0] for organ in organs])
    return np.degrees(np.arctan2(first[:, 0], -first[:, 1])) % 360.0


def slot(kaite: Cultivar, kind: str, name: str) -> Slot:
    return next(slot for slot in kaite.organs[kind].bears if slot.name == name)


@pytest.mark.parametrize(
    ("name", "kind"), [("leaf", "petiole"), ("shoot", "side_shoot"), ("fruit", "peduncle"), ("fruit", "cut")]
)
def test_azimuths_follow_their_histograms(kaite: Cultivar, plants: list[Plant], name: str, kind: str) -> None:
    # One organ per ten phytomers of a plant, since neighbours avoid each other.
    stated = slot(kaite, "node", name).azimuth
    assert stated is not None
    organs: list[Organ] = []
    for plant in plants:
        for tenth in range(4):
            here = [o for o in plant.of_kind(kind) if o.phytomer // 10 == tenth]
            organs += [organ for organ in here if plant.organs[organ.parent].kind == "node"][:1]
    edges = np.degrees([low for low, _, _ in stated.bins] + [stated.bins[-1][1]])
    # Petioles sway by half a degree within their first segment: negligible for bins of 45 degrees and more.
    counts, _ = np.histogram(azimuths(organs), edges)
    expected = counts.sum() * np.array([weight for _, _, weight in stated.bins])
    assert stats.chisquare(counts, expected).pvalue > SIGNIFICANCE


def test_leaves_avoid_the_leaf_below(plants: list[Plant]) -> None:
    steps = np.concatenate([np.diff(azimuths(list(plant.of_kind("petiole")))) % 360.0 for plant in plants])
    angle = np.minimum(steps, 360.0 - steps)
    assert np.mean(angle < 60.0) < 0.5 * 60.0 / 180.0  # less than half as often as by chance


def test_shoots_are_in_the_axils_of_leaves_and_fruit_opposite(plants: list[Plant]) -> None:
    same_side: dict[str, list[bool]] = {"side_shoot": [], "peduncle": []}
    for plant in plants:
        leaf = {o.phytomer: azimuths([o])[0] for o in plant.of_kind("petiole")}
        for kind, results in same_side.items():
            for organ in plant.of_kind(kind):
                if plant.organs[organ.parent].kind == "node" and organ.phytomer in leaf:
                    results.append(np.cos(np.radians(azimuths([organ])[0] - leaf[organ.phytomer])) > 0)
    assert np.mean(same_side["side_shoot"]) > 0.95
    assert np.mean(same_side["peduncle"]) < 0.1


def follows(choice: Choice, counts: Counter[str]) -> bool:
    names = [name for name, probability in choice.probabilities.items() if probability > 0]
    assert set(counts) <= set(names)
    total = sum(counts.values())
    expected = [total * choice.probabilities[name] for name in names]
    return bool(stats.chisquare([counts[name] for name in names], expected).pvalue > SIGNIFICANCE)


@pytest.mark.parametrize("name", ["leaf", "shoot", "fruit"])
def test_nodes_branch_by_their_probabilities(kaite: Cultivar, plants: list[Plant], name: str) -> None:
    # Flushes and harvest move fruit along the plant and keep its mean; counts then vary less than independent
    # ones, so the test is conservative.
    node_slot, counts = slot(kaite, "node", name), Counter[str]()
    for plant in plants:
        organs = [
            organ
            for organ in plant.organs
            if organ.kind in node_slot.kinds and plant.organs[organ.parent].kind == "node"
        ]
        # At most one per node.
        assert len({organ.parent for organ in organs}) == len(organs)
        counts["none"] += len(range(node_slot.first, kaite.stem.parts, node_slot.every)) - len(organs)
        counts.update(organ.kind for organ in organs)
    assert follows(node_slot.what, counts)


def test_shoots_end_by_their_probabilities(kaite: Cultivar, plants: list[Plant]) -> None:
    end, depth = slot(kaite, "side_shoot", "end"), kaite.organs["side_shoot"].depth
    assert depth is not None
    counts, ends = Counter[str](), Counter[str]()
    for plant in plants:
        children: dict[int, list[str]] = {i: [] for i, o in enumerate(plant.organs) if o.kind == "side_shoot"}
        for organ in plant.organs:
            if organ.parent in children:
                children[organ.parent].append(organ.kind)
        for index, kinds in children.items():
            counts[("one", "two", "three")[len(kinds) - 1]] += 1
            if shoot_depth(plant, index) < depth:
                ends.update(kinds)
            else:
                # At the depth limit only the other outcome is left.
                assert set(kinds) == {"shoot_petiole"}
    assert follows(end.count, counts)
    assert follows(end.what, ends)


def shoot_depth(plant: Plant, index: int) -> int:
    parent = plant.organs[index].parent
    return 1 + (shoot_depth(plant, parent) if plant.organs[parent].kind == "side_shoot" else 0)


def test_fruit_comes_in_flushes(kaite: Cultivar, plants: list[Plant]) -> None:
    # The probability of fruit or cut is a wave of random phase: nodes are correlated a wavelength apart, and
    # anticorrelated half a wavelength apart. Covariance at distance d: p^2 s^2 / 2 cos(2 pi d / period).
    fruiting = np.zeros((len(plants), kaite.stem.parts))
    for row, plant in enumerate(plants):
        fruiting[row, [o.phytomer for o in (*plant.of_kind("peduncle"), *plant.of_kind("cut"))]] = 1.0
    fruiting -= fruiting.mean()
    flush = slot(kaite, "node", "fruit").flush
    assert flush is not None
    half, full = round(flush.nodes.mean / 2), round(flush.nodes.mean)
    covariance = {d: np.mean(fruiting[:, d:] * fruiting[:, :-d]) for d in (1, half, full)}
    error = fruiting.var() / np.sqrt(fruiting.size)
    assert covariance[1] > 4 * error
    assert covariance[full] > 4 * error
    assert covariance[half] < -4 * error


def test_fruit_ripens_from_the_foot_in_the_stated_fractions(kaite: Cultivar, plants: list[Plant]) -> None:
    fruit = list(organs_of(plants, kaite, "fruit"))
    ripeness = np.array([organ.measures["ripeness"] for organ in fruit])
    height = np.array([organ.phytomer for organ in fruit])
    stated = kaite.organs["fruit"].distributions
    ripe, green = ripeness >= stated["ripe"].low, ripeness <= stated["unripe"].high
    fraction, breaker = stated["ripe_fraction"].mean, stated["breaker_fraction"].mean
    expected = len(fruit) * np.array([fraction - breaker / 2, breaker, 1 - fraction - breaker / 2])
    counts = [ripe.sum(), (~ripe & ~green).sum(), green.sum()]
    assert stats.chisquare(counts, expected).pvalue > SIGNIFICANCE
    assert stats.mannwhitneyu(height[ripe], height[green], alternative="less").pvalue < SIGNIFICANCE
    # Young fruit is green.
    young = [o for p in plants for o in p.of_kind("fruit") if o.phytomer >= mature(kaite)]
    assert young
    assert all(o.measures["ripeness"] <= stated["unripe"].high for o in young)


def test_cuts_are_lower_than_fruit(kaite: Cultivar, plants: list[Plant]) -> None:
    cuts, fruit = ([o.phytomer for o in organs_of(plants, kaite, kind)] for kind in ("cut", "fruit"))
    assert stats.mannwhitneyu(cuts, fruit, alternative="less").pvalue < SIGNIFICANCE


def test_numbers_of_lobes_follow_their_probabilities(kaite: Cultivar, plants: list[Plant]) -> None:
    lobes = kaite.organs["fruit"].lobes
    counts = Counter(o.measures["lobes"] for plant in plants for o in plant.of_kind("fruit"))
    expected = [sum(counts.values()) * probability for probability in lobes.numbers.values()]
    assert stats.chisquare([counts[float(n)] for n in lobes.numbers], expected).pvalue > SIGNIFICANCE

"""Grown plants have the sizes, azimuths and branch counts that their cultivar states.

Rationale: Barth et al. 2018 measured Table 1 with a ruler on plants; here the ruler is laid on the curves of
grown organs, so that everything between the file and the plant is in the test. Set-up: 200 plants with fixed
seeds, parts of the young top left out, as Table 1 is of grown parts. Expected: means and standard deviations
within four standard errors of the stated ones (a right program fails one such test in 16,000), chi-squared
tests at the significance 0.001.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from pepperscene.cultivar import Choice, Cultivar, Distribution, Slot
from pepperscene.grammar import Organ, Plant

SIGNIFICANCE = 1e-3


def grown(kaite: Cultivar) -> int:
    """Phytomers below this number are grown."""
    return kaite.stem.parts - kaite.stem.young_nodes


def of(plants: list[Plant], kaite: Cultivar, kind: str) -> Iterator[Organ]:
    """Grown organs of a kind."""
    for plant in plants:
        yield from (organ for organ in plant.of_kind(kind) if organ.phytomer < grown(kaite))


def along(organ: Organ) -> float:
    return float(np.linalg.norm(np.diff(organ.curve, axis=0), axis=1).sum())


def lengths(kind: str) -> Callable[[list[Plant], Cultivar], list[float]]:
    return lambda plants, kaite: [along(organ) for organ in of(plants, kaite, kind)]


def measures(kind: str, name: str, times: float = 1.0) -> Callable[[list[Plant], Cultivar], list[float]]:
    return lambda plants, kaite: [times * organ.measures[name] for organ in of(plants, kaite, kind)]


def node_spacing(plants: list[Plant], kaite: Cultivar) -> list[float]:
    found: list[float] = []
    for plant in plants:
        centres = np.array([(0, 0, 0), *(node.curve[1] for node in plant.of_kind("node"))])
        found += np.linalg.norm(np.diff(centres, axis=0), axis=1)[: grown(kaite)].tolist()
    return found


def stem_diameters(plants: list[Plant], kaite: Cultivar) -> list[float]:
    """One a plant: within a plant the diameters go together."""
    return [
        float(
            np.mean(
                [o.measures["radius_m"] + o.measures["radius_tip_m"] for o in of([p], kaite, "internode")]
            )
        )
        for p in plants
    ]


Ruler = Callable[[list[Plant], Cultivar], list[float]]
TABLE_1: dict[str, tuple[str, str, Ruler]] = {
    "I-1": ("internode", "length", node_spacing),
    "I-2": ("node", "width", measures("node", "radius_m", 2.0)),
    "L-4": ("petiole", "length", lengths("petiole")),
    "L-5": ("lamina", "length", lengths("lamina")),
    "L-6": ("lamina", "width", measures("lamina", "width_m")),
    "S-1": ("side_shoot", "length", lengths("side_shoot")),
    "S-6": ("shoot_petiole", "length", lengths("shoot_petiole")),
    "S-7": ("shoot_lamina", "length", lengths("shoot_lamina")),
    "S-8": ("shoot_lamina", "width", measures("shoot_lamina", "width_m")),
    "P-1 peduncle": ("peduncle", "length", lengths("peduncle")),
    "F-2": ("fruit", "diameter", measures("fruit", "diameter_m")),
    "P-1 stem": ("", "diameter", stem_diameters),
}


@pytest.mark.parametrize("name", TABLE_1)
def test_table_1_comes_back(kaite: Cultivar, plants: list[Plant], name: str) -> None:
    kind, parameter, ruler = TABLE_1[name]
    law: Distribution = kaite.organs[kind].distributions[parameter] if kind else kaite.stem.diameter
    found = np.array(ruler(plants, kaite))
    assert found.size >= len(plants)
    # A node is never thinner than its stem, which lifts the thinnest few: a tenth of a millimetre for I-2.
    slack = 1e-4 if name == "I-2" else 0.0
    assert abs(found.mean() - law.mean) < 4 * law.sd / np.sqrt(found.size) + slack
    # Standard error of a standard deviation from the fourth moment.
    fourth = np.mean((found - found.mean()) ** 4)
    error = np.sqrt((fourth - law.sd**4) / found.size) / (2 * law.sd)
    assert abs(found.std() - law.sd) < 4 * error + slack


SHAPES = [
    *(("lamina", name) for name in ("fold", "curl", "margin_wave", "blister", "vein", "asymmetry", "state")),
    *(("side_shoot", "state"), ("fruit", "taper"), ("fruit", "shoulder"), ("fruit", "ripeness_spread")),
]
CALLED = {"fold": "fold_rad", "curl": "curl_rad", "state": "state_mean"}


@pytest.mark.parametrize(("kind", "parameter"), SHAPES)
def test_shapes_follow_their_laws(kaite: Cultivar, plants: list[Plant], kind: str, parameter: str) -> None:
    law = kaite.organs[kind].distributions[parameter]
    suffix = "_m" if parameter in ("margin_wave", "blister", "vein") else ""
    found = measures(kind, CALLED.get(parameter, parameter + suffix))(plants, kaite)
    # Kolmogorov and Smirnov's test, with the law's own quantiles inverted on a fine grid.
    grid = np.linspace(0.0, 1.0, 4001)
    shares = np.interp(found, law.quantiles(grid), grid)
    assert stats.kstest(shares, "uniform").pvalue > SIGNIFICANCE


def test_leaves_are_as_wide_as_they_are_long(kaite: Cultivar, plants: list[Plant]) -> None:
    model = kaite.organs["lamina"]
    sizes = np.array([(o.measures["length_m"], o.measures["width_m"]) for o in of(plants, kaite, "lamina")])
    # Both follow the height and, about that, each other: correlations r^2 + (1 - r^2) c, and the
    # estimate's standard error is (1 - correlation^2) / sqrt(n).
    height = 2.0 * math.sin(math.pi * model.distributions["length"].with_height / 6.0)
    wanted = height**2 + (1.0 - height**2) * model.size_correlation
    assert np.corrcoef(sizes.T)[0, 1] == pytest.approx(wanted, abs=4 * (1 - wanted**2) / np.sqrt(len(sizes)))


def azimuths(organs: list[Organ]) -> NDArray[np.float64]:
    """Around the stem, degrees counter-clockwise from the aisle, where the organ leaves its node."""
    first = np.array([organ.curve[1] - organ.curve[0] for organ in organs])
    return np.degrees(np.arctan2(first[:, 0], -first[:, 1])) % 360.0


def slot(kaite: Cultivar, kind: str, name: str) -> Slot:
    return next(one for one in kaite.organs[kind].bears if one.name == name)


@pytest.mark.parametrize(
    ("name", "kind"), [("leaf", "petiole"), ("shoot", "side_shoot"), ("fruit", "peduncle"), ("fruit", "cut")]
)
def test_azimuths_follow_their_histograms(kaite: Cultivar, plants: list[Plant], name: str, kind: str) -> None:
    # One organ a plant and ten phytomers, since neighbours avoid each other.
    law = slot(kaite, "node", name).azimuth
    assert law is not None
    found = []
    for plant in plants:
        for tenth in range(4):
            here = [o for o in plant.of_kind(kind) if o.phytomer // 10 == tenth]
            found += [organ for organ in here if plant.organs[organ.parent].kind == "node"][:1]
    edges = np.degrees([low for low, _, _ in law.bins] + [law.bins[-1][1]])
    # Petioles sway, by half a degree within their first tenth: no matter for bins of 45 degrees and more.
    counts, _ = np.histogram(azimuths(found), edges)
    expected = counts.sum() * np.array([weight for _, _, weight in law.bins])
    assert stats.chisquare(counts, expected).pvalue > SIGNIFICANCE


def test_leaves_avoid_the_leaf_below(plants: list[Plant]) -> None:
    turned = []
    for plant in plants:
        turned += (np.diff(azimuths(list(plant.of_kind("petiole")))) % 360.0).tolist()
    off = np.minimum(turned, 360.0 - np.array(turned))
    assert np.mean(off < 60.0) < 0.5 * 60.0 / 180.0  # less than half as often as by chance


def test_a_shoot_grows_in_its_leafs_axil_and_fruit_away_from_it(plants: list[Plant]) -> None:
    near: dict[str, list[bool]] = {"side_shoot": [], "peduncle": []}
    for plant in plants:
        leaf = {o.phytomer: azimuths([o])[0] for o in plant.of_kind("petiole")}
        for kind, found in near.items():
            for organ in plant.of_kind(kind):
                if plant.organs[organ.parent].kind == "node" and organ.phytomer in leaf:
                    found.append(np.cos(np.radians(azimuths([organ])[0] - leaf[organ.phytomer])) > 0)
    assert np.mean(near["side_shoot"]) > 0.95
    assert np.mean(near["peduncle"]) < 0.1


def matches(choice: Choice, counts: Counter[str]) -> bool:
    names = [name for name, probability in choice.probabilities.items() if probability > 0]
    assert set(counts) <= set(names)
    total = sum(counts.values())
    expected = [total * choice.probabilities[name] for name in names]
    return bool(stats.chisquare([counts[name] for name in names], expected).pvalue > SIGNIFICANCE)


@pytest.mark.parametrize("name", ["leaf", "shoot", "fruit"])
def test_nodes_branch_by_their_probabilities(kaite: Cultivar, plants: list[Plant], name: str) -> None:
    # Flushes and harvest move fruit along the plant and keep its mean; they make the counts less random than
    # independent ones, so that the test is on the safe side.
    one, counts = slot(kaite, "node", name), Counter[str]()
    for plant in plants:
        carried = Counter(
            organ.parent
            for organ in plant.organs
            if organ.kind in one.kinds and plant.organs[organ.parent].kind == "node"
        )
        assert not carried or max(carried.values()) == 1
        counts["none"] += len(range(one.first, kaite.stem.parts, one.every)) - len(carried)
        counts.update(plant.organs[i].kind for i in _first_on_nodes(plant, one))
    assert matches(one.what, counts)


def _first_on_nodes(plant: Plant, one: Slot) -> Iterator[int]:
    for index, organ in enumerate(plant.organs):
        if organ.kind in one.kinds and plant.organs[organ.parent].kind == "node":
            yield index


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
                # At the depth the other outcomes keep their proportions.
                assert set(kinds) == {"shoot_petiole"}
    assert matches(end.count, counts)
    assert matches(end.what, ends)


def shoot_depth(plant: Plant, index: int) -> int:
    parent = plant.organs[index].parent
    return 1 + (shoot_depth(plant, parent) if plant.organs[parent].kind == "side_shoot" else 0)


def test_fruit_comes_in_flushes(kaite: Cultivar, plants: list[Plant]) -> None:
    # The chance of fruit or cut swings with a random phase: nodes a wave apart go together, those half a wave
    # apart do not. Covariance of neighbours at distance d: p^2 s^2 / 2 cos(2 pi d / period).
    fruiting = np.zeros((len(plants), kaite.stem.parts))
    for row, plant in enumerate(plants):
        fruiting[row, [o.phytomer for o in (*plant.of_kind("peduncle"), *plant.of_kind("cut"))]] = 1.0
    fruiting -= fruiting.mean()
    flush = slot(kaite, "node", "fruit").flush
    assert flush is not None
    half, whole = round(flush.nodes.mean / 2), round(flush.nodes.mean)
    apart = {d: np.mean(fruiting[:, d:] * fruiting[:, :-d]) for d in (1, half, whole)}
    error = fruiting.var() / np.sqrt(fruiting.size)
    assert apart[1] > 4 * error
    assert apart[whole] > 4 * error
    assert apart[half] < -4 * error


def test_fruit_ripens_from_the_foot_and_half_of_it_is_ripe(kaite: Cultivar, plants: list[Plant]) -> None:
    fruit = list(of(plants, kaite, "fruit"))
    ripeness = np.array([organ.measures["ripeness"] for organ in fruit])
    height = np.array([organ.phytomer for organ in fruit])
    laws = kaite.organs["fruit"].distributions
    ripe, green = ripeness >= laws["ripe"].low, ripeness <= laws["unripe"].high
    share, breaker = laws["ripe_fraction"].mean, laws["breaker_fraction"].mean
    expected = len(fruit) * np.array([share - breaker / 2, breaker, 1 - share - breaker / 2])
    counts = [ripe.sum(), (~ripe & ~green).sum(), green.sum()]
    assert stats.chisquare(counts, expected).pvalue > SIGNIFICANCE
    assert stats.mannwhitneyu(height[ripe], height[green], alternative="less").pvalue < SIGNIFICANCE
    # Where the plant still grows, all is green.
    young = [o for p in plants for o in p.of_kind("fruit") if o.phytomer >= grown(kaite)]
    assert young
    assert all(o.measures["ripeness"] <= laws["unripe"].high for o in young)


def test_cuts_are_where_fruit_was_oldest(kaite: Cultivar, plants: list[Plant]) -> None:
    cuts = [organ.phytomer for organ in of(plants, kaite, "cut")]
    fruit = [organ.phytomer for organ in of(plants, kaite, "fruit")]
    assert stats.mannwhitneyu(cuts, fruit, alternative="less").pvalue < SIGNIFICANCE


def test_lobes_are_as_many_as_stated(kaite: Cultivar, plants: list[Plant]) -> None:
    lobes = kaite.organs["fruit"].lobes
    found = Counter(o.measures["lobes"] for plant in plants for o in plant.of_kind("fruit"))
    expected = [sum(found.values()) * share for share in lobes.numbers.values()]
    assert stats.chisquare([found[float(n)] for n in lobes.numbers], expected).pvalue > SIGNIFICANCE


def test_blades_hang_as_stated(kaite: Cultivar, plants: list[Plant]) -> None:
    # Slope of the midrib's middle segment; sway tilts it out of its plane a little, hence half a degree.
    law = kaite.organs["lamina"].distributions["inclination"]
    blades = [(plant.organs[o.parent], o) for plant in plants for o in of([plant], kaite, "lamina")]
    middle = np.array([o.curve[7] - o.curve[6] for _, o in blades])
    outward = np.array([petiole.curve[1] - petiole.curve[0] for petiole, _ in blades])[:, :2]
    forward = (middle[:, :2] * outward).sum(axis=1) / np.linalg.norm(outward, axis=1)
    found = np.arctan2(middle[:, 2], forward)
    assert found.mean() == pytest.approx(law.mean, abs=4 * law.sd / np.sqrt(found.size) + np.radians(0.5))
    assert found.std() == pytest.approx(law.sd, rel=0.05)


@pytest.mark.parametrize(
    ("kind", "end"), [("petiole", 0), ("side_shoot", 0), ("peduncle", 0), ("peduncle", -1)]
)
def test_stalks_leave_and_end_at_their_inclination(
    kaite: Cultivar, plants: list[Plant], kind: str, end: int
) -> None:
    law = kaite.organs[kind].distributions["end_inclination" if end else "inclination"]
    organs = list(of(plants, kaite, kind))
    step = np.array([np.diff(o.curve, axis=0)[end] for o in organs])
    found = np.arcsin(step[:, 2] / np.linalg.norm(step, axis=1))
    # A segment is half a segment away from the end: an eighteenth of the bend, five degrees for peduncles.
    slack = np.radians(5.0 if kind == "peduncle" else 1.5)
    assert found.mean() == pytest.approx(law.mean, abs=4 * law.sd / np.sqrt(found.size) + slack)
    assert found.std() == pytest.approx(law.sd, rel=0.08)

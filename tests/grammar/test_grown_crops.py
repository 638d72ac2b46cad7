"""Another crop is another file: compound leaves, trusses, and slots of every sort.

Rationale: the forms are the only closed list. Set-up: the shipped tomato, and sweet peppers with slots of
their own. Expected: what the file says, by count and by angle; chi-squared at the significance 0.001.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from pepperscene.cultivar import Cultivar, load_cultivar
from pepperscene.grammar import Organ, Plant, build_plant, draw_parameters, grow

SIGNIFICANCE = 1e-3


def children(plant: Plant) -> dict[int, list[Organ]]:
    found: dict[int, list[Organ]] = defaultdict(list)
    for organ in plant.organs[1:]:
        found[organ.parent].append(organ)
    return found


def place(parent: Organ, child: Organ) -> float:
    """Where a child starts along its parent, 0 base to 1 tip."""
    step = np.diff(parent.curve, axis=0)
    along = np.clip(
        ((child.curve[0] - parent.curve[:-1]) * step).sum(axis=1) / (step**2).sum(axis=1), 0.0, 1.0
    )
    nearest = parent.curve[:-1] + along[:, None] * step
    best = int(np.argmin(np.linalg.norm(child.curve[0] - nearest, axis=1)))
    return float((best + along[best]) / len(step))


def azimuth(organ: Organ) -> float:
    """Of its first part, radians counter-clockwise from the aisle."""
    first = organ.curve[1] - organ.curve[0]
    return float(np.arctan2(first[0], -first[1]))


def apart(one: float, other: float) -> float:
    """Signed angle from the other to the one."""
    return float((one - other + np.pi) % (2.0 * np.pi) - np.pi)


def headings(plant: Plant, parent: int, kind: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place of each child along an organ, and its azimuth against the organ's there."""
    organ = plant.organs[parent]
    mine = [child for child in children(plant)[parent] if child.kind == kind]
    # The organ's own azimuth at its base; its sway is added along it.
    return np.array([place(organ, child) for child in mine]), np.array(
        [apart(azimuth(child), azimuth(organ)) for child in mine]
    )


def test_leaflets_stand_in_pairs_where_the_file_says(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    slots = {slot.name: slot for slot in tomato.organs["rachis"].bears}
    leaves = leaflets = 0
    for plant in tomatoes[:10]:
        for index, organ in enumerate(plant.organs):
            if organ.kind == "rachis":
                leaves += 1
                for name, kind in (("pairs", "petiolule"), ("between", "small_leaflet")):
                    places, turned = headings(plant, index, kind)
                    leaflets += len(places)
                    distance = np.abs(places[:, None] - slots[name].at)
                    assert (distance.min(axis=1) < 1e-6).all()
                    # One to either side: no two of one place to the same one.
                    seen = set(zip(distance.argmin(axis=1).tolist(), (turned > 0).tolist(), strict=True))
                    assert len(seen) == len(places)
                ends = [child for child in children(plant)[index] if child.kind == "terminal_leaflet"]
                assert len(ends) == 1
                np.testing.assert_allclose(ends[0].curve[0], organ.curve[-1], atol=1e-12)
    assert leaflets > 7 * leaves


def test_leaflets_leave_their_rachis_at_the_stated_angle(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    slot = next(one for one in tomato.organs["rachis"].bears if one.name == "pairs")
    assert slot.aside is not None
    found = []
    for plant in tomatoes:
        sway = {int(n): s for n, s in sways(tomato, plant)}
        for index, organ in enumerate(plant.organs):
            if organ.kind == "rachis":
                places, turned = headings(plant, index, "petiolule")
                # Against the direction of the rachis there, from its base's half a segment in.
                found += np.abs(turned - sway[index] * (places - 1 / 18)).tolist()
    error = 4 * slot.aside.sd / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(slot.aside.mean, abs=error + np.radians(0.5))
    assert np.std(found) == pytest.approx(slot.aside.sd, rel=0.1)


def sways(tomato: Cultivar, plant: Plant) -> list[tuple[int, float]]:
    """Sway of each rachis, read off its curve: the turn of its azimuth from base to tip."""
    found = []
    for index, organ in enumerate(plant.organs):
        if organ.kind == "rachis":
            step = np.diff(organ.curve, axis=0)
            # Out of the vertical plane of its azimuth, which its first segment has but for an eighteenth.
            base = azimuth(organ)
            aside = np.array([np.cos(base), np.sin(base), 0.0])
            out = np.arcsin(step @ aside / np.linalg.norm(step, axis=1))
            found.append((index, float(out[-1] / (8 / 9))))
    return found


def test_leaflets_lie_in_the_plane_of_their_leaf(tomatoes: list[Plant]) -> None:
    # Their roll, fold and twist are drawn about it; by chance alone the mean would be far lower.
    found = []
    for plant in tomatoes[:20]:
        for organ in plant.of_kind("petiolule"):
            rachis = plant.organs[organ.parent]
            step = np.diff(rachis.curve, axis=0)
            tangent = step[round(place(rachis, organ) * (len(step) - 1))]
            side = np.cross(tangent, [0.0, 0.0, 1.0])
            up = np.cross(side, tangent)
            along = organ.curve[1] - organ.curve[0]
            up -= (up @ along) / (along @ along) * along
            found.append(organ.up @ up / np.linalg.norm(up))
    assert np.min(found) > 0.9


def test_trusses_stand_at_every_third_node(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    for kind in ("truss", "flower_truss"):
        chance = np.zeros(tomato.stem.parts)
        for slot in tomato.organs["node"].bears:
            chance[slot.first :: slot.every] += slot.what.probabilities.get(kind, 0.0)
        counts = np.zeros(tomato.stem.parts)
        for plant in tomatoes:
            nodes = [organ.phytomer for organ in plant.of_kind(kind)]
            assert len(nodes) == len(set(nodes))
            counts[nodes] += 1.0
        assert not counts[chance == 0.0].any()
        assert set(np.diff(np.flatnonzero(chance))) == {3}
        # A sum of independent yes and no within four standard errors.
        error = np.sqrt(len(tomatoes) * (chance * (1.0 - chance)).sum())
        assert abs(counts.sum() - len(tomatoes) * chance.sum()) < 4 * error


def test_no_leaves_below_the_first(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    slot = next(one for one in tomato.organs["node"].bears if one.name == "leaf")
    assert min(o.phytomer for plant in tomatoes for o in plant.of_kind("rachis")) == slot.first


def test_pedicels_alternate_along_the_truss(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    at = np.array(tomato.organs["truss"].bears[0].at)
    first_sides = []
    for plant in tomatoes:
        for index, organ in enumerate(plant.organs):
            if organ.kind == "truss":
                places, turned = headings(plant, index, "pedicel")
                spot = np.abs(places[:, None] - at).argmin(axis=1)
                # By their place, whether or not the one before has set.
                sides = np.sign(turned) * np.where(spot % 2 == 0, 1, -1)
                assert abs(sides.sum()) == len(sides)
                first_sides.append(sides[0] > 0)
    # The first side is left to chance.
    assert stats.binomtest(int(np.sum(first_sides)), len(first_sides)).pvalue > SIGNIFICANCE


def test_every_pedicel_bears_a_fruit_on_its_calyx(tomatoes: list[Plant]) -> None:
    for plant in tomatoes[:10]:
        below = children(plant)
        for index, organ in enumerate(plant.organs):
            if organ.kind == "pedicel":
                (calyx,) = below[index]
                assert calyx.kind == "calyx"
            if organ.kind == "calyx":
                assert [child.kind for child in below[index]] == ["fruit"]


def test_fruit_is_smaller_up_the_stem(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    law = tomato.organs["fruit"].distributions["diameter"]
    fruit = [o for plant in tomatoes for o in plant.of_kind("fruit")]
    grown = tomato.stem.parts - tomato.stem.young_nodes
    for phytomer in (5, 14, 23):
        found = [o.measures["diameter_m"] for o in fruit if o.phytomer == phytomer]
        mean = float(law.quantiles(0.5, (phytomer + 0.5) / grown))
        assert np.mean(found) == pytest.approx(mean, abs=4 * law.sd / np.sqrt(len(found)) + 1e-3)


def written(folder: Path, text: str) -> Cultivar:
    path = folder / "mine.toml"
    path.write_text('extends = "kaite"\nname = "Mine"\n' + text)
    return load_cultivar(path)


def test_a_fruit_without_calyx_hangs_from_its_stalk(tmp_path: Path) -> None:
    plant = grow(written(tmp_path, "[organs.fruit]\ncalyx = false\n"), np.random.default_rng(1))
    assert not plant.of_form("calyx")
    fruit = plant.of_kind("fruit")
    assert fruit
    for organ in fruit:
        assert plant.organs[organ.parent].kind == "peduncle"
        np.testing.assert_array_equal(organ.curve[0], plant.organs[organ.parent].curve[-1])


SHOOT = """
[[organs.side_shoot.bears]]
name = "end"
what = {{ shoot_petiole = 1, chosen = "for a test" }}
count = {{ {count} = 1, chosen = "for a test" }}
spread = {{ value_deg = 40, chosen = "for a test" }}
"""


@pytest.mark.parametrize(("count", "number"), [("two", 2), ("five", 5)])
def test_several_at_one_place_fan_out(tmp_path: Path, count: str, number: int) -> None:
    plant = grow(written(tmp_path, SHOOT.format(count=count)), np.random.default_rng(2))
    below = children(plant)
    for index, organ in enumerate(plant.organs):
        if organ.kind == "side_shoot":
            fan = [azimuth(child) for child in below[index]]
            assert len(fan) == number
            # The petioles' own sway turns their first part by up to a degree.
            for one, other in pairwise(fan):
                assert np.degrees(apart(other, one)) == pytest.approx(40.0, abs=3.0)


def test_a_plant_that_never_ends_is_refused(kaite: Cultivar) -> None:
    # A file of this sort is not read; made by hand it stops all the same.
    shoot = kaite.organs["side_shoot"]
    what = shoot.bears[0].what.model_copy(update={"probabilities": {"shoot_petiole": 0.0, "side_shoot": 1.0}})
    slot = shoot.bears[0].model_copy(update={"what": what})
    endless = shoot.model_copy(update={"depth": None, "bears": (slot,)})
    organs = {**kaite.organs, "side_shoot": endless}
    with pytest.raises(ValueError, match="without end"):
        grow(kaite.model_copy(update={"organs": organs}), np.random.default_rng(0))


def test_a_bare_stem_grows(kaite: Cultivar) -> None:
    node = kaite.organs["node"].model_copy(update={"bears": ()})
    stem = kaite.stem.model_copy(update={"parts": 3, "young_nodes": 0})
    bare = kaite.model_copy(update={"stem": stem, "organs": {**kaite.organs, "node": node}})
    parameters = draw_parameters(bare, np.random.default_rng(0))
    plant = build_plant(parameters)
    assert [organ.kind for organ in plant.organs] == ["internode", "node"] * 3
    assert set(parameters.organs) == set(bare.organs)

"""Another crop is another file: compound leaves, trusses, and all types of slots.

Rationale: only the forms are fixed. Set-up: the shipped tomato, and sweet peppers with other slots.
Expected: what the file says, by count and by angle; chi-squared at the significance 0.001.
"""

from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from pepperscene.cultivar import Cultivar, load_cultivar
from pepperscene.errors import InputError
from pepperscene.grammar import Organ, Plant, build_plant, draw_parameters, grow

SIGNIFICANCE = 1e-3


def children(plant: Plant) -> dict[int, list[Organ]]:
    result: dict[int, list[Organ]] = defaultdict(list)
    for organ in plant.organs[1:]:
        result[organ.parent].append(organ)
    return result


def position(parent: Organ, child: Organ) -> float:
    """Start of a child along its parent, 0 base to 1 tip."""
    step = np.diff(parent.curve, axis=0)
    along = np.clip(
        ((child.curve[0] - parent.curve[:-1]) * step).sum(axis=1) / (step**2).sum(axis=1), 0.0, 1.0
    )
    nearest = parent.curve[:-1] + along[:, None] * step
    segment = int(np.argmin(np.linalg.norm(child.curve[0] - nearest, axis=1)))
    return float((segment + along[segment]) / len(step))


def azimuth(organ: Organ) -> float:
    """Azimuth of its first segment, radians counter-clockwise from the aisle."""
    first = organ.curve[1] - organ.curve[0]
    return float(np.arctan2(first[0], -first[1]))


def angle_between(a: float, b: float) -> float:
    """Signed angle from b to a."""
    return float((a - b + np.pi) % (2.0 * np.pi) - np.pi)


def placement(plant: Plant, parent: int, kind: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position of each child of a kind along an organ, and its azimuth relative to the organ's base."""
    organ = plant.organs[parent]
    organs = [child for child in children(plant)[parent] if child.kind == kind]
    return np.array([position(organ, child) for child in organs]), np.array(
        [angle_between(azimuth(child), azimuth(organ)) for child in organs]
    )


def test_leaflets_are_in_pairs_at_the_stated_positions(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    slots = {slot.name: slot for slot in tomato.organs["rachis"].bears}
    leaves = leaflets = 0
    for plant in tomatoes[:10]:
        for index, organ in enumerate(plant.organs):
            if organ.kind == "rachis":
                leaves += 1
                for name, kind in (("pairs", "petiolule"), ("between", "small_leaflet")):
                    positions, turns = placement(plant, index, kind)
                    leaflets += len(positions)
                    distance = np.abs(positions[:, None] - slots[name].at)
                    assert (distance.min(axis=1) < 1e-6).all()
                    # At most one on each side of a position.
                    sides = set(zip(distance.argmin(axis=1).tolist(), (turns > 0).tolist(), strict=True))
                    assert len(sides) == len(positions)
                (end,) = (child for child in children(plant)[index] if child.kind == "terminal_leaflet")
                np.testing.assert_allclose(end.curve[0], organ.curve[-1], atol=1e-12)
    assert leaflets > 7 * leaves


def sway(organ: Organ) -> float:
    """Sway of a rachis, from its curve: the angle of its last segment out of the plane of its azimuth."""
    step = np.diff(organ.curve, axis=0)
    base = azimuth(organ)
    out = np.arcsin(step @ [np.cos(base), np.sin(base), 0.0] / np.linalg.norm(step, axis=1))
    # The first segment already has an eighteenth of it, and the last one misses as much.
    return float(out[-1] / (8 / 9))


def test_leaflets_leave_their_rachis_at_the_stated_angle(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    aside = next(slot for slot in tomato.organs["rachis"].bears if slot.name == "pairs").aside
    assert aside is not None
    angles = []
    for plant in tomatoes:
        for index, organ in enumerate(plant.organs):
            if organ.kind == "rachis":
                positions, turns = placement(plant, index, "petiolule")
                # Relative to the direction of the rachis there, from the middle of its first segment.
                angles += np.abs(turns - sway(organ) * (positions - 1 / 18)).tolist()
    error = 4 * aside.sd / np.sqrt(len(angles))
    assert np.mean(angles) == pytest.approx(aside.mean, abs=error + np.radians(0.5))
    assert np.std(angles) == pytest.approx(aside.sd, rel=0.1)


def test_trusses_are_at_every_third_node(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    for kind in ("truss", "flower_truss"):
        probability = np.zeros(tomato.stem.parts)
        for slot in tomato.organs["node"].bears:
            probability[slot.first :: slot.every] += slot.what.probabilities.get(kind, 0.0)
        counts = np.zeros(tomato.stem.parts)
        for plant in tomatoes:
            nodes = [organ.phytomer for organ in plant.of_kind(kind)]
            assert len(nodes) == len(set(nodes))
            counts[nodes] += 1.0
        assert not counts[probability == 0.0].any()
        assert set(np.diff(np.flatnonzero(probability))) == {3}
        # A sum of independent Bernoulli variables, within four standard errors.
        error = np.sqrt(len(tomatoes) * (probability * (1.0 - probability)).sum())
        assert abs(counts.sum() - len(tomatoes) * probability.sum()) < 4 * error


def test_pedicels_alternate_along_the_truss(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    at = np.array(tomato.organs["truss"].bears[0].at)
    first_sides = []
    for plant in tomatoes:
        for index, organ in enumerate(plant.organs):
            if organ.kind == "truss":
                positions, turns = placement(plant, index, "pedicel")
                # By position, whether or not the one before has set.
                order = np.abs(positions[:, None] - at).argmin(axis=1)
                sides = np.sign(turns) * np.where(order % 2 == 0, 1, -1)
                assert abs(sides.sum()) == len(sides)
                first_sides.append(sides[0] > 0)
    # The first side is random.
    assert stats.binomtest(int(np.sum(first_sides)), len(first_sides)).pvalue > SIGNIFICANCE


def test_fruit_size_follows_its_curve_along_the_stem(tomato: Cultivar, tomatoes: list[Plant]) -> None:
    diameter = tomato.organs["fruit"].distributions["diameter"]
    fruit = [o for plant in tomatoes for o in plant.of_kind("fruit")]
    mature = tomato.stem.parts - tomato.stem.young_nodes
    for phytomer in (5, 14, 23):
        values = [o.measures["diameter_m"] for o in fruit if o.phytomer == phytomer]
        mean = float(diameter.quantiles(0.5, (phytomer + 0.5) / mature))
        assert np.mean(values) == pytest.approx(mean, abs=4 * diameter.sd / np.sqrt(len(values)) + 1e-3)


def child_of_kaite(folder: Path, text: str) -> Cultivar:
    path = folder / "child.toml"
    path.write_text('extends = "kaite"\nname = "Child"\n' + text)
    return load_cultivar(path)


def test_a_fruit_without_calyx_hangs_from_its_stalk(tmp_path: Path) -> None:
    plant = grow(child_of_kaite(tmp_path, "[organs.fruit]\ncalyx = false\n"), np.random.default_rng(1))
    assert not plant.of_form("calyx")
    assert plant.of_kind("fruit")
    for organ in plant.of_kind("fruit"):
        assert plant.organs[organ.parent].kind == "peduncle"
        np.testing.assert_array_equal(organ.curve[0], plant.organs[organ.parent].curve[-1])


SHOOT = """
[[organs.side_shoot.bears]]
name = "end"
what = { shoot_petiole = 1, chosen = "for a test" }
count = { five = 1, chosen = "for a test" }
spread = { value_deg = 40, chosen = "for a test" }
"""


def test_items_at_one_position_fan_out(tmp_path: Path) -> None:
    plant = grow(child_of_kaite(tmp_path, SHOOT), np.random.default_rng(2))
    below = children(plant)
    for index, organ in enumerate(plant.organs):
        if organ.kind == "side_shoot":
            fan = [azimuth(child) for child in below[index]]
            assert len(fan) == 5
            # The petioles' own sway turns their first segment by up to a degree.
            for a, b in pairwise(fan):
                assert np.degrees(angle_between(b, a)) == pytest.approx(40.0, abs=3.0)


def test_a_valid_recursion_with_too_many_organs_is_one_sentence(tmp_path: Path) -> None:
    text = """
[organs.side_shoot]
depth = 8
[[organs.side_shoot.bears]]
name = "more"
what = { side_shoot = 1, chosen = "for a test" }
count = { twelve = 1, chosen = "for a test" }
pairs = true
aside = { value_deg = 40, chosen = "for a test" }
"""
    cultivar = child_of_kaite(tmp_path, text)
    with pytest.raises(InputError, match=r"organs[.]\w+: grows more than 200,000 organs on a plant") as error:
        grow(cultivar, np.random.default_rng(0))
    assert "\n" not in str(error.value)


def test_a_bare_stem_grows(kaite: Cultivar) -> None:
    node = kaite.organs["node"].model_copy(update={"bears": ()})
    stem = kaite.stem.model_copy(update={"parts": 3, "young_nodes": 0})
    bare = kaite.model_copy(update={"stem": stem, "organs": {**kaite.organs, "node": node}})
    parameters = draw_parameters(bare, np.random.default_rng(0))
    plant = build_plant(parameters)
    assert [organ.kind for organ in plant.organs] == ["internode", "node"] * 3
    assert set(parameters.organs) == set(bare.organs)

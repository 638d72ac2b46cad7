"""Consistency of a plant: what grows where, and how parts join."""

import numpy as np
import pytest

from pepperscene.cultivar import CALYX, Cultivar
from pepperscene.grammar import Organ, Plant, grow


def form(plant: Plant, organ: Organ) -> str:
    return plant.kinds[organ.kind].form


@pytest.fixture(scope="module")
def both_crops(plants: list[Plant], tomatoes: list[Plant]) -> list[Plant]:
    return plants[:20] + tomatoes[:10]


def test_parents_are_those_of_the_file_and_come_first(
    kaite: Cultivar, tomato: Cultivar, both_crops: list[Plant]
) -> None:
    bearers = {
        cultivar.name: {
            kind: {on for on, model in cultivar.organs.items() for slot in model.bears if kind in slot.kinds}
            for kind in cultivar.organs
        }
        for cultivar in (kaite, tomato)
    }
    for plant in both_crops:
        allowed = bearers[plant.cultivar]
        for index, organ in enumerate(plant.organs):
            assert organ.parent < index
            parent = plant.organs[organ.parent]
            match form(plant, organ):
                case "internode":
                    assert index == 0 or parent.kind == "node"
                case "node":
                    assert parent.kind == "internode"
                case "fruit":
                    assert parent.kind == CALYX
                    assert plant.organs[parent.parent].kind in allowed[organ.kind]
                case "calyx":
                    assert form(plant, plant.organs[index + 1]) == "fruit"
                case _:
                    assert parent.kind in allowed[organ.kind]
            if index:
                assert organ.phytomer == parent.phytomer + (organ.kind == "internode")


def test_curves_start_on_their_parents(both_crops: list[Plant]) -> None:
    for plant in both_crops:
        for organ in plant.organs[1:]:
            parent = plant.organs[organ.parent]
            if parent.kind == "node" and organ.kind != "internode":
                # Inside the swelling, away from its axis.
                distance = np.linalg.norm(organ.curve[0] - parent.curve[1])
                radius = parent.measures["radius_m"]
                half = 0.5 * np.linalg.norm(np.diff(parent.curve, axis=0), axis=1).sum()
                assert 0.5 * radius < distance < np.hypot(radius, half)
            else:
                # On the centreline, and at its tip unless the file has another position.
                step = np.diff(parent.curve, axis=0)
                along = ((organ.curve[0] - parent.curve[:-1]) * step).sum(axis=1) / (step**2).sum(axis=1)
                nearest = parent.curve[:-1] + np.clip(along, 0.0, 1.0)[:, None] * step
                assert np.linalg.norm(organ.curve[0] - nearest, axis=1).min() < 1e-9
                if organ.kind in ("lamina", "shoot_lamina", "terminal_leaflet", "fruit", CALYX):
                    np.testing.assert_allclose(organ.curve[0], parent.curve[-1], rtol=0, atol=1e-12)


def test_blades_leave_their_stalks_without_a_kink(both_crops: list[Plant]) -> None:
    checked = 0
    for plant in both_crops:
        for blade in plant.of_form("blade"):
            stalk = plant.organs[blade.parent]
            if np.allclose(blade.curve[0], stalk.curve[-1], atol=1e-9):
                before, after = stalk.curve[-1] - stalk.curve[-2], blade.curve[1] - blade.curve[0]
                cosine = before @ after / np.linalg.norm(before) / np.linalg.norm(after)
                # Both bend within their last and first segment.
                assert cosine > np.cos(np.radians(45.0))
                checked += 1
    assert checked > 1000


def test_the_stem_follows_its_twine(kaite: Cultivar, plants: list[Plant]) -> None:
    # The twine hangs in the plane across the row; the stem winds around it within a few centimetres.
    lean = max(abs(kaite.stem.lean.low), abs(kaite.stem.lean.high))
    for plant in plants:
        nodes = np.array([node.curve[1] for node in plant.of_kind("node")])
        assert np.all(np.diff(nodes[:, 2]) > 0)
        assert np.abs(nodes[:, 0]).max() < 0.08
        assert np.abs(nodes[:, 1]).max() < 0.08 + np.tan(lean) * nodes[-1, 2]
    # 36 grown internodes of 99 mm and four shorter ones; the deviation between plants is 75 mm.
    heights = [plant.of_kind("node")[-1].curve[-1, 2] for plant in plants]
    assert np.mean(heights) == pytest.approx(3.75, abs=0.03)


def test_lean_is_added_towards_the_aisle(kaite: Cultivar) -> None:
    for seed in range(5):
        upright, leaning = (grow(kaite, np.random.default_rng(seed), lean) for lean in (0.0, 0.15))
        top, moved = (plant.of_kind("node")[-1].curve[1] for plant in (upright, leaning))
        assert np.arctan2(top[1] - moved[1], moved[2]) == pytest.approx(0.15, abs=0.01)
        # No other draw changes.
        assert [o.measures for o in upright.organs] == [o.measures for o in leaning.organs]


def test_the_young_top_is_small_pale_and_upright(kaite: Cultivar, plants: list[Plant]) -> None:
    young, mature = (
        [organ for plant in plants for organ in plant.of_kind("lamina") if organ.phytomer == phytomer]
        for phytomer in (kaite.stem.parts - 1, 20)
    )
    for name in ("length_m", "width_m", "state_mean", "blister_m"):
        assert np.mean([o.measures[name] for o in young]) < 0.9 * np.mean([o.measures[name] for o in mature])
    rise = [
        np.mean([(o.curve[-1] - o.curve[0])[2] / o.measures["length_m"] for o in organs])
        for organs in (young, mature)
    ]
    assert rise[0] > rise[1] + 0.3
    stem = np.array([[o.measures["radius_tip_m"] for o in p.of_kind("internode")] for p in plants])
    assert (np.diff(stem, axis=1) < 1e-12).all()


def test_states_and_radii_are_continuous_along_the_stem(both_crops: list[Plant]) -> None:
    for plant in both_crops:
        # Each organ varies by its own number.
        assert len({organ.measures["seed"] for organ in plant.organs}) == len(plant.organs)
        internodes, nodes = plant.of_form("internode"), plant.of_form("node")
        for below, node, above in zip(internodes[:-1], nodes[:-1], internodes[1:], strict=True):
            assert below.measures["state_tip"] == above.measures["state_mean"]
            assert below.measures["state_tip"] == pytest.approx(node.measures["state_mean"], abs=0.05)
            assert below.measures["radius_tip_m"] == node.measures["radius_start_m"]
            assert node.measures["radius_end_m"] == above.measures["radius_m"]
        # From an old foot to a young top.
        assert internodes[0].measures["state_mean"] < internodes[-1].measures["state_tip"] - 0.1

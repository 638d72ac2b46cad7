"""Crops other than sweet pepper and tomato: what grows, its sizes, labels and contacts.

Rationale: a crop is a file, and its plants must be valid throughout the program. Set-up: some
plants of each.
"""

import numpy as np
import pytest

from pepperscene import grow_plant, load_cultivar
from pepperscene.classes import OrganClass
from pepperscene.grammar import grow

CROPS = ("cucumber", "eggplant")


@pytest.fixture(scope="module")
def grown():
    """Two plants of each crop with contacts resolved."""
    return {name: [grow_plant(name, seed=seed, detail=0.4) for seed in range(2)] for name in CROPS}


@pytest.mark.parametrize("name", CROPS)
def test_every_kind_grows(name):
    cultivar = load_cultivar(name)
    plants = [grow(cultivar, np.random.default_rng(seed)) for seed in range(10)]
    assert {organ.kind for plant in plants for organ in plant.organs} == set(cultivar.present_kinds)


@pytest.mark.parametrize("name", CROPS)
def test_classes_and_contacts(name, grown):
    for plant in grown[name]:
        classes = set(np.unique(plant.mesh.face_class))
        assert {OrganClass.LEAF, OrganClass.PEPPER, OrganClass.PEDUNCLE, OrganClass.STEM} <= classes
        assert np.isfinite(plant.mesh.vertices).all()
        assert plant.contacts.fruit_touching == 0
        assert plant.contacts.blades_touching == 0


def test_a_cucumber_has_one_leaf_and_one_fruit_at_a_node():
    cultivar = load_cultivar("cucumber")
    for seed in range(10):
        plant = grow(cultivar, np.random.default_rng(seed))
        for kind in ("petiole", "fruit_stalk", "tendril"):
            nodes = [organ.phytomer for organ in plant.of_kind(kind)]
            assert len(nodes) == len(set(nodes))
        fruit = plant.of_form("fruit")
        assert min(organ.phytomer for organ in fruit) >= 8
        assert not plant.of_form("calyx")


def test_cucumbers_are_long_and_hang_and_the_lowest_are_the_largest():
    cultivar = load_cultivar("cucumber")
    plants = [grow(cultivar, np.random.default_rng(seed)) for seed in range(20)]
    fruit = [organ for plant in plants for organ in plant.of_form("fruit")]
    ready = [organ.measures for organ in fruit if organ.measures["ripeness"] >= 0.85]
    others = [organ.measures for organ in fruit if organ.measures["ripeness"] < 0.85]
    lengths = [measures["length_m"] for measures in ready]
    assert 0.29 < np.mean(lengths) < 0.34
    assert 0.04 < np.mean([measures["diameter_m"] for measures in ready]) < 0.045
    assert np.mean(lengths) > 2 * np.mean([measures["length_m"] for measures in others])
    assert 0 < len(ready) < len(others)
    for organ in fruit:
        axis = organ.curve[-1] - organ.curve[0]
        assert axis[2] < -0.9 * np.linalg.norm(axis)


def test_eggplants_have_a_flower_or_a_fruit_at_every_third_node():
    cultivar = load_cultivar("eggplant")
    for seed in range(10):
        plant = grow(cultivar, np.random.default_rng(seed))
        nodes = {organ.phytomer for kind in ("fruit_stalk", "flower_stalk") for organ in plant.of_kind(kind)}
        assert {node % 3 for node in nodes} <= {1, 2}

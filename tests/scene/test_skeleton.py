"""Centrelines lie inside the bodies that their organs have in the scene."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import load_recipe
from pepperscene.dataset.scenes.scene_builder import SceneBuilder
from pepperscene.geometry import Motion, mesh_plant, move_plant
from pepperscene.grammar import grow
from pepperscene.scene import Skeleton, build_skeleton


@pytest.fixture(scope="module", params=["barth2018", "greenhouse"])
def planted(request):
    """A settled row: upright plants, and leaning, turned ones of another crop in their greenhouse."""
    # Close together, so that the row has something to settle.
    told = {"row.plants_front": 2, "row.plants_back": 1, "row.spacing_mm": 90, "row.gap_mm": 220}
    if request.param == "greenhouse":
        told |= {"cultivar": "tomato", "greenhouse.far_rows": 0}
    recipe = load_recipe(request.param, told)
    planting = SceneBuilder(recipe, load_cultivar(recipe.cultivar), 1)
    return planting.scene(0, 1)


def body(mesh, instance):
    """The triangles of one instance."""
    faces = mesh.faces[mesh.face_instance == instance]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def along(curve, parts):
    """Points on a polyline."""
    place = np.asarray(parts) * (len(curve) - 1)
    low = np.minimum(place.astype(int), len(curve) - 2)
    return curve[low] + (place - low)[:, None] * (curve[low + 1] - curve[low])


def winding(points, mesh):
    """`(n,)` how often a closed surface goes round each point: the sum of its triangles' solid angles."""
    corners = mesh.triangles[None] - points[:, None, None]
    a, b, c = (corners[:, :, k] for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    volume = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
    dots = [np.einsum("nfi,nfi->nf", x, y) for x, y in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return np.arctan2(volume, below).sum(axis=1) / (2.0 * np.pi)


@pytest.mark.parametrize(("form", "parts"), [("peduncle", [0.1, 0.4, 0.9]), ("fruit", [0.3, 0.5])])
def test_centrelines_lie_inside_their_bodies(planted, form, parts):
    found = planted.skeleton.of_form(form)
    if form == "peduncle":
        # Those that bear fruit; a truss has few rings for its length, and cuts its own corners.
        found = sorted({planted.mesh.instances[one].parent for one in planted.skeleton.of_form("calyx")})
    assert len(found) >= 5
    for instance in found[::3]:
        organ = planted.skeleton.organ(instance)
        told = planted.mesh.instances[instance]
        assert (organ.kind, organ.phytomer, organ.parent) == (told.kind, told.phytomer, told.parent)
        # A body's own triangles are closed, so that inside is where they go round once.
        assert winding(along(organ.curve, parts), body(planted.mesh, instance)) == pytest.approx(
            1.0, abs=1e-3
        )


def test_the_row_did_settle_and_lean(planted):
    # Or the test above would show little.
    assert planted.skeleton.motions
    stems = planted.skeleton.of_form("internode", plant=0)
    first, last = (planted.skeleton.organ(stems[end]).curve for end in (0, -1))
    assert np.linalg.norm(last[-1, :2] - first[0, :2]) > 0.01


def test_organs_are_all_and_only_those_of_the_plants(planted):
    bones, instances = planted.skeleton, planted.mesh.instances
    held = [index for index in range(len(instances)) if bones.holds(index)]
    assert len(held) == sum(len(plant.organs) for plant in bones.plants)
    for index in held:
        assert bones.kind(index).organ_class == instances[index].organ_class
    others = set(range(len(instances))) - set(held)
    assert {instances[index].kind for index in others} >= {"twine"}
    assert all(bones.kind(index) is None for index in others)
    with pytest.raises(ValueError, match="no organ"):
        bones.organ(min(others))
    with pytest.raises(ValueError, match="no organ"):
        bones.organ(-1)


def test_motions_are_those_of_the_plant_by_itself():
    # Several turns, of organs and of what they grow on, in an order that matters.
    cultivar = load_cultivar("kaite_february")
    plant = grow(cultivar, np.random.default_rng(3))
    forms = {name: kind.form for name, kind in plant.kinds.items()}
    fruit = next(i for i, organ in enumerate(plant.organs) if forms[organ.kind] == "fruit")
    calyx = plant.organs[fruit].parent
    stalk = plant.organs[calyx].parent
    rng = np.random.default_rng(4)
    motions = []
    for index in (stalk, fruit, stalk, calyx):
        turn = trimesh.transformations.rotation_matrix(rng.uniform(0.1, 1.0), rng.normal(size=3))[:3, :3]
        motions.append(Motion(index, turn, rng.normal(size=3)))
    moved = move_plant(plant, motions)
    # The same plant stands second, behind a mesh with a thing more than organs.
    size = len(plant.organs)
    behind = [replace(one, instance=one.instance + size + 1) for one in motions]
    bones = Skeleton((plant, plant), (size + 1, size), np.zeros((2, 3)), np.zeros(2), tuple(behind))
    for index in (fruit, calyx, stalk, 0):
        np.testing.assert_allclose(bones.organ(size + 1 + index).curve, moved.organs[index].curve, atol=1e-12)
        np.testing.assert_allclose(bones.organ(size + 1 + index).up, moved.organs[index].up, atol=1e-12)
        np.testing.assert_array_equal(bones.organ(index).curve, plant.organs[index].curve)


def test_a_plant_by_itself_stands_as_its_mesh():
    plant = grow(load_cultivar("kaite_february"), np.random.default_rng(0))
    bones, mesh = build_skeleton([plant]), mesh_plant(plant, 0.5)
    fruit = bones.of_form("fruit")
    assert fruit == bones.of_form("fruit", plant=0)
    assert all(mesh.instances[index].kind == bones.organ(index).kind for index in fruit)


def test_skeletons_travel(planted):
    again = pickle.loads(pickle.dumps(planted.skeleton))
    for instance in planted.skeleton.of_form("fruit")[:3]:
        np.testing.assert_array_equal(again.organ(instance).curve, planted.skeleton.organ(instance).curve)


def test_what_does_not_fit_is_refused():
    plant = grow(load_cultivar("kaite_february"), np.random.default_rng(0))
    with pytest.raises(ValueError, match="as many"):
        Skeleton((plant,), (), np.zeros((1, 3)), np.zeros(1))
    with pytest.raises(ValueError, match="does not hold"):
        Skeleton((plant,), (3,), np.zeros((1, 3)), np.zeros(1))

"""Rays, distances and collisions in a living scene against trimesh, FCL and plain geometry."""

from __future__ import annotations

import numpy as np
import pytest
import row_cache
import trimesh

import pepperscene as ps
from pepperscene.errors import ArgumentError

CHANGES = {"row.plants_front": 1, "row.plants_back": 0, "cultivar": "kaite_february"}


@pytest.fixture(scope="module")
def plant(rows):
    """A scene of a small plant with a crate beside it."""
    with row_cache.rows_from(rows):
        scene = ps.open_scene("barth2018", 0, **CHANGES)
    place = np.eye(4)
    place[:3, 3] = 0.1, -0.2, 0.4
    scene.add(trimesh.creation.box((0.1, 0.2, 0.3)), place)
    return scene


@pytest.fixture(scope="module")
def solids(plant):
    """Each instance as a trimesh, by its number."""
    mesh = plant._state.mesh
    found = {}
    for index in np.unique(mesh.face_instance).tolist():
        faces = mesh.faces[mesh.face_instance == index]
        found[index + 1] = trimesh.Trimesh(mesh.vertices, faces, process=False)
        found[index + 1].remove_unreferenced_vertices()
    return found


def random_places(rng, plant, count):
    """Points in the box of the plant."""
    low, high = plant._state.mesh.bounds
    return rng.uniform(low - 0.02, high + 0.02, (count, 3))


def test_rays_meet_what_they_meet_in_trimesh(plant, solids):
    rng = np.random.default_rng(3)
    origins = random_places(rng, plant, 400)
    directions = rng.normal(size=(400, 3))
    distance, instance = plant.raycast(origins, directions)
    numbers = np.concatenate([np.full(len(one.faces), number) for number, one in solids.items()])
    together = trimesh.util.concatenate(list(solids.values()))
    places, ray, face = together.ray.intersects_location(origins, directions)[:3]
    expected = np.full(len(origins), np.inf)
    away = np.linalg.norm(places - origins[ray], axis=1)
    order = np.argsort(-away)
    expected[ray[order]] = away[order]
    owner = np.zeros(len(origins), int)
    owner[ray[order]] = numbers[face[order]]
    # A ray along the edge of a leaf may meet it in one program only.
    same = np.isclose(distance, expected, atol=1e-5)
    assert same.mean() > 0.99
    assert np.isfinite(distance).mean() > 0.1
    np.testing.assert_array_equal(instance[same], owner[same])
    assert plant.raycast(origins[0], directions[:1])[0] == distance[:1]


def test_rays_need_numbers_and_directions(plant):
    for origins, directions, message in (
        ([0, 0, 0], [[0, 0, 0]], "has no length"),
        ([0, 0, np.nan], [[0, 0, 1]], "must be finite"),
        (np.zeros((2, 3)), np.ones((3, 3)), "must be one or"),
        ([0, 0], [[0, 0, 1]], "must have the shape"),
    ):
        with pytest.raises(ArgumentError, match=message):
            plant.raycast(origins, directions)
    assert len(plant.raycast(np.zeros((0, 3)), np.zeros((0, 3)))[0]) == 0


def test_nearest_surfaces_are_those_of_trimesh(plant, solids):
    rng = np.random.default_rng(4)
    points = random_places(rng, plant, 60)
    distance, instance = plant.nearest(points)
    each = np.array([trimesh.proximity.closest_point_naive(one, points)[1] for one in solids.values()])
    np.testing.assert_allclose(distance, each.min(axis=0), atol=1e-6)
    chosen = [list(solids).index(number) for number in instance]
    np.testing.assert_allclose(each[chosen, np.arange(len(points))], each.min(axis=0), atol=1e-6)
    with pytest.raises(ArgumentError, match="must be finite"):
        plant.nearest([[0.0, 0.0, np.inf]])


def test_meshes_touch_what_they_touch_in_fcl(plant, solids):
    rng = np.random.default_rng(6)
    manager = trimesh.collision.CollisionManager()
    for number, solid in solids.items():
        manager.add_object(str(number), solid)
    tool = trimesh.creation.annulus(0.02, 0.03, 0.08)
    touching = 0
    for place in random_places(rng, plant, 100):
        pose = trimesh.transformations.random_rotation_matrix(rng.uniform(size=3))
        pose[:3, 3] = place
        _, names = manager.in_collision_single(tool, pose, return_names=True)
        crossing = {int(name) for name in names}
        moved = tool.copy().apply_transform(pose)
        inside = {
            number for number, one in solids.items() if number not in crossing
            and (moved.contains(one.vertices[:1])[0] or (one.is_watertight and one.contains(place[None])[0]))
        }  # fmt: skip
        found = set(plant.collides(tool, pose))
        assert crossing <= found <= crossing | inside
        touching += bool(crossing)
    assert touching > 5


def test_capsules_touch_what_is_nearer_than_their_radius(plant, solids):
    rng = np.random.default_rng(7)
    touched = 0
    for start in random_places(rng, plant, 30):
        end = start + rng.uniform(-0.1, 0.1, 3)
        found = plant.collides([[*start, *end, 0.015]])
        line = start + np.linspace(0.0, 1.0, 50)[:, None] * (end - start)
        distance = plant.nearest(line)[0].min()
        if found:
            assert distance < 0.0152
            touched += 1
        else:
            assert distance > 0.0145
    assert touched > 3
    box = next(one.instance for one in plant.organs if one.kind == "object")
    assert plant.collides([0.1, -0.2, 0.4, 0.1, -0.2, 0.4, 0.01]) == (box,)
    assert plant.collides([0.1, -0.2, 0.4, 0.1, -0.2, 0.4, 0.01], ignore=(box,)) == ()


INVALID = ([[0, 0, 0, 1, 1, 1]], [[0, 0, 0, 0, 0, 1, -1]], [[0, 0, 0, 0, 0, np.nan, 1]], "capsule")


@pytest.mark.parametrize("body", [*INVALID, trimesh.Trimesh()])
def test_invalid_bodies_are_refused(plant, body):
    with pytest.raises(ArgumentError):
        plant.collides(body)
    with pytest.raises(ArgumentError, match="must be a rotation"):
        plant.collides(trimesh.creation.box((0.1, 0.1, 0.1)), np.ones((4, 4)))

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pepperscene.classes import OrganClass
from pepperscene.geometry import rectangle, sphere, twine

STEM = np.stack([np.zeros(21), np.zeros(21), np.linspace(0.0, 2.0, 21)], axis=1)


def closed(mesh):
    points, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(points.astype(float), number.ravel()[mesh.faces], process=False)


def test_the_cord_touches_the_stem_all_the_way():
    mesh = twine(STEM, 0.0045, 0.001, turns_per_m=3.0, phase_rad=0.4, above_m=0.0)
    reach = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    inner = (mesh.vertices[:, 2] > 0.01) & (mesh.vertices[:, 2] < 1.99)
    assert reach[inner].min() == pytest.approx(0.0045, abs=2e-4)
    assert reach[inner].max() == pytest.approx(0.0065, abs=2e-4)


@pytest.mark.parametrize("turns", [-2.0, 0.0, 3.5])
def test_it_winds_as_often_as_told(turns):
    mesh = twine(STEM, 0.0045, 0.0005, turns, above_m=0.0)
    order = np.argsort(mesh.vertices[:, 2])
    height = mesh.vertices[order, 2]
    angle = np.unwrap(np.arctan2(mesh.vertices[order, 1], mesh.vertices[order, 0]))
    slope = np.polyfit(height, angle, 1)[0] / (2.0 * np.pi)
    assert slope == pytest.approx(turns, abs=0.05)


def test_it_starts_where_the_phase_says():
    first = twine(STEM, 0.0045, 0.0005, 2.0, 0.0, 0.0).vertices[0]
    assert first[1] == pytest.approx(-0.005, abs=1e-4)
    assert first[0] == pytest.approx(0.0, abs=1e-4)


def test_it_goes_on_straight_above_the_stem():
    mesh = twine(STEM, 0.0045, 0.001, 2.0, above_m=0.8)
    top = mesh.vertices[mesh.vertices[:, 2] > 2.2]
    assert mesh.vertices[:, 2].max() == pytest.approx(2.8, abs=2e-3)
    assert np.hypot(top[:, 0], top[:, 1]).max() < 0.0013


def test_it_is_a_closed_wire_of_one_instance():
    mesh = twine(STEM, np.linspace(0.006, 0.003, 21), 0.001, 3.0)
    solid = closed(mesh)
    assert solid.is_watertight
    assert solid.volume > 0.0
    assert mesh.surfaces == ("twine",)
    assert [item.organ_class for item in mesh.instances] == [OrganClass.WIRE]
    assert set(mesh.face_class) == {OrganClass.WIRE}


def test_a_crooked_stem_is_followed():
    wave = STEM + np.stack([0.03 * np.sin(4.0 * STEM[:, 2]), 0.0 * STEM[:, 0], 0.0 * STEM[:, 0]], axis=1)
    mesh = twine(wave, 0.004, 0.001, 3.0, above_m=0.0)
    fine = np.stack(
        [np.interp(np.linspace(0, 2, 2001), wave[:, 2], wave[:, axis]) for axis in range(3)], axis=1
    )
    distance = np.min(np.linalg.norm(mesh.vertices[:, None, :] - fine[None], axis=2), axis=1)
    assert distance.max() < 0.0068


@pytest.mark.parametrize("radius", [0.0, -0.001, float("nan")])
def test_a_cord_needs_a_radius(radius):
    with pytest.raises(ValueError, match="radius"):
        twine(STEM, 0.005, radius, 2.0)


def test_a_sphere_is_round_and_closed():
    mesh = sphere((1.0, 2.0, 3.0), 0.04, subdivisions=4)
    away = np.linalg.norm(mesh.vertices - [1.0, 2.0, 3.0], axis=1)
    np.testing.assert_allclose(away, 0.04, rtol=1e-5)
    np.testing.assert_allclose(mesh.vertices, [1.0, 2.0, 3.0] + 0.04 * mesh.normals, atol=1e-6)
    solid = closed(mesh)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.04**3, rel=0.01)
    assert mesh.uv.min() >= 0.0
    assert mesh.uv.max() <= 1.0
    with pytest.raises(ValueError, match="radius_m"):
        sphere((0, 0, 0), 0.0)


def test_a_rectangle_faces_right_cross_up():
    mesh = rectangle((0.0, 1.0, 0.0), (0.2, 0.0, 0.0), (0.0, 0.0, 0.3), surface="card")
    np.testing.assert_allclose(mesh.normals, np.tile([0.0, -1.0, 0.0], (4, 1)), atol=1e-7)
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(float) for corner in range(3))
    cross = np.cross(b - a, c - a)
    np.testing.assert_allclose(0.5 * cross.sum(axis=0), [0.0, -0.06, 0.0], atol=1e-8)
    np.testing.assert_allclose(mesh.vertices.mean(axis=0), [0.0, 1.0, 0.0], atol=1e-7)
    assert mesh.surfaces == ("card",)
    with pytest.raises(ValueError, match="span"):
        rectangle((0, 0, 0), (1, 0, 0), (2, 0, 0))

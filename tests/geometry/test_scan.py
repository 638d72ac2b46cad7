"""Scanned fruit, with meshes made here."""

from __future__ import annotations

import os

import numpy as np
import pytest
import trimesh

from pepperscene.classes import OrganClass
from pepperscene.cultivar.organs import USUAL, OrganKind
from pepperscene.errors import InputError
from pepperscene.geometry import mesh_plant
from pepperscene.geometry.fruit.scan import MOST_TRIANGLES, load_scan
from pepperscene.grammar.plant import Organ, Plant

AXIS = np.array([[0.1, 0.2, 1.0], [0.11, 0.18, 0.92]])
UP = np.array([1.0, 0.0, 0.0])


def lumpy(subdivisions=4):
    """A body like an apple, in millimetres and off the origin: lobes, a hollow on top."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = np.asarray(ball.vertices).T
    angle = np.arctan2(y, x)
    swell = 1.0 + 0.06 * np.cos(3.0 * angle) * (1.0 - z**2) - 0.55 * np.exp(-((1.0 - z) ** 2) / 0.08)
    points = np.stack([x, y, 1.3 * z], axis=1) * swell[:, None]
    return trimesh.Trimesh(40.0 * points + [300.0, -70.0, 12.0], ball.faces, process=False)


def scanned(path, *, calyx=False, **measures):
    """A plant of one fruit that wears the scan."""
    kinds = {**USUAL, "berry": OrganKind("fruit", OrganClass.PEPPER, "fruit", path)}
    shape = {"length_m": 0.09, "diameter_m": 0.07, "seed": 0.3} | measures
    organs = [Organ("berry", -1, 4, AXIS, UP, shape)]
    if calyx:
        stub = np.array([AXIS[0] - 0.05 * (AXIS[1] - AXIS[0]), AXIS[0]])
        plate = Organ("calyx", -1, 4, stub, UP, {"radius_m": 0.018, "seed": 0.4})
        organs = [plate, Organ("berry", 0, 4, AXIS, UP, shape)]
    return mesh_plant(Plant("scanned", tuple(organs), kinds))


def solid(mesh, instance=0):
    points, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = number.ravel()[mesh.faces[mesh.face_instance == instance]]
    return trimesh.Trimesh(points.astype(float), faces, process=False)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_a_scan_gets_the_size_and_place_of_its_fruit(tmp_path, suffix):
    path = tmp_path / f"fruit.{suffix}"
    lumpy().export(path)
    mesh = scanned(path, ripeness=0.6, ripeness_spread=0.1)
    body = solid(mesh)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume > 0.0
    axis = (AXIS[1] - AXIS[0]) / np.linalg.norm(AXIS[1] - AXIS[0])
    along = (mesh.vertices - AXIS[0]) @ axis
    assert np.ptp(along) == pytest.approx(0.09, rel=1e-4)
    across = np.linalg.svd(axis[None])[2][1:]
    angle = np.linspace(0.0, np.pi, 360)
    shadow = (mesh.vertices @ across.T) @ np.stack([np.cos(angle), np.sin(angle)])
    assert np.ptp(shadow, axis=0).max() == pytest.approx(0.07, rel=1e-3)
    # The stalk's foot lies on the surface, in the hollow between the shoulders: that end is the file's top.
    distance = trimesh.proximity.closest_point(body, AXIS[:1])[1][0]
    assert distance < 1e-4
    assert along.min() < -0.004
    assert mesh.state.mean() == pytest.approx(0.6, abs=0.01)
    assert mesh.state.std() == pytest.approx(0.1, abs=0.01)


def test_a_scan_has_sound_normals_and_surface_coordinates(tmp_path):
    path = tmp_path / "fruit.ply"
    lumpy().export(path)
    mesh = scanned(path)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    corners = mesh.vertices[mesh.faces].astype(float)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.sum(flat * mesh.normals[mesh.faces].mean(axis=1), axis=1).min() > 0.9
    assert mesh.uv.min() >= 0.0
    assert mesh.uv.max() <= 1.0
    # No triangle spans the fruit's surface coordinates where the seam runs, but at the two ends.
    middle = np.abs(mesh.uv[mesh.faces][..., 1] - 0.5).max(axis=1) < 0.4
    assert np.ptp(mesh.uv[mesh.faces][..., 0], axis=1)[middle].max() < 0.25
    # v runs from stalk to blossom end.
    along = (mesh.vertices - AXIS[0]) @ (AXIS[1] - AXIS[0])
    assert np.corrcoef(along, mesh.uv[:, 1])[0, 1] > 0.95


def test_a_calyx_hugs_a_scan(tmp_path):
    path = tmp_path / "fruit.obj"
    lumpy().export(path)
    mesh = scanned(path, calyx=True)
    body = solid(mesh, 1)
    plate = mesh.vertices[np.unique(mesh.faces[mesh.face_instance == 0])].astype(float)
    inside = trimesh.proximity.signed_distance(body, plate)
    axis = (AXIS[1] - AXIS[0]) / np.linalg.norm(AXIS[1] - AXIS[0])
    out = np.linalg.norm(plate - AXIS[0] - ((plate - AXIS[0]) @ axis)[:, None] * axis, axis=1)
    assert np.abs(inside[out > 0.008]).max() < 0.002
    assert 0.0 < inside.max() < 0.001


def test_dirt_is_cleaned_away(tmp_path):
    path = tmp_path / "fruit.stl"
    clean = lumpy(3)
    # A crumb beside it, a small hole, faces inside out, double and degenerate triangles; STL merges nothing.
    crumb = trimesh.creation.icosphere(subdivisions=1, radius=2.0).apply_translation([380.0, -70.0, 12.0])
    faces = np.array(clean.faces)[:-4][:, ::-1]
    faces = np.concatenate([faces, faces[:5], np.repeat(faces[:3, :1], 3, axis=1)])
    dirty = trimesh.Trimesh(clean.vertices, faces, process=False)
    trimesh.util.concatenate([dirty, crumb]).export(path)
    body = solid(scanned(path))
    assert body.is_watertight
    assert body.body_count == 1
    (tmp_path / "clean").mkdir()
    whole = tmp_path / "clean" / "fruit.stl"
    clean.export(whole)
    assert body.volume == pytest.approx(solid(scanned(whole)).volume, rel=0.01)


def open_on_one_side():
    ball = lumpy(3)
    keep = ball.triangles_center[:, 0] < 320.0
    return trimesh.Trimesh(ball.vertices, ball.faces[keep], process=False)


def two_fruit():
    other = lumpy(3)
    other.apply_translation([150.0, 0.0, 0.0])
    return trimesh.util.concatenate([lumpy(3), other])


def with_a_hole_in_space():
    ball = lumpy(2)
    points = np.array(ball.vertices)
    points[7] = np.nan
    return trimesh.Trimesh(points, ball.faces, process=False)


def a_sheet():
    grid = trimesh.creation.box(extents=[1.0, 1.0, 0.001])
    return trimesh.Trimesh(grid.vertices, grid.faces, process=False)


def a_ring():
    return trimesh.creation.torus(major_radius=2.0, minor_radius=0.8)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (open_on_one_side, "hole"),
        (two_fruit, "several parts"),
        (with_a_hole_in_space, "finite"),
        (a_sheet, "flat"),
        (a_ring, "over its middle"),
    ],
)
@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_what_is_not_one_closed_body_is_refused(tmp_path, make, word, suffix):
    path = tmp_path / f"fruit.{suffix}"
    make().export(path)
    with pytest.raises(InputError, match=word) as told:
        load_scan(path)
    assert str(path) in str(told.value)
    assert "closed surface" in str(told.value)


@pytest.mark.parametrize("content", [b"", b"these are words\n", b"ply\nformat ascii 1.0\nelement vertex 1\n"])
@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_files_that_are_no_meshes_are_refused(tmp_path, content, suffix):
    path = tmp_path / f"fruit.{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match="OBJ, PLY or STL"):
        load_scan(path)


def test_other_formats_and_missing_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_scan(tmp_path / "nowhere.ply")
    with pytest.raises(InputError, match="OBJ, PLY or STL"):
        load_scan(tmp_path / "fruit.blend")
    folder = tmp_path / "folder.ply"
    folder.mkdir()
    with pytest.raises(InputError):
        load_scan(folder)


def test_a_scan_too_fine_is_simplified_or_refused(tmp_path):
    path = tmp_path / "fruit.ply"
    lumpy(6).export(path)
    try:
        import fast_simplification  # noqa: F401
    except ImportError:
        with pytest.raises(InputError, match="fast-simplification"):
            load_scan(path)
    else:
        assert len(load_scan(path).faces) <= MOST_TRIANGLES


def test_a_scan_is_read_again_when_its_file_changes(tmp_path):
    path = tmp_path / "fruit.ply"
    lumpy(3).export(path)
    first = load_scan(path)
    assert load_scan(path) is first
    lumpy(2).export(path)
    os.utime(path, ns=(1, 1))
    assert len(load_scan(path).faces) < len(first.faces)

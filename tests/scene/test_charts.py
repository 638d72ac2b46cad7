"""Marker boards and stands against OpenCV's own boards and closed forms: patterns, sizes, orientation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh

from pepperscene.geometry import concatenate_meshes
from pepperscene.materials.stand import BLACK_PATCH, WHITE_PATCH
from pepperscene.scene import CalibrationChart, Stand, stand_meshes, turned_parts
from pepperscene.scene.charts import MARKERS, marker_bits
from pepperscene.scene.stand import Backdrop, PotShape

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


def picture(chart):
    """The pattern without its white margin, one pixel for each cell, 0 or 255."""
    image, _, _ = chart.pattern()
    assert set(np.unique(image)) == {WHITE_PATCH, BLACK_PATCH}
    return np.where(image == WHITE_PATCH, 255, 0)[2:-2, 2:-2]


def test_markers_are_those_of_opencv():
    for number in range(len(MARKERS)):
        assert np.array_equal(cv2.aruco.generateImageMarker(DICTIONARY, number, 6) > 0, marker_bits(number))


@pytest.mark.parametrize("count", [(7, 5), (5, 7), (8, 8), (4, 3)])
def test_charuco_boards_are_those_of_opencv(count):
    board = cv2.aruco.CharucoBoard(count, 0.04, 0.03, DICTIONARY)
    drawn = board.generateImage((8 * count[0], 8 * count[1]))
    chart = CalibrationChart(kind="charuco", position_m=(0, 0, 0), count=count)
    assert np.array_equal(picture(chart), np.where(drawn > 127, 255, 0))
    assert chart.marker_count == len(board.getIds())


def test_aruco_boards_are_those_of_opencv():
    board = cv2.aruco.GridBoard((3, 2), 0.06, 0.02, DICTIONARY, np.arange(10, 16))
    drawn = board.generateImage((3 * 8 - 2, 2 * 8 - 2))
    chart = CalibrationChart(kind="aruco", position_m=(0, 0, 0), count=(3, 2), first_marker=10)
    assert np.array_equal(picture(chart), np.where(drawn > 127, 255, 0))


def test_charts_have_the_size_of_their_cells():
    edges = {kind: CalibrationChart(kind=kind, position_m=(0, 0, 0), cell_m=0.02).pattern()[1:] for kind in
             ("charuco", "aruco", "colorchecker", "scale_bar")}  # fmt: skip
    x, y = edges["charuco"]
    assert (x[-3] - x[2], y[-3] - y[2]) == pytest.approx((7 * 0.02, 5 * 0.02))
    x, y = edges["aruco"]
    assert x[8] - x[2] == pytest.approx(0.02)
    x, y = edges["colorchecker"]
    assert np.diff(x[1:-1:2]) == pytest.approx(np.full(5, 0.02))
    x, y = edges["scale_bar"]
    assert np.diff(x) == pytest.approx(np.full(22, 0.01 * 2))


@pytest.mark.parametrize(
    ("azimuth_deg", "tilt_deg", "right", "front"),
    [(0, 0, (1, 0, 0), (0, -1, 0)), (0, 90, (1, 0, 0), (0, 0, 1)), (90, 0, (0, 1, 0), (1, 0, 0))],
)
def test_charts_face_their_direction(azimuth_deg, tilt_deg, right, front):
    """The first patch, dark skin, is at the upper left; areas and winding by trimesh."""
    chart = CalibrationChart(
        kind="colorchecker",
        position_m=(0.1, 0.2, 0.3),
        azimuth_rad=np.radians(azimuth_deg),
        tilt_rad=np.radians(tilt_deg),
    )
    mesh = chart.mesh()
    up = np.cross(front, right)
    first = mesh.vertices[np.isclose(mesh.state, 0.0)].mean(axis=0) - (0.1, 0.2, 0.3)
    assert first @ right < 0 < first @ up
    assert abs(first @ front) < 1e-6
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    corners = mesh.state[mesh.faces[:, 0]]
    facing = np.isclose(corners, 0.0)
    assert whole.area_faces[facing].sum() == pytest.approx((0.9 * 0.0445) ** 2, rel=1e-4)
    assert whole.face_normals[facing] == pytest.approx(np.tile(front, (2, 1)), abs=1e-5)


@pytest.mark.parametrize("shape", PotShape)
def test_pots_have_their_size_and_hold_substrate_up_to_the_stem(shape):
    stand = Stand(pot=shape, pot_width_m=0.2, pot_height_m=0.18, tray=True, stake_m=0.4, turntable_m=0.3)
    turning, staying = stand_meshes(stand)
    parts = {mesh.instances[0].kind: mesh for mesh in turning}
    assert parts.keys() == {"pot", "substrate", "tray", "stake", "turntable"}
    assert staying == []
    low, high = parts["pot"].bounds
    assert high[:2] - low[:2] == pytest.approx([0.2, 0.2], abs=1e-6)
    assert high[2] - low[2] == pytest.approx(0.18, abs=1e-6)
    assert parts["turntable"].bounds[:, 2] == pytest.approx([0.0, 0.03], abs=1e-6)
    low, high = parts["substrate"].bounds
    assert low[2] < stand.stem_base_m < high[2] < parts["pot"].bounds[1, 2]
    # Grains differ, but the surface is level on average, and ends at the wall.
    surface = trimesh.Trimesh(parts["substrate"].vertices, parts["substrate"].faces)
    inner = 0.2 * (0.96 - 0.06)
    area = np.pi * inner**2 / 4 if shape == PotShape.ROUND else inner**2
    flat = surface.area_faces @ np.abs(surface.face_normals[:, 2])
    assert flat == pytest.approx(area, rel=0.01)
    assert (surface.face_normals[:, 2] > 0).all()


@pytest.mark.parametrize("shape", PotShape)
def test_normals_point_out_of_pots(shape):
    for mesh in stand_meshes(Stand(pot=shape, tray=True, turntable_m=0.3, stake_m=0.2))[0]:
        faces = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
        for corner in range(3):
            assert (np.sum(faces * mesh.normals[mesh.faces[:, corner]], axis=1) > 0.7).all()
    pot = stand_meshes(Stand(pot=shape))[0][0]
    reach = np.sum(pot.vertices[pot.faces].mean(axis=1) * pot.normals[pot.faces[:, 0]] * (1, 1, 0), axis=1)
    # The inner wall faces the axis, and is nearer to it than the rim.
    assert reach.max() == pytest.approx(0.07, rel=0.01)
    assert -reach.min() == pytest.approx(0.07 * (0.96 - 0.06), rel=0.01)


@pytest.mark.parametrize("backdrop", [Backdrop.CLOTH, Backdrop.CABIN])
def test_backdrops_face_the_plant(backdrop):
    stand = Stand(backdrop=backdrop, backdrop_distance_m=0.8, backdrop_height_m=1.5, backdrop_width_m=2.0)
    _, (mesh,) = stand_meshes(stand)
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    normals = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    assert (np.sum(normals * (np.array([0.0, 0.0, 0.5]) - middle), axis=1) > 0).all()
    assert mesh.bounds[1, 1:] == pytest.approx([0.8, 1.5])


def test_only_what_stays_is_turned():
    charts = tuple(
        CalibrationChart(kind="aruco", position_m=(0.3, 0, 0.1), turns=turns) for turns in (True, False)
    )
    turning, staying = stand_meshes(Stand(charts=charts))
    mesh = concatenate_meshes([*turning, *staying])
    turned = turned_parts(mesh, len(staying), np.radians(90.0))
    last = mesh.vertex_instance == len(mesh.instances) - 1
    assert np.array_equal(turned.vertices[~last], mesh.vertices[~last])
    x, y, z = mesh.vertices[last].T
    assert turned.vertices[last] == pytest.approx(np.stack([-y, x, z], axis=1), abs=1e-6)

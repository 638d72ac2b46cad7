"""Coverage against closed forms, against labels of many small pixels, and against looking everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from greenhouse import POSES, camera, others, row_of_plants
from test_kernel_reuse import compiled

from pepperscene.camera import Camera, load_lens, load_sensor
from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.render import Renderer
from pepperscene.render.aov.coverage import POINTS, Coverage, pixel_points
from pepperscene.render.kernel.arrays import local_coordinates
from pepperscene.render.kernel.camera import camera_rays
from pepperscene.render.kernel.scene import truth_scene
from pepperscene.scene import assemble_scene

FOCAL_PX = 4.16e-3 / 9e-6  # of the bench camera: the lens' focal length over the pixels' pitch


def solid(body: trimesh.Trimesh, organ_class: OrganClass) -> Mesh:
    vertices, faces = len(body.vertices), len(body.faces)
    return Mesh(
        vertices=body.vertices.astype(np.float32),
        normals=np.asarray(body.vertex_normals, np.float32),
        uv=np.zeros((vertices, 2), np.float32),
        state=np.zeros(vertices, np.float32),
        faces=body.faces.astype(np.uint32),
        face_instance=np.zeros(faces, np.uint32),
        face_surface=np.zeros(faces, np.uint8),
        surfaces=("matt",),
        instances=(Instance(organ_class, "body"),),
    )


def wire(width_px: float, turn: float, aside_px: float = 0.0) -> Mesh:
    """A straight wire across the optical axis at 50 cm, turned from upright, of so many pixels' width."""
    rod = trimesh.creation.cylinder(radius=0.5 * width_px * 0.5 / FOCAL_PX, height=2.0, sections=64)
    rod.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    rod.apply_translation([aside_px * 0.5 / FOCAL_PX, 0, 0])
    rod.apply_transform(trimesh.transformations.rotation_matrix(turn, [0, 0, 1]))
    rod.apply_translation([0, 0, 0.5])
    return solid(rod, OrganClass.WIRE)


def bench_camera(columns: int = 64, rows: int = 64) -> Camera:
    """At the origin, looking along +z."""
    sensor = replace(load_sensor("ueye_ui5250re"), columns=columns, rows=rows)
    return Camera(load_lens("lensagon_cmfa0420nd"), sensor, np.eye(4), 50e-6)


def both(mesh: Mesh, view: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The coverage image, and that of looking closely at all pixels."""
    scene, rays = truth_scene(assemble_scene(mesh)), camera_rays(view, local_coordinates(mesh))
    made = Coverage(mesh)
    return made.image(scene, rays).astype(float), made.image(scene, rays, everywhere=True).astype(float)


# --- a wire ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [0.0, 0.05, 0.4, 0.7, 1.2, np.pi / 2])
@pytest.mark.parametrize("width", [0.06, 0.2, 0.7, 3.0])
def test_a_wire_covers_its_width_of_each_row_it_crosses(width, turn):
    # Rows are crossed at an angle: width / cos of each row, or of each column where it lies flatter.
    fast, everywhere = both(wire(width, turn, aside_px=0.3), bench_camera())
    np.testing.assert_array_equal(fast, everywhere)
    along = 1 if turn < np.pi / 4 else 0
    covered = fast[..., OrganClass.WIRE].sum(axis=along)
    expected = width / max(np.cos(turn), np.sin(turn))
    # Along a pixel's sides every row finds the same of 64 columns, and the mean is no better than one.
    tolerance = 1 / POINTS if turn in (0.0, np.pi / 2) else 0.01 * width + 0.003
    assert covered.mean() == pytest.approx(expected, abs=tolerance)
    # All of what is crossed, though no ray through a centre may meet it.
    assert (covered > 0).mean() > (0.95 if width > 0.1 else 0.9)
    assert (covered < expected + 0.06).all()


def test_a_wire_that_the_labels_lose_is_not_lost():
    mesh, view = wire(0.1, 0.3), bench_camera()
    frame = Renderer(assemble_scene(mesh)).render(view, ["class", "coverage"])
    assert (frame["class"] == OrganClass.WIRE).any(axis=1).mean() < 0.4
    assert (frame["coverage"][..., OrganClass.WIRE] > 0).any(axis=1).mean() > 0.9


def test_a_wire_is_followed_from_where_it_was_found():
    # So thin that the few rays of most of its pixels miss it; a ball hangs on it.
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.004)
    ball.apply_translation([0, 0, 0.5])
    mesh = concatenate_meshes([wire(0.08, 0.6), solid(ball, OrganClass.PEPPER)])
    fast, everywhere = both(mesh, bench_camera())
    found, there = (image[..., OrganClass.WIRE] > 0 for image in (fast, everywhere))
    assert there.sum() > 60
    assert (there & ~found).sum() <= 1  # where it leaves the picture through a corner of a pixel
    np.testing.assert_array_equal(fast[found], everywhere[found])


# --- plants ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plants():
    return row_of_plants()


@pytest.mark.parametrize("distorted", [False, True])
def test_coverage_is_the_mean_of_labels_of_smaller_pixels(plants, distorted):
    coarse, fine = camera(distorted=distorted), camera(columns=800, rows=600, distorted=distorted)
    fine = replace(fine, sensor=replace(fine.sensor, binning=fine.sensor.binning // 10))
    made = Renderer(assemble_scene(plants))
    coverage = made.render(coarse, ["coverage"])["coverage"].astype(float)
    labels = made.render(fine, ["class"])["class"].reshape(60, 10, 80, 10)
    for one in OrganClass:
        expected = (labels == one).mean(axis=(1, 3))
        error = coverage[..., one] - expected
        mixed = (expected > 0) & (expected < 1)
        # Both are counts of a hundred or 64 points.
        assert np.abs(error).max() < 0.2, one.name
        if mixed.any():
            assert np.sqrt(np.mean(error[mixed] ** 2)) < 0.04, one.name
            assert abs(error.mean()) < 1e-3, one.name


def test_looking_closely_where_classes_meet_is_looking_everywhere(plants):
    fast, everywhere = both(plants, camera(columns=160, rows=120))
    differ = (fast != everywhere).any(axis=-1)
    assert differ.mean() < 3e-4
    assert np.abs(fast - everywhere).max() < 0.15
    assert 0.03 < (everywhere.max(axis=-1) < 1).mean() < 0.5


@pytest.mark.parametrize(("columns", "rows"), [(1, 1), (2, 3), (7, 5), (81, 62)])
def test_shares_are_whole_and_sum_to_one_whatever_the_size(plants, columns, rows):
    frame = Renderer(assemble_scene(plants)).render(camera(columns=columns, rows=rows), ["coverage"])
    shares = frame["coverage"]
    assert shares.dtype == np.float16
    assert shares.shape == (rows, columns, len(OrganClass))
    assert (shares.astype(float).sum(axis=-1) == 1.0).all()
    assert (shares * POINTS == np.rint(shares * POINTS)).all()
    assert shares.min() >= 0


def test_the_same_bytes_twice_and_from_a_used_renderer(plants):
    made = Renderer(assemble_scene(plants))
    made.render(camera(2), ["coverage"])
    again = Renderer(assemble_scene(plants)).render(camera(), ["coverage"])
    assert made.render(camera(), ["coverage"])["coverage"].tobytes() == again["coverage"].tobytes()


def test_all_is_sharp_and_an_empty_picture_is_background(plants):
    made = Renderer(assemble_scene(plants))
    sharp, focused = (made.render(replace(camera(), focus_m=m), ["coverage"]) for m in (None, 0.2))
    np.testing.assert_array_equal(sharp["coverage"], focused["coverage"])
    away = POSES[1].copy()
    away[:3, :3] = away[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    nothing = made.render(replace(camera(), pose=away), ["coverage"])["coverage"]
    assert (nothing[..., OrganClass.BACKGROUND] == 1).all()


def test_another_scene_picture_or_pose_compiles_nothing(plants):
    asked = ("class", "coverage", "position", "uv", "flow", "stereo")
    first = Renderer(assemble_scene(plants))
    for step in (0, 1):
        first.render(camera(step), asked, others=others(step))
    _, missed = compiled(lambda: first.render(camera(1), asked, others=others(0)))
    assert missed == 0
    _, missed = compiled(lambda: first.render(camera(columns=84, rows=63), asked, others=others()))
    assert missed == 0
    other = Renderer(assemble_scene(concatenate_meshes([plants, wire(3.0, 0.3)])))
    _, missed = compiled(lambda: other.render(camera(), asked, others=others()))
    assert missed == 0


# --- points of a pixel ------------------------------------------------------------------------------------


def test_points_are_spread_evenly_and_so_are_their_groups():
    points = pixel_points()
    cell = np.floor(points * POINTS).astype(int)
    for axis in range(2):
        np.testing.assert_array_equal(np.sort(cell[:, axis]), np.arange(POINTS))
    for group in (points * 2).astype(int).reshape(-1, 4, 2).tolist():
        assert sorted(map(tuple, group)) == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_points_tell_the_share_beside_an_edge():
    rng = np.random.default_rng(1)
    exact = (np.stack(np.mgrid[:500, :500], -1).reshape(-1, 2) + 0.5) / 500 - 0.5
    errors = []
    for _ in range(300):
        turn, offset = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5)
        normal = np.array([np.cos(turn), np.sin(turn)])
        share, found = ((p @ normal < offset).mean() for p in (exact, pixel_points() - 0.5))
        errors.append(found - share)
    assert np.std(errors) < 0.014
    assert abs(np.mean(errors)) < 0.003

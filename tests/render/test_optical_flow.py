"""Optical flow in scenes where it is known by hand; coverage against closed forms and exhaustive rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera, body, card, sheet, sphere
from greenhouse import POSES, camera, partners, row_of_plants
from test_kernel_reuse import count_compiled

from pepperscene.camera import Camera, Partners
from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.outputs import OUTPUTS
from pepperscene.render import Renderer
from pepperscene.render.aov import coverage
from pepperscene.render.aov.coverage import POINTS, SceneCoverage, pixel_points
from pepperscene.render.aov.flow import CLEARANCE, is_unoccluded
from pepperscene.render.arrays import local_coordinates
from pepperscene.render.kernel.camera import camera_rays
from pepperscene.render.kernel.scene import truth_scene
from pepperscene.scene import assemble_scene

FOCAL_PX = 4.16e-3 / 9e-6  # of `axis_camera`: focal length over pixel pitch
VIEW = axis_camera(64, 64, flash=False)
WALL = sheet(2.0, 2.0, 0.4, "matt")


def moved_view(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Camera:
    """`VIEW` moved along its axes and rotated to the right."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return VIEW.at_pose(np.array([[cos, 0, sin, x], [0, 1, 0, y], [-sin, 0, cos, z], [0, 0, 0, 1]]))


def flow(mesh: Mesh, view: Camera, other: Camera) -> np.ndarray:
    image = Renderer(assemble_scene(mesh)).render(view, ["flow"], partners=Partners(flow=other))["flow"]
    assert OUTPUTS["flow"].fits(image)
    return image


@pytest.fixture(scope="module")
def plants():
    return row_of_plants()


def test_flow_of_a_wall_follows_the_pinhole_formula():
    # It is 40 cm from the camera, which moves 12 mm to the right, 5 mm down and 80 mm forward.
    image = flow(WALL, VIEW, moved_view(0.012, 0.005, 0.08))
    v, u = np.mgrid[:64, :64] + 0.5 - 32
    x, y = u * 0.4 / FOCAL_PX, v * 0.4 / FOCAL_PX
    expected = np.stack([(x - 0.012) / 0.32 * FOCAL_PX - u, (y - 0.005) / 0.32 * FOCAL_PX - v], axis=-1)
    np.testing.assert_allclose(image[..., :2], expected, atol=1e-4)
    inside = (np.abs(expected + np.stack([u, v], -1)) < 32).all(axis=-1)
    np.testing.assert_array_equal(image[..., 2] == 1, inside)
    assert 0.5 < inside.mean() < 0.7


def test_flow_of_the_sky_follows_the_rotation_alone():
    # A small ball in front of the sky; the camera moves and rotates 3 degrees to the left.
    renderer = Renderer(assemble_scene(sphere((0.0, 0.0, 0.5), 0.02, "matt", 4)))
    other = moved_view(x=0.02, yaw=np.radians(-3.0))
    frame = renderer.render(VIEW, ["class", "flow"], partners=Partners(flow=other))
    sky = frame["class"] == 0
    v, u = np.mgrid[:64, :64] + 0.5
    ray = np.stack([u - 32, v - 32, np.full_like(u, FOCAL_PX)], -1)
    rotated = ray @ other.pose[:3, :3]
    expected = rotated[..., :2] / rotated[..., 2:] * FOCAL_PX + 32
    np.testing.assert_allclose((frame["flow"][..., :2] + np.stack([u, v], -1))[sky], expected[sky], atol=1e-3)
    # The ball hides the sky in the other image.
    classes = renderer.render(other, ["class"])["class"]
    inside = sky & (expected > 0).all(-1) & (expected < 64).all(-1)
    column, row = np.floor(np.where(inside[..., None], expected, 0)).astype(int).transpose(2, 0, 1)
    hidden = inside & (classes[row, column] > 0)
    assert hidden.sum() > 300
    assert (frame["flow"][..., 2] == 1)[hidden].mean() < 0.1
    assert (frame["flow"][..., 2] == 1)[inside & ~hidden].mean() > 0.98
    assert not frame["flow"][..., 2][~inside & sky].any()


@pytest.mark.parametrize("other", [None, moved_view(z=1.0)], ids=["none", "in front of the wall"])
def test_points_that_no_other_camera_sees_have_no_flow(other):
    image = Renderer(assemble_scene(WALL)).render(VIEW, ["flow"], partners=Partners(flow=other))["flow"]
    assert OUTPUTS["flow"].fits(image)
    assert np.isnan(image[..., :2]).all()
    assert not image[..., 2].any()


@pytest.mark.parametrize(("gap", "hides"), [(100.0, True), (1.1, True), (0.9, False)])
def test_occluders_hide_points_beyond_the_clearance(gap, hides):
    # Points of a wall at 40 cm, and a second wall in front of it at a multiple of the clearance.
    rng = np.random.default_rng(2)
    closer = 0.4 * (1.0 - gap * CLEARANCE)
    points = np.column_stack([rng.uniform(-0.3, 0.3, (500, 2)), np.full(500, 0.4)])
    # The first wall has the first two triangles.
    scene = truth_scene(assemble_scene(concatenate_meshes([WALL, sheet(2.0, 2.0, closer, "matt")])))
    visible = is_unoccluded(scene, np.zeros(3), points, np.zeros(500, dtype=np.int64))
    assert (visible == (not hides)).all()
    # Nothing is in front of the second wall.
    assert is_unoccluded(scene, np.zeros(3), points * closer / 0.4, np.full(500, 2)).all()


@pytest.mark.parametrize("degrees", [5.0, 0.1])
def test_surface_does_not_hide_itself_at_grazing_angles(degrees):
    # A flat sheet of many triangles, seen from the front, and by a camera that looks along it.
    angle = np.radians(degrees)
    x, y = np.meshgrid(*2 * [np.linspace(-0.05, 0.05, 41)])
    points = np.stack([x, y, 0.4 + 0 * x], -1).reshape(-1, 3)
    first = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()[:, None]
    faces = np.concatenate([first + np.array(corners) for corners in ([0, 1, 42], [0, 42, 41])])
    mesh = body(trimesh.Trimesh(points, faces, process=False), "matt")
    # From the side, at the angle above the sheet, looking at its centre.
    centre = np.array([0, 0, 0.4]) + 0.4 * np.array([np.cos(angle), 0, -np.sin(angle)])
    forward = (np.array([0, 0, 0.4]) - centre) / 0.4
    down = np.array([0.0, 1.0, 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(down, forward), down, forward], axis=1)
    pose[:3, 3] = centre
    wide = axis_camera(400, 400).at_pose(pose)
    frame = Renderer(assemble_scene(mesh)).render(VIEW, ["class", "flow"], partners=Partners(flow=wide))
    assert (frame["class"] == OrganClass.LEAF).all()
    assert (frame["flow"][..., 2] == 1).all()


def test_back_of_a_solid_is_hidden_and_that_of_a_sheet_is_not():
    behind = moved_view(z=0.8, yaw=np.pi)
    assert not flow(sphere((0, 0, 0.4), 0.05, "matt", 4), VIEW, behind)[16:48, 16:48, 2].any()
    assert flow(WALL, VIEW, behind)[..., 2].all()


@pytest.mark.parametrize(("shift", "scale"), [((1e4, -2e4, 50.0), 1.0), ((0, 0, 0), 1e-3)])
def test_flow_does_not_depend_on_position_or_size_of_the_scene(plants, shift, scale):
    # 20 km away, and a thousand times smaller: the kernel uses local coordinates.
    view = camera(columns=40, rows=30, distorted=True, flash=False)

    def moved(original: Camera) -> Camera:
        pose = original.pose.copy()
        pose[:3, 3] = scale * pose[:3, 3] + shift
        return original.at_pose(pose)

    mesh = replace(plants, vertices=(scale * plants.vertices.astype(float) + shift).astype(np.float32))
    other = view.at_pose(POSES[2])
    expected, result = flow(plants, view, other), flow(mesh, moved(view), moved(other))
    same = np.isclose(expected, result, atol=0.05, equal_nan=True).all(axis=-1)
    # Far from the origin, vertices are rounded to a millimetre.
    assert same.mean() > (0.97 if scale != 1.0 else 0.5)
    assert np.mean(expected[..., 2] == result[..., 2]) > 0.95


def wire(width_px: float, angle: float, offset_px: float = 0.0) -> Mesh:
    """A straight wire across the optical axis at 50 cm, at an angle to the vertical."""
    rod = trimesh.creation.cylinder(radius=0.5 * width_px * 0.5 / FOCAL_PX, height=2.0, sections=64)
    rod.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    rod.apply_translation([offset_px * 0.5 / FOCAL_PX, 0, 0])
    rod.apply_transform(trimesh.transformations.rotation_matrix(angle, [0, 0, 1]))
    rod.apply_translation([0, 0, 0.5])
    return body(rod, "matt", OrganClass.WIRE)


def fast_and_exhaustive(mesh: Mesh, view: Camera = VIEW) -> tuple[np.ndarray, np.ndarray]:
    """The coverage image, and the one with all rays in every pixel."""
    scene, rays = truth_scene(assemble_scene(mesh)), camera_rays(view, local_coordinates(mesh))
    fast = SceneCoverage(mesh).image(scene, rays).astype(float)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coverage, "_is_mixed", lambda classes: np.ones(classes.shape, bool))
        return fast, SceneCoverage(mesh).image(scene, rays).astype(float)


def test_what_is_ignored_has_no_channel_and_is_not_background():
    # A wire in front of a wall that is ignored, whose edge is between two rays of column 40.
    edge = (40.3 - 32.0) / FOCAL_PX * 0.6
    wall = card(edge - 1.0, 0.0, 2.0, 4.0, "matt", 0.6)
    wall = replace(wall, instances=(Instance(OrganClass.BACKGROUND, "far_row", ignored=True),))
    fast, exhaustive = fast_and_exhaustive(concatenate_meshes([wire(3.0, 0.4), wall]))
    np.testing.assert_array_equal(fast, exhaustive)
    only_wire, _ = fast_and_exhaustive(wire(3.0, 0.4))
    np.testing.assert_array_equal(fast[..., OrganClass.WIRE], only_wire[..., OrganClass.WIRE])
    ignored = 1.0 - fast.sum(axis=-1)
    # The wire is only in columns 16 to 47; in front of it, the wall covers the first 40.3 columns.
    assert (ignored[:, :16] == 1.0).all()
    assert (ignored[:, 48:] == 0.0).all()
    clear = only_wire[..., OrganClass.WIRE][:, 40] == 0
    assert clear.sum() > 20
    np.testing.assert_allclose(ignored[clear, 40], 0.3, atol=1 / 32)
    np.testing.assert_array_equal(fast[..., OrganClass.BACKGROUND][clear, 40], 1.0 - ignored[clear, 40])


@pytest.mark.parametrize(("width", "angle"), [(0.06, 0.4), (0.7, 0.0), (3.0, 1.2)])
def test_wire_covers_its_width_of_each_row_it_crosses(width, angle):
    # It crosses rows at an angle: width / cos of each row, or of each column if it is closer to horizontal.
    fast, exhaustive = fast_and_exhaustive(wire(width, angle, offset_px=0.3))
    np.testing.assert_array_equal(fast, exhaustive)
    covered = fast[..., OrganClass.WIRE].sum(axis=1 if angle < np.pi / 4 else 0)
    expected = width / max(np.cos(angle), np.sin(angle))
    # Along a pixel's sides every row hits the same of 64 columns, and the mean is no better than one row.
    tolerance = 1 / POINTS if angle in (0.0, np.pi / 2) else 0.01 * width + 0.003
    assert covered.mean() == pytest.approx(expected, abs=tolerance)
    # Every crossed row is covered, even if no ray through a centre hits the wire.
    assert (covered > 0).mean() > (0.95 if width > 0.1 else 0.9)
    assert (covered < expected + 0.06).all()


def test_thin_wire_is_followed_from_where_it_is_hit():
    # The few rays of most of its pixels miss it; a ball is attached to it.
    ball = sphere((0, 0, 0.5), 0.004, "matt", subdivisions=2)
    fast, exhaustive = fast_and_exhaustive(concatenate_meshes([wire(0.08, 0.6), ball]))
    detected, expected = (image[..., OrganClass.WIRE] > 0 for image in (fast, exhaustive))
    assert expected.sum() > 60
    assert (expected & ~detected).sum() <= 1  # where it leaves the image through the corner of a pixel
    np.testing.assert_array_equal(fast[detected], exhaustive[detected])


def test_coverage_equals_the_mean_of_labels_of_smaller_pixels(plants):
    coarse, fine = camera(distorted=True), camera(columns=800, rows=600, distorted=True)
    fine = replace(fine, sensor=replace(fine.sensor, binning=fine.sensor.binning // 10))
    renderer = Renderer(assemble_scene(plants))
    image = renderer.render(coarse, ["coverage"])["coverage"].astype(float)
    labels = renderer.render(fine, ["class"])["class"].reshape(60, 10, 80, 10)
    for organ_class in OrganClass:
        expected = (labels == organ_class).mean(axis=(1, 3))
        error = image[..., organ_class] - expected
        mixed = (expected > 0) & (expected < 1)
        # 64 points per pixel against a hundred labels.
        assert np.abs(error).max() < 0.2, organ_class.name
        if mixed.any():
            assert np.sqrt(np.mean(error[mixed] ** 2)) < 0.04, organ_class.name
            assert abs(error.mean()) < 1e-3, organ_class.name


def test_coverage_equals_the_exhaustive_one(plants):
    fast, exhaustive = fast_and_exhaustive(plants, camera(columns=160, rows=120))
    differ = (fast != exhaustive).any(axis=-1)
    assert differ.mean() < 3e-4
    assert np.abs(fast - exhaustive).max() < 0.15
    assert 0.03 < (exhaustive.max(axis=-1) < 1).mean() < 0.5


def test_fractions_sum_to_one_everything_is_in_focus_and_an_empty_view_is_background(plants):
    renderer = Renderer(assemble_scene(plants))
    for columns, rows in ((1, 1), (7, 5)):
        fractions = renderer.render(camera(columns=columns, rows=rows), ["coverage"])["coverage"]
        assert (fractions.dtype, fractions.shape) == (np.float16, (rows, columns, len(OrganClass)))
        assert (fractions.astype(float).sum(axis=-1) == 1.0).all()
        assert (fractions * POINTS == np.rint(fractions * POINTS)).all()
        assert fractions.min() >= 0
    sharp, focused = (renderer.render(replace(camera(), focus_m=m), ["coverage"]) for m in (None, 0.2))
    np.testing.assert_array_equal(sharp["coverage"], focused["coverage"])
    away = POSES[1].copy()
    away[:3, :3] = away[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    empty = renderer.render(replace(camera(), pose=away), ["coverage"])["coverage"]
    assert (empty[..., OrganClass.BACKGROUND] == 1).all()


def test_another_scene_image_size_or_pose_compiles_nothing(plants):
    outputs = ("class", "coverage", "position", "uv", "flow", "stereo")
    first = Renderer(assemble_scene(plants))
    for step in (0, 1):
        first.render(camera(step), outputs, partners=partners(step))
    assert count_compiled(lambda: first.render(camera(1), outputs, partners=partners(0))) == 0
    small = camera(columns=84, rows=63)
    assert count_compiled(lambda: first.render(small, outputs, partners=partners())) == 0
    other = Renderer(assemble_scene(concatenate_meshes([plants, wire(3.0, 0.3)])))
    assert count_compiled(lambda: other.render(camera(), outputs, partners=partners())) == 0


def test_points_and_their_groups_are_evenly_spread():
    points = pixel_points()
    cell = np.floor(points * POINTS).astype(int)
    for axis in range(2):
        np.testing.assert_array_equal(np.sort(cell[:, axis]), np.arange(POINTS))
    for group in (points * 2).astype(int).reshape(-1, 4, 2).tolist():
        assert sorted(map(tuple, group)) == [(0, 0), (0, 1), (1, 0), (1, 1)]

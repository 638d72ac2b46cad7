"""Optical flow in scenes where it is known by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera, body, sheet, sphere
from greenhouse import POSES, camera, row_of_plants
from test_coverage import FOCAL_PX, VIEW

from pepperscene.camera import Camera, Partners
from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.outputs import OUTPUTS
from pepperscene.render import Renderer
from pepperscene.render.aov.flow import CLEARANCE, is_unoccluded
from pepperscene.render.kernel.scene import truth_scene
from pepperscene.scene import assemble_scene

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
    faces = np.concatenate([first + [0, 1, 42], first + [0, 42, 41]])
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

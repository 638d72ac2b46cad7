"""Visibility of points and of organs, in scenes where it is known by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera, card, sheet, sphere
from greenhouse import camera, greenhouse

from pepperscene.camera import Motion, look_at
from pepperscene.geometry import concatenate_meshes
from pepperscene.render import Renderer
from pepperscene.render.visibility import visible_fraction
from pepperscene.scene import assemble_scene

VIEW = axis_camera(64, 64, flash=False)
FOCAL_PX = 4.16e-3 / 9e-6
RADIUS_M, DISTANCE_M = 0.01, 0.5


def ball_points(count=20000, centre=(0.0, 0.0, DISTANCE_M)):
    """Even points on a sphere of `RADIUS_M`, and their normals."""
    number = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * number / count, number * np.pi * (3.0 - np.sqrt(5.0))
    normals = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    return np.array(centre) + RADIUS_M * normals, normals


def renderer(*meshes):
    return Renderer(assemble_scene(concatenate_meshes(meshes)))


@pytest.fixture(scope="module")
def ball():
    return sphere((0.0, 0.0, DISTANCE_M), RADIUS_M * (1.0 - 1e-4), "matt")


def test_the_near_side_of_a_ball_alone_is_visible(ball):
    points, normals = ball_points()
    visible = renderer(ball).visible_points(VIEW, points, normals)
    np.testing.assert_array_equal(visible, (normals * -points).sum(axis=1) > 0.0)
    # A cap ends where lines of sight touch the ball, slightly before its half.
    assert visible.mean() == pytest.approx(0.5 * (1.0 - RADIUS_M / DISTANCE_M), abs=1e-3)
    assert visible_fraction(renderer(ball).visible_points, VIEW, points, normals) == 1.0


@pytest.mark.parametrize("covered", [0.0, 0.25, 0.9])
def test_a_card_hides_its_share_of_the_outline(ball, covered):
    # The share of a disc left of a line at x radii is (acos(-x) + x sqrt(1 - x^2)) / pi.
    x = np.linspace(-1, 1, 100001)
    edge = np.interp(covered, (np.arccos(-x) + x * np.sqrt(1 - x**2)) / np.pi, x)
    # At half the distance, the card is as wide as it looks on a plane through the ball twice as far away.
    right = edge * RADIUS_M / np.sqrt(1 - (RADIUS_M / DISTANCE_M) ** 2) / 2
    board = card(right - 0.05, 0.0, 0.1, 0.1, "matt", DISTANCE_M / 2)
    points, normals = ball_points()
    fraction = visible_fraction(renderer(ball, board).visible_points, VIEW, points, normals)
    assert fraction == pytest.approx(1.0 - covered, abs=0.005)


def test_what_is_outside_the_image_counts_as_hidden():
    # The image's right border goes through the ball's centre.
    centre = (32 / FOCAL_PX * DISTANCE_M, 0.0, DISTANCE_M)
    points, normals = ball_points(centre=centre)
    rendered = renderer(sphere(centre, RADIUS_M * (1.0 - 1e-4), "matt"))
    assert visible_fraction(rendered.visible_points, VIEW, points, normals) == pytest.approx(0.5, abs=0.01)


def test_a_motion_of_the_camera_has_no_effect(ball):
    # Points around the ball, of which many are outside the image or hidden.
    points = np.random.default_rng(1).uniform((-0.05, -0.05, 0.4), (0.05, 0.05, 0.6), (2000, 3))
    sensor = replace(VIEW.sensor, line_time_s=1e-3)
    moving = replace(VIEW, sensor=sensor, motion=Motion((2.0, 0.0, 0.0), (0.0, 3.0, 0.0)))
    expected = renderer(ball).visible_points(VIEW, points)
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(renderer(ball).visible_points(moving, points), expected)


def test_points_of_a_blade_are_visible_from_both_sides():
    leaf = renderer(sheet(0.2, 0.2, 0.0, "matt"))
    points = np.column_stack([*np.random.default_rng(0).uniform(-0.01, 0.01, (2, 200)), np.zeros(200)])
    normals = np.tile([0.0, 0.0, -1.0], (200, 1))
    for z in (-DISTANCE_M, DISTANCE_M):
        view = VIEW.at_pose(look_at([0, 0, z], [0, 0, 0], [0, 1, 0]))
        assert visible_fraction(leaf.visible_points, view, points, normals, closed=False) == 1.0
        assert visible_fraction(leaf.visible_points, view, points, normals) == (z < 0)


def test_a_point_in_space_is_visible_unless_something_is_in_front():
    wall = renderer(sheet(2.0, 2.0, 0.4, "matt"))
    points = [[0.0, 0.0, z] for z in (0.1, 0.39, 0.4, 0.41, 5.0)]
    np.testing.assert_array_equal(wall.visible_points(VIEW, points), [True, True, True, False, False])
    assert visible_fraction(wall.visible_points, VIEW, points[:1]) == 1.0
    assert visible_fraction(wall.visible_points, VIEW, np.empty((0, 3))) == 0.0


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_the_size_of_the_world_does_not_matter(scale):
    near = sphere((0.0, 0.0, DISTANCE_M), RADIUS_M * (1.0 - 1e-4), "matt")
    scaled = replace(near, vertices=near.vertices * np.float32(scale))
    points, normals = ball_points(1000)
    visible = renderer(scaled).visible_points(VIEW, scale * points, normals)
    np.testing.assert_array_equal(visible, renderer(near).visible_points(VIEW, points, normals))


def test_points_behind_pixels_are_visible_before_and_after_light_was_traced():
    # Every point of the output `position` is visible by definition.
    rendered, view = Renderer(greenhouse()), camera()
    frame = rendered.render(view, ["position", "class"])
    points = frame["position"][frame["class"] > 0].astype(float)
    before = rendered.visible_points(view, points)
    rendered.render(view, ["colour"], "draft")
    np.testing.assert_array_equal(rendered.visible_points(view, points), before)
    assert len(points) > 500
    assert before.all()
    # The same points pushed into the surface are hidden.
    beyond = view.pose[:3, 3] + 1.01 * (points - view.pose[:3, 3])
    assert rendered.visible_points(view, beyond).mean() < 0.02

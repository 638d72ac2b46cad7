"""Visibility of points, organs and fruit: closed forms and an independent ray caster.

The points on a surface are evenly distributed, so a share of it is known to a few times one over their number
to the power of 3/4; the tolerances follow from that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera, body, card, sheet, sphere
from greenhouse import camera, greenhouse
from trimesh.ray.ray_triangle import RayMeshIntersector

from pepperscene.camera import Distortion, Motion, look_at
from pepperscene.classes import OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.geometry import concatenate_meshes
from pepperscene.render import Renderer
from pepperscene.render.viewpoints import observer as observer_module
from pepperscene.render.viewpoints.fruit_parts import FruitPart
from pepperscene.render.viewpoints.observer import FruitObserver
from pepperscene.render.visibility import visible_fraction
from pepperscene.scene import assemble_scene
from pepperscene.truth.cut_point import FruitStalk

RADIUS_M, DISTANCE_M = 0.03, 0.5
FOCAL_PX = 4.16e-3 / 9e-6
CAMERA = axis_camera(flash=False)
AHEAD = np.eye(4)  # at the origin, along +z
FIRST = FruitPart(0)


def observer(*meshes, fruit=(FIRST,), samples=4096):
    return FruitObserver(assemble_scene(concatenate_meshes(meshes)), samples, fruit)


def ball(x=0.0, y=0.0, z=0.5, subdivisions=5):
    return sphere((x, y, z), RADIUS_M, "matt", subdivisions)


@pytest.mark.parametrize("ratio", [0.5, 0.1, 0.01])
def test_a_free_ball_shows_its_cap(ratio):
    # Lines of sight touch a ball of radius R at a distance d on a circle; in front of it is (1 - R / d) / 2.
    distance = RADIUS_M / ratio
    seen = observer(ball(z=distance)).observe(CAMERA, AHEAD)
    assert seen.surface_fraction[0] == pytest.approx((1.0 - ratio) / 2.0, abs=0.004)
    # Its facets are flat, so those at the rim are in part hidden.
    assert seen.facing_fraction[0] == pytest.approx(1.0, abs=0.02)
    assert seen.visible_fraction[0] == pytest.approx(1.0, abs=1e-3)
    # Its image is a disc.
    radius_px = FOCAL_PX * ratio / np.sqrt(1.0 - ratio**2)
    assert seen.visible_pixels[0] == pytest.approx(np.pi * radius_px**2, rel=0.01)


def plate_over(covered):
    """A plate at half the distance that hides a share of the ball's outline."""
    # The share of a disc left of a line at x radii is (acos(-x) + x sqrt(1 - x^2)) / pi.
    x = np.linspace(-1, 1, 100001)
    edge = np.interp(covered, (np.arccos(-x) + x * np.sqrt(1 - x**2)) / np.pi, x)
    # It is as wide as it looks on a plane through the ball twice as far away.
    right = edge * RADIUS_M / np.sqrt(1 - (RADIUS_M / DISTANCE_M) ** 2) / 2
    return card(right - 0.1, 0.0, 0.2, 0.2, "matt", DISTANCE_M / 2)


@pytest.mark.parametrize("covered", [0.25, 0.9])
def test_a_plate_hides_its_share_of_a_disc(covered):
    seen = observer(ball(), plate_over(covered)).observe(CAMERA, AHEAD, occluders=True)
    assert seen.visible_fraction[0] == pytest.approx(1.0 - covered, abs=0.005)
    assert seen.occluders.instance.tolist() == [1]
    assert seen.occluders.fraction[0] == pytest.approx(covered, abs=0.005)


def test_of_two_plates_behind_each_other_the_first_one_is_the_occluder():
    near, far = card(-0.1, 0.0, 0.2, 0.2, "matt", 0.1), card(0.0, 0.0, 0.4, 0.4, "matt", 0.3)
    seen = observer(ball(), near, far).observe(CAMERA, AHEAD, occluders=True)
    assert seen.visible_fraction[0] == 0.0
    assert sorted(seen.occluders.instance.tolist()) == [1, 2]
    np.testing.assert_allclose(seen.occluders.fraction, 0.5, atol=0.01)
    assert np.all(np.diff(seen.occluders.fraction) <= 0.0)


def test_what_a_body_hides_of_itself_counts_in_the_areas_alone():
    ring = body(trimesh.creation.torus(0.05, 0.02), "matt", OrganClass.PEPPER)
    tilted = ring.moved(
        trimesh.transformations.rotation_matrix(1.2, [1, 0, 0])[:3, :3], np.array([0, 0, 0.5])
    )
    plate = card(-0.1, 0.0, 0.2, 0.2, "matt", 0.25)
    free, half = observer(tilted).observe(CAMERA, AHEAD), observer(tilted, plate).observe(CAMERA, AHEAD)
    assert free.visible_fraction[0] == 1.0
    assert 0.3 < free.facing_fraction[0] < 0.95
    # The plate hides the left half of a symmetric body.
    assert half.visible_fraction[0] == pytest.approx(0.5, abs=0.01)
    assert half.facing_fraction[0] == pytest.approx(free.facing_fraction[0] / 2, abs=0.01)


def test_each_point_is_as_visible_as_for_another_ray_caster():
    rng = np.random.default_rng(5)
    centres = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.03, 0.03, (3, 3))
    balls = [trimesh.creation.icosphere(3, RADIUS_M).apply_translation(centre) for centre in centres]
    fruit = body(trimesh.util.concatenate(balls), "matt", OrganClass.PEPPER)
    leaves = [
        card(*rng.uniform(-0.06, 0.06, 2), *rng.uniform(0.01, 0.05, 2), "matt", rng.uniform(0.1, 0.4))
        for _ in range(12)
    ]
    tested = observer(fruit, *leaves, samples=256)
    poses = [look_at(rng.uniform(-0.2, 0.2, 3), [0, 0, 0.5], [0, 1, 0]) for _ in range(6)]
    seen = tested.observe(CAMERA, poses)
    mesh = concatenate_meshes([fruit, *leaves])
    caster = RayMeshIntersector(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))
    points, normals = tested.points.points[0, :256], tested.points.normals[0, :256]
    visible = np.unpackbits(seen.seen, axis=1).astype(bool)
    assert 0.05 < visible.mean() < 0.4
    for pose, found in zip(poses, visible, strict=True):
        away = points - pose[:3, 3]
        distance = np.linalg.norm(away, axis=1)
        hits, rays, _ = caster.intersects_location(np.tile(pose[:3, 3], (256, 1)), away / distance[:, None])
        nearest = np.full(256, np.inf)
        np.minimum.at(nearest, rays, np.linalg.norm(hits - pose[:3, 3], axis=1))
        expected = (nearest > distance - 1e-4) & ((normals * away).sum(axis=1) < 0.0)
        # Rays may pass an edge on different sides.
        assert np.count_nonzero(found != expected) <= 1


@pytest.mark.parametrize("x", [0.0, 0.38])
def test_fractions_of_pixels_follow_a_distorting_lens(x):
    lens = replace(CAMERA.lens, distortion=Distortion(k1=-0.2, k2=0.06, p1=2e-3, p2=-2e-3))
    camera = replace(CAMERA, lens=lens)
    # A plate over the left half, and the image's border at the right of the second ball.
    plate = card(x / 2 - 0.1, 0.0, 0.2, 0.2, "matt", 0.25)
    meshes = ball(x), plate
    truth = Renderer(assemble_scene(concatenate_meshes(meshes))).render(camera, ["instance"])["instance"]
    alone = Renderer(assemble_scene(ball(x))).render(camera, ["instance"])["instance"]
    seen = observer(*meshes).observe(camera, AHEAD)
    assert seen.visible_pixels[0] == pytest.approx((truth == 1).sum(), abs=0.01 * (alone == 1).sum())
    assert seen.visible_fraction[0] == pytest.approx((truth == 1).sum() / (alone == 1).sum(), abs=0.01)


def test_a_peduncle_and_its_cut_have_fractions_of_their_own():
    # A vertical stalk of 4 cm, cut in its upper quarter; a plate hides all above its middle.
    tube = trimesh.creation.cylinder(0.004, 0.04, sections=128)
    tube.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    stalk = body(tube, "matt", OrganClass.PEDUNCLE).moved(np.eye(3), np.array([0.0, -0.05, 0.5]))
    curve = np.array([[0.0, -0.07, 0.5], [0.0, -0.03, 0.5]])
    tangent = np.array([0.0, 1.0, 0.0])
    part = FruitPart(0, FruitStalk(1, -1, 0.004, curve, 0.04, np.array([0.0, -0.06, 0.5]), tangent))
    plate = card(0.0, -0.125, 0.2, 0.2, "matt", 0.25)
    free = observer(ball(), stalk, fruit=[part]).observe(CAMERA, AHEAD)
    assert free.peduncle.tolist() == [1]
    # The ball hides a part of its lower end.
    assert free.peduncle_visible_fraction[0] == pytest.approx(1.0, abs=0.02)
    assert free.cut_visible_fraction[0] == 1.0
    seen = observer(ball(), stalk, plate, fruit=[part]).observe(CAMERA, AHEAD)
    assert seen.visible_fraction[0] == 1.0
    assert seen.peduncle_visible_fraction[0] == pytest.approx(0.5, abs=0.06)
    assert seen.cut_visible_fraction[0] == 0.0


def test_only_fruit_in_view_have_rows():
    parts = [FruitPart(index) for index in range(3)]
    tested = observer(ball(), ball(0.1), ball(5.0), fruit=parts, samples=64)
    away = look_at([0, 0, 0], [0, 0, -1], [0, 1, 0])
    seen = tested.observe(CAMERA, [AHEAD, away, AHEAD])
    assert seen.pose_index.tolist() == [0, 0, 2, 2]
    assert seen.fruit_index.tolist() == [0, 1, 0, 1]
    # The surface seen of the first ball is that of its cap; a third pose sees less of it from near.
    near = look_at([0, 0, 0.4], [0, 0, 0.5], [0, 1, 0])
    assert tested.observe(CAMERA, [near, AHEAD, away]).best_poses().tolist() == [1, 1, -1]
    assert len(tested.observe(CAMERA, [away])) == 0
    assert len(tested.observe(CAMERA, [away], occluders=True).occluders.row) == 0


def test_parts_and_repetitions_give_the_same_bytes(monkeypatch):
    rng = np.random.default_rng(2)
    plates = [card(*rng.uniform(-0.06, 0.06, 2), 0.02, 0.02, "matt", 0.3) for _ in range(9)]
    tested = observer(ball(), ball(0.1), *plates, fruit=[FIRST, FruitPart(1)], samples=128)
    poses = [look_at(rng.uniform(-0.1, 0.1, 3), [0, 0, 0.5], [0, 1, 0]) for _ in range(20)]
    done = []
    whole = tested.observe(CAMERA, poses, occluders=True, on_progress=lambda *counts: done.append(counts))
    assert done == [(20, 20)]
    monkeypatch.setattr(observer_module, "_LANES", 1000)
    monkeypatch.setattr(observer_module, "_POSES", 7)
    parts = tested.observe(CAMERA, poses, occluders=True)
    for name in observer_module.ROW_ARRAYS:
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
    for name in ("row", "instance", "fraction"):
        np.testing.assert_array_equal(getattr(whole.occluders, name), getattr(parts.occluders, name))
    shares = np.bincount(whole.occluders.row, whole.occluders.fraction, len(whole)) + whole.visible_fraction
    np.testing.assert_allclose(shares, 1.0, atol=1e-9)


def test_invalid_arguments_are_rejected():
    scene = assemble_scene(ball(subdivisions=1))
    for arguments, message in (
        ((100, [FIRST]), "samples: must be a multiple of 64 above 0, not 100"),
        ((64,), "skeleton"),
        ((64, []), "has no fruit"),
    ):
        with pytest.raises(ArgumentError, match=message):
            FruitObserver(scene, *arguments)
    tested = FruitObserver(scene, 64, [FIRST])
    for poses, message in (
        (np.zeros((0, 4, 4)), "poses: must be at least one"),
        ([AHEAD, 2.0 * AHEAD], "poses: pose 1 must be a rotation and a translation"),
    ):
        with pytest.raises(ArgumentError, match=message):
            tested.observe(CAMERA, poses)


# --- points of any body -------------------------------------------------------------------------------------

VIEW = axis_camera(64, 64, flash=False)


def ball_points(count=20000, centre=(0.0, 0.0, DISTANCE_M)):
    """Even points on a sphere of `RADIUS_M`, and their normals."""
    number = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * number / count, number * np.pi * (3.0 - np.sqrt(5.0))
    normals = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    return np.array(centre) + RADIUS_M * normals, normals


def renderer(*meshes):
    return Renderer(assemble_scene(concatenate_meshes(meshes)))


@pytest.fixture(scope="module")
def inner():
    """A ball just below the points of `ball_points`."""
    return sphere((0.0, 0.0, DISTANCE_M), RADIUS_M * (1.0 - 1e-4), "matt")


def test_the_near_side_of_a_ball_alone_is_visible(inner):
    points, normals = ball_points()
    visible = renderer(inner).visible_points(VIEW, points, normals)
    np.testing.assert_array_equal(visible, (normals * -points).sum(axis=1) > 0.0)
    # A cap ends where lines of sight touch the ball, slightly before its half.
    assert visible.mean() == pytest.approx(0.5 * (1.0 - RADIUS_M / DISTANCE_M), abs=1e-3)
    assert visible_fraction(renderer(inner).visible_points, VIEW, points, normals) == 1.0


@pytest.mark.parametrize("covered", [0.0, 0.25, 0.9])
def test_a_card_hides_its_share_of_the_outline(inner, covered):
    points, normals = ball_points()
    fraction = visible_fraction(renderer(inner, plate_over(covered)).visible_points, VIEW, points, normals)
    assert fraction == pytest.approx(1.0 - covered, abs=0.005)


def test_what_is_outside_the_image_counts_as_hidden():
    # The image's right border goes through the ball's centre.
    centre = (32 / FOCAL_PX * DISTANCE_M, 0.0, DISTANCE_M)
    points, normals = ball_points(centre=centre)
    rendered = renderer(sphere(centre, RADIUS_M * (1.0 - 1e-4), "matt"))
    assert visible_fraction(rendered.visible_points, VIEW, points, normals) == pytest.approx(0.5, abs=0.01)


def test_a_motion_of_the_camera_has_no_effect(inner):
    # Points around the ball, of which many are outside the image or hidden.
    points = np.random.default_rng(1).uniform((-0.05, -0.05, 0.4), (0.05, 0.05, 0.6), (2000, 3))
    sensor = replace(VIEW.sensor, line_time_s=1e-3)
    moving = replace(VIEW, sensor=sensor, motion=Motion((2.0, 0.0, 0.0), (0.0, 3.0, 0.0)))
    expected = renderer(inner).visible_points(VIEW, points)
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(renderer(inner).visible_points(moving, points), expected)


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
def test_the_size_of_the_world_does_not_matter(inner, scale):
    scaled = replace(inner, vertices=inner.vertices * np.float32(scale))
    points, normals = ball_points(1000)
    visible = renderer(scaled).visible_points(VIEW, scale * points, normals)
    np.testing.assert_array_equal(visible, renderer(inner).visible_points(VIEW, points, normals))


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

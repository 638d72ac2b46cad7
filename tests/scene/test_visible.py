"""Nothing that a view can show is touched, and what goes stays within its bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.camera import Camera, Distortion, arc_path, load_flash, load_lens, load_sensor
from pepperscene.classes import Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import Mesh, concatenate_meshes, mesh_plant, rectangle, sphere
from pepperscene.grammar import grow
from pepperscene.scene import (
    LightReach,
    cull_mesh,
    light_reach,
    place_plants,
    rotation_about_z,
    view_frustums,
)
from pepperscene.scene.culling import LEAST_LIGHT, negligible, pieces
from pepperscene.scene.lod import pattern, stand_ins

NIGHT = LightReach(0.0, 0.0, 0.05, 0.4)


@pytest.fixture(scope="module")
def camera() -> Camera:
    return Camera(
        load_lens("lensagon_cmfa0420nd"),
        load_sensor("ueye_ui5250re"),
        flash=load_flash("led_matrix_200klx"),
        focus_m=0.4,
    )


@pytest.fixture(scope="module")
def row() -> Mesh:
    """Three plants, 15 cm apart, and a floor."""
    rng = np.random.default_rng(3)
    plants = [mesh_plant(grow(load_cultivar("kaite"), child), 0.5) for child in rng.spawn(3)]
    feet = np.array([[-0.15, 0.0, 0.0], [0.0, 0.1, 0.0], [0.15, 0.0, 0.0]])
    floor = rectangle((0, 0, -0.05), (9, 0, 0), (0, 9, 0))
    return concatenate_meshes([place_plants(plants, feet, np.array([0.0, 1.0, 2.0])), floor])


def path(count=9, low=0.9, high=1.3, pitch=20.0):
    return arc_path(count, 0.4, (-0.8, 0.8), (low, high), np.radians(pitch))


def corners(mesh: Mesh) -> np.ndarray:
    """`(f, 10)` each triangle's instance and corners."""
    return np.column_stack([mesh.face_instance, mesh.vertices[mesh.faces].reshape(-1, 9)])


def in_picture(camera, poses, points):
    """`(n,)` whether the camera's own projection puts a point into the picture from any pose."""
    found = np.zeros(len(points), dtype=bool)
    for pose in poses:
        u, v = camera.at_pose(pose).project(points).T
        found |= (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)
    return found


# --- what is seen -------------------------------------------------------------------------------------------


@given(
    seed=st.integers(0, 2**32 - 1),
    k1=st.floats(-0.12, 0.1),
    half=st.floats(0.0, 0.3),
    share=st.floats(0.0, 1.0),
)
@settings(max_examples=40, deadline=None)
def test_no_box_with_a_point_in_the_picture_or_in_the_flash_s_way_is_missed(camera, seed, k1, half, share):
    rng = np.random.default_rng(seed)
    few = replace(camera.sensor, columns=80, rows=60, binning=20)
    bent = replace(camera, sensor=few, lens=replace(camera.lens, distortion=Distortion(k1=k1)))
    turn = rotation_about_z(rng.uniform(0, 6))
    poses = path(5) @ np.eye(4)
    poses[:, :3] = turn @ poses[:, :3]
    points = rng.uniform((-2, -2, 0), (2, 2, 4), (400, 3))
    for pose in poses:
        here = bent.at_pose(pose)
        shown = points[in_picture(here, [pose], points)]
        lamp = rng.integers(len(camera.flash.emitters_m), size=len(shown))
        lamps = np.pad(camera.flash.emitters_m, ((0, 0), (0, 1)))[lamp] + camera.flash.offset_m
        starts = lamps @ pose[:3, :3].T + pose[:3, 3]
        on_the_way = starts + share * (shown - starts)
        # A box that holds the point off its middle.
        halves = np.full(shown.shape, half)
        centres = on_the_way + rng.uniform(-half, half, shown.shape) * 0.999
        seen = view_frustums(bent, poses).meets(centres.astype(np.float32), halves.astype(np.float32))
        assert seen.all()


def test_rays_out_of_focus_stay_inside(camera):
    # Rays from all over the pupil through the plane in focus, far beyond it.
    pose, rng = path(1)[0], np.random.default_rng(1)
    near = replace(camera, focus_m=0.1, flash=None, lens=replace(camera.lens, f_number=1.0))
    directions = near.ray_slopes()[[0, 0, -1, -1], [0, -1, 0, -1]]
    angle = rng.uniform(0, 2 * np.pi, 64)
    rim = near.aperture_radius_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(64)])
    in_focus = 0.1 * np.column_stack([directions, np.ones(4)])
    ends = rim[:, None] + 40.0 * (in_focus[None] - rim[:, None])
    world = (ends.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
    assert view_frustums(near, pose).meets(world, np.zeros_like(world)).all()
    assert not view_frustums(replace(near, focus_m=None), pose).meets(world, np.zeros_like(world)).all()


def test_what_lies_outside_every_view_is_found(camera):
    view = view_frustums(camera, path(5, 0.9, 0.9, pitch=0.0))
    box = np.full((3, 3), 0.01, np.float32)
    outside = np.array([[0.0, 3.0, 9.0], [0.0, 0.0, 0.2], [0.0, -5.0, 0.9]], np.float32)
    assert not view.meets(outside, box).any()
    assert view.meets(np.array([[0.0, 0.0, 0.9]], np.float32), box[:1]).all()


@pytest.mark.parametrize("light", [NIGHT, LightReach(0.01, 0.01, 0.05, 0.4), LightReach(1.0, 1.0, 0.0, 0.4)])
def test_no_triangle_that_a_view_can_show_is_touched(camera, row, light):
    poses = path()
    made = cull_mesh(row, view_frustums(camera, poses), light)
    shown = in_picture(camera, poses, row.vertices)
    wanted = corners(row)[shown[row.faces].any(axis=1)]
    left = {line.tobytes() for line in corners(made)}
    assert len(wanted) > 1000
    assert all(line.tobytes() in left for line in wanted)
    # Instances and surfaces keep their numbers.
    assert made.instances == row.instances
    assert made.surfaces == row.surfaces
    if light.simple:
        assert len(made.faces) < 0.7 * len(row.faces)
    np.testing.assert_array_equal(np.unique(made.faces), np.arange(len(made.vertices)))


def test_the_same_whichever_way_it_is_asked(camera, row):
    poses = path(40)
    one, two = (cull_mesh(row, view_frustums(camera, order), NIGHT) for order in (poses, poses[::-1]))
    np.testing.assert_array_equal(corners(one), corners(two))
    # More poses see more.
    fewer = cull_mesh(row, view_frustums(camera, poses[:5]), NIGHT)
    assert len(fewer.faces) < len(one.faces)


def test_a_view_of_all_and_of_nothing_keep_the_mesh(camera, row):
    ball = sphere((0.0, 0.0, 0.0), 0.1, "leaf", subdivisions=2).moved(np.eye(3), np.array([0.0, 0.0, 1.0]))
    assert cull_mesh(ball, view_frustums(camera, path(3, 0.9, 0.9)), NIGHT) is ball
    away = ball.moved(np.eye(3), np.array([0.0, 0.0, 9.0]))
    assert cull_mesh(away, view_frustums(camera, path(3, 0.9, 0.9)), NIGHT) is away


# --- pieces -------------------------------------------------------------------------------------------------


def test_boxes_hold_their_pieces(row):
    long = sphere((0.5, 0.2, 1.0), 0.4, "leaf", subdivisions=5)
    mesh = concatenate_meshes([row, long])
    found = pieces(mesh)
    assert found.faces[0] == 0
    assert found.faces[-1] == len(mesh.faces)
    assert (np.diff(found.faces) > 0).all()
    # The long one is in pieces, no organ is.
    assert (~found.whole).sum() == (found.owner == len(mesh.instances) - 1).sum() > 10
    number = np.repeat(np.arange(len(found.owner)), np.diff(found.faces))
    np.testing.assert_array_equal(found.owner[number], mesh.face_instance)
    off = np.abs(mesh.vertices[mesh.faces] - found.centres[number][:, None])
    assert (off <= found.halves[number][:, None] + 1e-6).all()
    inside = (mesh.faces >= found.vertices[number, :1]) & (mesh.faces < found.vertices[number, 1:])
    assert inside.all()


# --- what does not matter -----------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), daylight=st.floats(0.0, 1.0), sun=st.sampled_from([0.0, 1e-4, 0.3]))
@settings(max_examples=20, deadline=None)
def test_all_that_is_left_out_stays_below_the_bound(camera, seed, daylight, sun):
    rng = np.random.default_rng(seed)
    seen_at = rng.uniform((-0.1, -0.1, 0.9), (0.1, 0.1, 1.1), (3, 3))
    near = [sphere(at, 0.05, "leaf", subdivisions=1) for at in seen_at]
    places, sizes = rng.uniform((-9, -9, -40), (9, 9, 0), (40, 3)), rng.uniform(0.001, 0.1, 40)
    far = [sphere(at, size, "leaf", subdivisions=1) for at, size in zip(places, sizes, strict=True)]
    found = pieces(concatenate_meshes([*near, *far]))
    light = LightReach(daylight, sun, 0.05, 0.4, 0.07)
    view = view_frustums(camera, path(5, 0.9, 1.1))
    seen = view.meets(found.centres, found.halves)
    out = negligible(found, seen, view, light)
    assert not (out & seen).any()
    # Told again, one by one, with the balls' solid angles from the nearest points that are seen.
    total = 0.0
    for centre, radius in zip(found.centres[out].astype(float), found.radii[out].astype(float), strict=True):
        away = (np.linalg.norm(found.centres[seen] - centre, axis=1) - found.radii[seen]).min()
        flash = np.linalg.norm(view.places - centre, axis=1).min() - radius - 0.07
        covered = min(1.0, (radius / max(away, radius)) ** 2)
        total += (daylight + sun + 0.05 * (0.4 / flash) ** 2) * covered
        # The sun's disc is half a degree wide.
        total += sun * min(1.0, covered / np.radians(0.2666) ** 2)
    assert total <= LEAST_LIGHT * 1.001


def test_far_away_things_go_and_near_ones_stay(camera):
    seen, below, far = (
        sphere(place, 0.05, "leaf", subdivisions=2) for place in ((0, 0, 1.0), (0, 0, 0.3), (0, 0, -60.0))
    )
    mesh = concatenate_meshes([seen, below, far])
    made = cull_mesh(mesh, view_frustums(camera, path(5, 0.9, 0.9)), LightReach(0.5, 0.0, 0.05, 0.4))
    assert {*made.face_instance.tolist()} == {0, 1}
    assert len(made.instances) == 3


def test_reach_tells_the_shares_of_flash_and_daylight(camera):
    flash = camera.flash
    bright = light_reach(camera, flash.at_m, flash.illuminance_lx * camera.flash_duty)
    assert bright.sky == pytest.approx(0.5)
    assert bright.sun == 0.0
    assert not bright.simple
    # Beside the picture the beam is weak.
    border = np.arctan(np.abs(camera.ray_slopes()[0, :, 1]).min())
    assert bright.stray == pytest.approx(0.5 * float(flash.profile.at(border)), rel=1e-3)
    assert light_reach(camera, 0.4, 0.0).sky == 0.0
    assert light_reach(camera, 0.4, 3000.0, 2000.0).sun == pytest.approx(
        light_reach(camera, 0.4, 2000.0, 3000.0).sky
    )
    assert light_reach(replace(camera, flash=None), 0.4, 100.0) == LightReach(1.0, 1.0, 0.0, 0.4)
    # Twice as near the flash is four times as bright.
    one, two = light_reach(camera, 0.4, 5500.0).sky, light_reach(camera, 0.2, 5500.0).sky
    assert (1 / two - 1) == pytest.approx(4 * (1 / one - 1))


# --- stand-ins ----------------------------------------------------------------------------------------------


def test_a_flat_sheet_keeps_its_area():
    u, v = np.meshgrid(np.linspace(0, 1, 13), np.linspace(0, 1, 25))
    uv = np.column_stack([u.ravel(), v.ravel()]).astype(np.float32)
    corner = np.arange(13 * 25).reshape(25, 13)
    a, b, d, c = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    made = pattern(uv, faces, (4, 6), closed=False)
    p, q, r = (uv[made.vertices][made.faces[:, k]].astype(float) for k in range(3))
    area = ((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0]) / 2.0
    # All turn the same way, and cover the whole sheet once.
    assert (area > 0).all()
    assert area.sum() == pytest.approx(1.0)
    assert len(made.faces) == 2 * 4 * 6


def test_stand_ins_are_made_of_their_organ_s_own_vertices(row):
    found = pieces(row)
    chosen = np.flatnonzero(found.whole)
    ends = np.stack([found.faces[chosen], found.faces[chosen + 1]], axis=1)
    few, done = stand_ins(row, ends, found.vertices[chosen])
    assert done.sum() > 0.95 * len(chosen)
    assert len(few.faces) < 0.2 * len(row.faces)
    own = np.column_stack([row.vertex_instance, row.vertices, row.normals, row.uv, row.state])
    new = np.column_stack([few.vertex_instance, few.vertices, few.normals, few.uv, few.state])
    assert {line.tobytes() for line in new} <= {line.tobytes() for line in own}
    replaced = found.owner[chosen[done]]
    np.testing.assert_array_equal(np.unique(few.face_instance), np.sort(replaced))
    # A leaf keeps its surface, and most of its area.
    for number in replaced:
        there, here = few.face_instance == number, row.face_instance == number
        assert {*few.face_surface[there]} <= {*row.face_surface[here]}
    leaf = [number for number in replaced if row.instances[number].organ_class == OrganClass.LEAF]
    area = [_areas(mesh)[leaf].sum() for mesh in (few, row)]
    assert 0.75 < area[0] / area[1] <= 1.0


def test_what_has_no_pattern_stays():
    # Of the background class, as all furniture is.
    wall = sphere((0, 0, 0), 0.1, "wall", 3)
    wall = replace(wall, instances=(Instance(OrganClass.BACKGROUND, "wall"),))
    few, done = stand_ins(wall, np.array([[0, len(wall.faces)]]), np.array([[0, len(wall.vertices)]]))
    assert not done.any()
    assert len(few.faces) == len(few.vertices) == 0


def _areas(mesh: Mesh) -> np.ndarray:
    p, q, r = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    area = np.linalg.norm(np.cross(q - p, r - p), axis=1) / 2.0
    return np.bincount(mesh.face_instance, area, minlength=len(mesh.instances))

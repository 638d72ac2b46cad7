"""Culling: nothing that a view can show changes, and what is left out stays below its tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.camera import Camera, Distortion, arc_path, load_flash, load_lens, load_sensor
from pepperscene.classes import OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import concatenate_meshes, mesh_plant, rectangle, sphere
from pepperscene.grammar import grow
from pepperscene.scene import (
    LightReach,
    combine_reaches,
    cull_mesh,
    light_reach,
    place_plants,
    rotation_about_z,
    view_frustums,
)
from pepperscene.scene.culling import LIGHT_TOLERANCE, mesh_chunks, negligible
from pepperscene.scene.lod import cluster_vertices, join_triangles, simplify_organs

NIGHT = LightReach(0.0, 0.0, 0.05, 0.4)


@pytest.fixture(scope="module")
def camera():
    lens, sensor = load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re")
    return Camera(lens, sensor, flash=load_flash("led_matrix_200klx"), focus_m=0.4)


@pytest.fixture(scope="module")
def row():
    """Three plants, 15 cm apart, and a floor."""
    rng = np.random.default_rng(3)
    plants = [mesh_plant(grow(load_cultivar("kaite"), child), 0.5) for child in rng.spawn(3)]
    bases = np.array([[-0.15, 0.0, 0.0], [0.0, 0.1, 0.0], [0.15, 0.0, 0.0]])
    floor = rectangle((0, 0, -0.05), (9, 0, 0), (0, 9, 0))
    return concatenate_meshes([place_plants(plants, bases, np.array([0.0, 1.0, 2.0])), floor])


def path(count=9, low=0.9, high=1.3, pitch=20.0):
    return arc_path(count, 0.4, (-0.8, 0.8), (low, high), np.radians(pitch))


def triangles(mesh):
    """Each triangle's instance and corners, as bytes."""
    rows = np.column_stack([mesh.face_instance, mesh.vertices[mesh.faces].reshape(-1, 9)])
    return [row.tobytes() for row in rows]


def in_image(camera, poses, points):
    """`(n,)` whether the camera's own projection puts a point into the image from any pose."""
    visible = np.zeros(len(points), dtype=bool)
    for pose in poses:
        u, v = camera.at_pose(pose).project(points).T
        visible |= (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)
    return visible


@given(
    seed=st.integers(0, 2**32 - 1),
    k1=st.floats(-0.12, 0.1),
    half=st.floats(0.0, 0.3),
    fraction=st.floats(0.0, 1.0),
)
def test_frustums_contain_all_visible_points_and_their_way_to_the_flash(camera, seed, k1, half, fraction):
    rng = np.random.default_rng(seed)
    coarse = replace(camera.sensor, columns=80, rows=60, binning=20)
    bent = replace(camera, sensor=coarse, lens=replace(camera.lens, distortion=Distortion(k1=k1)))
    poses = path(5)
    poses[:, :3] = rotation_about_z(rng.uniform(0, 6)) @ poses[:, :3]
    points = rng.uniform((-2, -2, 0), (2, 2, 4), (400, 3))
    for pose in poses:
        shown = points[in_image(bent, [pose], points)]
        emitters = camera.flash.emitter_positions()[
            rng.integers(len(camera.flash.emitters_m), size=len(shown))
        ]
        starts = emitters @ pose[:3, :3].T + pose[:3, 3]
        on_the_way = starts + fraction * (shown - starts)
        # A box that contains the point away from its centre.
        halves = np.full(shown.shape, half, np.float32)
        centres = on_the_way + rng.uniform(-half, half, shown.shape) * 0.999
        assert view_frustums(bent, poses).intersects(centres.astype(np.float32), halves).all()


def test_frustums_contain_defocused_rays(camera):
    # Rays from all over the pupil through the focal plane, far beyond it.
    pose, rng = path(1)[0], np.random.default_rng(1)
    near = replace(camera, focus_m=0.1, flash=None, lens=replace(camera.lens, f_number=1.0))
    directions = near.ray_slopes()[[0, 0, -1, -1], [0, -1, 0, -1]]
    angle = rng.uniform(0, 2 * np.pi, 64)
    rim = near.aperture_radius_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(64)])
    in_focus = 0.1 * np.column_stack([directions, np.ones(4)])
    ends = rim[:, None] + 40.0 * (in_focus[None] - rim[:, None])
    world = (ends.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
    assert view_frustums(near, pose).intersects(world, np.zeros_like(world)).all()
    pinhole = view_frustums(replace(near, focus_m=None), pose)
    assert not pinhole.intersects(world, np.zeros_like(world)).all()


def test_frustums_exclude_boxes_outside_every_view(camera):
    frustums = view_frustums(camera, path(5, 0.9, 0.9, pitch=0.0))
    half = np.full((3, 3), 0.01, np.float32)
    outside = np.array([[0.0, 3.0, 9.0], [0.0, 0.0, 0.2], [0.0, -5.0, 0.9]], np.float32)
    assert not frustums.intersects(outside, half).any()
    assert frustums.intersects(np.array([[0.0, 0.0, 0.9]], np.float32), half[:1]).all()


@pytest.mark.parametrize("light", [NIGHT, LightReach(0.01, 0.01, 0.05, 0.4), LightReach(1.0, 1.0, 0.0, 0.4)])
def test_visible_triangles_are_unchanged(camera, row, light):
    culled = cull_mesh(row, view_frustums(camera, path()), light)
    visible = in_image(camera, path(), row.vertices)[row.faces].any(axis=1)
    expected = {line for line, shown in zip(triangles(row), visible, strict=True) if shown}
    assert len(expected) > 1000
    assert expected <= set(triangles(culled))
    # Instances and surfaces keep their numbers.
    assert culled.instances == row.instances
    assert culled.surfaces == row.surfaces
    if light.sky + light.sun < 0.03:
        assert len(culled.faces) < 0.7 * len(row.faces)
    np.testing.assert_array_equal(np.unique(culled.faces), np.arange(len(culled.vertices)))


def test_culling_does_not_depend_on_the_order_of_poses(camera, row):
    poses = path(40)
    forward, backward = (cull_mesh(row, view_frustums(camera, p), NIGHT) for p in (poses, poses[::-1]))
    assert triangles(forward) == triangles(backward)
    # Fewer poses see less.
    fewer = cull_mesh(row, view_frustums(camera, poses[:5]), NIGHT)
    assert len(fewer.faces) < len(forward.faces)


def test_mesh_is_unchanged_if_everything_or_nothing_is_visible(camera):
    frustums = view_frustums(camera, path(3, 0.9, 0.9))
    for height in (1.0, 9.0):
        ball = sphere((0.0, 0.0, height), 0.1, "leaf", subdivisions=2)
        assert cull_mesh(ball, frustums, NIGHT) is ball


def test_chunks_are_bounded_by_their_boxes(row):
    long = sphere((0.5, 0.2, 1.0), 0.4, "leaf", subdivisions=5)
    mesh = concatenate_meshes([row, long])
    chunks = mesh_chunks(mesh)
    assert chunks.faces[0] == 0
    assert chunks.faces[-1] == len(mesh.faces)
    assert (np.diff(chunks.faces) > 0).all()
    # Only the long instance is split.
    owner = mesh.face_instance[chunks.faces[:-1]]
    assert (~chunks.whole).sum() == (owner == len(mesh.instances) - 1).sum() > 10
    number = np.repeat(np.arange(len(owner)), np.diff(chunks.faces))
    np.testing.assert_array_equal(owner[number], mesh.face_instance)
    offset = np.abs(mesh.vertices[mesh.faces] - chunks.centres[number][:, None])
    assert (offset <= chunks.half_extents[number][:, None] + 1e-6).all()
    assert (mesh.faces >= chunks.vertices[number, :1]).all()
    assert (mesh.faces < chunks.vertices[number, 1:]).all()


@given(seed=st.integers(0, 2**32 - 1), daylight=st.floats(0.0, 1.0), sun=st.sampled_from([0.0, 1e-4, 0.3]))
def test_total_change_by_removed_chunks_is_below_the_tolerance(camera, seed, daylight, sun):
    rng = np.random.default_rng(seed)
    near = [sphere(at, 0.05, "leaf", 1) for at in rng.uniform((-0.1, -0.1, 0.9), (0.1, 0.1, 1.1), (3, 3))]
    positions, sizes = rng.uniform((-9, -9, -40), (9, 9, 0), (40, 3)), rng.uniform(0.001, 0.1, 40)
    far = [sphere(at, size, "leaf", 1) for at, size in zip(positions, sizes, strict=True)]
    chunks = mesh_chunks(concatenate_meshes([*near, *far]))
    frustums = view_frustums(camera, path(5, 0.9, 1.1))
    visible = frustums.intersects(chunks.centres, chunks.half_extents)
    removed = negligible(chunks, visible, frustums, LightReach(daylight, sun, 0.05, 0.4, 0.07))
    assert not (removed & visible).any()
    # Computed again one by one, with the balls' solid angles from the nearest visible points.
    total = 0.0
    for index in np.flatnonzero(removed):
        centre, radius = chunks.centres[index].astype(float), float(chunks.radii[index])
        gap = (np.linalg.norm(chunks.centres[visible] - centre, axis=1) - chunks.radii[visible]).min()
        flash = np.linalg.norm(frustums.positions - centre, axis=1).min() - radius - 0.07
        covered = min(1.0, (radius / max(gap, radius)) ** 2)
        total += (daylight + sun + 0.05 * (0.4 / flash) ** 2) * covered
        # The sun's disc is half a degree wide.
        total += sun * min(1.0, covered / np.radians(0.2666) ** 2)
    assert total <= LIGHT_TOLERANCE * 1.001


def test_distant_objects_are_removed_and_near_ones_kept(camera):
    positions = ((0, 0, 1.0), (0, 0, 0.3), (0, 0, -60.0))
    mesh = concatenate_meshes([sphere(at, 0.05, "leaf", subdivisions=2) for at in positions])
    culled = cull_mesh(mesh, view_frustums(camera, path(5, 0.9, 0.9)), LightReach(0.5, 0.0, 0.05, 0.4))
    assert {*culled.face_instance.tolist()} == {0, 1}
    assert len(culled.instances) == 3


def test_light_reach_compares_flash_and_daylight(camera):
    flash = camera.flash
    equal = light_reach(camera, flash.at_m, flash.illuminance_lx * camera.flash_duty)
    assert equal.sky == pytest.approx(0.5)
    assert equal.sun == 0.0
    # Outside the image the beam is weak.
    border = np.arctan(np.abs(camera.ray_slopes()[0, :, 1]).min())
    assert equal.stray == pytest.approx(0.5 * float(flash.profile.at(border)), rel=1e-3)
    assert light_reach(camera, 0.4, 0.0).sky == 0.0
    sunny, cloudy = light_reach(camera, 0.4, 3000.0, 2000.0), light_reach(camera, 0.4, 2000.0, 3000.0)
    assert sunny.sun == pytest.approx(cloudy.sky)
    assert light_reach(replace(camera, flash=None), 0.4, 100.0) == LightReach(1.0, 1.0, 0.0, 0.4)
    # At half the distance the flash is four times as bright.
    one, two = light_reach(camera, 0.4, 5500.0).sky, light_reach(camera, 0.2, 5500.0).sky
    assert (1 / two - 1) == pytest.approx(4 * (1 / one - 1))


def test_combined_reach_is_at_least_that_of_each_view(camera):
    near = light_reach(camera, 0.2, 4000.0, 1000.0)
    far = light_reach(replace(camera, flash=replace(camera.flash, radius_m=0.02)), 0.8, 500.0)
    for reaches in ([near, far], [far, near], [near]):
        combined = combine_reaches(reaches)
        for reach in reaches:
            assert combined.sky >= reach.sky
            assert combined.sun >= reach.sun
            assert combined.flash_extent_m >= reach.flash_extent_m
            # Stray light falls with the squared distance; no more than the strongest is assumed.
            assert combined.stray * combined.distance_m**2 >= reach.stray * reach.distance_m**2 * (1 - 1e-12)
        strongest = max(reach.stray * reach.distance_m**2 for reach in reaches)
        assert combined.stray * combined.distance_m**2 == pytest.approx(strongest)


def test_a_turned_flash_may_light_anything_with_its_highest_intensity(camera):
    turned = replace(camera, flash=replace(camera.flash, rotation=np.eye(3)[[1, 2, 0]]))
    straight, reach = (light_reach(view, 0.4, 0.0) for view in (camera, turned))
    angles = np.linspace(0.0, np.pi / 2.0, 1000)
    assert reach.stray == pytest.approx(float(camera.flash.profile.at(angles).max()), rel=1e-3)
    assert reach.stray > 1.5 * straight.stray


def test_simplified_sheet_keeps_its_area():
    u, v = np.meshgrid(np.linspace(0, 1, 13), np.linspace(0, 1, 25))
    uv = np.column_stack([u.ravel(), v.ravel()]).astype(np.float32)
    corner = np.arange(13 * 25).reshape(25, 13)
    a, b, d, c = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    simple = cluster_vertices(uv, faces, (4, 6), closed=False)
    p, q, r = (uv[simple.vertices][simple.faces[:, k]].astype(float) for k in range(3))
    area = ((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0]) / 2.0
    # All have the same orientation, and cover the whole sheet once.
    assert (area > 0).all()
    assert area.sum() == pytest.approx(1.0)
    assert len(simple.faces) == 2 * 4 * 6


def instance_areas(mesh):
    p, q, r = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    area = np.linalg.norm(np.cross(q - p, r - p), axis=1) / 2.0
    return np.bincount(mesh.face_instance, area, minlength=len(mesh.instances))


def test_simplified_organs_use_their_own_vertices_and_keep_surface_and_area(row):
    chunks = mesh_chunks(row)
    whole = np.flatnonzero(chunks.whole)
    face_ranges = np.stack([chunks.faces[whole], chunks.faces[whole + 1]], axis=1)
    parts, simplified = simplify_organs(row, face_ranges, chunks.vertices[whole])
    simple = join_triangles(parts).taken_from(row)
    assert simplified.sum() > 0.95 * len(whole)
    assert len(simple.faces) < 0.2 * len(row.faces)
    own, new = (
        np.column_stack([mesh.vertex_instance, mesh.vertices, mesh.normals, mesh.uv, mesh.state])
        for mesh in (row, simple)
    )
    assert {line.tobytes() for line in new} <= {line.tobytes() for line in own}
    replaced = row.face_instance[face_ranges[simplified, 0]]
    np.testing.assert_array_equal(np.unique(simple.face_instance), np.sort(replaced))
    for number in replaced:
        there, here = simple.face_instance == number, row.face_instance == number
        assert {*simple.face_surface[there]} <= {*row.face_surface[here]}
    leaves = [number for number in replaced if row.instances[number].organ_class == OrganClass.LEAF]
    assert 0.75 < instance_areas(simple)[leaves].sum() / instance_areas(row)[leaves].sum() <= 1.0

"""Flow and stereo on plants: they lead to the same organ, and hide what an independent ray caster hides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import maximum_filter, minimum_filter
from test_culling import few_pixels
from test_ground_truth import plants_before_the_camera
from trimesh.ray.ray_triangle import RayMeshIntersector

from pepperscene.camera import arc_path
from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

BASELINE_M = 0.06


@pytest.fixture(scope="module")
def views():
    """A renderer of three plants, two cameras 3 degrees apart on their path, and a partner of the first."""
    mesh, camera = plants_before_the_camera()
    poses = arc_path(16, 0.4, (-0.3, 0.3), (0.2, 0.5), np.radians(20.0))
    first, second = camera.at_pose(poses[7]), camera.at_pose(poses[8])
    beside = poses[7].copy()
    beside[:3, 3] += BASELINE_M * beside[:3, 0]
    return Renderer(assemble_scene(mesh)), first, second, camera.at_pose(beside)


def edges(labels: np.ndarray) -> np.ndarray:
    return maximum_filter(labels, 3) != minimum_filter(labels, 3)


def led_to(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels that a flow leads to; any for what is nowhere."""
    v, u = np.mgrid[: flow.shape[0], : flow.shape[1]] + 0.5
    where = np.nan_to_num(np.stack([v + flow[..., 1], u + flow[..., 0]]))
    row, column = (np.clip(np.floor(x), 0, n - 1).astype(int) for x, n in zip(where, u.shape, strict=True))
    return row, column


@pytest.mark.parametrize("name", ["class", "instance"])
def test_flow_brings_the_next_labels_onto_these(views, name):
    made, first, second, _ = views
    frame = made.render(first, [name, "flow"], others={"flow": second})
    following = made.render(second, [name])[name]
    at = led_to(frame["flow"])
    visible = frame["flow"][..., 2] == 1
    assert 0.5 < visible.mean() < 0.99
    same = following[at] == frame[name]
    assert same[visible].mean() > 0.97
    away = visible & ~edges(frame[name]) & ~edges(following)[at]
    assert away.mean() > 0.5
    assert same[away].mean() >= 0.995


def test_there_and_back_again(views):
    # What is visible from both leads back to the pixel that it came from, to what a pixel spans.
    made, first, second, _ = views
    there = made.render(first, ["flow", "instance"], others={"flow": second})
    back = made.render(second, ["flow", "instance"], others={"flow": first})
    at = led_to(there["flow"])
    both = (there["flow"][..., 2] == 1) & (back["flow"][..., 2][at] == 1)
    flat = both & ~edges(there["instance"]) & ~edges(back["instance"])[at]
    error = np.abs(there["flow"][..., :2] + back["flow"][at][..., :2]).max(axis=-1)
    assert np.median(error[flat]) < 0.05
    assert (error[flat] < 1.0).mean() > 0.99


def test_disparity_is_focal_length_times_baseline_over_depth(views):
    made, first, _, partner = views
    first, partner = (
        replace(one, lens=replace(one.lens, distortion=type(one.lens.distortion)()))
        for one in (first, partner)
    )
    frame = made.render(first, ["stereo", "depth_z"], others={"stereo": partner})
    near = np.isfinite(frame["depth_z"])
    visible = frame["stereo"][..., 2] == 1
    disparity = first.intrinsics[0, 0] * BASELINE_M / frame["depth_z"][near].astype(float)
    np.testing.assert_allclose(-frame["stereo"][..., 0][near], disparity, rtol=1e-5, atol=1e-4)
    assert np.abs(frame["stereo"][..., 1]).max() < 1e-4
    # The sky is where it was; beyond the left border nothing is visible.
    assert np.abs(frame["stereo"][..., 0][~near]).max() < 1e-4
    u = np.arange(800) + 0.5
    outside = u + frame["stereo"][..., 0] < 0
    assert outside.any()
    assert not (visible & outside).any()
    assert 0.5 < visible.mean() < 0.95


@pytest.mark.parametrize("which", ["flow", "stereo"])
def test_an_independent_ray_caster_hides_what_is_hidden(views, which):
    # 300 random pixels whose point lies in the other picture: cast with trimesh from the other camera.
    made, first, second, partner = views
    other = second if which == "flow" else partner
    frame = made.render(first, [which, "position", "distance"], others={which: other})
    found = frame[which]
    v, u = np.mgrid[:600, :800] + 0.5
    inside = (
        (u + found[..., 0] > 0)
        & (u + found[..., 0] < 800)
        & (v + found[..., 1] > 0)
        & (v + found[..., 1] < 600)
    )
    candidates = inside & np.isfinite(frame["distance"])
    assert not found[..., 2][~inside].any()
    rng = np.random.default_rng(4)
    # Half of them hidden, of which there are fewer.
    chosen = np.concatenate(
        [
            rng.choice(np.flatnonzero(candidates & (found[..., 2] == flag)), 150, replace=False)
            for flag in (0, 1)
        ]
    )
    target = frame["position"].reshape(-1, 3)[chosen].astype(float)
    start = other.pose[:3, 3]
    away = np.linalg.norm(target - start, axis=1)
    mesh = made.scene.mesh
    caster = RayMeshIntersector(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))
    nearest = np.full(len(chosen), np.inf)
    for begin in range(0, len(chosen), 10):  # a few at a time: each ray has many candidates
        rays = (target - start)[begin : begin + 10] / away[begin : begin + 10, None]
        points, ray, _ = caster.intersects_location(np.tile(start, (len(rays), 1)), rays)
        np.minimum.at(nearest, begin + ray, np.linalg.norm(points - start, axis=1))
    hidden = nearest < away * (1.0 - 1e-4)
    np.testing.assert_array_equal(hidden, found[..., 2].ravel()[chosen] == 0)


def test_a_culled_scene_shows_the_partner_all_that_it_sees():
    # A partner so far beside that it sees what no pose of the path does, which goes straight up.
    beside = {"row.plants_front": 5, "row.plants_back": 0, "path.azimuth_deg": [0.0, 0.0]}
    recipe = load_recipe("barth2018", {**beside, "camera.baseline_mm": 500.0, "plan.frames": 3})
    stage, shot = FrameRenderer(recipe), recipe.plan.frame(1)
    partner = few_pixels(stage.views.others(shot.step, ["stereo"])["stereo"], 8)
    frames = []
    for stage.culled in (False, True):
        scene = stage.scene(shot, traced=False)
        frames.append(Renderer(scene).render(partner, ["class", "instance", "distance"]))
    whole, lean = frames
    for name in ("class", "instance", "distance"):
        np.testing.assert_array_equal(whole[name], lean[name])
    assert (whole["instance"] > 0).any()
    # Without a partner some of that is made simple: the test can tell.
    alone = FrameRenderer(load_recipe("barth2018", {**beside, "plan.frames": 3})).scene(shot, traced=False)
    assert (Renderer(alone).render(partner, ["distance"])["distance"] != whole["distance"]).any()

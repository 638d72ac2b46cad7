"""Flow and stereo lead to the same organs, with the visibility that an independent ray caster finds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter
from test_culling import with_larger_pixels
from test_ground_truth import cast_rays, distorted_view_of_plants

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Partners, arc_path
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

BASELINE_M = 0.06


@pytest.fixture(scope="module")
def views():
    """A renderer of three plants, two cameras 3 degrees apart on their path, and a partner of the first."""
    mesh, camera = distorted_view_of_plants()
    poses = arc_path(16, 0.4, (-0.3, 0.3), (0.2, 0.5), np.radians(20.0))
    first, second = camera.at_pose(poses[7]), camera.at_pose(poses[8])
    pose = poses[7].copy()
    pose[:3, 3] += BASELINE_M * pose[:3, 0]
    return Renderer(assemble_scene(mesh)), first, second, camera.at_pose(pose)


def edges(labels: np.ndarray) -> np.ndarray:
    return maximum_filter(labels, 3) != minimum_filter(labels, 3)


def target_pixels(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels that a flow leads to; arbitrary where there is no flow."""
    v, u = np.mgrid[: flow.shape[0], : flow.shape[1]] + 0.5
    target = np.nan_to_num(np.stack([v + flow[..., 1], u + flow[..., 0]]))
    row, column = (np.clip(np.floor(x), 0, n - 1).astype(int) for x, n in zip(target, u.shape, strict=True))
    return row, column


def test_flow_leads_to_the_same_labels_in_the_next_frame(views):
    renderer, first, second, _ = views
    name = "instance"
    frame = renderer.render(first, [name, "flow"], partners=Partners(flow=second))
    following = renderer.render(second, [name])[name]
    at = target_pixels(frame["flow"])
    visible = frame["flow"][..., 2] == 1
    assert 0.5 < visible.mean() < 0.99
    same = following[at] == frame[name]
    assert same[visible].mean() > 0.97
    inner = visible & ~edges(frame[name]) & ~edges(following)[at]
    assert inner.mean() > 0.5
    assert same[inner].mean() >= 0.995


def test_disparity_is_focal_length_times_baseline_over_depth(views):
    renderer, first, _, partner = views
    first, partner = (
        replace(view, lens=replace(view.lens, distortion=type(view.lens.distortion)()))
        for view in (first, partner)
    )
    frame = renderer.render(first, ["stereo", "depth_z"], partners=Partners(stereo=partner))
    near = np.isfinite(frame["depth_z"])
    visible = frame["stereo"][..., 2] == 1
    disparity = first.intrinsics[0, 0] * BASELINE_M / frame["depth_z"][near].astype(float)
    np.testing.assert_allclose(-frame["stereo"][..., 0][near], disparity, rtol=1e-5, atol=1e-4)
    assert np.abs(frame["stereo"][..., 1]).max() < 1e-4
    # The sky does not move; beyond the left border nothing is visible.
    assert np.abs(frame["stereo"][..., 0][~near]).max() < 1e-4
    u = np.arange(800) + 0.5
    outside = u + frame["stereo"][..., 0] < 0
    assert outside.any()
    assert not (visible & outside).any()
    assert 0.5 < visible.mean() < 0.95


@pytest.mark.parametrize("name", ["flow", pytest.param("stereo", marks=pytest.mark.long)])
def test_visibility_equals_that_of_an_independent_ray_caster(views, name):
    # 100 random pixels whose point is inside the other image, half of them hidden.
    renderer, first, second, partner = views
    other = second if name == "flow" else partner
    frame = renderer.render(first, [name, "position", "distance"], partners=Partners(**{name: other}))
    flow = frame[name]
    v, u = np.mgrid[:600, :800] + 0.5
    inside = (
        (u + flow[..., 0] > 0) & (u + flow[..., 0] < 800) & (v + flow[..., 1] > 0) & (v + flow[..., 1] < 600)
    )
    candidates = inside & np.isfinite(frame["distance"])
    assert not flow[..., 2][~inside].any()
    rng = np.random.default_rng(4)
    chosen = np.concatenate(
        [rng.choice(np.flatnonzero(candidates & (flow[..., 2] == k)), 50, replace=False) for k in (0, 1)]
    )
    ray = frame["position"].reshape(-1, 3)[chosen].astype(float) - other.pose[:3, 3]
    distance = np.linalg.norm(ray, axis=1)
    nearest, _ = cast_rays(renderer.scene.mesh, other.pose[:3, 3], ray / distance[:, None])
    hidden = nearest < distance * (1.0 - 1e-4)
    np.testing.assert_array_equal(hidden, flow[..., 2].ravel()[chosen] == 0)


def test_culled_scene_contains_everything_that_the_stereo_partner_sees():
    # The path goes straight up; the partner is far to the side and sees what no pose of the path sees.
    changes = {"row.plants_front": 5, "row.plants_back": 0, "views.azimuth_deg": [0.0, 0.0], "plan.frames": 3}
    recipe = load_recipe("barth2018", {**changes, "camera.baseline_mm": 500.0})
    frames, spec = FrameRenderer(recipe), recipe.plan.frame(1)
    partner = with_larger_pixels(frames.views.partners(spec, ["stereo"]).stereo, 8)
    # Culled for a camera without a partner, some of it is simplified: the test has power.
    scenes = [FrameRenderer(load_recipe("barth2018", changes)).scene(spec, traced=False)]
    for frames.culled in (False, True):
        scenes.append(frames.scene(spec, traced=False))
    names = ["class", "instance", "distance"]
    wrong, complete, culled = (Renderer(scene).render(partner, names) for scene in scenes)
    for name in names:
        np.testing.assert_array_equal(complete[name], culled[name])
    assert (complete["instance"] > 0).any()
    assert (wrong["distance"] != complete["distance"]).any()

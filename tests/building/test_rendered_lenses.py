"""Rendered surface points of three lens models, projected by OpenCV: they land on their pixels' centres."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pepperscene import render_scene
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.recipe.resolve.load import resolve_recipe

COEFFICIENTS = {
    "plumb_bob": [-0.28, 0.09, 0.0012, -0.0008, -0.012],
    "rational_polynomial": [0.52, -0.08, 0.0003, -0.0004, 0.003, 0.86, -0.03, 0.004],
    "equidistant": [0.035, -0.012, 0.006, -0.0015],
}
FX, FY, CX, CY = 210.0, 212.0, 158.3, 121.2
INTRINSICS = {"camera.fx": FX, "camera.fy": FY, "camera.cx": CX, "camera.cy": CY}
SMALL = {
    "plan.sets": 1, "plan.rotations": 1, "plan.frames": 3, "plan.select": [1],
    "row.plants_front": 1, "row.plants_back": 0, "cultivar": "kaite",
    "camera.sensor": "generic_rgb", "camera.width": 320, "camera.height": 240,
}  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    """The frame renderer of a recipe without distortion, and its scene before culling."""
    frames = FrameRenderer(resolve_recipe("barth2018", SMALL | INTRINSICS), culled=False)
    return frames.scene(frames.recipe.plan.frame(1), traced=False)


@pytest.mark.slow
@pytest.mark.parametrize("model", COEFFICIENTS)
def test_rendered_positions_are_projected_by_opencv_onto_their_pixels(scene, model):
    lens = {"camera.distortion_model": model, "camera.distortion": COEFFICIENTS[model]}
    frames = FrameRenderer(resolve_recipe("barth2018", SMALL | INTRINSICS | lens))
    camera = frames.camera(frames.recipe.plan.frame(1), traced=False)
    frame = render_scene(scene, camera, ["position"], "draft")
    position = frame["position"]
    rows, columns = np.nonzero(np.isfinite(position).all(axis=-1))
    chosen = np.random.default_rng(1).choice(len(rows), 1000, replace=False)
    rows, columns = rows[chosen], columns[chosen]
    points = position[rows, columns].astype(float)

    pose = np.array(frame.metadata["camera"]["pose"])
    vector, shift = cv2.Rodrigues(pose[:3, :3].T)[0], -pose[:3, :3].T @ pose[:3, 3]
    matrix = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    pixels, _ = project(points[:, None], vector, shift, matrix, np.array(COEFFICIENTS[model]))
    # In OpenCV's convention, the centre of the pixel in row r and column c is (c, r).
    error = pixels.reshape(-1, 2) - np.stack([columns, rows], axis=-1)
    assert np.abs(error).max() < 0.05

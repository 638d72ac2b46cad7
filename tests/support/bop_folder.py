"""BOP-scenewise folders, read as BOP's documentation describes them.

https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from __future__ import annotations

import json

import numpy as np

CORNERS = [[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]
"""Of the harvest truth's boxes, in the order of `corners_px`: in fruit axes, where z is down."""


def load(path):
    return json.loads(path.read_text())


def scene_folder(dataset, out, index):
    """The folder of the scene of a frame, of a recipe without twins and an export without splits."""
    return out / f"train/{index // dataset.info['recipe']['plan']['frames']:06d}"


def annotations(dataset, out):
    """Frame, entry of the harvest truth, object id, K, R, t of each fruit in each frame, in order."""
    for index in dataset.indices():
        scene = scene_folder(dataset, out, index)
        matrix = np.reshape(load(scene / "scene_camera.json")[str(index)]["cam_K"], (3, 3))
        poses = load(scene / "scene_gt.json")[str(index)]
        fruit = dataset.image(index, "harvest")["fruit"]
        for entry, pose in zip(fruit, poses, strict=True):
            rotation, translation = np.reshape(pose["cam_R_m2c"], (3, 3)), np.array(pose["cam_t_m2c"])
            yield index, entry, pose["obj_id"], matrix, rotation, translation


def project(points_mm, matrix, rotation, translation):
    """Pixels of points of a model, nan behind the camera; the centre of the upper left pixel is at (0, 0)."""
    in_camera = points_mm @ rotation.T + translation
    in_camera[in_camera[:, 2] <= 0] = np.nan
    return (in_camera @ matrix.T)[:, :2] / in_camera[:, 2:]


def corner_error(entry, size_mm, matrix, rotation, translation):
    """Largest distance of the projected corners of a model's box from those of the harvest truth."""
    corners = np.array(CORNERS) * [1, -1, -1] * size_mm
    expected = np.array(entry["box_3d"]["corners_px"], float) - 0.5
    error = np.linalg.norm(project(corners, matrix, rotation, translation) - expected, axis=1).max()
    return error if np.isfinite(error) else np.inf


def has_corners(entry):
    """Whether all corners of a fruit's box are in front of the camera."""
    corners = entry["box_3d"]["corners_px"]
    return corners is not None and None not in corners

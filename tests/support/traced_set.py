"""Data sets of a sphere in front of a wall, traced exactly through the lenses of OpenCV.

Rays, intersections and poses of rows are computed here with OpenCV and SciPy, so that exports are compared
with a second implementation of the camera. `position` holds the true world point of every pixel.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from data_sets import set_without_plants
from scipy.spatial.transform import Rotation
from stand_in import SceneStandIn

from pepperscene.frame import Frame

WIDTH, HEIGHT = 160, 120
INTRINSICS = {"fx": 150.0, "fy": 153.0, "cx": 84.25, "cy": 57.5}
"""In OpenCV's convention, as a recipe has it: the centre of the upper left pixel is at (0, 0)."""
LENSES = {"pinhole": {}} | {
    name: {"distortion_model": model, "distortion": coefficients}
    for name, model, coefficients in (
        ("brown", "plumb_bob", [-0.21, 0.07, 0.002, -0.003]),
        ("brown_k3", "plumb_bob", [-0.21, 0.07, 0.002, -0.003, -0.01]),
        ("rational", "rational_polynomial", [0.3, 0.1, 0.001, -0.002, 0.02, 0.5, 0.15, 0.03]),
        ("fisheye", "equidistant", [0.03, -0.01, 0.004, -0.001]),
    )
}
SPHERE, RADIUS_M = np.array([0.02, -0.1, 1.2]), 0.09
WALL_Y_M, TOP_M = 0.25, 1.9
FRUIT, LEAF, IGNORED = 7, 300, 41_000
"""Instances: the sphere, the wall, and the part of the wall on the left that can be ignored."""
OUTPUTS = ("colour", "class", "instance", "distance", "depth_z", "position")
ROLLING = {
    "line_time_s": 2e-4,
    "motion": {
        "velocity_m_s": [0.4, 0.1, -0.2],
        "angular_velocity_rad_s": [0.3, -0.5, 0.8],
        "labels_per_row": True,
    },
}
"""Keys of the camera of a frame that moves while its rows are read out."""


def image_points(points_camera, lens, matrix):
    """OpenCV's image points `(n, 2)` of points `(n, 3)` in camera axes."""
    points = np.ascontiguousarray(points_camera, dtype=float)[:, None]
    coefficients, zero = np.array(lens.get("distortion", [0.0] * 4)), np.zeros(3)
    if lens.get("distortion_model") == "equidistant":
        return cv2.fisheye.projectPoints(points, zero, zero, matrix, coefficients)[0][:, 0]
    return cv2.projectPoints(points, zero, zero, matrix, coefficients)[0][:, 0]


def reprojection_error(points_camera, lens, matrix, pixels):
    """Largest distance of the image points of points in camera axes from pixels; inf if one is behind."""
    if (points_camera[:, 2] <= 0).any():
        return np.inf
    return np.linalg.norm(image_points(points_camera, lens, np.array(matrix, float)) - pixels, axis=1).max()


@cache
def directions(lens):
    """`(h w, 3)` unit directions in camera axes of the rays through all pixel centres, to 1e-9 of a pixel."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].reshape(2, -1)
    fx, fy, cx, cy = INTRINSICS.values()
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    points = np.column_stack([np.zeros((len(rows), 2)), np.ones(len(rows))])
    error = np.ones(())
    while np.abs(error).max() > 1e-9:
        error = image_points(points, LENSES[lens], matrix) - np.column_stack([columns, rows])
        points[:, :2] -= error / [fx, fy]
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def row_poses(pose, rolling):
    """`(h, 4, 4)` camera to world of every row, of a camera with constant velocities in world axes."""
    poses = np.tile(np.asarray(pose, float), (HEIGHT, 1, 1))
    if rolling:
        times = (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) * rolling["line_time_s"]
        turns = Rotation.from_rotvec(times[:, None] * rolling["motion"]["angular_velocity_rad_s"]).as_matrix()
        poses[:, :3, :3] = turns @ poses[:, :3, :3]
        poses[:, :3, 3] += times[:, None] * rolling["motion"]["velocity_m_s"]
    return poses


def intersect(origin, direction):
    """Distance `(n,)` to the sphere and to the wall along unit directions `(n, 3)`; inf for none."""
    offset = origin - SPHERE
    half = (direction * offset).sum(axis=-1)
    root = half**2 - (offset**2).sum(axis=-1) + RADIUS_M**2
    with np.errstate(invalid="ignore", divide="ignore"):
        sphere = np.where(root > 0, -half - np.sqrt(root), np.inf)
        wall = (WALL_Y_M - origin[..., 1]) / direction[..., 1]
        is_hit = (wall > 0) & (origin[..., 2] + wall * direction[..., 2] < TOP_M)
    return np.where(sphere > 0, sphere, np.inf), np.where(is_hit, wall, np.inf)


def trace(pose, lens, rolling=None):
    """All outputs of a frame, by name."""
    direction, rows = directions(lens), np.arange(HEIGHT).repeat(WIDTH)
    poses = row_poses(pose, rolling)[rows]
    world = np.einsum("nij,nj->ni", poses[:, :3, :3], direction)
    sphere, wall = intersect(poses[:, :3, 3], world)
    distance = np.minimum(sphere, wall)
    with np.errstate(invalid="ignore"):
        position = poses[:, :3, 3] + distance[:, None] * world
    position[np.isinf(distance)] = np.inf
    instance = np.where(position[:, 0] < -0.1, IGNORED, LEAF)
    instance = np.where(sphere < wall, FRUIT, np.where(np.isinf(distance), 0, instance))
    images = {
        "colour": colour_of(position),
        "instance": instance.astype(np.uint16),
        "class": np.select([instance == FRUIT, instance == 0], [2, 0], 1).astype(np.uint8),
        "distance": distance.astype(np.float32),
        "depth_z": (distance * direction[:, 2]).astype(np.float32),
        "position": position.astype(np.float32),
    }
    return {name: image.reshape(HEIGHT, WIDTH, *image.shape[1:]) for name, image in images.items()}


def colour_of(position):
    """uint8 colours `(n, 3)` of world points; the sky is blue."""
    with np.errstate(invalid="ignore"):
        colour = 128 + 100 * np.sin(30 * position + [0, 1, 2])
    return np.where(np.isfinite(position), colour, [40, 60, 200]).astype(np.uint8)


def blurred_coverage(classes):
    """`(h, w, 8)` the shares of the classes in squares of 3 pixels, in 64ths that sum to 1."""
    one_hot = (classes[..., None] == np.arange(8)).astype(float)
    shares = np.floor(64 * cv2.blur(one_hot, (3, 3))) / 64
    shares[..., 0] += 1 - shares.sum(axis=-1)
    return shares.astype(np.float16)


class Tracer(SceneStandIn):
    """Traces a frame through the lens of its recipe."""

    lens, rolling, ignores = "pinhole", None, False

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        images = trace(camera.pose, self.lens, self.rolling)
        entries = {
            str(value): {
                "class": organ_class, "kind": kind, "plant": 0, "phytomer": 3, "parent": 0,
                "pixels": int((images["instance"] == value).sum()),
            }
            for value, organ_class, kind in ((FRUIT, 2, "fruit"), (LEAF, 1, "lamina"), (IGNORED, 1, "lamina"))
            if (images["instance"] == value).any()
        }  # fmt: skip
        if "coverage" in outputs:
            images["coverage"] = blurred_coverage(images["class"])
        if self.ignores:
            images["class"][images["instance"] == IGNORED] = 255
        metadata = {"camera": {**camera.to_metadata(), **(self.rolling or {})}, "instances": entries}
        return Frame({name: images[name] for name in outputs}, metadata)


def make_traced_set(folder, lens="pinhole", outputs=OUTPUTS, frames=range(4), rolling=None, **changes):
    """Frames of one scene on an arc, 12 if all are built."""
    settings = {"lens": lens, "rolling": rolling, "ignores": "greenhouse.far_rows_as" in changes}
    kind = type("LensTracer", (Tracer,), settings)
    camera = {f"camera.{key}": value for key, value in {**INTRINSICS, **LENSES[lens]}.items()}
    recipe = {
        "plan.sets": 1, "plan.rotations": 1, "plan.frames": 12, "camera.lens": "none",
        "camera.width": WIDTH, "camera.height": HEIGHT, **camera, **changes,
    }  # fmt: skip
    return set_without_plants(folder, frames, outputs, kind, recipe)


def visible_pixels(dataset, index, count=1000):
    """Pixels `(n, 2)` column, row with a surface, at most `count`, and their world points `(n, 3)`."""
    position = dataset.image(index, "position").astype(float)
    rows, columns = np.nonzero(np.isfinite(position[..., 0]))
    chosen = np.random.default_rng(0).permutation(len(rows))[:count]
    return np.column_stack([columns, rows])[chosen], position[rows[chosen], columns[chosen]]


def check_seed_points(position, colour, least_x=-np.inf):
    """Points `(n, 3)` are on both surfaces, right of `least_x` on the wall, in their colours to one code."""
    to_sphere = np.abs(np.linalg.norm(position - SPHERE, axis=1) - RADIUS_M)
    to_wall = np.abs(position[:, 1] - WALL_Y_M)
    assert np.minimum(to_sphere, to_wall).max() < 2e-6
    assert (to_sphere < 2e-6).sum() > 1000
    assert position[:, 2].max() < TOP_M
    assert position[to_wall < 1e-5, 0].min() > least_x - 1e-5
    # Where a position that is rounded is at the border of a code, colours differ by one.
    assert np.abs(colour - colour_of(position).astype(int)).max() <= 1

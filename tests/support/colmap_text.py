"""COLMAP's text model, read as its documentation describes it.

https://colmap.github.io/format.html, https://colmap.github.io/cameras.html
"""

from __future__ import annotations

import numpy as np


class Model:
    """A text model: `cameras`, `images` and `points` by id."""

    def __init__(self, folder):
        model = folder / "sparse" / "0"
        self.cameras = {}
        for line in lines_of(model / "cameras.txt"):
            number, name, width, height, *parameters = line.split()
            self.cameras[int(number)] = (name, int(width), int(height), [float(text) for text in parameters])
        self.images = {}
        lines = lines_of(model / "images.txt")
        for first, second in zip(lines[::2], lines[1::2], strict=True):
            number, *pose, camera, name = first.split()
            observed = np.array(second.split(), float).reshape(-1, 3)
            self.images[int(number)] = (np.array(pose, float), int(camera), name, observed)
        self.points = {}
        for line in lines_of(model / "points3D.txt"):
            number, *values = line.split()
            track = np.array(values[7:], int).reshape(-1, 2)
            colour, error = [int(text) for text in values[3:6]], float(values[6])
            self.points[int(number)] = (np.array(values[:3], float), colour, error, track)


def lines_of(path):
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


def rotation_of(w, x, y, z):
    """The rotation of a unit quaternion in Hamilton's convention."""
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip

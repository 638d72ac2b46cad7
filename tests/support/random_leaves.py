"""Random square leaves of a canopy."""

from __future__ import annotations

import numpy as np


def leaf_corners(
    centres: np.ndarray, size_m: float, rng: np.random.Generator, *, level: bool = False
) -> np.ndarray:
    """`(n, 4, 3)` corners of square leaves with centres `(n, 3)`, of all orientations alike or level."""
    normals, others = rng.standard_normal((2, *centres.shape))
    if level:
        normals[:] = 0.0, 0.0, 1.0
    u = np.cross(normals, others)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size_m / 2.0
    return centres[:, None] + corners[:, :1] * u[:, None] + corners[:, 1:] * v[:, None]

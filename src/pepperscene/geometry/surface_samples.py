"""Points that are evenly distributed over the surface of an organ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.mesh import FloatArray

_R2_STEPS: Final = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of the R2 sequence, which covers a square evenly (M. Roberts, "The unreasonable effectiveness of
quasirandom sequences", 2018): powers of the inverse of the real root of x^3 = x + 1."""


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points on a surface, each of which stands for an equal part of its area.

    Attributes:
        points: `(n, 3)` metres.
        normals: `(n, 3)` unit normals of the triangles that the points are on.
        area_m2: of the whole surface.
    """

    points: FloatArray
    normals: FloatArray
    area_m2: float


def sample_surface(triangles: NDArray[np.floating[Any]], count: int) -> SurfaceSamples | None:
    """Points on `(n, 3, 3)` triangles at equal steps of area; None if these have no area.

    The same triangles give the same points. They follow each other in the order of the triangles.
    """
    corners = np.asarray(triangles, dtype=float)
    first, second, third = corners.transpose(1, 0, 2)
    normals = area_normals(corners)
    areas = np.linalg.norm(normals, axis=1)
    ends = np.cumsum(areas)
    if not len(ends) or not ends[-1] > 0.0:
        return None

    # Equal steps of area, each with another place in its triangle.
    number = np.arange(count)
    rows = np.minimum(np.searchsorted(ends, (number + 0.5) / count * ends[-1]), len(ends) - 1)
    u, v = ((number[:, None] * _R2_STEPS) % 1.0).T
    outside = u + v > 1.0
    u, v = np.where(outside, 1.0 - u, u), np.where(outside, 1.0 - v, v)
    points = first[rows] + u[:, None] * (second - first)[rows] + v[:, None] * (third - first)[rows]
    unit_normals = normals[rows] / np.maximum(areas[rows], np.finfo(float).tiny)[:, None]
    return SurfaceSamples(points, unit_normals, float(ends[-1]))


def area_normals(triangles: FloatArray) -> FloatArray:
    """`(n, 3)` normals of `(n, 3, 3)` triangles, as long as their areas."""
    first, second, third = triangles.transpose(1, 0, 2)
    return 0.5 * np.cross(second - first, third - first)

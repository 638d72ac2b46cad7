"""Which coarse plants of far rows a camera shows from near, where their triangles would be seen."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.recipe.views.free_space import triangle_distances

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.geometry import Mesh
    from pepperscene.scene import FarRow

FloatArray = NDArray[np.float64]

NEAR_M: Final = 1.0
"""A plant that a camera shows nearer than this is grown in full. Chosen: a coarse leaf differs from the full
one by about ten pixels there."""
_STEP_M: Final = 0.02  # chosen: places of a moving camera are at most this far apart
_STEP_RAD: Final = 0.02  # chosen: and its directions, which at `NEAR_M` moves the image as far
_MAX_STEPS: Final = 1000  # chosen: of one exposure; a line scanner sweeps 20 m
_ROUNDING_M: Final = 1e-5  # of triangles and poses in single precision


@dataclass(frozen=True, eq=False)
class NearViews:
    """What cameras show nearer than `NEAR_M`: half-spaces and a ball around each projection centre.

    Attributes:
        normals: `(p, k, 3)` unit, into the view.
        offsets: `(p, k)`; a point x is inside where `normals @ x >= offsets`.
        positions: `(p, 3)` projection centres, metres.
        reach_m: `(p,)` radii of the balls.
    """

    normals: FloatArray
    offsets: FloatArray
    positions: FloatArray
    reach_m: FloatArray


def near_views(cameras: Iterable[Camera]) -> NearViews:
    """The near views of cameras, wherever they are during their exposures."""
    from pepperscene.scene.culling import view_sides

    normals, offsets, positions, reaches = [], [], [], []
    for camera in cameras:
        # What only the flash is near to is not in the image.
        inward, pupil = view_sides(replace(camera, flash=None))
        poses, margin_m = _poses_of_exposure(camera)
        sides = np.einsum("pij,kj->pki", poses[:, :3, :3], inward)
        centre = poses[:, :3, 3]
        normals.append(sides)
        offsets.append(np.einsum("pki,pi->pk", sides, centre) - pupil - 2.0 * margin_m - _ROUNDING_M)
        positions.append(centre)
        reaches.append(np.full(len(poses), NEAR_M + margin_m + _ROUNDING_M))
    return NearViews(*(np.concatenate(parts) for parts in (normals, offsets, positions, reaches)))


def _poses_of_exposure(camera: Camera) -> tuple[FloatArray, float]:
    """`(n, 4, 4)` poses during the exposure, and the farthest that it is from the nearest of them, metres."""
    if camera.motion is None:
        return camera.pose[None].astype(float), 0.0
    duration_s = camera.exposure_s + camera.height * camera.sensor.line_time_s
    length_m = float(np.linalg.norm(camera.motion.velocity_m_s)) * duration_s
    angle_rad = camera.motion.angular_speed_rad_s * duration_s
    steps = min(int(np.ceil(max(length_m / _STEP_M, angle_rad / _STEP_RAD, 1.0))), _MAX_STEPS)
    times = np.linspace(-0.5 * duration_s, 0.5 * duration_s, steps + 1)
    return camera.motion.pose_at(camera.pose, times), 0.5 * max(length_m, angle_rad) / steps


@dataclass(frozen=True, eq=False)
class _Triangles:
    """The triangles of a coarse plant, in its own coordinates."""

    corners: FloatArray  # `(n, 3, 3)` metres
    centroids: FloatArray  # `(n, 3)`
    radii: FloatArray  # `(n,)` no corner is farther from its triangle's centroid
    radius_m: float  # no corner is farther from the vertical through the stem base


class CoarsePlants:
    """The coarse plants of a scene's far rows.

    Args:
        models: the different plants.
        rows: where they are repeated.
        full: numbers of plants that are grown in full, and so are not among them.
    """

    def __init__(self, models: Sequence[Mesh], rows: Sequence[FarRow], full: Collection[int] = ()) -> None:
        self._models = [_model_triangles(model) for model in models]
        numbers, choice, turns, bases = (
            np.concatenate([getattr(row, name) for row in rows])
            for name in ("plants", "choice", "turns", "bases")
        )
        coarse = ~np.isin(numbers, list(full))
        self._numbers, self._choice = numbers[coarse], choice[coarse]
        self._turns, self._bases = turns[coarse], bases[coarse]
        radii = np.array([model.radius_m for model in self._models])
        self._radii = radii[self._choice]

    @property
    def numbers(self) -> frozenset[int]:
        """The numbers of the plants."""
        return frozenset(self._numbers.tolist())

    def shown_near(self, views: NearViews) -> tuple[int, ...]:
        """The numbers of the plants with a triangle that a view shows nearer than `NEAR_M`, ascending."""
        shown = [plant for plant in range(len(self._numbers)) if self._is_shown(plant, views)]
        return tuple(sorted(self._numbers[shown].tolist()))

    def _is_shown(self, plant: int, views: NearViews) -> bool:
        """Whether any view shows a triangle of a plant nearer than `NEAR_M`, whatever hides it."""
        # The horizontal distance decides for most views.
        across = views.positions[:, :2] - self._bases[plant, :2]
        reach = views.reach_m + self._radii[plant]
        candidates = np.flatnonzero((across**2).sum(axis=1) < reach**2)
        return any(self._is_shown_by(plant, views, view) for view in candidates.tolist())

    def _is_shown_by(self, plant: int, views: NearViews, view: int) -> bool:
        """Whether one view does."""
        from pepperscene.scene import rotation_about_z

        model = self._models[self._choice[plant]]
        # In the coordinates of the plant.
        rotation = rotation_about_z(float(self._turns[plant]))
        centre = (views.positions[view] - self._bases[plant]) @ rotation
        reach = views.reach_m[view]
        rows = np.flatnonzero(((model.centroids - centre) ** 2).sum(axis=1) < (reach + model.radii) ** 2)
        triangles = model.corners[rows]
        # Keep those that no side of the view excludes.
        normals = views.normals[view] @ rotation
        offsets = views.offsets[view] - views.normals[view] @ self._bases[plant]
        triangles = triangles[((triangles @ normals.T) >= offsets).any(axis=1).all(axis=1)]
        points = np.broadcast_to(centre, (len(triangles), 3))
        return bool((triangle_distances(points, triangles) < reach).any())


def _model_triangles(model: Mesh) -> _Triangles:
    corners = model.vertices[model.faces].astype(float)
    centroids = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    return _Triangles(
        corners, centroids, radii, float(np.hypot(model.vertices[:, 0], model.vertices[:, 1]).max())
    )

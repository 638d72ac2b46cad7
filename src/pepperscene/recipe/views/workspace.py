"""Where a camera can be: a box, a ball or a function of the user's, away from all surfaces."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.poses.generators import MAX_POSES, as_points, as_positions, look_at
from pepperscene.errors import ArgumentError
from pepperscene.geometry import Mesh
from pepperscene.recipe.views.free_space import FreeSpace

FloatArray = NDArray[np.float64]
Point = tuple[float, float, float]

_TRIES: Final = 50
"""Chosen: positions that are drawn for each wanted one. In a ball half of them are inside, and in dense crop
one in ten is free."""
_ROUNDING: Final = 1e-9  # of a number of steps
_LEVEL: Final = 1e-6  # metres beside the target's vertical from which a camera can look at it


class Workspace(ABC):
    """The positions that a robot can bring its camera to."""

    @property
    @abstractmethod
    def bounds_m(self) -> FloatArray:
        """`(2, 3)` lowest and highest coordinates, world metres."""

    @abstractmethod
    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """`(n,)` whether `(n, 3)` world points are inside."""


@dataclass(frozen=True)
class BoxWorkspace(Workspace):
    """A box along the axes of the world, from one corner to the other, metres.

    Raises:
        ArgumentError: a coordinate is not finite, or low is above high.
    """

    low_m: Point
    high_m: Point

    def __post_init__(self) -> None:
        if not (
            np.isfinite([self.low_m, self.high_m]).all() and (self.bounds_m[0] <= self.bounds_m[1]).all()
        ):
            limits = f"from {list(self.low_m)} to {list(self.high_m)} m"
            raise ArgumentError("box", f"must have finite limits, the lower ones first, not {limits}")

    @property
    def bounds_m(self) -> FloatArray:
        """`(2, 3)` its corners."""
        return np.array([self.low_m, self.high_m], dtype=float)

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """`(n,)` whether points are inside; its surface is a part of it."""
        low, high = self.bounds_m
        points = as_points(points)
        return np.asarray(((low <= points) & (points <= high)).all(axis=1))


@dataclass(frozen=True)
class SphereWorkspace(Workspace):
    """A ball, metres: the reach of an arm around its shoulder.

    Raises:
        ArgumentError: a number is not finite, or the radius is not above 0.
    """

    centre_m: Point
    radius_m: float

    def __post_init__(self) -> None:
        if not (np.isfinite([*self.centre_m, self.radius_m]).all() and self.radius_m > 0.0):
            values = f"{list(self.centre_m)} and {self.radius_m:g} m"
            raise ArgumentError("sphere", f"must have a finite centre and a radius above 0, not {values}")

    @property
    def bounds_m(self) -> FloatArray:
        """`(2, 3)` corners of the box around it."""
        centre = np.array(self.centre_m, dtype=float)
        return np.stack([centre - self.radius_m, centre + self.radius_m])

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """`(n,)` whether points are inside; its surface is a part of it."""
        return np.asarray(
            np.linalg.norm(as_points(points) - np.array(self.centre_m), axis=1) <= self.radius_m
        )


@dataclass(frozen=True)
class FunctionWorkspace(Workspace):
    """The part of a box that a function accepts, such as the inverse kinematics of an arm.

    Attributes:
        function: of `(n, 3)` world points, metres; returns `(n,)` whether they can be reached.
        box: that has all these points.
    """

    function: Callable[[FloatArray], ArrayLike]
    box: BoxWorkspace

    @property
    def bounds_m(self) -> FloatArray:
        """`(2, 3)` corners of its box."""
        return self.box.bounds_m

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """`(n,)` whether points are in the box and accepted.

        Raises:
            ArgumentError: the function does not return a Boolean for each point.
        """
        points = as_points(points)
        inside = self.box.contains(points)
        reached: NDArray[Any] = np.asarray(self.function(points))
        if reached.shape != inside.shape or reached.dtype != np.bool_:
            problem = f"must return {len(points)} Booleans, not {reached.dtype} of the shape {reached.shape}"
            raise ArgumentError("function", problem)
        return np.asarray(inside & reached)


@dataclass(frozen=True, eq=False)
class ReachTest:
    """Whether camera positions are in a workspace, and away from all surfaces of a scene.

    Attributes:
        workspace: the positions that the robot can reach.
        mesh: of the scene.
        clearance_m: no surface is nearer to the projection centre.

    Raises:
        ArgumentError: the clearance is below 0 or not finite.
    """

    workspace: Workspace
    mesh: Mesh
    clearance_m: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.clearance_m) and self.clearance_m >= 0.0):
            raise ArgumentError(
                "clearance", f"must be a finite distance, at least 0, not {self.clearance_m:g} m"
            )

    def __call__(self, points: ArrayLike) -> NDArray[np.bool_]:
        """`(n,)` whether positions are reachable: also above the floor and not inside an organ.

        Args:
            points: `(n, 3)` world metres, or `(n, 4, 4)` poses of cameras, whose positions are tested; also
                a single one.

        Raises:
            ArgumentError: the points have another shape.
        """
        points = as_positions(points)
        reachable = self.workspace.contains(points) & (points[:, 2] > 0.0)
        rows = np.flatnonzero(reachable)
        rows_free = self._space.is_free(points[rows], self.clearance_m)
        reachable[rows[~rows_free]] = False
        rows = rows[rows_free]
        reachable[rows[self._space.inside(points[rows])]] = False
        return reachable

    @cached_property
    def _space(self) -> FreeSpace:
        return FreeSpace(self.mesh)


def random_poses(reach: ReachTest, targets: ArrayLike, count: int, rng: np.random.Generator) -> FloatArray:
    """`(count, 4, 4)` poses at random positions of a workspace, each facing the nearest target.

    Positions are uniform in the reachable part. Rows of the image are level.

    Args:
        reach: of the camera.
        targets: `(m, 3)` world metres, such as the centres of fruit.
        count: number of poses.
        rng: draws the positions.

    Raises:
        ArgumentError: an argument is not allowed, or the reachable part of the workspace is too small.
    """
    if not 1 <= count <= MAX_POSES:
        raise ArgumentError("random", f"must be from 1 to {MAX_POSES:,}, not {count}")
    low, high = reach.workspace.bounds_m
    found: list[FloatArray] = []
    missing, tries = count, _TRIES * count
    while missing > 0 and tries > 0:
        # Always draw as many as are wanted, so that the draws do not depend on what was found before.
        points = low + rng.random((count, 3)) * (high - low)
        poses = facing_poses(points[reach(points)], targets)[:missing]
        found.append(poses)
        missing, tries = missing - len(poses), tries - count
    if missing:
        problem = f"finds {count - missing:,} reachable positions of {count:,} in {_TRIES * count:,} attempts"
        raise ArgumentError("random", problem)
    return np.concatenate(found)


def lattice_poses(reach: ReachTest, targets: ArrayLike, spacing_m: float) -> FloatArray:
    """`(n, 4, 4)` poses at the reachable points of a cubic lattice, as `random_poses`; x varies slowest.

    Args:
        reach: of the camera.
        targets: `(m, 3)` world metres.
        spacing_m: of the lattice, which is in the middle of the workspace's box.

    Raises:
        ArgumentError: the targets are not as above, or the spacing is not above 0, gives no pose or too many.
    """
    if not (np.isfinite(spacing_m) and spacing_m > 0.0):
        raise ArgumentError("spacing", f"must be a finite distance above 0, not {spacing_m:g} m")
    low, high = reach.workspace.bounds_m
    steps = np.floor((high - low) / spacing_m + _ROUNDING)
    if np.prod(steps + 1.0) > MAX_POSES:
        raise ArgumentError("spacing", f"of {spacing_m:g} m gives more than {MAX_POSES:,} positions")
    axes = [
        0.5 * (a + b) + spacing_m * (np.arange(n + 1) - 0.5 * n)
        for a, b, n in zip(low, high, steps, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # Rounding could put the outermost ones outside.
    points = np.clip(points, low, high)
    poses = facing_poses(points[reach(points)], targets)
    if not len(poses):
        raise ArgumentError(
            "spacing", f"of {spacing_m:g} m gives no reachable position among {len(points):,}"
        )
    return poses


def facing_poses(points: FloatArray, targets: ArrayLike) -> FloatArray:
    """`(n, 4, 4)` poses at `(n, 3)` points, each facing the nearest of `(m, 3)` targets.

    Points right above or below their target are left out: no image there is level.
    """
    from scipy.spatial import cKDTree

    targets = as_points(targets, "targets")
    if not len(targets):
        raise ArgumentError("targets", "must be at least one")
    nearest = targets[cKDTree(targets).query(points)[1]] if len(points) else points
    level = np.linalg.norm((points - nearest)[:, :2], axis=1) > _LEVEL
    poses = [look_at(point, target) for point, target in zip(points[level], nearest[level], strict=True)]
    return np.array(poses).reshape(-1, 4, 4)

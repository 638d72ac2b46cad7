"""Random views: poses of a camera in free space that look at an organ, within limits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.recipe.views.free_space import FreeSpace
from pepperscene.recipe.views.targets import Target, organ_target, point_target, target_instances
from pepperscene.recipe.views_tables import RandomViews

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.render.visibility import PointTest
    from pepperscene.scene import Scene

FloatArray = NDArray[np.float64]
Limits = tuple[float, float]
"""Lowest and highest value."""

_ALONG_Z = 1e-9  # chosen: directions closer to the vertical than this, in radians, have no azimuth
_ROUNDING = 1e-12  # of the sine of an angle


def image_rays(camera: Camera, places: FloatArray) -> FloatArray:
    """`(n, 3)` unit directions in camera axes of the rays through `(n, 2)` places in the image.

    Places count from the image's centre, right and down, in halves of its width and height.
    """
    size = np.array([camera.width, camera.height])
    matrix = camera.intrinsics
    pixels = 0.5 * size * (1.0 + places)
    slopes = camera.lens.distortion.undistort((pixels - matrix[:2, 2]) / matrix[[0, 1], [0, 1]])
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def directions(elevation: FloatArray, azimuth: FloatArray) -> FloatArray:
    """`(n, 3)` unit vectors from a target to cameras: at azimuth 0 at its -y side, then towards +x."""
    cosine = np.cos(elevation)
    return np.stack([cosine * np.sin(azimuth), -cosine * np.cos(azimuth), np.sin(elevation)], axis=1)


def aimed_rotations(
    elevation: FloatArray, azimuth: FloatArray, rays: FloatArray, roll: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Rotations of cameras around a target that see it along given rays.

    A camera is turned about the vertical, then tilted up or down, and then rolled about its optical axis, so
    that with no roll the rows of its image are level.

    Args:
        elevation: `(n,)` of the camera seen from the target, radians, positive above it.
        azimuth: `(n,)` of the camera around the target, radians, as in `directions`.
        rays: `(n, 3)` unit vectors to the target in camera axes.
        roll: `(n,)` radians, clockwise seen from behind the camera.

    Returns:
        `(n, 3, 3)` camera to world, and `(n,)` whether there is such a camera that is tilted by at most 90
        degrees: from above, a level camera cannot have the target far to the left or right.
    """
    view = -directions(elevation, azimuth)
    # The ray in the axes of the camera before it was rolled.
    cos, sin = np.cos(roll), np.sin(roll)
    x, y, z = cos * rays[:, 0] - sin * rays[:, 1], sin * rays[:, 0] + cos * rays[:, 1], rays[:, 2]
    # Tilt: turns (y, z) so far that the ray rises as the view does.
    length = np.hypot(y, z)
    rise = view[:, 2] / length
    tilt = np.arctan2(y, z) + np.arcsin(np.clip(rise, -1.0, 1.0))
    is_possible = (np.abs(rise) <= 1.0 + _ROUNDING) & (np.abs(tilt) <= 0.5 * np.pi + _ALONG_Z)
    # Turn: brings the ray's horizontal part, x to the right and the rest ahead, to that of the view.
    ahead = length * np.sqrt(np.maximum(1.0 - rise**2, 0.0))
    turn = np.arctan2(view[:, 1], view[:, 0]) - np.arctan2(ahead, x)
    turn = np.where(np.hypot(ahead, x) < _ALONG_Z, azimuth, turn)

    level = np.zeros_like(turn)
    right = np.stack([np.cos(turn), np.sin(turn), level], axis=1)
    forward_level = np.stack([-np.sin(turn), np.cos(turn), level], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    forward = np.cos(tilt)[:, None] * forward_level + np.sin(tilt)[:, None] * up
    down = np.sin(tilt)[:, None] * forward_level - np.cos(tilt)[:, None] * up
    rolled_right = cos[:, None] * right + sin[:, None] * down
    rolled_down = -sin[:, None] * right + cos[:, None] * down
    return np.stack([rolled_right, rolled_down, forward], axis=2), is_possible


_ATTEMPTS: Final = 2000  # chosen: if one candidate in 200 is a view, one search of 20,000 finds none
_BLOCKS: Final = (4, 64)
"""Chosen: candidates tested together, at first and at most. Usually one in two to one in ten is a view, and
many together take less time for each."""
_NUMBERS: Final = 7  # random numbers for each candidate


@dataclass(frozen=True, eq=False)
class RandomView:
    """A view within all limits.

    Attributes:
        pose: `(4, 4)` camera to world, metres.
        target_instance: index of the organ among the scene's instances; None for a point.
        target_point: `(3,)` world metres, what the ray to the target's place in the image goes through.
        visibility: fraction of what the camera would see of the target alone that is in the image and not
            hidden.
        attempts: candidates up to this one.
    """

    pose: FloatArray
    target_instance: int | None
    target_point: FloatArray
    visibility: float
    attempts: int


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Cameras that look at targets, one entry each."""

    target: list[Target]
    pose: FloatArray  # `(n, 4, 4)` camera to world, metres
    is_possible: NDArray[np.bool_]  # `(n,)` whether there is such a pose

    def rows(self, chosen: slice) -> _Candidates:
        """Some of the candidates."""
        return _Candidates(self.target[chosen], self.pose[chosen], self.is_possible[chosen])


class ViewSearch:
    """A search for random views of a scene within limits.

    Args:
        settings: the limits.
        scene: with all its triangles: one culled for other views lacks surfaces that this one may show.
        camera: lens, sensor and flash; its pose does not matter.
        space: free space of the scene's mesh, which further views can use too; None makes it.
        where: name of the recipe that the settings are from, for errors.

    Raises:
        InputError: the scene has no such target.
    """

    def __init__(
        self,
        settings: RandomViews,
        scene: Scene,
        camera: Camera,
        space: FreeSpace | None = None,
        where: str | Path = "random view",
    ) -> None:
        self._settings, self._camera, self._mesh, self._where = settings, camera, scene.mesh, where
        self._space = space or FreeSpace(scene.mesh)
        self._targets: dict[int, Target] = {}
        if isinstance(settings.target, str):
            self._instances = target_instances(scene, settings.target, where)
        else:
            self._instances = np.array([-1])
            self._targets[-1] = point_target(settings.target)

    def find(
        self,
        rng: np.random.Generator,
        visible: PointTest,
        *,
        rejected: Callable[[FloatArray], bool] | None = None,
        earlier: RandomView | None = None,
        attempts: int = _ATTEMPTS,
    ) -> RandomView:
        """Draw a view, which depends on the arguments and the generator's state alone.

        Args:
            rng: draws the candidates.
            visible: `visible_points` of the scene's `Renderer`.
            rejected: whether a `(4, 4)` pose shows coarse plants from near, which is a limit too.
            earlier: a view that is kept if it is within all limits.
            attempts: candidates after which the search ends.

        Raises:
            InputError: no candidate is within all limits.
        """

        def test(candidates: _Candidates, row: int, failed: str, number: int) -> RandomView | str:
            """The view of a candidate, or the limit that it fails."""
            if failed:
                return failed
            view = self._view(candidates, row, number, visible)
            least = self._settings.least_visibility
            if view.visibility < least:
                return f"showed less than least_visibility = {least:g} of the target"
            if rejected is not None and rejected(view.pose):
                return "showed a coarse plant of the far rows from near"
            return view

        if earlier is not None:
            candidates = self._candidate(earlier)
            kept = test(candidates, 0, self._failed_limits(candidates)[0], earlier.attempts)
            if isinstance(kept, RandomView):
                return kept
        reasons: Counter[str] = Counter()
        first, block = 0, _BLOCKS[0]
        while first < attempts:
            # Always draw a whole block, so that the number of attempts does not change the views.
            candidates = self._draw(block, rng).rows(slice(attempts - first))
            for row, failed in enumerate(self._failed_limits(candidates)):
                found = test(candidates, row, failed, first + row + 1)
                if isinstance(found, RandomView):
                    return found
                reasons[found] += 1
            first, block = first + block, min(2 * block, _BLOCKS[1])
        counts = ", ".join(f"{number:,} {failed}" for failed, number in reasons.most_common())
        raise InputError(self._where, f"no view found in {attempts:,} attempts: {counts}")

    def _draw(self, count: int, rng: np.random.Generator) -> _Candidates:
        """Draw candidates; each takes the next `_NUMBERS` random numbers, however many are drawn together."""
        limits, numbers = self._settings, rng.random((count, _NUMBERS)).T
        chosen = self._instances[(numbers[0] * len(self._instances)).astype(np.intp)]
        target = [self._target(int(instance)) for instance in chosen]
        distance = _between(limits.distance_m, numbers[1])
        # Equal steps of the sine are equal solid angles.
        low, high = np.sin(limits.elevation_rad).tolist()
        elevation = np.arcsin(_between((low, high), numbers[2]))
        azimuth, roll = _between(limits.azimuth_rad, numbers[3]), _between(limits.roll_rad, numbers[4])
        # Equal steps of the square are equal areas.
        offset = np.sqrt(_between((limits.offset[0] ** 2, limits.offset[1] ** 2), numbers[5]))
        angle = 2.0 * np.pi * numbers[6]
        rays = image_rays(self._camera, np.stack([offset * np.cos(angle), offset * np.sin(angle)], axis=1))

        pose = np.tile(np.eye(4), (count, 1, 1))
        pose[:, :3, :3], is_possible = aimed_rotations(elevation, azimuth, rays, roll)
        points = np.array([item.point for item in target])
        pose[:, :3, 3] = points + distance[:, None] * directions(elevation, azimuth)
        return _Candidates(target, pose, is_possible)

    def _candidate(self, view: RandomView) -> _Candidates:
        """A view as the only candidate."""
        instance = -1 if view.target_instance is None else view.target_instance
        return _Candidates([self._target(instance)], view.pose[None], np.array([True]))

    def _view(self, candidates: _Candidates, row: int, attempts: int, visible: PointTest) -> RandomView:
        """The view of a candidate, with what is visible of its target."""
        from pepperscene.render.visibility import visible_fraction

        pose, target = candidates.pose[row], candidates.target[row]
        visibility = visible_fraction(
            visible,
            self._camera.at_pose(pose),
            target.samples,
            target.normals,
            closed=target.closed,
            instance=target.instance,
        )
        return RandomView(pose, target.instance, target.point, visibility, attempts)

    def _failed_limits(self, candidates: _Candidates) -> list[str]:
        """The first limit that each candidate fails, as the end of a sentence; "" for none."""
        settings, flash = self._settings, self._camera.flash
        failed = [""] * len(candidates.target)
        lens = candidates.pose[:, :3, 3]
        clearance_m = max(settings.clearance_m, self._camera.aperture_radius_m)

        def test(passes: Callable[[NDArray[np.intp]], NDArray[np.bool_]], reason: str) -> None:
            rows = np.array([row for row, earlier in enumerate(failed) if not earlier], dtype=np.intp)
            if len(rows):
                for row in rows[~passes(rows)]:
                    failed[row] = reason

        reason = "could not have the target at that place in the image with that roll"
        test(lambda rows: candidates.is_possible[rows], reason)
        if settings.volume_m is not None:
            low, high = np.array(settings.volume_m, dtype=float).T
            test(
                lambda rows: ((low <= lens[rows]) & (lens[rows] <= high)).all(axis=1),
                "were outside volume_mm",
            )
        test(lambda rows: lens[rows, 2] > 0.0, "were below the floor")
        limit = f"clearance_mm = {1e3 * clearance_m:g}"
        if clearance_m > settings.clearance_m:
            limit = f"the radius of the lens' pupil, {1e3 * clearance_m:.2g} mm,"
        reason = f"were nearer than {limit} to a surface"
        test(lambda rows: self._space.is_free(lens[rows], clearance_m), reason)
        test(lambda rows: ~self._space.inside(lens[rows]), "were inside an organ")
        if flash is not None:
            # A ball around all emitters.
            middle = flash.emitters_m.mean(axis=0)
            radius_m = float(np.linalg.norm(flash.emitters_m - middle, axis=1).max()) + flash.radius_m
            place = np.append(middle, 0.0) + flash.offset_m
            lamp = lens + candidates.pose[:, :3, :3] @ place
            reason = f"had a surface in the flash, within {1e3 * radius_m:.0f} mm of its centre"
            test(lambda rows: self._space.is_free(lamp[rows], radius_m), reason)
            test(lambda rows: ~self._space.inside(lamp[rows]), "had the flash inside an organ")
        return failed

    def _target(self, instance: int) -> Target:
        if instance not in self._targets:
            self._targets[instance] = organ_target(self._mesh, instance, self._space)
        return self._targets[instance]


def _between(limits: Limits, fraction: FloatArray) -> FloatArray:
    """Values at fractions of the way from the lowest to the highest; never outside by rounding."""
    return np.clip(limits[0] + fraction * (limits[1] - limits[0]), *limits)

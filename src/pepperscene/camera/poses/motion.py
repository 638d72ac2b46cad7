"""The motion of a camera while it takes an image: constant velocity and angular velocity."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion with constant velocities, in world axes.

    Attributes:
        velocity_m_s: `(3,)` velocity of the projection centre.
        angular_velocity_rad_s: `(3,)` rotation about the projection centre: the axis, right-handed, times the
            angular speed.

    Raises:
        ValueError: a velocity is not three finite numbers.
    """

    velocity_m_s: Array = field(default_factory=lambda: np.zeros(3))
    angular_velocity_rad_s: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("velocity_m_s", "angular_velocity_rad_s"):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise ValueError(f"{name} must be three finite numbers")
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def is_zero(self) -> bool:
        """Whether nothing moves."""
        return not (self.velocity_m_s.any() or self.angular_velocity_rad_s.any())

    @property
    def angular_speed_rad_s(self) -> float:
        """Magnitude of the angular velocity."""
        return float(np.linalg.norm(self.angular_velocity_rad_s))

    @property
    def axis(self) -> Array:
        """`(3,)` unit axis of the rotation; arbitrary without one."""
        speed = self.angular_speed_rad_s
        return self.angular_velocity_rad_s / speed if speed > 0.0 else np.array([0.0, 0.0, 1.0])

    def at_offset(self, offset_m: ArrayLike) -> Motion:
        """The motion of a point that turns with the camera, `(3,)` metres from it in world axes."""
        velocity = self.velocity_m_s + np.cross(self.angular_velocity_rad_s, np.asarray(offset_m, float))
        return Motion(velocity, self.angular_velocity_rad_s)

    def rotate(self, vectors: ArrayLike, t: ArrayLike) -> Array:
        """Rotate vectors `(..., 3)` as the camera rotates from time 0 to `t` `(...)`, seconds; exact.

        Method: O. Rodrigues, "Des lois géométriques qui régissent les déplacements d'un système solide dans
        l'espace", Journal de mathématiques pures et appliquées 5 (1840) 380.
        """
        vector, angle = np.asarray(vectors, float), self.angular_speed_rad_s * np.asarray(t, float)[..., None]
        axis = self.axis
        along = (vector * axis).sum(axis=-1, keepdims=True) * axis
        # 1 - cos(angle), without the cancellation at small angles.
        versine = 2.0 * np.sin(0.5 * angle) ** 2
        # Axis by axis: three times as fast as `np.cross`.
        (a, b, c), (x, y, z) = axis, np.moveaxis(vector, -1, 0)
        across = np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)
        return np.asarray(vector + np.sin(angle) * across - versine * (vector - along))

    def translation(self, t: ArrayLike) -> Array:
        """`(..., 3)` metres that the projection centre moves from time 0 to `t` `(...)`, seconds."""
        return np.asarray(np.asarray(t, float)[..., None] * self.velocity_m_s)

    def pose_at(self, pose: ArrayLike, t: ArrayLike) -> Array:
        """`(..., 4, 4)` camera to world at times `t` `(...)`, seconds, of a camera with `pose` at time 0."""
        start, time = np.asarray(pose, float), np.asarray(t, float)
        poses = np.broadcast_to(start, (*time.shape, 4, 4)).copy()
        poses[..., :3, 3] += self.translation(time)
        # The columns of a rotation are the camera's axes.
        axes = np.broadcast_to(start[:3, :3].T, (*time.shape, 3, 3))
        poses[..., :3, :3] = np.swapaxes(self.rotate(axes, time[..., None]), -1, -2)
        return poses

    def to_camera(self, pose: ArrayLike, points_world: ArrayLike, t: ArrayLike) -> Array:
        """World points `(n, 3)` in the axes of the camera at the times `t` `(n,)` or one for all; metres."""
        start, time = np.asarray(pose, float), np.asarray(t, float)
        from_centre = np.asarray(points_world, float) - start[:3, 3] - self.translation(time)
        turned = self.rotate(from_centre, -time)
        # Axis by axis: BLAS splits such products between threads, and its last bits depend on their number.
        return np.stack([(turned * axis).sum(axis=-1) for axis in start[:3, :3].T], axis=-1)

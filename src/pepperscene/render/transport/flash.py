"""The flash inside the kernel: discs side by side, each with the same angular profile."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel.arrays import device_number, device_table
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.variant import mitsuba_modules

_LEAST_DISTANCE: Final = 1e-4
"""In the kernel's unit, a metre for all but tiny scenes: chosen, for a lamp is not smaller, and its light
stays within single precision."""


class FlashMatrix:
    """The flash as discs across the camera's axis, each point of them with the same angular profile."""

    def __init__(self, flash: Flash, view: CameraRays) -> None:
        mi, dr = mitsuba_modules()
        angles = np.linspace(0.0, np.pi / 2.0, 512)
        # Over squared distance, which the kernel tells in its own unit.
        self.profile = device_table(flash.profile.at(angles) / view.unit**2)
        self.steps = 511.0 / (np.pi / 2.0)
        offset = mi.Point3f(*(float(x / view.unit) for x in flash.offset_m))
        self.radius = device_number(flash.radius_m / view.unit)
        self.least = device_number(_LEAST_DISTANCE**2)
        self.count = device_number(len(flash.emitters_m))
        self.emitters = device_table(_neighbours_first(flash.emitters_m) / view.unit)
        dr.make_opaque(offset)
        self.rotation = view.rotation
        self.centre = view.origin + view.rotation @ mi.Vector3f(offset)

    def towards(self, p: Any, sample: Any) -> Any:
        """A point of the flash, and its falloff (profile over squared distance, m-2) seen from `p`."""
        mi, dr = mitsuba_modules()
        # One coordinate takes the emitter and, in what is left of it, a place on its disc.
        turn = sample.x * self.count
        chosen = dr.minimum(dr.floor(turn), self.count - 1.0)
        emitter = dr.gather(mi.Point2f, self.emitters, mi.UInt32(chosen))
        within = mi.Point2f(dr.clip(turn - chosen, 0.0, 1.0), sample.y)
        on_disc = emitter + self.radius * mi.warp.square_to_uniform_disk_concentric(within)
        point = self.centre + self.rotation @ mi.Vector3f(on_disc.x, on_disc.y, 0.0)
        away = p - point
        # Nearer than that the light no longer grows, and at no distance there is none.
        square = dr.maximum(dr.squared_norm(away), self.least)
        distance = dr.sqrt(square)
        forward = self.rotation @ mi.Vector3f(0.0, 0.0, 1.0)
        cosine = dr.dot(away, forward) / distance
        x = dr.clip(dr.safe_acos(cosine) * self.steps, 0.0, 510.999)
        left = dr.floor(x)
        index = mi.UInt32(left)
        profile = dr.lerp(
            dr.gather(mi.Float, self.profile, index), dr.gather(mi.Float, self.profile, index + 1), x - left
        )
        return point, dr.select(cosine > 0.0, profile / square, 0.0)


def _neighbours_first(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places `(k, 2)` along a Z-order curve (Morton 1966): an even share of them is a compact block.

    So an even spread of samples over the list is one over the plane as well.
    """
    extent = max(float(np.ptp(places, axis=0).max()), 1e-12)
    cells = np.rint((places - places.min(axis=0)) / extent * 255.0).astype(np.int64)
    bits = np.arange(8)
    spread = ((cells[:, None, :] >> bits[:, None]) & 1) << (2 * bits[:, None] + np.arange(2))
    return places[np.argsort(spread.sum(axis=(1, 2)), kind="stable")]

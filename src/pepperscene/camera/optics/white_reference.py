"""The white reference: a matt panel that a user photographs before the plants, to measure reflectance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.optics.flash import Flash

Array = NDArray[np.float64]
Facing = Literal["camera", "up"]

UNLIT_BANDS: Final = "bands_without_light"
"""Key of a frame's JSON, under `white_reference`: the bands, from 0, whose reflectance is nan somewhere,
because the panel has too little light; missing if there are none."""

_RINGS, _SPOKES = 8, 32  # points on an emitter's disc; chosen: exact to 1e-6 at twice its radius
_UP: Final = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class WhiteReference:
    """A matt (Lambertian) panel, small, alone and unshadowed, under the light of a frame.

    Attributes:
        reflectance: in all bands, in (0, 1].
        distance_m: of its centre from the projection centre, along the optical axis.
        facing: "camera" for a panel across the optical axis, "up" for a level one.

    Raises:
        ValueError: a number is out of range.
    """

    reflectance: float = 0.99
    distance_m: float = 0.5
    facing: Facing = "camera"

    def __post_init__(self) -> None:
        if not (0 < self.reflectance <= 1 and 0 < self.distance_m < math.inf):
            raise ValueError("a white reference needs a reflectance in (0, 1] and a positive distance")

    def to_metadata(self) -> dict[str, Any]:
        """JSON-ready description."""
        return {"reflectance": self.reflectance, "distance_m": self.distance_m, "facing": self.facing}

    def centre(self, pose: ArrayLike) -> Array:
        """`(3,)` in world axes, for a camera at a pose `(4, 4)`."""
        matrix = np.asarray(pose, float)
        return np.asarray(matrix[:3, 3] + self.distance_m * matrix[:3, 2])

    def normal(self, pose: ArrayLike) -> Array:
        """`(3,)` unit normal in world axes, for a camera at a pose `(4, 4)`."""
        return -np.asarray(pose, float)[:3, 2] if self.facing == "camera" else np.array(_UP)


def flash_on_panel(flash: Flash, panel: WhiteReference, pose: ArrayLike) -> float:
    """Irradiance of a panel by the flash of a camera at a pose, over the flash's axial intensity, m-2.

    The mean over the points of all emitters of p(theta) cos(beta) / r^2: p is the profile at the angle theta
    to the flash's axis, beta the angle to the panel's normal, and r the distance.
    """
    normal = np.asarray(pose, float)[:3, :3].T @ panel.normal(pose)
    turn = np.eye(3) if flash.rotation is None else flash.rotation
    # On a unit disc across the z axis: Gauss's rule in the squared radius, in which area is uniform.
    angle = (np.arange(_SPOKES) + 0.5) * (2.0 * np.pi / _SPOKES)
    node, weight = np.polynomial.legendre.leggauss(_RINGS)
    radius = np.sqrt(0.5 * (1.0 + node))
    x, y = (np.outer(radius, along(angle)).ravel() for along in (np.cos, np.sin))
    disc, weights = np.stack([x, y, np.zeros_like(x)], axis=-1), np.repeat(weight / (2.0 * _SPOKES), _SPOKES)
    points = flash.emitter_positions()[:, None] + (flash.radius_m * disc) @ turn.T
    towards = np.array([0.0, 0.0, panel.distance_m]) - points
    distance = np.linalg.norm(towards, axis=-1)
    cosine = np.clip(towards @ turn[:, 2] / distance, -1.0, 1.0)
    emitted = np.where(cosine > 0.0, flash.profile.at(np.arccos(cosine)), 0.0)
    received = np.maximum(-(towards @ normal) / distance, 0.0)
    return float((emitted * received / distance**2 @ weights).mean())

"""A share against the angle to an axis: a lamp's beam, a lens' vignetting."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class AngularProfile:
    """Relative intensity against the angle to the axis; linear in between.

    Attributes:
        angle_rad: `(n,)` increasing from 0, at most pi/2; read-only.
        relative_intensity: `(n,)` at least 0, and 1 on the axis; read-only.
        beyond: the last angle: nothing (a lamp's beam ends), or what the last angle has (a lens' table).
    """

    angle_rad: NDArray[np.float64]
    relative_intensity: NDArray[np.float64]
    beyond: Literal["zero", "hold"] = "zero"

    def __post_init__(self) -> None:
        angle = np.array(self.angle_rad, dtype=float)
        relative = np.array(self.relative_intensity, dtype=float)
        if angle.ndim != 1 or angle.size < 2 or angle[0] != 0 or not np.all(np.diff(angle) > 0):
            raise ValueError("angles must be one increasing list of at least two from 0")
        if angle[-1] > math.pi / 2 + 1e-12:
            raise ValueError("angles must not pass a right angle")
        if relative.shape != angle.shape:
            raise ValueError("angles and relative intensities must be equally long")
        if relative[0] != 1 or not np.all((relative >= 0) & np.isfinite(relative)):
            raise ValueError("relative intensities must be finite, at least 0, and 1 at angle 0")
        for name, values in (("angle_rad", angle), ("relative_intensity", relative)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def at(self, angle_rad: ArrayLike) -> NDArray[np.float64]:
        """Relative intensity `(...)` at angles `(...)`."""
        end = 0.0 if self.beyond == "zero" else float(self.relative_intensity[-1])
        angle = np.asarray(angle_rad, dtype=float)
        return np.asarray(np.interp(angle, self.angle_rad, self.relative_intensity, right=end))

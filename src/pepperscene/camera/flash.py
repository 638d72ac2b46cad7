"""The flash: a bright disc beside the lens with a narrow beam and a short pulse."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra import Spectrum, with_illuminance


@dataclass(frozen=True, eq=False)
class AngularProfile:
    """Relative radiant intensity against the angle to the axis; linear in between, zero beyond.

    Attributes:
        angle_rad: `(n,)` increasing from 0, at most pi/2.
        relative_intensity: `(n,)` at least 0, and 1 on the axis.
    """

    angle_rad: NDArray[np.float64]
    relative_intensity: NDArray[np.float64]

    def __post_init__(self) -> None:
        angle = np.asarray(self.angle_rad, dtype=float)
        relative = np.asarray(self.relative_intensity, dtype=float)
        if angle.ndim != 1 or angle.size < 2 or angle[0] != 0 or not np.all(np.diff(angle) > 0):
            raise ValueError("angles must be one increasing list from 0")
        if angle[-1] > math.pi / 2 + 1e-12:
            raise ValueError("angles must not pass a right angle")
        if relative.shape != angle.shape or relative[0] != 1 or not np.all(relative >= 0):
            raise ValueError("relative intensities must be one per angle, at least 0, and 1 at angle 0")
        object.__setattr__(self, "angle_rad", angle)
        object.__setattr__(self, "relative_intensity", relative)

    def at(self, angle_rad: ArrayLike) -> NDArray[np.float64]:
        """Relative intensity `(...)` at angles `(...)`."""
        return np.interp(
            np.asarray(angle_rad, dtype=float), self.angle_rad, self.relative_intensity, right=0.0
        )


@dataclass(frozen=True, eq=False)
class Flash:
    """A disc that looks along the optical axis; every point of it has the same angular profile.

    Attributes:
        name: for reports.
        spectrum: relative spectral power distribution (SPD), `(n,)`.
        illuminance_lx: on a plane facing the flash, straight ahead of the disc's centre.
        at_m: distance of that plane.
        profile: intensity against angle.
        radius_m: of the disc; 0 makes it a point.
        offset_m: `(3,)` centre of the disc in camera axes (x right, y down, z forward).
        pulse_s: how long it shines, with constant power; the exposure starts with it.
    """

    name: str
    spectrum: Spectrum
    illuminance_lx: float
    at_m: float
    profile: AngularProfile
    radius_m: float = 0.0
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pulse_s: float = 50e-6

    def __post_init__(self) -> None:
        if min(self.illuminance_lx, self.at_m, self.pulse_s) <= 0 or self.radius_m < 0:
            raise ValueError(
                f"{self.name}: illuminance, distance and pulse must be positive, radius at least 0"
            )
        if self.spectrum.values.ndim != 1 or self.spectrum.values.min() < 0 or not is_visible(self.spectrum):
            raise ValueError(
                f"{self.name}: the spectrum must be one curve, at least 0 and not all 0 in 400 to 700 nm"
            )

    @property
    def axial_area_m2(self) -> float:
        """Axial intensity over the irradiance that the whole disc gives straight ahead at `at_m`.

        A point gives E = I / d^2. Of a disc of radius a, an element dA emits I p(theta) dA / (pi a^2) towards
        the plane's centre, at distance d / cos theta and incidence theta, so that
        E = I 2 / a^2 * integral of p(theta) sin theta dtheta from 0 to atan(a / d).
        """
        if self.radius_m < 1e-9 * self.at_m:  # a point, to rounding
            return self.at_m**2
        edge = math.atan2(self.radius_m, self.at_m)
        inner = self.profile.angle_rad[self.profile.angle_rad < edge]
        knots = np.append(inner, edge)
        # Gauss-Legendre on each linear piece of the profile: exact to rounding for p(theta) sin theta.
        node, weight = np.polynomial.legendre.leggauss(8)
        middle, half = (knots[1:] + knots[:-1]) / 2, np.diff(knots) / 2
        theta = middle[:, None] + half[:, None] * node
        integral = float(np.sum(half[:, None] * weight * self.profile.at(theta) * np.sin(theta)))
        return self.radius_m**2 / (2 * integral)

    def radiant_intensity(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """`(n,)` W sr-1 nm-1 of the whole disc on its axis, during the pulse."""
        irradiance = with_illuminance(self.spectrum, self.illuminance_lx)
        return irradiance.at(wavelength_nm) * self.axial_area_m2


def is_visible(spectrum: Spectrum) -> bool:
    """Whether there is light between 400 and 700 nm, so that lux can be told."""
    return bool(spectrum.at(np.arange(400.0, 701.0)).any())

"""The flash: a matrix of LEDs beside the lens, with a narrow beam and a short pulse."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.profile import AngularProfile
from pepperscene.spectra import Spectrum, with_illuminance

_RINGS: Final = 32  # chosen: for smooth profiles exact to rounding, beside a sharp edge to 1e-4
_TURNS: Final = 32


@dataclass(frozen=True, eq=False)
class Flash:
    """Equal discs in a plane across the optical axis; every point of each has the same angular profile.

    What the whole flash gives straight ahead sets its strength, in lux, or in watts for a lamp whose light
    cannot be seen.

    Attributes:
        name: for reports.
        spectrum: relative spectral power distribution (SPD), `(n,)`.
        at_m: distance of the plane on which the strength is told; it faces the flash.
        profile: intensity of an emitter against the angle to the flash's axis.
        illuminance_lx: on that plane, straight ahead of `offset_m`, from all emitters together; or None.
        irradiance_W_m2: the same in W m-2 over all wavelengths; exactly one of the two is given.
        radius_m: of one emitter; 0 makes it a point.
        emitters_m: `(k, 2)` centres of the emitters from `offset_m`, right and down; read-only.
        offset_m: `(3,)` the flash's centre in camera axes (x right, y down, z forward).
        pulse_s: how long it shines, with constant power; the exposure starts with it.
    """

    name: str
    spectrum: Spectrum
    at_m: float
    profile: AngularProfile
    illuminance_lx: float | None = None
    irradiance_W_m2: float | None = None  # noqa: N815 (the unit is written so)
    radius_m: float = 0.0
    emitters_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, 2)))
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pulse_s: float = 50e-6

    def __post_init__(self) -> None:
        strengths = [s for s in (self.illuminance_lx, self.irradiance_W_m2) if s is not None]
        if len(strengths) != 1:
            raise ValueError(f"{self.name}: exactly one of illuminance_lx and irradiance_W_m2 is needed")
        if not min(*strengths, self.at_m, self.pulse_s) > 0 or not self.radius_m >= 0:
            raise ValueError(f"{self.name}: strength, distance and pulse must be positive, radius at least 0")
        if self.spectrum.values.ndim != 1 or not self.spectrum.values.min() >= 0:
            raise ValueError(f"{self.name}: the spectrum must be one curve, at least 0")
        if self.illuminance_lx is not None and not is_visible(self.spectrum):
            raise ValueError(f"{self.name}: a spectrum without light in 400 to 700 nm has no lux")
        if not self.spectrum.integral() > 0:
            raise ValueError(f"{self.name}: the spectrum must not be 0 throughout")
        emitters = np.array(self.emitters_m, dtype=float)
        if emitters.ndim != 2 or emitters.shape[1] != 2 or not len(emitters):
            raise ValueError(f"{self.name}: emitters must be (k, 2) with k >= 1, not {emitters.shape}")
        if not np.isfinite(emitters).all():
            raise ValueError(f"{self.name}: emitters must be finite")
        emitters.setflags(write=False)
        object.__setattr__(self, "emitters_m", emitters)
        if not self._per_intensity > 0:
            raise ValueError(f"{self.name}: no light of the profile falls straight ahead at {self.at_m:g} m")

    @property
    def axial_area_m2(self) -> float:
        """Axial intensity over the irradiance that the whole flash gives straight ahead at `at_m`.

        An emitting point gives E = I / d^2 on its axis. Beside it by rho, at the angle theta = atan(rho / d),
        E = I p(theta) cos(theta) / (d^2 + rho^2). Each of k discs holds I / k, evenly over its area, so that
        E / I is the mean of p(theta) cos(theta) / (d^2 + rho^2) over all points of all discs.
        """
        return 1.0 / self._per_intensity

    @cached_property
    def _per_intensity(self) -> float:
        """Irradiance straight ahead at `at_m` over the axial intensity, m-2."""
        points = self.emitters_m[:, None, :] + _disc_points(self.radius_m)
        rho2 = (points**2).sum(axis=-1)
        distance2 = rho2 + self.at_m**2
        profile = self.profile.at(np.arctan2(np.sqrt(rho2), self.at_m))
        per_point = profile * self.at_m / (distance2 * np.sqrt(distance2))
        return float((per_point @ _disc_weights()).mean())

    def irradiance(self) -> Spectrum:
        """W m-2 nm-1 straight ahead at `at_m` during the pulse; its strength is the stated one."""
        if self.illuminance_lx is not None:
            return with_illuminance(self.spectrum, self.illuminance_lx)
        assert self.irradiance_W_m2 is not None  # exactly one is given
        return self.spectrum.times(self.irradiance_W_m2 / float(self.spectrum.integral()))

    def radiant_intensity(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """`(n,)` W sr-1 nm-1 of all emitters together on the axis, during the pulse."""
        return self.irradiance().at(wavelength_nm) * self.axial_area_m2


def square_matrix(columns: int, rows: int, pitch_m: float) -> NDArray[np.float64]:
    """`(rows * columns, 2)` centres of a matrix of emitters around (0, 0), row by row."""
    right = (np.arange(columns) - (columns - 1) / 2) * pitch_m
    down = (np.arange(rows) - (rows - 1) / 2) * pitch_m
    return np.stack(np.meshgrid(right, down), axis=-1).reshape(-1, 2)


def is_visible(spectrum: Spectrum) -> bool:
    """Whether there is light between 400 and 700 nm, so that lux can be told."""
    return bool(spectrum.at(np.arange(400.0, 701.0)).any())


def _disc_points(radius_m: float) -> NDArray[np.float64]:
    """`(m, 2)` points of a disc for quadrature: Gauss-Legendre in the squared radius, even in azimuth."""
    node, _ = np.polynomial.legendre.leggauss(_RINGS)
    ring = radius_m * np.sqrt((node + 1) / 2)
    turn = (np.arange(_TURNS) + 0.5) * (2 * math.pi / _TURNS)
    return (ring[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)).reshape(-1, 2)


def _disc_weights() -> NDArray[np.float64]:
    """`(m,)` weights of `_disc_points`; their sum is 1."""
    _, weight = np.polynomial.legendre.leggauss(_RINGS)
    return np.repeat(weight / (2 * _TURNS), _TURNS)

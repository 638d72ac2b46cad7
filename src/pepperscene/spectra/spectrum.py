"""Sampled functions of wavelength."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Outside = Literal["hold", "zero", "error"]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Values at wavelengths, linear in between.

    Attributes:
        wavelength_nm: `(n,)` strictly increasing, n >= 2.
        values: `(..., n)`, finite; the unit is the owner's.
        outside: what `at` gives beyond the range: the end value, zero, or an error.
    """

    wavelength_nm: NDArray[np.float64]
    values: NDArray[np.float64]
    outside: Outside = "zero"

    def __post_init__(self) -> None:
        nm = np.asarray(self.wavelength_nm, dtype=float)
        values = np.asarray(self.values, dtype=float)
        if nm.ndim != 1 or nm.size < 2 or not np.all(np.diff(nm) > 0):
            raise ValueError("wavelengths must be one increasing list of at least two")
        if values.shape[-1:] != nm.shape:
            raise ValueError(f"{values.shape[-1:]} values for {nm.shape} wavelengths")
        if not (np.isfinite(nm).all() and np.isfinite(values).all()):
            raise ValueError("wavelengths and values must be finite")
        object.__setattr__(self, "wavelength_nm", nm)
        object.__setattr__(self, "values", values)

    def at(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Linear interpolation, `(..., m)` at `(m,)` wavelengths.

        Raises:
            ValueError: a wavelength lies beyond the range and `outside` is "error".
        """
        nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
        beyond = (nm < self.wavelength_nm[0]) | (nm > self.wavelength_nm[-1])
        if self.outside == "error" and beyond.any():
            low, high = self.wavelength_nm[[0, -1]]
            raise ValueError(f"{nm[beyond][0]:g} nm lies beyond the spectrum's {low:g} to {high:g} nm")
        right = np.clip(np.searchsorted(self.wavelength_nm, nm, side="right"), 1, self.wavelength_nm.size - 1)
        left = right - 1
        span = self.wavelength_nm[right] - self.wavelength_nm[left]
        weight = np.clip((nm - self.wavelength_nm[left]) / span, 0.0, 1.0)
        found = (1.0 - weight) * self.values[..., left] + weight * self.values[..., right]
        return np.where(beyond, 0.0, found) if self.outside == "zero" else found

    def integral(self) -> NDArray[np.float64]:
        """Trapezoidal integral over the range, `(...)`, exact for the linear interpolant (unit x nm)."""
        return np.asarray(np.trapezoid(self.values, self.wavelength_nm, axis=-1))

    def times(self, factor: float) -> Spectrum:
        """The spectrum scaled by a number."""
        return Spectrum(self.wavelength_nm, self.values * factor, self.outside)

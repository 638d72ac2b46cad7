"""Sampled functions of wavelength."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
Outside = Literal["hold", "zero", "error"]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Values at wavelengths, interpolated linearly.

    Attributes:
        wavelength_nm: `(n,)` strictly increasing, n >= 2; the first and last are the spectrum's range.
        values: `(..., n)`, finite; the unit depends on the use.
        outside: behaviour outside the range: "hold" the end value, "zero" (with a step at the end, where the
            end value applies), or raise an "error".
    """

    wavelength_nm: FloatArray
    values: FloatArray
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

    @property
    def range_nm(self) -> tuple[float, float]:
        """First and last wavelength."""
        return float(self.wavelength_nm[0]), float(self.wavelength_nm[-1])

    def at(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Interpolate linearly: `(..., m)` values at `(m,)` wavelengths.

        Raises:
            ValueError: a wavelength is outside the range and `outside` is "error".
        """
        nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
        low, high = self.range_nm
        outside = (nm < low) | (nm > high)
        if self.outside == "error" and outside.any():
            raise ValueError(f"{nm[outside][0]:g} nm is outside the spectrum's {low:g} to {high:g} nm")
        values = self._interpolate(nm)
        return np.where(outside, 0.0, values) if self.outside == "zero" else values

    def integral(self, weight: Spectrum | None = None) -> FloatArray:
        """Integral over this spectrum's range, `(...)`, exact for piecewise linear functions (unit x nm).

        Args:
            weight: a second spectrum to multiply with; its leading axes broadcast, and its own `outside`
                applies outside its range. The product of two linear pieces is quadratic; Simpson's rule
                between the nodes of both integrates it exactly.

        Raises:
            ValueError: `outside` of `weight` is "error" and it does not cover the range.
        """
        if weight is None:
            return np.asarray(np.trapezoid(self.values, self.wavelength_nm, axis=-1))
        low, high = self.range_nm
        nodes = np.union1d(self.wavelength_nm, weight.wavelength_nm)
        nm = nodes[(nodes >= low) & (nodes <= high)]
        (f0, f1), (g0, g1) = self._segment_ends(nm), weight._segment_ends(nm)
        # Simpson's rule; the value in the middle is the mean of both ends.
        simpson = 2.0 * (f0 * g0 + f1 * g1) + f0 * g1 + f1 * g0
        return np.asarray((simpson * np.diff(nm)).sum(axis=-1) / 6.0)

    def times(self, factor: float | Spectrum) -> Spectrum:
        """Multiply by a number or by another spectrum, whose leading axes broadcast.

        The product is sampled at the nodes of both, where it is exact, and is linear in between (`integral`
        with a weight is exact there too). Its range is the intersection of both ranges; the range of a
        spectrum with `outside` "hold" does not limit it. `outside` of the product is the stricter of both.

        Raises:
            ValueError: the two ranges do not overlap.
        """
        if not isinstance(factor, Spectrum):
            return Spectrum(self.wavelength_nm, self.values * factor, self.outside)
        both = (self, factor)
        outsides = {s.outside for s in both}
        outside: Outside = "error" if "error" in outsides else "zero" if "zero" in outsides else "hold"
        nm = np.union1d(self.wavelength_nm, factor.wavelength_nm)
        for low, high in (s.range_nm for s in both if s.outside != "hold"):
            nm = nm[(nm >= low) & (nm <= high)]
        if nm.size < 2:
            raise ValueError("the ranges of the two spectra do not overlap")
        return Spectrum(nm, self._interpolate(nm) * factor._interpolate(nm), outside)

    def _interpolate(self, nm: FloatArray) -> FloatArray:
        """Linear interpolation, `(..., m)`; the end values outside the range."""
        right = np.clip(np.searchsorted(self.wavelength_nm, nm, side="right"), 1, self.wavelength_nm.size - 1)
        left = right - 1
        span = self.wavelength_nm[right] - self.wavelength_nm[left]
        weight = np.clip((nm - self.wavelength_nm[left]) / span, 0.0, 1.0)
        return (1.0 - weight) * self.values[..., left] + weight * self.values[..., right]

    def _segment_ends(self, nm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values `(..., m - 1)` at the start and the end of the segments between `(m,)` wavelengths.

        The wavelengths include all nodes of this spectrum between the first and the last of them, so each
        segment is linear and either completely inside or completely outside the range.
        """
        low, high = self.range_nm
        inside = (nm[:-1] >= low) & (nm[1:] <= high)
        if self.outside == "error" and not inside.all():
            raise ValueError(
                f"{nm[0]:g} to {nm[-1]:g} nm is partly outside the spectrum's {low:g} to {high:g} nm"
            )
        weight = inside if self.outside == "zero" else np.ones_like(inside)
        values = self._interpolate(nm)
        return values[..., :-1] * weight, values[..., 1:] * weight

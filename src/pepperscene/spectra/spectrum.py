"""Sampled functions of wavelength."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Outside = Literal["hold", "zero", "error"]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Values at wavelengths, linear in between.

    Attributes:
        wavelength_nm: `(n,)` strictly increasing, n >= 2; its ends are the spectrum's range.
        values: `(..., n)`, finite; the unit is the owner's.
        outside: what the spectrum is beyond its range: its end value, zero (with a step at the end, whose
            own value holds there), or an error to ask for.
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
        low, high = self.range_nm
        beyond = (nm < low) | (nm > high)
        if self.outside == "error" and beyond.any():
            raise ValueError(f"{nm[beyond][0]:g} nm lies beyond the spectrum's {low:g} to {high:g} nm")
        found = self._held(nm)
        return np.where(beyond, 0.0, found) if self.outside == "zero" else found

    def integral(self, weight: Spectrum | None = None) -> NDArray[np.float64]:
        """Integral over this spectrum's range, `(...)`, exact for linear pieces (unit x nm).

        Args:
            weight: a second spectrum to multiply with, whose leading axes broadcast; beyond its own range it
                is what its `outside` says. The product of two linear pieces is quadratic, which Simpson's
                rule on the nodes of both integrates exactly.

        Raises:
            ValueError: `weight` says "error" and does not cover the range.
        """
        if weight is None:
            return np.asarray(np.trapezoid(self.values, self.wavelength_nm, axis=-1))
        low, high = self.range_nm
        nodes = np.union1d(self.wavelength_nm, weight.wavelength_nm)
        nm = nodes[(nodes >= low) & (nodes <= high)]
        (f0, f1), (g0, g1) = self._pieces(nm), weight._pieces(nm)
        # Simpson with the mean of the ends in the middle of both.
        simpson = 2.0 * (f0 * g0 + f1 * g1) + f0 * g1 + f1 * g0
        return np.asarray((simpson * np.diff(nm)).sum(axis=-1) / 6.0)

    def averaged(self, edges_nm: ArrayLike) -> NDArray[np.float64]:
        """Mean within each bin, `(..., k)` between `(k + 1,)` increasing edges.

        Exact for linear pieces, so that the means times the bins' widths add up to the integral from the
        first to the last edge, whatever the grids. Beyond the range counts what `outside` says.

        Raises:
            ValueError: the edges do not increase, or lie beyond the range and `outside` is "error".
        """
        edges = np.asarray(edges_nm, dtype=float)
        if edges.ndim != 1 or edges.size < 2 or not np.all(np.diff(edges) > 0):
            raise ValueError("edges must be one increasing list of at least two")
        # Trapezoids between neighbouring nodes and edges, summed by bin.
        nodes = np.union1d(self.wavelength_nm, edges)
        nm = nodes[(nodes >= edges[0]) & (nodes <= edges[-1])]
        start, end = self._pieces(nm)
        areas = (start + end) / 2.0 * np.diff(nm)
        return np.add.reduceat(areas, np.searchsorted(nm, edges[:-1]), axis=-1) / np.diff(edges)

    def times(self, factor: float | Spectrum) -> Spectrum:
        """The spectrum scaled by a number, or the product of two spectra, whose leading axes broadcast.

        The product is sampled at the nodes of both, where it is exact; between them it is taken as linear
        (`integral` with a weight takes it as the quadratic that it is). It has the range that both have, and
        beyond is zero if one of them is, an error to ask for if one of them says so. Where a spectrum is held
        beyond its range, its range does not limit the product's.

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
            raise ValueError("the product of spectra whose ranges do not overlap")
        return Spectrum(nm, self._held(nm) * factor._held(nm), outside)

    @property
    def range_nm(self) -> tuple[float, float]:
        """First and last wavelength."""
        return float(self.wavelength_nm[0]), float(self.wavelength_nm[-1])

    def _held(self, nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Linear interpolation, `(..., m)`; the end values beyond the range."""
        right = np.clip(np.searchsorted(self.wavelength_nm, nm, side="right"), 1, self.wavelength_nm.size - 1)
        left = right - 1
        span = self.wavelength_nm[right] - self.wavelength_nm[left]
        weight = np.clip((nm - self.wavelength_nm[left]) / span, 0.0, 1.0)
        return (1.0 - weight) * self.values[..., left] + weight * self.values[..., right]

    def _pieces(self, nm: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values `(..., m - 1)` at the start and the end of the pieces between wavelengths.

        All of this spectrum's nodes between the first and the last wavelength are among the `(m,)`, so that
        a piece is linear and lies wholly within the range or wholly beyond.
        """
        low, high = self.range_nm
        within = (nm[:-1] >= low) & (nm[1:] <= high)
        if self.outside == "error" and not within.all():
            asked = f"{nm[0]:g} to {nm[-1]:g} nm"
            raise ValueError(f"{asked} lie partly beyond the spectrum's {low:g} to {high:g} nm")
        counts = within if self.outside == "zero" else np.ones_like(within)
        held = self._held(nm)
        return held[..., :-1] * counts, held[..., 1:] * counts


PLANCK: Final = 6.62607015e-34
"""Planck constant, J s; exact in the SI of 2019."""

LIGHT_SPEED: Final = 299_792_458.0
"""Speed of light in vacuum, m s-1; exact."""


def photons_per_joule(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Photons in one joule of light, lambda / (h c), at each wavelength."""
    return np.asarray(wavelength_nm, dtype=float) * 1e-9 / (PLANCK * LIGHT_SPEED)


@cache
def colour_science() -> ModuleType:
    """The package `colour`, imported when first asked for.

    It warns where matplotlib is not installed, which only its plots need; nothing here plots, so that a user
    should not have to wonder.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", '"Matplotlib" related API features are not available')
        import colour
    return colour

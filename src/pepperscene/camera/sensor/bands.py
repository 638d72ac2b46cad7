"""Spectral bands: response curves of given centre and width, and the description of any curves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.spectra import Spectrum

Array = NDArray[np.float64]
BandShape = Literal["gaussian", "box"]

_STEP_NM: Final = 0.25
"""Of tabulated curves. Chosen: half of the wavelength grid on which light is traced; the width of a Gaussian
of 2 nm is then exact to 0.01 nm."""
_REACH: Final = 2.0
"""Half of a Gaussian's range over its full width at half maximum. Chosen: the curve is 1.5e-5 there, and
filters block more than a ten-thousandth of the light beside their band."""


@dataclass(frozen=True)
class Band:
    """A band of a sensor, by the curve of its response.

    Attributes:
        name: in the sensor's file, such as "red edge"; "" for none.
        centre_nm: mean wavelength, weighted with the response; to 0.01 nm.
        width_nm: full width at half maximum: between the outermost wavelengths with half of the response's
            peak; to 0.01 nm.
    """

    name: str
    centre_nm: float
    width_nm: float

    def to_json(self) -> dict[str, Any]:
        """JSON-ready description."""
        return {"name": self.name, "centre_nm": self.centre_nm, "width_nm": self.width_nm}


def band_curves(
    centre_nm: Sequence[float],
    width_nm: Sequence[float],
    peak: Sequence[float],
    shape: Sequence[BandShape],
) -> Spectrum:
    """The responses `(c, n)` of c bands: Gaussians or boxes of given widths at half maximum and peaks."""
    centres, widths, peaks = (np.asarray(values, float)[:, None] for values in (centre_nm, width_nm, peak))
    is_box = np.array([each == "box" for each in shape])[:, None]
    reach = np.where(is_box, 0.5, _REACH) * widths + _STEP_NM
    first, last = (centres - reach).min() / _STEP_NM, (centres + reach).max() / _STEP_NM
    nm = _STEP_NM * np.arange(math.floor(first), math.ceil(last) + 1)
    offsets = np.abs(nm - centres)
    gaussians = np.where(offsets <= _REACH * widths, np.exp2(-((2.0 * offsets / widths) ** 2)), 0.0)
    # Means over a step, so that the area is exact wherever a box ends.
    boxes = np.clip((0.5 * widths - offsets) / _STEP_NM + 0.5, 0.0, 1.0)
    return Spectrum(nm, peaks * np.where(is_box, boxes, gaussians))


def describe_bands(response: Spectrum, names: Sequence[str] = ()) -> tuple[Band, ...]:
    """The bands of response curves `(c, n)`, with their names if there are some.

    Raises:
        ValueError: a curve is 0 everywhere.
    """
    labels = names or [""] * len(response.values)
    curves = [Spectrum(response.wavelength_nm, values) for values in response.values]
    return tuple(Band(name, *_centre_and_width(curve)) for name, curve in zip(labels, curves, strict=True))


def _centre_and_width(curve: Spectrum) -> tuple[float, float]:
    nm, values = curve.wavelength_nm, curve.values
    total, peak = float(curve.integral()), float(values.max())
    if not total > 0.0:
        raise ValueError("has a band that detects no light")
    # Wavelength is linear too, so the integral of the product is exact.
    centre = float(curve.integral(Spectrum(nm, nm))) / total
    above = np.flatnonzero(values >= 0.5 * peak)
    first, last = int(above[0]), int(above[-1])
    low = _crossing(nm, values, first - 1, first, 0.5 * peak) if first > 0 else nm[0]
    high = _crossing(nm, values, last + 1, last, 0.5 * peak) if last + 1 < nm.size else nm[-1]
    return round(centre, 2), round(float(high - low), 2)


def _crossing(nm: Array, values: Array, below: int, above: int, level: float) -> float:
    """Wavelength between two neighbouring entries at which the curve has a level."""
    share = (level - values[below]) / (values[above] - values[below])
    return float(nm[below] + share * (nm[above] - nm[below]))

"""Noise of a photograph by the fields of a chart: deviations in codes, and the photon transfer curve."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.calibration.photographs import ChartPhotograph
from pepperscene.camera.sensor.readout import block_means

Floats = NDArray[np.float64]

YCBCR: Final = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])
"""Luma and chroma of codes, ITU-R BT.601 as in JPEG (JFIF 1.02)."""

SCALES: Final = (1, 2)
"""Sides in pixels of the areas whose means deviate: noise that was smoothed remains in larger areas."""

_TILES: Final = 3  # chosen: a field is divided into 3 x 3 parts for the uncertainty
_RESAMPLES: Final = 200  # chosen: a standard deviation is then known to 5 %


@dataclass(frozen=True, eq=False)
class NoiseCurve:
    """Noise of the fields of a photograph.

    Attributes:
        levels: `(n, 3)` mean codes, 0 to 1.
        deviations: `(n, 2, 3)` standard deviations of luma and both chromas of codes, of single pixels and of
            means of 2 x 2 pixels; nan where clipped.
        relative_sd: relative standard deviation of a deviation, over resamples of parts of the fields.
    """

    levels: Floats
    deviations: Floats
    relative_sd: float

    def mean(self) -> Floats:
        """`(2, 3)` root mean square deviations over the fields."""
        return np.asarray(np.sqrt(np.nanmean(self.deviations**2, axis=0)))


@dataclass(frozen=True)
class PhotonTransfer:
    """A line through variances of a linear signal against its means: variance = slope * mean + dark.

    Without processing the slope is the reciprocal of the electrons at full scale (Janesick 2007, "Photon
    transfer", SPIE Press, chapter 5; EMVA standard 1288).

    Attributes:
        slope: of the line, with its standard deviation over resamples of the fields.
        dark: variance without light.
    """

    slope: float
    slope_sd: float
    dark: float


def chart_noise(photograph: ChartPhotograph, rng: np.random.Generator | None = None) -> NoiseCurve:
    """Noise in the fields of a photograph, without the gradual change of the light in them.

    A generator draws resamples of parts of the fields; without one, the standard deviation is 0.
    """
    parts = np.stack([_variances(codes @ YCBCR.T) for codes in photograph.middles])
    parts[~photograph.usable.all(axis=1)] = np.nan
    variances, relative = parts.mean(axis=1), 0.0
    if rng is not None:
        usable = parts[np.isfinite(variances).all(axis=(1, 2)), :, 0, 0]
        drawn = rng.integers(0, usable.shape[1], (_RESAMPLES, usable.shape[1]))
        means = usable[:, drawn].mean(axis=-1) / np.maximum(usable.mean(axis=1), 1e-12)[:, None]
        relative = float(np.sqrt(np.mean(means.var(axis=1, ddof=1)))) / 2.0
    return NoiseCurve(photograph.codes, np.sqrt(variances), relative)


def photon_transfer(means: Floats, variances: Floats, rng: np.random.Generator) -> PhotonTransfer:
    """Fit the photon transfer line to means `(n,)` and variances `(n,)` of a linear signal, n >= 3."""

    def line(number: NDArray[np.intp]) -> Floats:
        mean, variance = means[number], variances[number]
        weight = 1.0 / np.maximum(variance, 1e-12)
        for _ in range(3):
            # The standard error of a variance is proportional to it: that of the line, not the measured one.
            slope, dark = np.polyfit(mean, variance, 1, w=weight)
            weight = 1.0 / np.maximum(slope * mean + dark, 1e-3 * variance.max() + 1e-15)
        return np.array([slope, dark])

    count = len(means)
    slope, dark = line(np.arange(count))
    drawn = [rng.integers(0, count, count) for _ in range(_RESAMPLES)]
    slopes = [line(number)[0] for number in drawn if len(set(number.tolist())) > 2]
    return PhotonTransfer(float(slope), float(np.std(slopes, ddof=1)), float(dark))


def chart_transfer(
    photograph: ChartPhotograph, linear: tuple[Floats, ...], rng: np.random.Generator
) -> PhotonTransfer:
    """The photon transfer line of green, of linear values `(k, k, 3)` of the middles of all fields."""
    greens = [values[..., 1] for values in linear]
    usable = photograph.usable.all(axis=1)
    means = np.array([green.mean() for green in greens])[usable]
    variances = np.array([_without_trend(green[..., None]).var() for green in greens])[usable]
    return photon_transfer(means, variances, rng)


def _variances(values: Floats) -> Floats:
    """`(parts, 2, c)` variances in parts of a square `(k, k, c)`, of pixels and of means of 2 x 2 pixels."""
    flat = _without_trend(values)
    result = []
    for scale in SCALES:
        square = block_means(flat, scale) ** 2
        side = len(square)
        edges = np.linspace(0, side, _TILES + 1).astype(int)
        parts = [
            square[top:bottom, left:right].mean(axis=(0, 1))
            for top, bottom in pairwise(edges)
            for left, right in pairwise(edges)
        ]
        # Three numbers of a plane were fitted.
        result.append(np.stack(parts) * side**2 / max(side**2 - 3, 1))
    return np.stack(result, axis=1)


def _without_trend(values: Floats) -> Floats:
    """A square `(k, k, c)` without its best plane."""
    side = len(values)
    step = np.linspace(-1.0, 1.0, side)
    x, y = np.meshgrid(step, step)
    basis = np.stack([np.ones(side**2), x.ravel(), y.ravel()], axis=1)
    flat = values.reshape(side**2, -1)
    plane = basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
    return np.asarray((flat - plane).reshape(values.shape))

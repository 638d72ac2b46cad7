"""Image sizes that are no whole fraction of the photosites: areas of photosites are averaged to pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Floats = NDArray[np.float32]

_PART: Final = 1 << 21  # chosen: pixels that are spread at a time; each takes 0.1 KB meanwhile


@dataclass(frozen=True)
class AreaAverage:
    """Pixels of `factor` photosites each, not always a whole number, along one direction of the image.

    The pixels are in the middle of the photosites that are read out, an even number so that they form whole
    Bayer quads: those that pixels cover, and at most two more.

    Attributes:
        pixels: number of pixels.
        factor: photosites per pixel, at least 1.
    """

    pixels: int
    factor: Fraction

    @property
    def sites(self) -> int:
        """Number of photosites that are read out: even."""
        covered = self.pixels * self.factor
        return 2 * -(-covered.numerator // (2 * covered.denominator))

    @property
    def count(self) -> float:
        """Number of photosites of equal weight whose mean has the noise of a pixel, on average."""
        weights = _overlaps(self) / float(self.factor)
        return float(1 / np.mean(weights.power(2).sum(axis=1)))

    def spread(self, pixels: NDArray[np.floating], axis: int) -> Floats:
        """Mean light of each photosite, from that of the pixels along `axis`.

        Large images are computed in parts across the axis.

        Within a pixel the light is linear, so that a gradient of grey stays grey after demosaicing. The light
        of each pixel is kept, and no photosite gets more or less than the pixels around it (monotonised
        central slopes; B. van Leer, "Towards the ultimate conservative difference scheme III", J. Comput.
        Phys. 23 (1977) 263).
        """
        lines = np.moveaxis(pixels, axis, 0)
        parts = [self._spread(part) for part in np.array_split(lines, lines.size // _PART + 1, axis=1)]
        return np.moveaxis(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1), 0, axis)

    def _spread(self, pixels: NDArray[np.floating]) -> Floats:
        """`spread` along the first axis."""
        # A photosite's light: of each pixel its value times the overlap, and its slope times the overlap's
        # moment about the pixel's middle; over the whole pixel the latter is 0, which keeps its light.
        overlaps, moments = _overlaps(self).T.tocsr(), _moments(self).T.tocsr()
        covered = np.asarray(overlaps.sum(axis=1)).reshape(-1)
        # A photosite outside the image has no pixel, and takes that of its neighbour.
        inside = np.flatnonzero(covered > 0)
        nearest = inside[np.clip(np.searchsorted(inside, np.arange(self.sites)), 0, len(inside) - 1)]
        light = _product(overlaps, pixels) + _product(moments, _limited_slopes(pixels))
        means = (light.T / covered.clip(1e-12)).T
        return np.asarray(means[nearest], np.float32)

    def average(self, sites: NDArray[np.floating], axis: int, pixels: slice = slice(None)) -> Floats:
        """Mean over each pixel's area of the photosites along `axis`.

        Of some pixels, from the photosites of `sites_of` alone.
        """
        overlaps = _overlaps(self)[pixels, self.sites_of(pixels)]
        means = np.moveaxis(_product(overlaps, np.moveaxis(sites, axis, 0)), 0, axis)
        return np.asarray(means / float(self.factor), np.float32)

    def sites_of(self, pixels: slice) -> slice:
        """The photosites that some pixels overlap, an even number of them from an even one on."""
        first, end, _ = pixels.indices(self.pixels)
        margin = (self.sites - self.pixels * self.factor) / 2
        last = margin + end * self.factor
        stop = -(-last.numerator // last.denominator)
        return slice(2 * int((margin + first * self.factor) / 2), min(stop + stop % 2, self.sites))


@lru_cache(maxsize=8)
def _overlaps(area: AreaAverage) -> csr_array:
    """`(pixels, sites)` length of each photosite inside each pixel, in photosites."""
    return _matrix(area, lambda first, last, middle: last - first)


@lru_cache(maxsize=8)
def _moments(area: AreaAverage) -> csr_array:
    """`(pixels, sites)` overlaps times the distance of their middle from that of the pixel, in pixels."""

    def moment(first: Fraction, last: Fraction, middle: Fraction) -> Fraction:
        return (last - first) * ((first + last) / 2 - middle) / area.factor

    return _matrix(area, moment)


def _matrix(area: AreaAverage, value: Callable[[Fraction, Fraction, Fraction], Fraction]) -> csr_array:
    """`(pixels, sites)` values of the first and last end of each overlap and the middle of its pixel."""
    from scipy.sparse import csr_array

    margin = (area.sites - area.pixels * area.factor) / 2
    rows, columns, values = [], [], []
    for pixel in range(area.pixels):
        first, last = margin + pixel * area.factor, margin + (pixel + 1) * area.factor
        for site in range(int(first), -(-last.numerator // last.denominator)):
            rows.append(pixel)
            columns.append(site)
            ends = max(first, Fraction(site)), min(last, Fraction(site + 1))
            values.append(float(value(*ends, (first + last) / 2)))
    return csr_array((values, (rows, columns)), shape=(area.pixels, area.sites))


def _limited_slopes(pixels: NDArray[np.floating]) -> NDArray[np.floating]:
    """Slopes per pixel along the first axis that overshoot no neighbour: 0 at extrema and at the edges."""
    edge = np.zeros_like(pixels[:1])
    steps = np.concatenate([edge, np.diff(pixels, axis=0), edge])
    before, after = steps[:-1], steps[1:]
    size = np.minimum(np.abs(before + after) / 2, 2 * np.minimum(np.abs(before), np.abs(after)))
    return np.where(before * after > 0, np.sign(before) * size, 0.0)


def _product(matrix: csr_array, values: NDArray[np.floating]) -> NDArray[np.float64]:
    """The product of a matrix with `values` along their first axis."""
    return (matrix @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])

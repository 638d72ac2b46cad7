"""The indirect light of many bands from the denoised light of three broad ones.

The filter takes three channels. The light of a band is close to a sum of that of three means over
neighbouring bands, with factors that change little from place to place: surfaces nearby are of a few kinds,
and as all bands share their paths, they share most of their noise. So the means are filtered, and the factors
are found by least squares in the traced light: for each tile of the image, over it and its neighbours. They
are scaled so that the light of the neighbourhood is the traced one in each band, and interpolated between
tiles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Array = NDArray[np.float64]

_FILTERED: Final = 3  # channels of the filter
_MOST_FILTERED: Final = 12
"""Bands that are filtered themselves, three at a time. Chosen: four passes of a second each. The factors
below are those of all surfaces of a neighbourhood: what distinguishes a leaf from the next in two bands of
the same mean is lost, such as the photochemical index, of 531 and 570 nm."""
_TILE: Final = 32  # pixels; chosen: three are the neighbourhood whose mean is restored in other images
_RIDGE: Final = 0.02
"""Of the mean square of the broad channels. Chosen: where these are proportional, the factors of the whole
image decide between them."""
MIN_GAIN, MAX_GAIN = 0.5, 2.0
"""Chosen: a neighbourhood that differs more holds a single bright path, or nothing."""


def denoise_bands(
    traced: Image, denoise: Callable[[Image, int], Image], levels: Array | None = None
) -> Image:
    """`(h, w, c)` denoised light of c bands.

    Args:
        traced: `(h, w, c)` light about 1.
        denoise: filters one of the `broad_images`; the second argument is its number.
        levels: `(c,)` see `band_levels`; None for those of `traced`.
    """
    c = traced.shape[-1]
    images = broad_images(traced, band_levels(traced) if levels is None else levels)
    if c <= _MOST_FILTERED:
        return np.concatenate([denoise(part, number) for number, part in enumerate(images)], axis=-1)[..., :c]
    (broad,) = images
    filtered = denoise(broad, 0)
    factors = _factors(traced, broad, filtered)
    return _combine(filtered, factors.astype(np.float32))


def band_levels(traced: Image) -> Array:
    """`(c,)` mean light of each band."""
    return np.asarray(traced.mean(axis=(0, 1), dtype=np.float64))


def broad_images(traced: Image, levels: Array) -> Iterator[Image]:
    """Yield the images `(h, w, 3)` that are filtered: three bands each, or three means over all bands.

    Args:
        traced: `(h, w, c)` light about 1.
        levels: `(c,)` by which bands are divided in means.
    """
    c = traced.shape[-1]
    if c <= _MOST_FILTERED:
        # Padded with the first bands.
        bands = np.arange(-(-c // _FILTERED) * _FILTERED) % c
        for part in bands.reshape(-1, _FILTERED):
            yield np.ascontiguousarray(traced[..., part])
        return
    # Bands of the same weight, however many electrons they have.
    scale = np.divide(1.0, levels, out=np.zeros(c), where=levels > 0.0).astype(np.float32)
    groups = np.array_split(np.arange(c), _FILTERED)
    yield np.stack([np.einsum("hwb,b->hw", traced[..., g], scale[g] / len(g)) for g in groups], axis=-1)


def _factors(traced: Image, broad: Image, filtered: Image) -> Array:
    """`(rows, columns, 3, c)` factors of the broad channels in each band, by tiles."""
    normal = _neighbourhoods(_tile_products(broad, broad))
    mixed = _neighbourhoods(_tile_products(broad, traced))
    # Of the whole image, where a tile does not decide.
    eye = np.eye(_FILTERED)
    whole, whole_mixed = normal.sum(axis=(0, 1)), mixed.sum(axis=(0, 1))
    level = np.trace(whole) / _FILTERED
    prior = np.linalg.solve(whole + 1e-3 * level * eye, whole_mixed)
    ridge = _RIDGE * np.trace(normal, axis1=2, axis2=3)[..., None, None] / _FILTERED + 1e-9 * level
    factors = prior + np.linalg.solve(normal + ridge * eye, mixed - normal @ prior)
    # The traced light of the neighbourhood, in each band.
    ones = np.ones((*traced.shape[:2], 1), np.float32)
    light = _neighbourhoods(_tile_products(ones, traced))[:, :, 0]
    result = np.einsum("ijg,ijgc->ijc", _neighbourhoods(_tile_products(ones, filtered))[:, :, 0], factors)
    gain = np.divide(light, result, out=np.ones_like(light), where=result > 0.0)
    return factors * np.clip(gain, MIN_GAIN, MAX_GAIN)[:, :, None]


def _tile_products(first: Image, second: Image) -> Array:
    """`(rows, columns, a, b)` sums over tiles of products of channels of two images."""
    h, w, a = first.shape
    result = np.empty((-(-h // _TILE), -(-w // _TILE), a, second.shape[-1]))
    for row, column in np.ndindex(result.shape[:2]):
        part = slice(row * _TILE, (row + 1) * _TILE), slice(column * _TILE, (column + 1) * _TILE)
        one, other = (image[part].reshape(-1, image.shape[-1]) for image in (first, second))
        result[row, column] = np.einsum("pa,pb->ab", one, other)
    return result


def _neighbourhoods(tiles: Array) -> Array:
    """Sums over tiles and their neighbours."""
    padded = np.pad(tiles, ((1, 1), (1, 1), (0, 0), (0, 0)))
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])


def _combine(filtered: Image, factors: Image) -> Image:
    """Sums of broad channels times factors that are linear between the centres of tiles."""
    h, w, _ = filtered.shape
    result = np.empty((h, w, factors.shape[-1]), np.float32)
    rows, columns = (
        _between_tiles(size, count) for size, count in zip((h, w), factors.shape[:2], strict=True)
    )
    for first, top, bottom, down in rows:
        for second, left, right, along in columns:
            part = filtered[top:bottom, left:right]
            near = factors[first : first + 2, second : second + 2]
            weights = down[:, None, :, None] * along[None, :, None, :]
            weights = weights[..., None] * part[:, :, None, None, :]
            flat = weights.reshape(-1, near.shape[0] * near.shape[1] * _FILTERED)
            light = np.einsum("pk,kc->pc", flat, near.reshape(flat.shape[1], -1))
            result[top:bottom, left:right] = light.reshape(bottom - top, right - left, -1)
    return np.maximum(result, np.float32(0.0))


def _between_tiles(size: int, count: int) -> list[tuple[int, int, int, Image]]:
    """Stretches of pixels between the centres of tiles: first tile, begin, end, and `(pixels, 2)` weights."""
    if count == 1:
        return [(0, 0, size, np.ones((size, 1), np.float32))]
    position = np.clip((np.arange(size) + 0.5) / _TILE - 0.5, 0.0, count - 1.0)
    first = np.minimum(position.astype(int), count - 2)
    fraction = (position - first).astype(np.float32)
    weights = np.stack([1.0 - fraction, fraction], axis=-1)
    ends = [int(end) for end in np.searchsorted(first, np.arange(count))]
    return [(k, ends[k], ends[k + 1], weights[ends[k] : ends[k + 1]]) for k in range(count - 1)]

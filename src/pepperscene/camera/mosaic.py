"""The way between image pixels and the photosites of a sensor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor import Sensor

Floats = NDArray[np.float32]


def spread(pixels: NDArray[np.floating], sensor: Sensor) -> Floats:
    """`(site rows, site columns)`: each photosite takes its pixel's value `(h, w, c)` in its own colour."""
    sites = np.empty(sensor.site_shape, np.float32)
    if sensor.pattern == "mono":
        sites[:] = _repeated(pixels[..., 0], sensor.binning)
        return sites
    for row, column, channel in _quad(sensor):
        # A block of an even binning holds binning / 2 quads each way; a pixel of binning 1 lies in one.
        plane = pixels[..., channel]
        plane = plane[row::2, column::2] if sensor.binning == 1 else _repeated(plane, sensor.binning // 2)
        sites[row::2, column::2] = plane
    return sites


def gathered(sites: Floats, sensor: Sensor) -> Floats:
    """`(h, w, c)` means over each pixel's photosites of a colour, where no demosaicing is needed."""
    if sensor.pattern == "mono":
        return _block_means(sites, sensor.binning)[..., None]
    pixels = np.zeros((sensor.rows, sensor.columns, 3), np.float32)
    for row, column, channel in _quad(sensor):
        share = np.float32(0.5 if channel == 1 else 1.0)  # two of a quad's photosites are green
        pixels[..., channel] += share * _block_means(sites[row::2, column::2], sensor.binning // 2)
    return pixels


def _quad(sensor: Sensor) -> Iterator[tuple[int, int, int]]:
    """Row, column and channel of the four photosites of a quad."""
    for place, letter in enumerate(sensor.pattern):
        yield place // 2, place % 2, "rgb".index(letter)


def _repeated(plane: NDArray[np.floating], times: int) -> NDArray[np.floating]:
    return plane if times == 1 else plane.repeat(times, axis=0).repeat(times, axis=1)


def _block_means(plane: Floats, size: int) -> Floats:
    if size == 1:
        return plane
    rows, columns = plane.shape
    return plane.reshape(rows // size, size, columns // size, size).mean(axis=(1, 3))

"""Reading the sensor out, and its colours, in strips of rows, so that large images take little memory.

A strip draws its noise after the strip above it, from the same generator. Where pixels are whole blocks of
photosites, a strip is complete in itself. Where colours are interpolated, or areas averaged, the mosaic is
kept as a whole, and a strip sees the photosites around it: its colours are those of the whole image.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.readout import (
    DEMOSAIC_MARGIN,
    Demosaic,
    Developing,
    Floats,
    average_areas,
    bin_photosites,
    demosaic_image,
    read_out,
)
from pepperscene.camera.sensor.row_strips import row_strips
from pepperscene.camera.sensor.sensor import Sensor

Strips = Iterator[tuple[slice, Floats]]
"""Rows of the image, and values of theirs, from top to bottom."""


def mosaic_strips(
    electrons: NDArray[np.floating], sensor: Sensor, rng: np.random.Generator | None, developing: Developing
) -> Strips:
    """Read a sensor out: rows of photosites `(n, site columns)` and their digital numbers, see `read_out`.

    Args:
        electrons: `(h, w, c)` expected electrons of a photosite of each colour, finite; of a sensor with
            bands, those of one of them, `(h, w, 1)`.
        sensor: of that size.
        rng: draws the noise of one strip after the other; None leaves it out.
        developing: says what is left out.
    """
    strips = row_strips(sensor.columns, sensor.rows)
    if sensor.areas is not None:
        # The light of an area depends on its neighbours.
        strips = (slice(0, sensor.rows),)
    for rows in strips:
        expected = np.maximum(electrons[rows], 0.0)
        part = dataclasses.replace(sensor, rows=len(expected))
        first = rows.start * sensor.binning
        sites = read_out(expected, part, rng, developing)
        yield slice(first, first + len(sites)), sites


def colour_strips(
    electrons: NDArray[np.floating], sensor: Sensor, rng: np.random.Generator | None, developing: Developing
) -> Strips:
    """Linear device colour `(n, w, c)` of rows of pixels: black is 0, full scale is 1.

    Arguments are those of `mosaic_strips`.
    """
    mosaic = mosaic_strips(electrons, sensor, rng, developing)
    needs_demosaicing = sensor.pattern not in ("mono", "bands") and sensor.binning == 1
    if sensor.reduction is None and not needs_demosaicing:
        for rows, sites in mosaic:
            part = dataclasses.replace(sensor, rows=len(sites) // sensor.binning)
            colours = bin_photosites(_scaled(sites, sensor), part)
            yield slice(rows.start // sensor.binning, rows.stop // sensor.binning), colours
        return
    whole = _joined(mosaic, sensor)
    for rows in row_strips(sensor.columns, sensor.rows):
        needed = rows if sensor.areas is None else sensor.areas[0].sites_of(rows)
        if needs_demosaicing:
            colours = demosaic_rows(whole, sensor.pattern, developing.demosaic, needed)
        else:
            colours = whole[needed, :, None]
        yield rows, average_areas(colours, sensor, rows)


def demosaic_rows(sites: Floats, pattern: str, method: Demosaic, rows: slice) -> Floats:
    """Rows of the colours `(n, w, 3)` of a mosaic `(h, w)`, see `demosaic_image`."""
    top = max(rows.start - DEMOSAIC_MARGIN, 0) & ~1
    bottom = min(rows.stop + DEMOSAIC_MARGIN + 1 & ~1, len(sites))
    colours = demosaic_image(sites[top:bottom], pattern, method)
    return colours[rows.start - top : rows.stop - top]


def _joined(mosaic: Strips, sensor: Sensor) -> Floats:
    """The scaled numbers of all photosites."""
    whole: Floats | None = None
    for rows, sites in mosaic:
        if len(sites) == sensor.site_shape[0]:
            return _scaled(sites, sensor)
        whole = np.empty(sensor.site_shape, np.float32) if whole is None else whole
        whole[rows] = _scaled(sites, sensor)
    assert whole is not None
    return whole


def _scaled(sites: Floats, sensor: Sensor) -> Floats:
    """Digital numbers as fractions of full scale above black, in place."""
    sites -= np.float32(sensor.black_level_dn)
    sites /= np.float32(sensor.full_scale_dn - sensor.black_level_dn)
    return sites

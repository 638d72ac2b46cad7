"""Sensor read-out: from expected electrons to digital numbers, and to colours, in strips of rows.

A strip draws its noise after the strip above it, from the same generator. Where pixels are whole blocks of
photosites, a strip is complete in itself. Where colours are interpolated, or areas averaged, the mosaic is
kept as a whole, and a strip sees the photosites around it: its colours are those of the whole image.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.developing_steps import Demosaic, Developing
from pepperscene.camera.sensor.rows import row_strips
from pepperscene.camera.sensor.sensor import Sensor
from pepperscene.spectra import colour_science

Floats = NDArray[np.float32]
Real = TypeVar("Real", np.float32, np.float64)
_FEW_ELECTRONS: Final = 32.0  # chosen: below, single electrons and the lack of negative counts could show
_MAX_ELECTRONS: Final = 1e18  # chosen: beyond any light, and far from where single precision ends
_STRIP: Final = 1 << 18  # chosen: photosites processed at once, so that they stay in the cache
DEMOSAIC_MARGIN: Final = 8  # photosites; even, to keep the pattern, and beyond the reach of all filters
Strips = Iterator[tuple[slice, Floats]]
"""Rows of the image, and values of theirs, from top to bottom."""


def read_out(
    expected: NDArray[np.floating], sensor: Sensor, rng: np.random.Generator | None, developing: Developing
) -> Floats:
    """`(site rows, site columns)` digital numbers of the mosaic, black level included.

    `expected`, `(h, w, c)`, are the mean electrons of a photosite of each colour, at least 0; of a sensor
    with bands, those of one of them, `(h, w, 1)`. Without a generator there is no noise. The random numbers
    do not depend on saturation and quantisation.
    """
    sites = spread_to_photosites(np.minimum(expected, _MAX_ELECTRONS), sensor)
    height = max(_STRIP // sites.shape[1], 1)
    for top in range(0, len(sites), height):
        strip = sites[top : top + height]
        charge = strip
        if rng is not None and developing.shot_noise:
            charge = shot_noise(charge, rng)
        if developing.saturation:
            charge = np.minimum(charge, np.float32(sensor.full_well_e))
        if rng is not None and developing.read_noise:
            noise = rng.standard_normal(charge.shape, dtype=np.float32)
            charge = charge + np.float32(sensor.read_noise_e) * noise
        # Convert: gain, black level, rounding, and the converter's range.
        number = charge / np.float32(sensor.gain_e_per_dn) + np.float32(sensor.black_level_dn)
        number = np.rint(number) if developing.quantise else number
        largest = sensor.full_scale_dn if developing.saturation else np.inf
        strip[:] = np.clip(number, np.float32(0), np.float32(largest))
    return sites


def shot_noise(mean: Floats, rng: np.random.Generator) -> Floats:
    """Poisson counts with the given means, same shape.

    Means below 32 are drawn exactly. Above, a normal deviate z is transformed by the Cornish-Fisher expansion
    of the Poisson distribution to the order 1/mean, n = m + sqrt(m) z + (z^2 - 1)/6 + (z - z^3)/(72 sqrt(m)),
    which keeps its mean, variance and skewness (Johnson, Kemp and Kotz, "Univariate Discrete Distributions",
    2005, section 4.5 on approximations) and takes a third of the time. Its counts are not whole numbers,
    which is hidden by the read noise, or by converter steps of an electron and more.
    """
    z = rng.standard_normal(mean.shape, dtype=np.float32)
    root = np.sqrt(mean)
    square = z * z
    with np.errstate(divide="ignore", invalid="ignore"):  # means of 0 are drawn below
        counts = mean + z * (root + (1 - square) / (72 * root)) + (square - 1) / 6
    is_small = mean < _FEW_ELECTRONS
    counts[is_small] = rng.poisson(mean[is_small])
    return counts


def spread_to_photosites(pixels: NDArray[np.floating], sensor: Sensor) -> Floats:
    """`(site rows, site columns)` the value of each photosite's pixel `(h, w, c)` in its own colour."""
    sites = np.empty(sensor.site_shape, np.float32)
    if sensor.areas is not None:
        down, right = sensor.areas
        # First down the image, where the pixels of a photosite's row are few.
        for row, column, channel in _quad_sites(sensor):
            plane = down.spread(pixels[..., channel], 0)[row::2]
            sites[row::2, column::2] = right.spread(plane, 1)[:, column::2]
        return sites
    if sensor.pattern in ("mono", "bands"):
        sites[:] = _upscale(pixels[..., 0], sensor.binning)
        return sites
    for row, column, channel in _quad_sites(sensor):
        # A block with an even binning holds binning / 2 quads each way; a pixel of binning 1 is part of one.
        plane = pixels[..., channel]
        plane = plane[row::2, column::2] if sensor.binning == 1 else _upscale(plane, sensor.binning // 2)
        sites[row::2, column::2] = plane
    return sites


def average_areas(colours: Floats, sensor: Sensor, rows: slice = slice(None)) -> Floats:
    """`(h, w, c)` means of demosaiced photosites `(site rows, site columns, c)` over each pixel's area.

    With `rows` of the image, from the rows of photosites that `AreaAverage.sites_of` says.
    """
    if sensor.areas is None:
        return colours
    down, right = sensor.areas
    return right.average(down.average(colours, 0, rows), 1)


def bin_photosites(sites: Floats, sensor: Sensor) -> Floats:
    """`(h, w, c)` means over each pixel's photosites of a colour, for sensors that need no demosaicing."""
    if sensor.pattern in ("mono", "bands"):
        return block_means(sites, sensor.binning)[..., None]
    pixels = np.zeros((sensor.rows, sensor.columns, 3), np.float32)
    for row, column, channel in _quad_sites(sensor):
        weight = np.float32(0.5 if channel == 1 else 1.0)  # two of a quad's photosites are green
        pixels[..., channel] += weight * block_means(sites[row::2, column::2], sensor.binning // 2)
    return pixels


def _quad_sites(sensor: Sensor) -> Iterator[tuple[int, int, int]]:
    """Row, column and channel of the four photosites of a quad."""
    letters = "rrrr" if sensor.pattern in ("mono", "bands") else sensor.pattern
    for position, letter in enumerate(letters):
        yield position // 2, position % 2, "rgb".index(letter)


def _upscale(plane: NDArray[np.floating], times: int) -> NDArray[np.floating]:
    return plane if times == 1 else plane.repeat(times, axis=0).repeat(times, axis=1)


def block_means(image: NDArray[Real], size: int) -> NDArray[Real]:
    """`(h // size, w // size, ...)` means of blocks of pixels, without rows and columns that fill none."""
    if size == 1:
        return image
    rows, columns = image.shape[0] // size, image.shape[1] // size
    blocks = image[: rows * size, : columns * size].reshape(rows, size, columns, size, *image.shape[2:])
    return blocks.mean(axis=(1, 3))


def demosaic_image(sites: Floats, pattern: str, method: Demosaic) -> Floats:
    """`(h, w, 3)` colours of a mosaic `(h, w)` with even sides, by the library colour-demosaicing.

    Methods: "malvar", linear filters that follow the other colours' gradients (Malvar, He and Cutler 2004,
    ICASSP); "menon", directional filters with an a-posteriori decision (Menon, Andriani and Calvagno 2007,
    IEEE Trans. Image Process. 16:132); "bilinear", the mean of the nearest photosites of a colour.

    The mosaic is first mirrored about its outermost photosites, which keeps the pattern; two methods of the
    library mirror about the edge, which mixes colours there.
    """
    colour_science()  # imports the library's dependency without its warnings
    with warnings.catch_warnings():
        # The library imports SciPy's functions from where they are until SciPy 2.
        warnings.filterwarnings("ignore", "Please import `convolve", DeprecationWarning)
        import colour_demosaicing
    demosaic = {
        "malvar": colour_demosaicing.demosaicing_CFA_Bayer_Malvar2004,
        "menon": colour_demosaicing.demosaicing_CFA_Bayer_Menon2007,
        "bilinear": colour_demosaicing.demosaicing_CFA_Bayer_bilinear,
    }[method]
    margin = DEMOSAIC_MARGIN
    padded = np.pad(sites, margin, mode="reflect")

    def demosaic_part(top: int) -> Floats:
        rows = padded[top : top + part + 2 * margin]
        return demosaic(rows, pattern.upper())[margin:-margin, margin:-margin].astype(np.float32)

    # In two threads: the filters do not see beyond the margin.
    part = (len(sites) // 2 + 1) // 2 * 2
    with ThreadPoolExecutor(2) as pool:
        return np.concatenate(list(pool.map(demosaic_part, range(0, len(sites), part))))


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
    # Even, so that both ends are between whole quads.
    top = max(rows.start - rows.start % 2 - DEMOSAIC_MARGIN, 0)
    bottom = min(rows.stop + rows.stop % 2 + DEMOSAIC_MARGIN, len(sites))
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

"""Sensor read-out: from expected electrons to digital numbers by noise, full well, gain and converter."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.sensor import Sensor
from pepperscene.spectra import colour_science

Floats = NDArray[np.float32]
Demosaic = Literal["malvar", "menon", "bilinear"]
Light = Literal["flash", "daylight"]
Gains = tuple[float, float, float]
WhiteBalance = Light | Gains
Matrix = tuple[Gains, Gains, Gains]
Tone = Literal["srgb", "linear"]
Pedestal = float | Literal["auto"]

GAIN_RANGE: Final = (0.01, 100.0)
"""Allowed white balance gains. Chosen: cameras need 1 to 4, and single precision is exact enough here."""

LARGEST_MATRIX_ENTRY: Final = 100.0
"""Largest absolute entry of a given colour matrix. Chosen as `GAIN_RANGE`; fitted matrices stay below 20."""

LARGEST_PEDESTAL: Final = 0.25  # of full scale; chosen: black is then a bright grey, code 137

_FEW_ELECTRONS: Final = 32.0  # chosen: below, single electrons and the lack of negative counts could show
_MAX_ELECTRONS: Final = 1e18  # chosen: beyond any light, and far from where single precision ends
_STRIP: Final = 1 << 18  # chosen: photosites processed at once, so that they stay in the cache
DEMOSAIC_MARGIN: Final = (
    8  # photosites; even, to keep the pattern, and beyond the reach of the widest demosaic filter
)


@dataclass(frozen=True)
class Developing:
    """The steps from the light in front of the lens to the image; each can be left out.

    Attributes:
        falloff: the fall-off towards the image corners: cos^4 of the field angle and the lens' vignetting.
        shot_noise: photo-electrons arrive at random (needs a generator).
        read_noise: noise of the amplifier (needs a generator).
        saturation: the photosites' full well and the converter's upper end.
        quantise: rounding by the converter.
        demosaic: how colours are interpolated if every Bayer photosite is a pixel (binning 1).
        white_balance: the light under which a white diffuser is neutral, or the gains of red, green and blue,
            each within `GAIN_RANGE`; None keeps the device's colour cast.
        colour_matrix: from camera_rgb to linear sRGB. True fits it to the light of the white balance or, if
            that names none, to the flash or else daylight; False leaves it out; a `(3, 3)` matrix is applied
            to camera_rgb after the gains. Its rows need not sum to 1; entries are within +-100.
        tone: the sRGB curve, or codes proportional to light.
        white_balance_error: factors on the gains of red, green and blue, as of a camera that misjudges the
            light; the colour matrix is still that of the right gains.
        stray_light: diffraction, scatter, veiling glare and ghosts of the lens; see `StrayLight`.
        pedestal: added to linear sRGB before it is clipped at black, as a fraction of full scale, from 0 to
            0.25; white stays white. Without it, clipping the noise of black makes it brighter, and most where
            noise is strongest, in red and blue. "auto" is `AUTO_PEDESTAL` standard deviations of the noisiest
            colour of black, which makes it neutral; 0 on a monochrome sensor.

    Sequences and arrays of numbers become tuples of floats. White balance and colour matrix do not apply to
    monochrome sensors. With numbers for both, or without a matrix, no reference light is needed.

    Raises:
        ValueError: neither the name of a light nor numbers of that shape and range.
    """

    falloff: bool = True
    shot_noise: bool = True
    read_noise: bool = True
    saturation: bool = True
    quantise: bool = True
    demosaic: Demosaic = "malvar"
    white_balance: WhiteBalance | None = "flash"
    colour_matrix: bool | Matrix = True
    tone: Tone = "srgb"
    white_balance_error: tuple[float, float, float] = (1.0, 1.0, 1.0)
    stray_light: bool = False
    pedestal: Pedestal = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "white_balance_error", _gains(self.white_balance_error, "error"))
        if self.white_balance is not None:
            object.__setattr__(self, "white_balance", _white_balance(self.white_balance))
        object.__setattr__(self, "colour_matrix", _colour_matrix(self.colour_matrix))
        if self.pedestal != "auto" and not 0.0 <= float(self.pedestal) <= LARGEST_PEDESTAL:
            raise ValueError(f'a pedestal must be "auto", or 0 to {LARGEST_PEDESTAL:g}')

    def metadata(self) -> dict[str, Any]:
        """JSON-ready description; later steps only if they are used."""
        steps = dataclasses.asdict(self)
        unused = {"white_balance_error": (1.0, 1.0, 1.0), "stray_light": False, "pedestal": 0.0}
        return {name: value for name, value in steps.items() if name not in unused or value != unused[name]}


def _white_balance(value: object) -> WhiteBalance:
    """The name of a light unchanged, gains as a tuple."""
    if isinstance(value, str):
        for light in get_args(Light):
            if value == light:
                return light
        raise ValueError(f'white balance must be "flash", "daylight", gains or None, not {value!r}')
    return _gains(value, "gains")


def _gains(value: object, name: str) -> tuple[float, float, float]:
    """Three factors of red, green and blue as a tuple."""
    gains = np.asarray(value, dtype=float)
    # Written so that nan fails too.
    if gains.shape != (3,) or not ((gains >= GAIN_RANGE[0]) & (gains <= GAIN_RANGE[1])).all():
        raise ValueError("white balance {} must be three numbers of {:g} to {:g}".format(name, *GAIN_RANGE))
    red, green, blue = gains.tolist()
    return red, green, blue


def _colour_matrix(value: object) -> bool | Matrix:
    """A switch as a bool, a matrix as tuples."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    matrix = np.asarray(value, dtype=float)
    if matrix.shape != (3, 3) or not (np.abs(matrix) <= LARGEST_MATRIX_ENTRY).all():
        allowed = f"three rows of three numbers of {-LARGEST_MATRIX_ENTRY:g} to {LARGEST_MATRIX_ENTRY:g}"
        raise ValueError(f"a colour matrix must be {allowed}")
    red, green, blue = ((float(row[0]), float(row[1]), float(row[2])) for row in matrix)
    return red, green, blue


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
        return _block_means(sites, sensor.binning)[..., None]
    pixels = np.zeros((sensor.rows, sensor.columns, 3), np.float32)
    for row, column, channel in _quad_sites(sensor):
        weight = np.float32(0.5 if channel == 1 else 1.0)  # two of a quad's photosites are green
        pixels[..., channel] += weight * _block_means(sites[row::2, column::2], sensor.binning // 2)
    return pixels


def _quad_sites(sensor: Sensor) -> Iterator[tuple[int, int, int]]:
    """Row, column and channel of the four photosites of a quad."""
    letters = "rrrr" if sensor.pattern in ("mono", "bands") else sensor.pattern
    for position, letter in enumerate(letters):
        yield position // 2, position % 2, "rgb".index(letter)


def _upscale(plane: NDArray[np.floating], times: int) -> NDArray[np.floating]:
    return plane if times == 1 else plane.repeat(times, axis=0).repeat(times, axis=1)


def _block_means(plane: Floats, size: int) -> Floats:
    if size == 1:
        return plane
    rows, columns = plane.shape
    return plane.reshape(rows // size, size, columns // size, size).mean(axis=(1, 3))


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
    colours = demosaic(np.pad(sites, margin, mode="reflect"), pattern.upper())
    return colours[margin:-margin, margin:-margin].astype(np.float32)

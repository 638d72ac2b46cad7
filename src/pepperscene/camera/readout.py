"""From expected electrons to digital numbers: shot noise, full well, read noise, gain, converter."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor import Sensor
from pepperscene.spectra import colour_science

Demosaic = Literal["malvar", "menon", "bilinear"]
Floats = NDArray[np.float32]
_MARGIN = 8  # photosites; even, to keep the pattern, and beyond the reach of the widest of the three


def demosaic_image(sites: Floats, pattern: str, method: Demosaic) -> Floats:
    """`(h, w, 3)` colours of a mosaic `(h, w)` with even sides, by the library colour-demosaicing.

    Methods: "malvar", linear filters that follow the other colours' gradients (Malvar, He and Cutler 2004,
    ICASSP); "menon", directional filters with a choice afterwards (Menon, Andriani and Calvagno 2007, IEEE
    Trans. Image Process. 16:132); "bilinear", the mean of the nearest photosites of a colour.

    The mosaic is mirrored about its outermost photosites before, which keeps the pattern; two methods of the
    library mirror about the edge, which mixes colours there.
    """
    bayer = _library()
    method_of = {
        "malvar": bayer.demosaicing_CFA_Bayer_Malvar2004,
        "menon": bayer.demosaicing_CFA_Bayer_Menon2007,
        "bilinear": bayer.demosaicing_CFA_Bayer_bilinear,
    }
    framed = np.pad(sites, _MARGIN, mode="reflect")
    colours = method_of[method](framed, pattern.upper())
    return colours[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN].astype(np.float32)


def _library() -> Any:
    """colour-demosaicing, which takes scipy's functions from where they will be until SciPy 2."""
    colour_science()  # the quiet way to what it imports
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Please import `convolve", DeprecationWarning)
        import colour_demosaicing
    return colour_demosaicing


Light = Literal["flash", "daylight"]
Gains = tuple[float, float, float]
WhiteBalance = Light | Gains
Matrix = tuple[Gains, Gains, Gains]
Tone = Literal["srgb", "linear"]

GAIN_RANGE: Final = (0.01, 100.0)
"""Of explicit white balance gains. Chosen: cameras need 1 to 4, and single precision bears these anywhere."""

LARGEST_ENTRY: Final = 100.0
"""Of an explicit colour matrix, either sign. Chosen as `GAIN_RANGE`; fitted matrices stay below 20."""


@dataclass(frozen=True)
class Developing:
    """Which steps lead from the light before the lens to the picture; each can be left out.

    Attributes:
        falloff: the image's fall-off towards the corners: cos^4 of the field angle and the lens' vignetting.
        shot_noise: photo-electrons arrive at random (needs a generator).
        read_noise: the amplifier's noise (needs a generator).
        saturation: the photosites' full well and the converter's upper end.
        quantise: the converter's steps.
        demosaic: how colours are interpolated where every Bayer photosite is a pixel (binning 1).
        white_balance: the light under which a white diffuser is neutral, or the gains of red, green and blue,
            each within `GAIN_RANGE`; None leaves the device's cast.
        colour_matrix: from camera_rgb to linear sRGB: that of the light of the white balance, or where this
            names none, of the flash or else daylight; or an own `(3, 3)`, row by row, that is applied to
            camera_rgb behind the gains. Its rows need not sum to 1; entries are within +-`LARGEST_ENTRY`.
        tone: the sRGB curve, or codes proportional to light.

    Sequences and arrays of numbers become tuples of floats. White balance and colour matrix do not concern
    monochrome sensors. With gains of one's own, and an own matrix or none, no reference light is asked for.

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

    def __post_init__(self) -> None:
        if self.white_balance is not None:
            object.__setattr__(self, "white_balance", _white_balance(self.white_balance))
        object.__setattr__(self, "colour_matrix", _colour_matrix(self.colour_matrix))


def _white_balance(wanted: object) -> WhiteBalance:
    """A light's name as it is, numbers as a tuple."""
    if isinstance(wanted, str):
        for light in get_args(Light):
            if wanted == light:
                return light
        raise ValueError(f'a white balance is "flash", "daylight", gains or None, not {wanted!r}')
    gains = np.asarray(wanted, dtype=float)
    # Written so that nan fails too.
    if gains.shape != (3,) or not ((gains >= GAIN_RANGE[0]) & (gains <= GAIN_RANGE[1])).all():
        raise ValueError("white balance gains are three numbers of {:g} to {:g}".format(*GAIN_RANGE))
    red, green, blue = gains.tolist()
    return red, green, blue


def _colour_matrix(wanted: object) -> bool | Matrix:
    """A switch as it is, numbers as tuples."""
    if isinstance(wanted, bool | np.bool_):
        return bool(wanted)
    matrix = np.asarray(wanted, dtype=float)
    if matrix.shape != (3, 3) or not (np.abs(matrix) <= LARGEST_ENTRY).all():
        raise ValueError(
            f"a colour matrix is three rows of three numbers of {-LARGEST_ENTRY:g} to {LARGEST_ENTRY:g}"
        )
    red, green, blue = ((float(row[0]), float(row[1]), float(row[2])) for row in matrix)
    return red, green, blue


def spread_to_photosites(pixels: NDArray[np.floating], sensor: Sensor) -> Floats:
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


def bin_photosites(sites: Floats, sensor: Sensor) -> Floats:
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


_FEW_ELECTRONS = 32.0  # chosen: below, single electrons and the lack of negative counts could show
_MOST_ELECTRONS = 1e18  # chosen: beyond any light, and far from where single precision ends
_STRIP = 1 << 18  # chosen: photosites worked on at once, so that what lies between stays in the cache


def read_out(
    expected: NDArray[np.floating], sensor: Sensor, rng: np.random.Generator | None, choice: Developing
) -> Floats:
    """`(site rows, site columns)` digital numbers of the mosaic, black level included.

    Args:
        expected: `(h, w, c)` mean electrons of a photosite of each colour, at least 0.
        sensor: its mosaic, noise, well and converter.
        rng: draws the noise; None leaves it out.
        choice: which of shot noise, saturation, read noise and quantisation take place. The random numbers do
            not depend on saturation and quantisation.
    """
    sites = spread_to_photosites(np.minimum(expected, _MOST_ELECTRONS), sensor)
    height = max(_STRIP // sites.shape[1], 1)
    for top in range(0, len(sites), height):
        strip = sites[top : top + height]
        charge = strip
        if rng is not None and choice.shot_noise:
            charge = shot_noise(charge, rng)
        if choice.saturation:
            charge = np.minimum(charge, np.float32(sensor.full_well_e))
        if rng is not None and choice.read_noise:
            charge = read_noise(charge, sensor.read_noise_e, rng)
        strip[:] = convert(charge, sensor, choice.quantise, choice.saturation)
    return sites


def shot_noise(mean: Floats, rng: np.random.Generator) -> Floats:
    """Poisson counts of the given means, same shape.

    Means below 32 are drawn exactly. Above, a normal deviate z is bent by the Cornish-Fisher expansion of the
    Poisson law to the order 1/mean, n = m + sqrt(m) z + (z^2 - 1)/6 + (z - z^3)/(72 sqrt(m)), which keeps its
    mean, variance and skewness (Johnson, Kemp and Kotz, "Univariate Discrete Distributions", 2005, section
    4.5 on approximations) and costs a third; its counts are not whole, which does not show behind
    the read noise, or behind converter steps of an electron and more.
    """
    z = rng.standard_normal(mean.shape, dtype=np.float32)
    root = np.sqrt(mean)
    square = z * z
    with np.errstate(divide="ignore", invalid="ignore"):  # means of 0 are drawn below
        counts = mean + z * (root + (1 - square) / (72 * root)) + (square - 1) / 6
    few = mean < _FEW_ELECTRONS
    counts[few] = rng.poisson(mean[few])
    return counts


def read_noise(charge: Floats, deviation_e: float, rng: np.random.Generator) -> Floats:
    """The charge with Gaussian noise of the amplifier, electrons."""
    return charge + np.float32(deviation_e) * rng.standard_normal(charge.shape, dtype=np.float32)


def convert(charge: Floats, sensor: Sensor, quantise: bool = True, saturation: bool = True) -> Floats:
    """Digital numbers of charges: gain, black level, rounding and the converter's range.

    Without saturation the range has no upper end; below 0 there is nothing in either case.
    """
    number = charge / np.float32(sensor.gain_e_per_dn) + np.float32(sensor.black_level_dn)
    number = np.rint(number) if quantise else number
    return np.clip(number, np.float32(0), np.float32(sensor.full_scale_dn if saturation else np.inf))

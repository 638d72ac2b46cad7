"""What a fit compares: mean and spread of an organ's colour in CIELAB and in hue, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.colorimetry import D65_WHITE, SRGB_TO_XYZ, xyz_to_lab

if TYPE_CHECKING:
    from pepperscene.camera import Sensor


Array = NDArray[np.float64]

NUMBERS: Final = 8
"""Of each cell: L*, a*, b* of the mean colour, the sd of the pixels in each, and where their hues point to on
average: its direction is their mean, and its length tells how much they agree."""

_KNEE: Final = (6.0 / 29.0) ** 3
_TOE: Final = 1.0 / (3.0 * (6.0 / 29.0) ** 2)
_LEAST_SD: Final = 1e-6
_TOE_END: Final = 0.0031308  # of the sRGB curve, IEC 61966-2-1
_GREY: Final = 1.5 / 255.0  # chosen: distance from grey at which a hue counts .7
_PLANE: Final = np.array([[1.0, -0.5, -0.5], [0.0, np.sqrt(0.75), -np.sqrt(0.75)]])
"""Codes to the plane across the grey axis: red points along the first coordinate, as hue 0."""
_FROM_LAB: Final = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])


def lab_of(linear: Array) -> Array:
    """`(..., 3)` CIELAB (D65) of linear sRGB `(..., 3)`, white at 1."""
    return xyz_to_lab(linear @ SRGB_TO_XYZ.T)


def lab_slopes(linear: Array) -> Array:
    """`(..., 3, 3)` derivatives of `lab_of`: rows are L*, a*, b*, columns red, green, blue."""
    share = linear @ SRGB_TO_XYZ.T / D65_WHITE
    # Of the cube root, and of the line that takes its place in the dark.
    slope = np.where(share > _KNEE, np.cbrt(np.maximum(share, _KNEE)) ** -2 / 3.0, _TOE)
    return np.asarray(np.einsum("ij,...j,jk->...ik", _FROM_LAB, slope / D65_WHITE, SRGB_TO_XYZ))


def hues(linear: Array) -> tuple[Array, Array]:
    """Cosine and sine `(n, 2)` of the hue of pixels `(n, 3)` in encoded sRGB, and their slopes `(n, 2, 3)`.

    The hue is the angle in the plane across the grey axis, at most 1.2 degrees from that of HSV, which is not
    smooth. Colours within a code or two of grey have a hue by chance alone: they count the less.
    """
    value = np.clip(linear, 0.0, 1.0)
    toe = value <= _TOE_END
    base = np.maximum(value, _TOE_END)
    code = np.where(toe, 12.92 * value, 1.055 * base ** (1.0 / 2.4) - 0.055)
    slope = np.where(toe, 12.92, 1.055 / 2.4 * base ** (1.0 / 2.4 - 1.0))
    plane = code @ _PLANE.T
    square = (plane**2).sum(axis=1) + _GREY**2
    length = np.sqrt(square)
    # Of p / |p| by p, and of p by the light.
    turned = (np.eye(2) - plane[:, :, None] * plane[:, None, :] / square[:, None, None]) / length[
        :, None, None
    ]
    return plane / length[:, None], turned @ (_PLANE * slope[:, None, :])


def numbers(linear: Array) -> Array:
    """`(8,)` of pixels `(n, 3)`: CIELAB of the mean, sd of CIELAB, mean cosine and sine of the hue."""
    direction, _ = hues(linear)
    return np.concatenate([lab_of(linear.mean(axis=0)), lab_of(linear).std(axis=0), direction.mean(axis=0)])


def numbers_and_slopes(linear: Array, slopes: Array) -> tuple[Array, Array]:
    """`numbers` of pixels `(n, 3)`, and their derivatives `(8, p)` from the pixels' `(p, n, 3)`."""
    mean, pixels = linear.mean(axis=0), lab_of(linear)
    of_mean = lab_slopes(mean) @ slopes.mean(axis=1).T
    moved = np.einsum("nij,pnj->pni", lab_slopes(linear), slopes)
    away, sd = pixels - pixels.mean(axis=0), np.maximum(pixels.std(axis=0), _LEAST_SD)
    of_sd = np.einsum("ni,pni->ip", away, moved) / (len(linear) * sd[:, None])
    direction, turned = hues(linear)
    of_hue = np.einsum("nij,pnj->ip", turned, slopes) / len(linear)
    found = np.concatenate([lab_of(mean), pixels.std(axis=0), direction.mean(axis=0)])
    return found, np.concatenate([of_mean, of_sd, of_hue])


def pixel_noise(pixels: int, channels: int, rng: np.random.Generator) -> Array:
    """`(n, c)` normal deviates whose mean is 0 and whose sd is 1 over the pixels, channel by channel.

    So noise spreads a view's colours and leaves their mean alone: that of a model is known without it.
    """
    drawn = rng.standard_normal((pixels, channels))
    drawn -= drawn.mean(axis=0)
    return np.asarray(drawn / np.maximum(drawn.std(axis=0), 1e-9))


@dataclass(frozen=True, eq=False)
class PatchObservables:
    """From the electrons that pixels expect to their linear sRGB, with the sensor's noise and its limits.

    Noise is drawn once and for all, so that a picture stays a smooth function of its light (see
    `pixel_noise`); where there is none in the camera's `developing`, `noise` is None.

    Attributes:
        sensor: whose picture it is.
        saturation: whether light beyond full scale is cut.
        noise: `(n, c)` standard normal deviates of pixels, or None.
        shot, read: which kinds of noise there are.
        timed: whether exposure is one of time: electrons, and not what is made of them. The light of a flash
            is over before the time is.
    """

    sensor: Sensor
    saturation: bool
    noise: Array | None
    shot: bool = True
    read: bool = True
    timed: bool = False

    def linear(self, electrons: Array, exposure: float, gains: Array, matrix: Array) -> Array:
        """Pixels `(n, 3)` in linear sRGB, cut to [0, 1].

        Args:
            electrons: `(n, c)` that photosites expect.
            exposure: factor on the sensor's gain, or on the time.
            gains: `(3,)` white balance.
            matrix: `(3, 3)` colour matrix.
        """
        return self.linear_and_slope(electrons, exposure, gains, matrix)[0]

    def linear_and_slope(
        self, electrons: Array, exposure: float, gains: Array, matrix: Array
    ) -> tuple[Array, Array, Array]:
        """`linear`, the slope `(n, c)` of balanced colour by electrons, and `(n, 3)` 1 where nothing is cut.

        A change of electrons, times that slope, through the matrix, where nothing is cut, is that of pixels.
        """
        time, gain = (exposure, 1.0) if self.timed else (1.0, exposure)
        counted, slope = self._counted(time * electrons)
        full = self.sensor.gain_e_per_dn * (self.sensor.full_scale_dn - self.sensor.black_level_dn)
        raw, slope = gain * counted / full, slope * (time * gain / full) * gains
        balanced = raw * gains
        if self.saturation:
            # The well is full whatever the amplifier does; the converter ends at full scale.
            most = min(gain * self.sensor.full_well_e / full, 1.0)
            limit = np.minimum(most * gains, min(self.sensor.gain * gain, 1.0) * gains.min())
            slope = np.where(balanced < limit, slope, 0.0)
            balanced = np.minimum(balanced, limit)
        found = balanced @ matrix.T
        free = (found > 0.0) & (found < 1.0)
        return np.clip(found, 0.0, 1.0), slope, free.astype(float)

    def _counted(self, electrons: Array) -> tuple[Array, Array]:
        """Electrons with their noise, and their slope by those expected."""
        if self.noise is None:
            return electrons, np.ones_like(electrons)
        sites = np.array(self.sensor.photosites, float)
        variance = np.full_like(electrons, self.sensor.read_noise_e**2 if self.read else 0.0)
        if self.shot:
            variance += np.maximum(electrons, 0.0)
        sd = np.sqrt(variance / sites)
        slope = np.ones_like(electrons)
        if self.shot:
            slope += self.noise / (2.0 * np.maximum(sd * sites, 1e-9))
        return electrons + sd * self.noise, slope

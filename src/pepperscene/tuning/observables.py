"""Colour statistics that a fit compares, and the camera as smooth formulas, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Sensor
from pepperscene.camera.image.colorimetry import D65_WHITE, SRGB_TO_XYZ
from pepperscene.colour import linear_srgb_to_lab

Array = NDArray[np.float64]
OBSERVABLE_COUNT: Final = 8
"""L*, a*, b* of the mean colour; standard deviations of the pixels' L*, a*, b*; mean cosine and sine of the
pixels' hue, whose direction is the mean hue and whose length says how much the hues agree."""
_KNEE: Final = (6.0 / 29.0) ** 3
_TOE: Final = 1.0 / (3.0 * (6.0 / 29.0) ** 2)
_MIN_SD: Final = 1e-6
_TOE_END: Final = 0.0031308  # of the sRGB curve, IEC 61966-2-1
_GREY: Final = 1.5 / 255.0  # chosen: distance from grey at which a hue has a weight of 0.7
_PLANE: Final = np.array([[1.0, -0.5, -0.5], [0.0, np.sqrt(0.75), -np.sqrt(0.75)]])
"""Projects codes on the plane perpendicular to the grey axis; red has hue 0 (the first coordinate)."""
_FROM_LAB: Final = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])


def lab_derivatives(linear: Array) -> Array:
    """`(..., 3, 3)` derivatives of CIELAB (rows) with respect to linear sRGB (columns)."""
    ratio = linear @ SRGB_TO_XYZ.T / D65_WHITE
    # Of the cube root, and of the line that replaces it for dark colours.
    slope = np.where(ratio > _KNEE, np.cbrt(np.maximum(ratio, _KNEE)) ** -2 / 3.0, _TOE)
    return np.asarray(np.einsum("ij,...j,jk->...ik", _FROM_LAB, slope / D65_WHITE, SRGB_TO_XYZ))


def hue_vectors(linear: Array) -> tuple[Array, Array]:
    """Cosine and sine of the hue of pixels `(n, 3)` in encoded sRGB: `(n, 2)`, and derivatives `(n, 2, 3)`.

    The hue is the angle in the plane perpendicular to the grey axis. It differs by at most 1.2 degrees from
    the hue of HSV, which is not smooth. The hue of a colour within a code or two of grey is random; its
    vector is shorter than 1 and counts less.
    """
    value = np.clip(linear, 0.0, 1.0)
    toe = value <= _TOE_END
    base = np.maximum(value, _TOE_END)
    code = np.where(toe, 12.92 * value, 1.055 * base ** (1.0 / 2.4) - 0.055)
    slope = np.where(toe, 12.92, 1.055 / 2.4 * base ** (1.0 / 2.4 - 1.0))
    plane = code @ _PLANE.T
    square = (plane**2).sum(axis=1) + _GREY**2
    length = np.sqrt(square)
    # Of p / |p| with respect to p, and of p with respect to linear colour.
    outer = plane[:, :, None] * plane[:, None, :]
    by_plane = (np.eye(2) - outer / square[:, None, None]) / length[:, None, None]
    return plane / length[:, None], by_plane @ (_PLANE * slope[:, None, :])


def observables(linear: Array) -> Array:
    """`(8,)` observables of pixels `(n, 3)` in linear sRGB."""
    hue, _ = hue_vectors(linear)
    lab = linear_srgb_to_lab(linear)
    return np.concatenate([linear_srgb_to_lab(linear.mean(axis=0)), lab.std(axis=0), hue.mean(axis=0)])


def observables_and_derivatives(linear: Array, derivatives: Array) -> tuple[Array, Array]:
    """Observables of pixels `(n, 3)`, and their derivatives `(8, p)` from those of the pixels `(p, n, 3)`."""
    mean, pixels = linear.mean(axis=0), linear_srgb_to_lab(linear)
    # CIELAB of the mean colour, then spread (d sd = mean of deviation times its change, over sd), then hue.
    of_mean = lab_derivatives(mean) @ derivatives.mean(axis=1).T
    of_pixels = np.einsum("nij,pnj->pni", lab_derivatives(linear), derivatives)
    deviation, sd = pixels - pixels.mean(axis=0), np.maximum(pixels.std(axis=0), _MIN_SD)
    of_sd = np.einsum("ni,pni->ip", deviation, of_pixels) / (len(linear) * sd[:, None])
    hue, hue_derivatives = hue_vectors(linear)
    of_hue = np.einsum("nij,pnj->ip", hue_derivatives, derivatives) / len(linear)
    values = np.concatenate([linear_srgb_to_lab(mean), pixels.std(axis=0), hue.mean(axis=0)])
    return values, np.concatenate([of_mean, of_sd, of_hue])


def standardised_noise(pixels: int, channels: int, rng: np.random.Generator) -> Array:
    """`(n, c)` normal deviates with mean 0 and sd 1 over the pixels of each channel.

    Such noise spreads the colours of a view without changing their mean.
    """
    noise = rng.standard_normal((pixels, channels))
    noise -= noise.mean(axis=0)
    return np.asarray(noise / np.maximum(noise.std(axis=0), 1e-9))


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Expected electrons to linear sRGB, with the sensor's noise and limits, as differentiable formulas.

    The noise is fixed, so that an image is a smooth function of its light (see `standardised_noise`). With
    `scales_time`, exposure is a factor on the exposure time, and so on electrons, rather than on the gain;
    the light of a flash does not depend on the exposure time.
    """

    sensor: Sensor
    saturation: bool  # whether light beyond full scale is clipped
    noise: Array | None  # (n, c) standard normal deviates of the pixels, or None
    shot_noise: bool = True
    read_noise: bool = True
    scales_time: bool = False
    pedestal: float = 0.0  # lifts black; see `Developing`

    def linear(self, electrons: Array, exposure: float, gains: Array, matrix: Array) -> Array:
        """Pixels `(n, 3)` in linear sRGB, clipped to [0, 1]. Arguments as in `linear_and_slopes`."""
        return self.linear_and_slopes(electrons, exposure, gains, matrix)[0]

    def linear_and_slopes(
        self, electrons: Array, exposure: float, gains: Array, matrix: Array
    ) -> tuple[Array, Array, Array]:
        """Pixels in linear sRGB, and the factors of their derivatives.

        A change of the electrons `(n, c)` that photosites expect changes the pixels by
        `unclipped * ((slope * change) @ matrix.T)`. White balance gains are `(3,)`, the matrix is `(3, 3)`.

        Returns:
            Pixels `(n, 3)`; slope `(n, c)`; unclipped `(n, 3)`, 0 where the result is clipped, else 1, or
                less with a pedestal.
        """
        time, gain = (exposure, 1.0) if self.scales_time else (1.0, exposure)
        counted, slope = self._counted(time * electrons)
        full_scale_e = self.sensor.gain_e_per_dn * (self.sensor.full_scale_dn - self.sensor.black_level_dn)
        raw, slope = gain * counted / full_scale_e, slope * (time * gain / full_scale_e) * gains
        balanced = raw * gains
        if self.saturation:
            # The full well does not depend on the gain; the converter ends at full scale.
            maximum = min(gain * self.sensor.full_well_e / full_scale_e, 1.0)
            limit = np.minimum(maximum * gains, min(self.sensor.gain * gain, 1.0) * gains.min())
            slope = np.where(balanced < limit, slope, 0.0)
            balanced = np.minimum(balanced, limit)
        colour = (balanced @ matrix.T + self.pedestal) / (1.0 + self.pedestal)
        unclipped = (colour > 0.0) & (colour < 1.0)
        return np.clip(colour, 0.0, 1.0), slope, unclipped / (1.0 + self.pedestal)

    def _counted(self, electrons: Array) -> tuple[Array, Array]:
        """Electrons with noise, and their slope with respect to the expected ones."""
        if self.noise is None:
            return electrons, np.ones_like(electrons)
        sites = np.array(self.sensor.photosites, float)
        variance = np.full_like(electrons, self.sensor.read_noise_e**2 if self.read_noise else 0.0)
        if self.shot_noise:
            variance += np.maximum(electrons, 0.0)
        sd = np.sqrt(variance / sites)
        slope = np.ones_like(electrons)
        if self.shot_noise:
            slope += self.noise / (2.0 * np.maximum(sd * sites, 1e-9))
        return electrons + sd * self.noise, slope

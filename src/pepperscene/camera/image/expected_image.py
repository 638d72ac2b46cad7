"""The expected image: the mean of a developed image over the noise of its sensor.

Noise does not cancel in the mean of the codes: black is clipped, so that its noise makes it brighter, and the
tone curve is steepest there. So each pixel's value is taken as normally distributed, with the variance that
its photosites have, and the tone curve is averaged over it. Where the noise of single photosites is clipped,
with a black level of 0, the mean code of black comes out up to 4 codes too bright.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.image.colorimetry import srgb_encode
from pepperscene.camera.image.developing import colour_transform, correct_colours, pedestal
from pepperscene.camera.sensor.developing_steps import Demosaic, Developing
from pepperscene.camera.sensor.readout import Floats, average_areas, bin_photosites, demosaic_image
from pepperscene.camera.sensor.sensor import Pattern, Sensor
from pepperscene.spectra import Spectrum

_NODES: Final = np.linspace(-3.0, 3.0, 17, dtype=np.float32)
"""Of the average over a normal distribution, in standard deviations. Chosen: equal steps, as the tone curve
has a corner at black, where the quadrature by Gauss and Hermite with as many nodes is a code worse."""
_CODES: Final = 1 << 16  # entries of the tone table; chosen: next to black, they are 0.05 codes apart
_NOISE_SIDE: Final = 96  # pixels of an image of noise; chosen: its variance is then exact to 2 %


def expected_image(electrons: NDArray[np.floating], camera: Camera) -> Floats:
    """`(..., c)` expected values of the developed image's pixels, as fractions of the largest code.

    They are the means over noise, rounding included, of what `develop` makes of an image of any size, all of
    whose pixels have the camera's photosites. One channel for a monochrome sensor; of a sensor with bands,
    the mean signal as a fraction of full scale, without a tone curve.

    Args:
        electrons: `(..., c)` mean electrons of a photosite of each colour; values below 0 count as 0.
        camera: its sensor and developing; its exposure has no effect.

    Raises:
        ValueError: the white balance needs a flash that the camera does not have.
        InputError: the sensor cannot distinguish colours under the reference light.
    """
    sensor, developing = camera.sensor, camera.developing
    mean, variance = _photosites(np.asarray(electrons, np.float32), sensor, developing)
    if sensor.pattern == "bands":
        return np.clip(mean, 0, 1)
    linear, deviation = correct_colours(mean, camera), _deviation(mean, variance, camera)
    lift = np.float32(pedestal(camera))
    return _encoded((linear + lift) / (1 + lift), deviation / (1 + lift), developing.tone == "srgb")


def _photosites(electrons: Floats, sensor: Sensor, developing: Developing) -> tuple[Floats, Floats]:
    """Mean and variance of the numbers of single photosites, black at 0 and full scale at 1."""
    from scipy.special import ndtr

    # The converter's numbers before they are clipped; rounding adds the variance of a uniform distribution.
    per_dn = sensor.gain_e_per_dn
    electrons = np.maximum(electrons, 0)
    number = electrons / np.float32(per_dn) + np.float32(sensor.black_level_dn)
    variance = electrons / np.float32(per_dn**2) if developing.shot_noise else np.zeros_like(number)
    constant = (sensor.read_noise_e / per_dn) ** 2 if developing.read_noise else 0.0
    variance += np.float32(constant + (1 / 12 if developing.quantise else 0.0))

    # Mean and variance of a normal distribution whose ends are clipped.
    full_well_dn = sensor.full_well_e / per_dn + sensor.black_level_dn
    highest = np.float32(min(sensor.full_scale_dn, full_well_dn) if developing.saturation else np.inf)
    deviation = np.sqrt(np.maximum(variance, np.float32(1e-12)))
    below, above = -number / deviation, (highest - number) / deviation
    chance_below, chance_above = ndtr(below), ndtr(-above)
    inside = 1 - chance_below - chance_above
    density_below, density_above = _density(below), _density(above)
    above = np.minimum(above, np.float32(1e6))  # finite, so that products with a chance of 0 are 0
    # First and second moment of the clipped deviate: at its ends, and between them by parts.
    offset = below * chance_below + above * chance_above + density_below - density_above
    square = below**2 * chance_below + above**2 * chance_above + inside
    square += below * density_below - above * density_above
    mean = number + deviation * offset
    scale = np.float32(1 / (sensor.full_scale_dn - sensor.black_level_dn))
    clipped = np.maximum(square - offset**2, 0) * variance
    return (mean - np.float32(sensor.black_level_dn)) * scale, clipped * scale**2


def _density(z: Floats) -> Floats:
    return np.exp(-0.5 * np.square(z)) * np.float32(1 / np.sqrt(2 * np.pi))


def _deviation(mean: Floats, variance: Floats, camera: Camera) -> Floats:
    """`(..., c)` standard deviation of pixels in linear sRGB, from the variance of single photosites."""
    sensor, developing = camera.sensor, camera.developing
    shared = _noise_of_pixels(sensor.pattern, sensor.binning, sensor.reduction, developing.demosaic)
    if sensor.pattern == "mono":
        return np.sqrt(variance * shared[0, 0])
    gains, matrix = colour_transform(camera)
    if developing.saturation and developing.white_balance is not None:
        # Channels that `correct_colours` clips have no noise.
        variance = np.where(mean * gains < min(sensor.gain, 1.0) * gains.min(), variance, np.float32(0))
    colours = np.sqrt(variance)
    total = np.empty_like(variance)
    for channel, row in enumerate((matrix * gains).astype(np.float32)):
        total[..., channel] = ((colours @ (np.outer(row, row) * shared)) * colours).sum(axis=-1)
    return np.sqrt(np.maximum(total, 0))


@lru_cache(maxsize=16)
def _noise_of_pixels(
    pattern: Pattern, binning: int, reduction: Fraction | None, demosaic: Demosaic
) -> Floats:
    """`(c, c)` covariance of a pixel's colours where its photosites have noise of the variance 1.

    Measured in an image of noise, because demosaicing and averaging over areas share photosites.
    """
    channels = 1 if pattern == "mono" else 3
    efficiency = Spectrum(np.array([400.0, 700.0]), np.ones((channels, 2)))
    sensor = Sensor(
        "noise", *(_NOISE_SIDE,) * 2, 1e-6, efficiency, 1.0, 0.0, 8, 0.0, binning, pattern, 1.0, reduction
    )
    sites = np.random.default_rng(0).standard_normal(sensor.site_shape, dtype=np.float32)
    if pattern != "mono" and binning == 1:
        colours = average_areas(demosaic_image(sites, pattern, demosaic), sensor)
    elif reduction is not None:
        colours = average_areas(sites[..., None], sensor)
    else:
        colours = bin_photosites(sites, sensor)
    colours = colours.reshape(-1, channels)
    return np.asarray(colours.T @ colours / np.float32(len(colours)))


def _encoded(linear: Floats, deviation: Floats, is_curved: bool) -> Floats:
    """The mean of the tone curve over normally distributed linear values, clipped to [0, 1]."""
    nodes = _NODES if deviation.any() else np.zeros(1, np.float32)
    weights = _density(nodes) / _density(nodes).sum()
    table, last = _tone_table(is_curved), np.float32(_CODES - 1)
    total = np.zeros_like(linear)
    for node, weight in zip(nodes, weights, strict=True):
        place = np.clip((linear + node * deviation) * last + np.float32(0.5), 0, last)
        total += weight * table[place.astype(np.int32)]
    return total


@lru_cache(maxsize=2)
def _tone_table(is_curved: bool) -> Floats:
    """`(n,)` the tone curve at equal steps from 0 to 1: four times as fast as a power per pixel."""
    linear = np.linspace(0, 1, _CODES)
    return (srgb_encode(linear) if is_curved else linear).astype(np.float32)

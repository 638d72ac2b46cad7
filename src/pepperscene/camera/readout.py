"""From expected electrons to digital numbers: shot noise, read noise, full well, converter, binning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor import Sensor

Floats = NDArray[np.float32]
_FEW_ELECTRONS = 32.0  # chosen: below, single electrons and the lack of negative counts could show


def read_out(
    expected: NDArray[np.floating], sensor: Sensor, rng: np.random.Generator | None, quantise: bool
) -> Floats:
    """`(h, w, 3)` digital numbers of the pixels, black level included, means over the photosites of a colour.

    Args:
        expected: `(h, w, 3)` mean electrons of a photosite of each colour.
        sensor: its noise, well and converter.
        rng: draws the noise; None leaves it out.
        quantise: False leaves the converter's steps out (its range stays).
    """
    channels = []
    for channel, count in enumerate(sensor.photosites):
        mean = np.asarray(expected[..., channel], dtype=np.float32)
        # Without noise all photosites of a colour are equal, so one stands for all.
        sites = mean[None] if rng is None else np.broadcast_to(mean, (count, *mean.shape))
        charge = sites if rng is None else shot_noise(sites, rng)
        charge = np.minimum(charge, np.float32(sensor.full_well_e))
        charge = charge if rng is None else read_noise(charge, sensor.read_noise_e, rng)
        channels.append(convert(charge, sensor, quantise).mean(axis=0))
    return np.stack(channels, axis=-1)


def shot_noise(mean: Floats, rng: np.random.Generator) -> Floats:
    """Poisson counts of the given means, same shape.

    Means below 32 are drawn exactly. Above, a normal deviate z is bent by the Cornish-Fisher expansion of the
    Poisson law to the order 1/mean, n = m + sqrt(m) z + (z^2 - 1)/6 + (z - z^3)/(72 sqrt(m)), which keeps its
    mean, variance and skewness (Johnson, Kemp and Kotz, "Univariate Discrete Distributions", 2005, section
    4.5 on approximations) and costs a third; its counts are not whole, which no converter step shows.
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


def convert(charge: Floats, sensor: Sensor, quantise: bool = True) -> Floats:
    """Digital numbers of charges: gain, black level, rounding and the converter's range."""
    number = charge / np.float32(sensor.gain_e_per_dn) + np.float32(sensor.black_level_dn)
    number = np.rint(number) if quantise else number
    return np.clip(number, np.float32(0), np.float32(sensor.full_scale_dn))

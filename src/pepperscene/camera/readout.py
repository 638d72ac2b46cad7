"""From expected electrons to digital numbers: shot noise, full well, read noise, gain, converter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.mosaic import Floats, spread
from pepperscene.camera.sensor import Sensor
from pepperscene.camera.steps import Developing

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
    sites = spread(np.minimum(expected, _MOST_ELECTRONS), sensor)
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

"""Reading the measures of many organs of one kind into arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pepperscene.grammar.hashing import splitmix64
from pepperscene.grammar.plant import Organ


def organ_measure(organs: Sequence[Organ], name: str, default: float | None = None) -> NDArray[np.float64]:
    """`(n,)` one measure of each organ.

    Raises:
        ValueError: an organ lacks it and there is no default, or it is not a finite number.
    """
    # What is missing becomes a NaN.
    values = np.array([organ.measures.get(name, default) for organ in organs], dtype=np.float64)
    if not np.isfinite(values).all():
        organ = organs[int(np.argmin(np.isfinite(values)))]
        raise ValueError(
            f"{organ.kind} of phytomer {organ.phytomer} needs a finite measure {name}, "
            f"not {organ.measures.get(name, default)}"
        )
    return values


def size(organs: Sequence[Organ], name: str) -> NDArray[np.float64]:
    """`(n,)` one measure of each organ that must be above zero.

    Raises:
        ValueError: an organ lacks it or it is not above zero.
    """
    values = organ_measure(organs, name)
    if not np.all(values > 0.0):
        raise ValueError(f"{organs[0].kind}: {name} must be above zero, found {values.min()}")
    return values


_WAVES = 8  # chosen: enough plane waves that no single one shows as a stripe


def hashed(seed: NDArray[np.float64], salt: int, count: int) -> NDArray[np.float64]:
    """`(n, count)` numbers uniform in [0, 1), the same for the same seeds and salt on every machine.

    Args:
        seed: `(n,)` in [0, 1), one for each organ.
        salt: tells one use of a seed from another.
        count: how many numbers each organ needs.

    The mixer is SplitMix64 (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators").
    """
    start = np.ldexp(np.mod(seed, 1.0), 53).astype(np.uint64)[:, None]
    step = np.arange(1, count + 1, dtype=np.uint64) + np.uint64(salt) * np.uint64(1 << 20)
    bits = splitmix64(start + step * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(11)
    return np.ldexp(bits.astype(np.float64), -53)


def signed(seed: NDArray[np.float64], salt: int, count: int) -> NDArray[np.float64]:
    """`(n, count)` numbers uniform in [-1, 1), otherwise as `hashed`."""
    return 2.0 * hashed(seed, salt, count) - 1.0


def smooth_field(
    points: NDArray[np.float64], seed: NDArray[np.float64], salt: int, size: float
) -> NDArray[np.float64]:
    """`(n, m)` smooth noise of mean 0 and variance 1 at `(n, m, d)` points, d = 2 or 3.

    A sum of plane waves of random direction and phase, which tends to a Gaussian random field (the spectral
    method of Shinozuka & Deodatis 1991).

    Args:
        points: where it is wanted, in any unit; equal points get equal values, so seams do not show.
        seed: `(n,)` in [0, 1).
        salt: tells one field of an organ from another.
        size: mean wavelength, in the unit of the points.
    """
    dimensions = points.shape[-1]
    # Directions are uniform on the circle or the sphere; wavelengths vary by two fifths to either side.
    angle = 2.0 * np.pi * hashed(seed, salt, _WAVES)
    height = signed(seed, salt + 1, _WAVES) if dimensions == 3 else np.zeros_like(angle)
    radius = np.sqrt(1.0 - height**2)
    direction = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)[:, :dimensions]
    number = 2.0 * np.pi / size * (1.0 + 0.4 * signed(seed, salt + 2, _WAVES))
    phase = 2.0 * np.pi * hashed(seed, salt + 3, _WAVES)
    waves = np.cos(points @ (direction * number[:, None, :]) + phase[:, None, :])
    return waves.sum(axis=2) * np.sqrt(2.0 / _WAVES)

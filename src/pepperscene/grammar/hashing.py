"""Counter-based random numbers: each is computed from an address and a name, independent of all others.

Every organ has a 64-bit address, hashed from its parent's; every random number is hashed from an address and
the name of its purpose. So numbers of all organs of a kind can be computed at once, in any order, and a plant
at two dates is the same plant, grown. The method is that of counter-based generators (Salmon et al. 2011,
"Parallel random numbers: as easy as 1, 2, 3"), with SplitMix64 as the mixer (Steele, Lea & Flood 2014, "Fast
splittable pseudorandom number generators").
"""

from __future__ import annotations

from functools import cache
from typing import Final
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
Addresses = NDArray[np.uint64]

GOLDEN_GAMMA: Final = np.uint64(0x9E3779B97F4A7C15)
"""Increment of SplitMix64: 2^64 divided by the golden ratio, odd."""

# Chosen: another odd number without pattern (a multiplier of Steele & Vigna 2022, "Computationally easy,
# spectrally good multipliers"), so that no address equals one of its parent's random numbers.
_CHILD_GAMMA: Final = np.uint64(0xD1342543DE82EF95)


def splitmix64(values: ArrayLike) -> Addresses:
    """Finaliser of SplitMix64: every bit of each 64-bit number depends on all of its bits.

    Args:
        values: unsigned 64-bit integers of any shape; a scalar gives an array of one.
    """
    z = np.array(values, dtype=np.uint64, ndmin=1)
    z ^= z >> np.uint64(30)
    z *= np.uint64(0xBF58476D1CE4E5B9)
    z ^= z >> np.uint64(27)
    z *= np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return z


def draw_key(rng: np.random.Generator) -> Addresses:
    """Draw the address `(1,)` from which all others of a plant are hashed."""
    return rng.integers(0, 2**64, size=1, dtype=np.uint64)


def child_addresses(addresses: Addresses, index: ArrayLike) -> Addresses:
    """Addresses of the children of this index, which broadcasts against the addresses."""
    return splitmix64(addresses + _counter(index, _CHILD_GAMMA))


def uniforms(addresses: Addresses, names: str | tuple[str, ...]) -> FloatArray:
    """Random numbers in (0, 1), midpoints of 2^52 equal parts; neither 0 nor 1 occurs.

    Args:
        addresses: `(n,)`.
        names: one name gives `(n,)` numbers, several give `(names, n)`.
    """
    numbers = name_number(names) if isinstance(names, str) else [[name_number(name)] for name in names]
    bits = splitmix64(addresses + _counter(numbers, GOLDEN_GAMMA)) >> np.uint64(12)
    return np.ldexp(bits.astype(np.float64) + 0.5, -52)


def _counter(numbers: ArrayLike, gamma: np.uint64) -> Addresses:
    """Offset (number + 1) gamma modulo 2^64; always an array, since NumPy scalars warn on overflow."""
    return (np.array(numbers, dtype=np.uint64, ndmin=1) + np.uint64(1)) * gamma


@cache
def name_number(name: str) -> int:
    """Number of a name: a checksum, so that a new parameter does not change other draws."""
    return crc32(name.encode())

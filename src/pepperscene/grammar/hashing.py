"""Random numbers that are looked up, not drawn in turn: each belongs to an address and a name.

Every organ has a 64-bit address, hashed out of its parent's; every random number is hashed out of an address
and the name of what it is for. So numbers come for all organs of a kind at once, in any order, and a plant at
two dates is the same plant, grown. The method is that of counter-based generators (Salmon et al. 2011,
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

_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)  # SplitMix64's increment: 2^64 by the golden ratio, odd
# Chosen: another odd number without pattern (a multiplier of Steele & Vigna 2022, "Computationally easy,
# spectrally good multipliers"), so that no address is one of its parent's random numbers.
_DOWN: Final = np.uint64(0xD1342543DE82EF95)


def splitmix64(values: ArrayLike) -> Addresses:
    """The finaliser of SplitMix64: every bit of each 64-bit number depends on all of its bits.

    Args:
        values: unsigned 64-bit integers of any shape; one number gives an array of one.
    """
    z = np.array(values, dtype=np.uint64, ndmin=1)
    z ^= z >> np.uint64(30)
    z *= np.uint64(0xBF58476D1CE4E5B9)
    z ^= z >> np.uint64(27)
    z *= np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return z


def drawn_key(rng: np.random.Generator) -> Addresses:
    """`(1,)` the address that all others of a plant are hashed from."""
    return rng.integers(0, 2**64, size=1, dtype=np.uint64)


def descended(addresses: Addresses, steps: ArrayLike) -> Addresses:
    """Addresses of what stands below: of child number `steps`, which is broadcast against the addresses."""
    return splitmix64(addresses + _times(steps, _DOWN))


def shares(addresses: Addresses, name: str) -> FloatArray:
    """Numbers uniform in (0, 1), one of that name for each address; neither 0 nor 1 occurs."""
    return uniform(addresses, number(name))


def several_shares(addresses: Addresses, names: tuple[str, ...]) -> FloatArray:
    """`(names, n)` what `shares` gives for each of the names at `(n,)` addresses."""
    numbers = np.array([number(name) for name in names], dtype=np.uint64)
    return uniform(addresses, numbers[:, None])


def uniform(addresses: Addresses, numbers: ArrayLike) -> FloatArray:
    """Random number `numbers` of each address: the middles of 2^52 equal parts of (0, 1)."""
    bits = splitmix64(addresses + _times(numbers, _GOLDEN)) >> np.uint64(12)
    return np.ldexp(bits.astype(np.float64) + 0.5, -52)


def _times(numbers: ArrayLike, factor: np.uint64) -> Addresses:
    """One more than the numbers, times a factor, modulo 2^64; of a single number an array of one."""
    return (np.array(numbers, dtype=np.uint64, ndmin=1) + np.uint64(1)) * factor


@cache
def number(name: str) -> int:
    """The number of a name: a checksum, so that a new parameter leaves all other draws as they were."""
    return crc32(name.encode())

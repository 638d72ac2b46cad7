"""Well-spread numbers for the samples of every pixel: Sobol' points with Owen's scrambling, by hashing.

The first two dimensions of Sobol's sequence are a (0,2)-sequence: any block of 2^m points that starts at a
multiple of 2^m has one point in each of 2^m equal boxes of every shape. So samples added to those that are
there fill the gaps between them, and edges can go on where a first look ended. Each further pair of numbers
is the same sequence in another order and under other scrambling (padding), both by hashes of pixel, dimension
and seed (B. Burley, "Practical hash-based Owen scrambling", J. Comput. Graph. Tech. 9 (2020), no. 4). A
number is a function of those and of the sample's index alone, so no state is kept and passes may be cut as
one likes.
"""

from __future__ import annotations

from typing import Any, Final

from pepperscene.render.variant import mitsuba_modules

_TO_UNIT: Final = 2.0**-24  # of the upper 24 bits, which single precision holds exactly
_HALVES: Final = ((1, 0xAAAAAAAA), (2, 0xCCCCCCCC), (4, 0xF0F0F0F0), (8, 0xFF00FF00), (16, 0xFFFF0000))


class Sequence:
    """The numbers of a wavefront of samples, dimension by dimension.

    Args:
        pixel: `UInt32`, of each sample.
        index: `UInt32`, of the sample within its pixel.
        seed: `UInt32`, opaque.
    """

    def __init__(self, pixel: Any, index: Any, seed: Any) -> None:
        _, dr = mitsuba_modules()
        self._pixel, self._seed = pixel, seed
        self._reversed = dr.brev(index)
        self._dimension = 0

    def next_1d(self) -> Any:
        """A number in [0, 1) for each sample."""
        place, first, _ = self._next()
        return _unit(_scrambled(place, first))

    def next_2d(self) -> Any:
        """A point in the unit square for each sample."""
        mi, dr = mitsuba_modules()
        place, first, second = self._next()
        return mi.Point2f(
            _unit(_scrambled(place, first)), _unit(_scrambled(dr.brev(_second(dr.brev(place))), second))
        )

    def _next(self) -> tuple[Any, Any, Any]:
        """Bit-reversed places in the sequence, in this dimension's order, and two seeds for scrambling."""
        mi, _ = mitsuba_modules()
        order, first = mi.sample_tea_32(self._pixel, self._seed + self._dimension * 0x9E3779B9 % 2**32)
        self._dimension += 1
        # A shuffle of the indices by Owen's scrambling keeps every block of 2^m of them together.
        return _mixed(self._reversed, order), first, first * 0x85EBCA6B + 0x6C078965


def _second(index: Any) -> Any:
    """Bits of Sobol's second dimension, lowest first: Pascal's triangle modulo 2 times those of the index."""
    for shift, upper in _HALVES:
        index = index ^ ((index & upper) >> shift)
    return index


def _scrambled(reversed_bits: Any, seed: Any) -> Any:
    """Owen's scrambling of a number whose first binary place is its highest bit; given and returned so."""
    _, dr = mitsuba_modules()
    return dr.brev(_mixed(dr.brev(reversed_bits), seed))


def _mixed(bits: Any, seed: Any) -> Any:
    """A hash in which each bit depends on itself and on lower ones alone (Laine & Karras 2011).

    Constants by N. Vegdahl ("Building a better LK hash", 2021).
    """
    bits = bits ^ (bits * 0x3D20ADEA)
    bits = bits + seed
    bits = bits * ((seed >> 16) | 1)
    bits = bits ^ (bits * 0x05526C56)
    return bits ^ (bits * 0x53A22864)


def _unit(bits: Any) -> Any:
    mi, _ = mitsuba_modules()
    return mi.Float(bits >> 8) * _TO_UNIT

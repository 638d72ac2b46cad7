"""Random numbers of a wavefront of samples: hashed, Owen-scrambled Sobol' points.

The first two dimensions of the Sobol' sequence are a (0,2)-sequence: any block of 2^m points that starts at a
multiple of 2^m has one point in each of 2^m equal boxes of every shape. So additional samples fill the gaps
between earlier ones, and a pixel can be refined where its first samples ended. Each further pair of numbers is the same sequence in
another order and with another scrambling (padding), both by hashes of pixel, dimension and seed (B. Burley,
"Practical hash-based Owen scrambling", J. Comput. Graph. Tech. 9 (2020), no. 4). A number depends on these
and on the sample's index alone: samples can be split into passes freely.
"""

from __future__ import annotations

import copy
from typing import Any, Final

from pepperscene.render.variant import mitsuba_modules

_TO_UNIT: Final = 2.0**-24  # of the upper 24 bits, which single precision holds exactly
_HALVES: Final = ((1, 0xAAAAAAAA), (2, 0xCCCCCCCC), (4, 0xF0F0F0F0), (8, 0xFF00FF00), (16, 0xFFFF0000))


class OwenSobol:
    """The numbers of a wavefront of samples, dimension by dimension.

    `dimension` is that of the next number. Inside a loop of the kernel it is a `UInt32` of the loop's state.

    Args:
        pixel: `UInt32`, of each sample.
        index: `UInt32`, of the sample within its pixel.
        seed: `UInt32`, opaque.
    """

    def __init__(self, pixel: Any, index: Any, seed: Any) -> None:
        _, dr = mitsuba_modules()
        self._pixel, self._seed = pixel, seed
        self._reversed_index = dr.brev(index)
        self.dimension: Any = 0

    def subset(self, lanes: Any) -> OwenSobol:
        """The next numbers of some lanes of the wavefront."""
        mi, dr = mitsuba_modules()
        part = copy.copy(self)
        part._pixel, part._reversed_index = (
            dr.gather(mi.UInt32, values, lanes) for values in (self._pixel, self._reversed_index)
        )
        dr.eval(part._pixel, part._reversed_index)
        return part

    def next_1d(self) -> Any:
        """A number in [0, 1) for each sample."""
        index, first_seed, _ = self._next_dimension()
        return _to_unit_interval(_owen_scramble(index, first_seed))

    def next_2d(self) -> Any:
        """A point in the unit square for each sample."""
        mi, dr = mitsuba_modules()
        index, first_seed, second_seed = self._next_dimension()
        second = dr.brev(_second_sobol_dimension(dr.brev(index)))
        return mi.Point2f(
            _to_unit_interval(_owen_scramble(index, first_seed)),
            _to_unit_interval(_owen_scramble(second, second_seed)),
        )

    def _next_dimension(self) -> tuple[Any, Any, Any]:
        """Bit-reversed, shuffled indices of the samples in the sequence, and two seeds for scrambling."""
        mi, _ = mitsuba_modules()
        offset = self.dimension * 0x9E3779B9
        if isinstance(offset, int):
            offset %= 2**32  # as the device's integers do by themselves
        order, seed = mi.sample_tea_32(self._pixel, self._seed + offset)
        self.dimension = self.dimension + 1
        # Owen scrambling of the indices shuffles them and keeps every block of 2^m of them together.
        return _hash_bits(self._reversed_index, order), seed, seed * 0x85EBCA6B + 0x6C078965


def _second_sobol_dimension(index: Any) -> Any:
    """Bits of the second Sobol' dimension, lowest first: Pascal's triangle modulo 2 times the index bits."""
    for shift, upper in _HALVES:
        index = index ^ ((index & upper) >> shift)
    return index


def _owen_scramble(reversed_bits: Any, seed: Any) -> Any:
    """Owen scrambling of binary fractions, given and returned with the first binary digit as highest bit."""
    _, dr = mitsuba_modules()
    return dr.brev(_hash_bits(dr.brev(reversed_bits), seed))


def _hash_bits(bits: Any, seed: Any) -> Any:
    """A hash in which each bit depends only on itself and lower bits (Laine & Karras 2011).

    Constants by N. Vegdahl ("Building a better LK hash", 2021).
    """
    bits = bits ^ (bits * 0x3D20ADEA)
    bits = bits + seed
    bits = bits * ((seed >> 16) | 1)
    bits = bits ^ (bits * 0x05526C56)
    return bits ^ (bits * 0x53A22864)


def _to_unit_interval(bits: Any) -> Any:
    mi, _ = mitsuba_modules()
    return mi.Float(bits >> 8) * _TO_UNIT

"""The beam of a lamp: intensity by direction, in the planes and angles of photometric files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_PLANE_STEPS: Final = 144
"""Of the beam of a diffuse tube. Chosen: between planes 2.5 degrees apart, a linear function is 2e-4 off."""
_ANGLE_STEPS: Final = 360  # chosen: of half a degree; between them, a linear function is 1e-5 off a cosine


@dataclass(frozen=True, eq=False)
class Beam:
    """Relative intensity by direction, linear between the directions of its table.

    Directions have the angle gamma to the lamp's axis, and are in the plane C about it: 0 towards the lamp's
    x axis, a right angle towards its y axis (CIE 121:1996).

    Attributes:
        plane_rad: `(m,)` planes C, increasing from 0 to a full turn; one plane, 0, for all.
        angle_rad: `(n,)` angles gamma, increasing from 0, at most pi; no light beyond the last.
        intensity: `(m, n)` at least 0; read-only.

    Raises:
        ValueError: a table is not as described, or dark.
    """

    plane_rad: Array
    angle_rad: Array
    intensity: Array

    def __post_init__(self) -> None:
        planes, angles, values = (
            np.array(table, float) for table in (self.plane_rad, self.angle_rad, self.intensity)
        )
        is_round = planes.size == 1
        if values.shape != (planes.size, angles.size) or angles.size < 2:
            raise ValueError("a beam needs an intensity for each plane and each of at least two angles")
        if planes[0] != 0 or not (is_round or abs(planes[-1] - 2 * math.pi) < 1e-9):
            raise ValueError("the planes of a beam must go from 0 to a full turn")
        if angles[0] != 0 or not angles[-1] <= math.pi + 1e-9:
            raise ValueError("the angles of a beam must go from 0 to at most 180 degrees")
        if not (np.all(np.diff(planes) > 0) and np.all(np.diff(angles) > 0)):
            raise ValueError("the planes and the angles of a beam must increase")
        if not (np.isfinite(values).all() and values.min() >= 0):
            raise ValueError("the intensities of a beam must be finite and at least 0")
        for name, table in (("plane_rad", planes), ("angle_rad", angles), ("intensity", values)):
            table.setflags(write=False)
            object.__setattr__(self, name, table)
        if not self.flux > 0:
            raise ValueError("a beam must contain some light")

    @cached_property
    def flux(self) -> float:
        """Integral of the intensity over all directions: lumens, if the intensity is in candela."""
        low, high = self.angle_rad[:-1], self.angle_rad[1:]
        # Of a linear function times the sine, exact on each piece.
        slope = np.diff(self.intensity, axis=1) / np.diff(self.angle_rad)
        ends = self.intensity[:, :-1] * np.cos(low) - self.intensity[:, 1:] * np.cos(high)
        by_plane = (ends + slope * (np.sin(high) - np.sin(low))).sum(axis=1)
        if by_plane.size == 1:
            return float(2 * math.pi * by_plane[0])
        return float(np.trapezoid(by_plane, self.plane_rad))

    def at(self, directions: ArrayLike) -> Array:
        """`(...)` intensity over the flux, sr-1, in unit directions `(..., 3)` of the lamp's axes."""
        x, y, z = np.moveaxis(np.asarray(directions, float), -1, 0)
        angle = np.arccos(np.clip(z, -1.0, 1.0))
        column = np.clip(np.searchsorted(self.angle_rad, angle, "right") - 1, 0, self.angle_rad.size - 2)
        span = np.diff(self.angle_rad)[column]
        along = np.clip((angle - self.angle_rad[column]) / span, 0.0, 1.0)
        row, across = np.zeros(angle.shape, int), np.zeros(angle.shape)
        if self.plane_rad.size > 1:
            plane = np.arctan2(y, x) % (2 * math.pi)
            row = np.clip(np.searchsorted(self.plane_rad, plane, "right") - 1, 0, self.plane_rad.size - 2)
            across = np.clip((plane - self.plane_rad[row]) / np.diff(self.plane_rad)[row], 0.0, 1.0)
        next_row = np.minimum(row + 1, self.plane_rad.size - 1)
        low, high = (
            self.intensity[each, column] * (1.0 - along) + self.intensity[each, column + 1] * along
            for each in (row, next_row)
        )
        value = low * (1.0 - across) + high * across
        # Rounding may bring a direction a little beyond a beam of 180 degrees.
        return np.asarray(np.where(angle <= self.angle_rad[-1] + 1e-9, value, 0.0) / self.flux)


def profile_beam(angle_rad: ArrayLike, intensity: ArrayLike) -> Beam:
    """A beam that is the same in all planes: intensities `(n,)` at angles `(n,)`."""
    return Beam(np.zeros(1), np.asarray(angle_rad, float), np.asarray(intensity, float)[None])


def even_beam() -> Beam:
    """The same intensity in all directions, as of a bare point."""
    return profile_beam([0.0, math.pi], [1.0, 1.0])


def lambertian_beam() -> Beam:
    """A surface across the axis with the same radiance in all directions: the cosine of the angle."""
    angle = np.linspace(0.0, 0.5 * math.pi, _ANGLE_STEPS // 2 + 1)
    return profile_beam(angle, np.append(np.cos(angle[:-1]), 0.0))


def diffuse_tube_beam() -> Beam:
    """A diffuse cylinder along the x axis: the sine of the angle to it."""
    plane = np.linspace(0.0, 2 * math.pi, _PLANE_STEPS + 1)
    angle = np.linspace(0.0, math.pi, _ANGLE_STEPS + 1)
    along = np.outer(np.cos(plane), np.sin(angle))
    return Beam(plane, angle, np.sqrt(np.maximum(1.0 - along**2, 0.0)))

"""Palmate blades, as of cucumber: the lowest veins radiate from the base, to a margin with lobes and teeth.

A palmate blade has the rows, columns and texture coordinates of any other, so that it shows the veins of the
material; only the places of its vertices differ. Its margin is given in polar coordinates about the base, as
if the blade were as wide as long; then both extents are scaled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pepperscene.geometry.batch import hash_uniform, read_measure, read_positive
from pepperscene.geometry.blade.grid import TIP_NUMBER
from pepperscene.geometry.blade.outline import FlatBlades
from pepperscene.geometry.mesh import FloatArray
from pepperscene.grammar.plant import Organ

# All chosen, as cucumber leaves look. Directions are radians from the tip, seen from the base.
_LAST_LOBE: Final = 2.06  # direction of the lowest pair of lobes
_REAR: Final = 3.0  # direction of the sides of the sinus where they reach the base
_REAR_POWER: Final = 4.0  # of the decrease of the radius towards them: the lower lobes are rounder
_POINTED: Final = 1.2  # power of a sine from lobe to lobe; lobes are corners, notches round
_VEIN_NUMBERS: Final = (-1.0, 0.0, 1.0, 2.0, TIP_NUMBER)
_VEIN_DIRECTIONS: Final = (_REAR, _LAST_LOBE, 1.5, 1.03, 0.0)  # in which these veins meet the margin
_COT: Final = 0.8  # of the angle at which the upper veins leave the midrib
_FOOT: Final = 0.03  # fraction of the midrib over which the lowest veins leave it, instead of at one point
_TOOTH_FRONT: Final = 0.3  # fraction of a tooth's length that its side towards the tip takes
_TOOTHLESS: Final = 0.2  # of the half-width: teeth nearer to the midrib are smaller
_DEEPEST_TOOTH: Final = 0.35, 0.06  # of the distance between teeth, and of the length of a row
_DEEPEST_LOBE: Final = 0.3, 0.5  # of one lobe, and of several over their number; veins must stay inside
_MAX_LOBES: Final = 6
_MAX_TEETH: Final = 60
_ANGLES: Final = np.linspace(0.0, _REAR, 241)


def spread_rows(organs: Sequence[Organ], flat: FlatBlades) -> FlatBlades:
    """Move the rows of palmate blades to their places; other blades are left as they are.

    Measures, all optional but the length: length_m, palmate (1 for a palmate blade), lobes (on each side of
    the tip), lobe_depth (fraction of the distance from the base), sinus (how far the lower lobes extend
    behind the base, over the length), teeth (along each margin), tooth_depth_m, seed. Depths are limited so
    that rows stay inside the margin: lobes to 0.3, several to 0.5 over their number, teeth to a third of the
    distance between two.

    Args:
        organs: n blades.
        flat: their rows as on a blade with pinnate veins.
    """
    palmate = read_measure(organs, "palmate", 0.0) > 0.0
    if not palmate.any():
        return flat
    margin = _PolarMargins.build(organs, flat)
    grid = flat.grid
    direction = np.interp(grid.margin, _VEIN_NUMBERS, _VEIN_DIRECTIONS)

    # Veins leave the midrib at about the same angle, and those that would do so below the base leave there.
    entire = margin.place(direction, entire=True).mean(axis=1)
    start = (1.0 - margin.depth[:, 0]) * (entire[..., 1] - _COT * entire[..., 0] / margin.length)
    rank = (grid.margin + 1.0) / (TIP_NUMBER + 1.0)
    start = (1.0 - _FOOT) * np.maximum.accumulate(np.maximum(start, 0.0), axis=1) + _FOOT * rank

    # Rows are straight; teeth are cut into the margin only, along the rows.
    foot = np.stack([np.zeros_like(start), start], axis=-1)[:, None]
    end = margin.place(direction)
    toothed = end - margin.tooth_fraction(direction, end, foot)[..., None] * (end - foot)
    rows, extra = grid.row_in_margin, grid.extra_in_margin
    steps = (end - foot)[:, :, rows, None] * flat.column[:, None]
    steps[..., -1, :] = (toothed - foot)[:, :, rows]
    out, along = np.moveaxis(steps, -1, 0)
    along = along + start[:, None, rows, None]

    def choose(moved: FloatArray, unmoved: FloatArray) -> FloatArray:
        return np.where(palmate.reshape(-1, *[1] * (moved.ndim - 1)), moved, unmoved)

    return replace(
        flat,
        reach=choose(toothed[..., 0], flat.reach),
        edge=choose(out[..., -1], flat.edge),
        midrib=choose(start[:, rows], flat.midrib),
        out=choose(out, flat.out),
        along=choose(along, flat.along),
        extra_edge=choose(toothed[:, :, extra, 0], flat.extra_edge),
        extra_along=choose(toothed[:, :, extra, 1], flat.extra_along),
    )


@dataclass(frozen=True, eq=False)
class _PolarMargins:
    """The left and right margins of n blades, as functions of the direction from the base."""

    length: FloatArray  # `(n, 1)` metres
    half_width: FloatArray  # `(n, 2)` metres
    lobes: FloatArray  # `(n, 1, 1)` on each side of the tip
    depth: FloatArray  # `(n, 1, 1)` of the notches between them
    teeth: FloatArray  # `(n, 1, 1)` along each margin
    tooth_depth: FloatArray  # `(n, 1, 1)` metres
    numbers: FloatArray  # `(n, 2, k)` hashed numbers for the place and depth of lobes and teeth
    extent: FloatArray  # `(n, 2, 3)` by which places are scaled: sideways in metres, forwards, backwards

    @classmethod
    def build(cls, organs: Sequence[Organ], flat: FlatBlades) -> _PolarMargins:
        """Read the measures of blades, and scale their margins to the stated sizes."""
        n = len(organs)

        def read(name: str, limit: float) -> FloatArray:
            return np.clip(read_measure(organs, name, 0.0), 0.0, limit)[:, None, None]

        count = 2 + _MAX_LOBES + _MAX_TEETH
        lobes = np.round(read("lobes", _MAX_LOBES))
        deepest = np.minimum(_DEEPEST_LOBE[0], _DEEPEST_LOBE[1] / np.maximum(lobes, 1.0))
        margins = cls(
            length=read_positive(organs, "length_m")[:, None],
            half_width=flat.half_width,
            lobes=lobes,
            depth=np.minimum(read("lobe_depth", 1.0), deepest),
            teeth=np.round(read("teeth", _MAX_TEETH)),
            tooth_depth=read("tooth_depth_m", np.inf),
            numbers=hash_uniform(flat.seed, 281, 2 * count).reshape(n, 2, count),
            extent=np.ones((n, 2, 3)),
        )
        points = margins.place(_ANGLES)
        widest, rear = points[..., 0].max(axis=2), -points[..., 1].min(axis=2)
        sinus = np.broadcast_to(read("sinus", 0.5)[..., 0], widest.shape)
        extent = np.stack([flat.half_width / widest, np.ones_like(widest), sinus / rear], axis=-1)
        return replace(margins, extent=extent)

    def place(self, direction: FloatArray, *, entire: bool = False) -> FloatArray:
        """`(n, 2, m, 2)` points of the margins in directions `(m,)`: metres aside, and along in lengths.

        `entire` leaves out the notches between lobes.
        """
        # Lobes are unevenly spaced; the first is the tip, at 0.
        phase = 2.0 * np.pi * self.numbers[..., :1]
        even = direction / _LAST_LOBE * self.lobes
        position = even + 0.05 * (np.sin(2.0 * np.pi * 0.7 * even + phase) - np.sin(phase))
        index = np.minimum(position.astype(np.intp), _MAX_LOBES - 1)
        uneven = 0.75 + 0.5 * np.take_along_axis(self.numbers[..., 2 : 2 + _MAX_LOBES], index, axis=2)
        notch = np.abs(np.sin(np.pi * position)) ** _POINTED * (position < self.lobes)
        closing = np.sqrt(np.clip(1.0 - (direction / _REAR) ** _REAR_POWER, 0.0, 1.0))
        depth = np.zeros_like(self.depth) if entire else self.depth
        radius = (1.0 - depth * uneven * notch) * closing
        sideways, forwards, backwards = (self.extent[..., k, None] for k in range(3))
        along = radius * np.cos(direction)
        return np.stack(
            [sideways * radius * np.sin(direction), along * np.where(along > 0.0, forwards, backwards)],
            axis=-1,
        )

    def tooth_fraction(self, direction: FloatArray, points: FloatArray, feet: FloatArray) -> FloatArray:
        """`(n, 2, m)` fraction that teeth cut off the way from points of the margins to the feet of rows."""
        metres = np.stack([np.ones_like(self.length), self.length], axis=-1)[:, None]
        # Teeth are evenly spaced along the margin.
        line = self.place(_ANGLES) * metres
        steps = np.linalg.norm(np.diff(line, axis=2), axis=-1)
        distance = np.concatenate([np.zeros((*steps.shape[:2], 1)), np.cumsum(steps, axis=2)], axis=2)
        rows = (distance / distance[..., -1:]).reshape(-1, distance.shape[2])
        fraction = np.array([np.interp(direction, _ANGLES, row) for row in rows]).reshape(points.shape[:3])
        position = self.teeth * fraction + self.numbers[..., 1:2] * (self.teeth > 0.0)
        part, index = np.modf(position)
        back = 1.0 - _TOOTH_FRONT
        cut = np.where(part < back, part / back, (1.0 - part) / _TOOTH_FRONT)
        table = self.numbers[..., 2 + _MAX_LOBES :]
        uneven = 0.6 + 0.4 * np.take_along_axis(table, index.astype(np.intp) % _MAX_TEETH, axis=2)
        # They vanish near the tip, which is a tooth of its own, and around the lower lobes, which are smooth.
        cut = cut * uneven * np.clip(points[..., 0] / (_TOOTHLESS * self.half_width[..., None]), 0.0, 1.0)
        cut = cut * np.clip((_REAR - direction) / (_REAR - _LAST_LOBE), 0.0, 1.0) ** 2
        spacing = distance[..., -1:] / np.maximum(self.teeth, 1.0)
        way = np.maximum(np.linalg.norm((points - feet) * metres, axis=-1), 1e-9)
        depth = np.minimum(self.tooth_depth, _DEEPEST_TOOTH[0] * spacing) / way
        return np.where(self.teeth > 0.0, cut * np.minimum(depth, _DEEPEST_TOOTH[1]), 0.0)

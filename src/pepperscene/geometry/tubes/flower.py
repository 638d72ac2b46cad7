"""Flowers: the short tube of a corolla and its star of petals, from bud to fully open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pepperscene.geometry.batch import (
    MeshBatch,
    hash_signed,
    read_measure,
    read_positive,
    subdivisions,
    vertex_normals,
)
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.geometry.spine import organ_spines
from pepperscene.grammar.plant import Organ

_PETALS: Final = 6.0  # chosen: Capsicum annuum has five to seven
_OPEN: Final = 0.8  # chosen: most flowers are nearly flat
_STATE: Final = 0.8  # chosen: white rather than greenish
# Chosen from photographs of Capsicum annuum; radii over the flower's radius.
_TUBE: Final = (0.12, 0.3)  # radius of the corolla's tube at the stalk, and where the petals start
_NOTCH: Final = 0.5  # radius where neighbouring petals separate
_BUD: Final = 1.45  # radians by which petals stand up in a bud
_CLOSING: Final = 0.7  # radians by which their outer parts lean in over it


def mesh_flowers(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Build corollas as single sheets with normals out of the inner side.

    u is 0 where petals separate and 0.5 along their middles, v runs from the stalk to the tips. Measures:
    radius_m (when flat), petals (count), open (0 bud, 1 flat), seed, state_mean.
    """
    radius = read_positive(organs, "radius_m")
    opened = np.clip(read_measure(organs, "open", _OPEN), 0.0, 1.0)
    sides, pieces = subdivisions(28, detail, 14), subdivisions(3, detail, 2)
    petals = np.round(read_measure(organs, "petals", _PETALS)).clip(3.0, sides // 2)
    angle, aside = _star(petals, sides)
    seed = read_measure(organs, "seed", 0.0)
    # A petal is longest at its middle; each flower is slightly uneven.
    uneven = 1.0 + 0.06 * np.cos(angle + np.pi * hash_signed(seed, 151, 1)) * hash_signed(seed, 152, 1)
    reach = (_NOTCH + (1.0 - _NOTCH) * (1.0 - aside) ** 0.8) * uneven
    reach = reach / reach.max(axis=1, keepdims=True)
    # Profile: up the tube to the petals' plane, then out along them; in a bud they stand up and lean in.
    v = np.linspace(0.0, 1.0, pieces + 1)
    spine = organ_spines(organs, 2)
    depth = np.minimum(spine.lengths, radius) / radius
    base, throat = _TUBE
    out = (reach - throat)[:, None] * np.clip(1.5 * v - 0.5, 0.0, 1.0)[:, None]
    rise = (1.0 - opened)[:, None, None] * (_BUD + _CLOSING * v[:, None])
    wide = base + (throat - base) * np.clip(3.0 * v, 0.0, 1.0)[:, None] + out * np.cos(rise)
    high = depth[:, None, None] * np.clip(3.0 * v, 0.0, 1.0)[:, None] + out * np.sin(rise)
    # Each petal is slightly folded along its middle, and its tip is bent back when open.
    high = high - 0.25 * out * opened[:, None, None] * (out + 0.3 * aside[:, None, :])
    wide, high = radius[:, None, None] * np.maximum(wide, 0.3 * base), radius[:, None, None] * high
    n, shape = len(organs), (len(organs), -1)
    vertices = spine.place(
        high.reshape(shape),
        (wide * np.sin(angle)[:, None, :]).reshape(shape),
        (wide * np.cos(angle)[:, None, :]).reshape(shape),
    )
    faces = _faces(len(v), sides)
    # The throat is greenish.
    state = read_measure(organs, "state_mean", _STATE)[:, None] - 0.4 * (1.0 - np.repeat(v, sides)) ** 3
    u = np.broadcast_to(0.5 - 0.5 * aside[:, None, :], (n, len(v), sides)).reshape(shape)
    uv = np.stack([u, np.broadcast_to(np.repeat(v, sides), u.shape)], axis=-1)
    return MeshBatch(vertices, vertex_normals(vertices, faces), uv, np.clip(state, 0.0, 1.0), faces)


def _star(petals: FloatArray, sides: int) -> tuple[FloatArray, FloatArray]:
    """Angles `(n, sides)` of the columns, and their distance from the middle of their petal, 1 between two.

    Every middle and every notch gets a column, whatever the number of petals.
    """
    angle, aside = np.empty((2, len(petals), sides))
    for count in np.unique(petals):
        half = np.arange(2.0 * count + 1.0)
        at = np.interp(np.arange(sides), np.round(half * sides / (2.0 * count)), half)
        rows = petals == count
        angle[rows], aside[rows] = np.pi * at / count, 1.0 - np.abs(at % 2.0 - 1.0)
    return angle, aside


def _faces(rings: int, sides: int) -> IndexArray:
    """Triangles between rings, counter-clockwise seen from the inner side of the corolla."""
    row, column = np.mgrid[0 : rings - 1, 0:sides]
    a, b = row * sides + column, row * sides + (column + 1) % sides
    d, c = a + sides, b + sides
    return np.concatenate([np.stack([a, d, c], -1).reshape(-1, 3), np.stack([a, c, b], -1).reshape(-1, 3)])

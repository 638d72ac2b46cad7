"""Flowers: the short tube of a corolla and its star of petals, from bud to flat."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.bodies import MeshBatch, fineness, vertex_normals
from pepperscene.geometry.organ_arrays import organ_measure, signed, size
from pepperscene.geometry.tubes.tube import centrelines
from pepperscene.grammar.plant import Organ

_PETALS: Final = 6.0  # chosen: Capsicum annuum has five to seven
_OPEN: Final = 0.8  # chosen: most flowers are nearly flat
_STATE: Final = 0.8  # chosen: white rather than greenish
# Chosen by eye from photographs of Capsicum annuum; radii over the flower's.
_THROAT: Final = (0.12, 0.3)  # radius of the tube at the stalk and where the petals part from its plane
_NOTCH: Final = 0.5  # where neighbouring petals part
_BUD: Final = 1.45  # radians by which petals stand up in a bud
_CLOSING: Final = 0.7  # radians by which their outer parts lean in over it


def flowers(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Corollas as single sheets; normals leave the inner side. u is 0 where petals part and .5 along their
    middles, v runs from the stalk to the tips.

    Measures: radius_m (when flat), petals (count), open (0 bud, 1 flat), seed, state_mean.
    """
    radius, opened = size(organs, "radius_m"), np.clip(organ_measure(organs, "open", _OPEN), 0.0, 1.0)
    sides, pieces = fineness(28, detail, 14), fineness(3, detail, 2)
    angle, aside = _star(np.round(organ_measure(organs, "petals", _PETALS)).clip(3.0, sides // 2), sides)
    seed = organ_measure(organs, "seed", 0.0)
    # A petal is longest at its middle; no two flowers are quite alike.
    uneven = 1.0 + 0.06 * np.cos(angle + np.pi * signed(seed, 151, 1)) * signed(seed, 152, 1)
    reach = (_NOTCH + (1.0 - _NOTCH) * (1.0 - aside) ** 0.8) * uneven
    reach = reach / reach.max(axis=1, keepdims=True)
    # From the tube up to the petals' plane, then out along them; they stand up, and lean in, in a bud.
    part = np.linspace(0.0, 1.0, pieces + 1)
    spine = centrelines(organs, 2)
    depth = np.minimum(spine.lengths, radius) / radius
    base, throat = _THROAT
    out = (reach - throat)[:, None] * np.clip(1.5 * part - 0.5, 0.0, 1.0)[:, None]
    rise = (1.0 - opened)[:, None, None] * (_BUD + _CLOSING * part[:, None])
    wide = base + (throat - base) * np.clip(3.0 * part, 0.0, 1.0)[:, None] + out * np.cos(rise)
    high = depth[:, None, None] * np.clip(3.0 * part, 0.0, 1.0)[:, None] + out * np.sin(rise)
    # Each petal is folded a little along its middle, and its tip is bent back when open.
    high = high - 0.25 * out * opened[:, None, None] * (out + 0.3 * aside[:, None, :])
    wide, high = radius[:, None, None] * np.maximum(wide, 0.3 * base), radius[:, None, None] * high
    n, shape = len(organs), (len(organs), -1)
    vertices = spine.place(
        high.reshape(shape),
        (wide * np.sin(angle)[:, None, :]).reshape(shape),
        (wide * np.cos(angle)[:, None, :]).reshape(shape),
    )
    faces = _faces(len(part), sides)
    # The throat is greenish.
    state = organ_measure(organs, "state_mean", _STATE)[:, None] - 0.4 * (1.0 - np.repeat(part, sides)) ** 3
    u = np.broadcast_to(0.5 - 0.5 * aside[:, None, :], (n, len(part), sides)).reshape(shape)
    uv = np.stack([u, np.broadcast_to(np.repeat(part, sides), u.shape)], axis=-1)
    return MeshBatch(vertices, vertex_normals(vertices, faces), uv, np.clip(state, 0.0, 1.0), faces)


def _star(petals: NDArray[np.float64], sides: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angles of the columns `(n, sides)`, and how far each is from its petal's middle, 1 between two.

    Every middle and every notch gets a column, whatever the number of petals.
    """
    angle, aside = np.empty((2, len(petals), sides))
    for count in np.unique(petals):
        half = np.arange(2.0 * count + 1.0)
        at = np.interp(np.arange(sides), np.round(half * sides / (2.0 * count)), half)
        rows = petals == count
        angle[rows], aside[rows] = np.pi * at / count, 1.0 - np.abs(at % 2.0 - 1.0)
    return angle, aside


def _faces(rings: int, sides: int) -> NDArray[np.intp]:
    """Triangles between rings, counter-clockwise seen from the inner side of the corolla."""
    row, column = np.mgrid[0 : rings - 1, 0:sides]
    a, b = row * sides + column, row * sides + (column + 1) % sides
    d, c = a + sides, b + sides
    return np.concatenate([np.stack([a, d, c], -1).reshape(-1, 3), np.stack([a, c, b], -1).reshape(-1, 3)])

"""How a blade is bent: the midrib's tip, the fold along it, and margins that turn up or down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.lamina_flat import Flat
from pepperscene.geometry.measures import measure
from pepperscene.geometry.noise import hashed, signed
from pepperscene.geometry.spine import Spines
from pepperscene.grammar.plant import Organ

Array = NDArray[np.float64]


def liveliness(organs: Sequence[Organ], width: Array) -> Array:
    """`(n,)` 0 for a blade as flat as in a herbarium, towards 1 for one with wavy margins.

    What every living leaf has and no measure tells (a hooked tip, a winding midrib, an edge that turns over
    here and there) goes with the waves of its margin. Chosen: half of it at waves of 1 % of the width.
    """
    wave = np.abs(measure(organs, "margin_wave_m", 0.0))
    return wave / (wave + 0.01 * width)


def hooked(spine: Spines, lively: Array, seed: Array) -> Spines:
    """Midribs that wind a little and whose tip is bent down and to one side; their lengths stay.

    Args:
        spine: midribs with the blade's upper side as normals.
        lively: `(n,)` how much of it, see `liveliness`.
        seed: `(n,)` of the blades.
    """
    steps = spine.points.shape[1] - 1
    at = np.linspace(0.0, 1.0, steps + 1)
    chance, turn = hashed(seed, 261, 4)[..., None], signed(seed, 262, 2)[..., None]
    # Chosen: the last quarter bends down by 9 to 31 degrees and aside by up to 20; the rest winds by 4.
    tip = np.clip((at - 0.72) / 0.28, 0.0, None) ** 1.5
    winding = np.sin(2.0 * np.pi * (1.1 * at + chance[:, 2])) - np.sin(2.0 * np.pi * chance[:, 2])
    down = lively[:, None] * ((0.15 + 0.4 * chance[:, 0]) * tip + 0.07 * winding * turn[:, 1])
    aside = lively[:, None] * turn[:, 0] * (0.35 * tip + 0.12 * at**2)
    tangents = np.cross(spine.normals, spine.across)
    tangents, normals, across = _turned(tangents, spine.normals, spine.across, down, aside)
    # Each piece of the midrib turns with the mean of its ends.
    pieces = np.diff(spine.points, axis=1)
    up, right = _square(pieces, spine.normals[:, 1:] + spine.normals[:, :-1])
    bent, _, _ = _turned(pieces, up, right, _between(down), _between(aside))
    points = np.concatenate([spine.points[:, :1], spine.points[:, :1] + np.cumsum(bent, axis=1)], axis=1)
    return replace(spine, points=points, normals=normals, across=across)


def _between(values: Array) -> Array:
    """Means of neighbours along the last axis."""
    return 0.5 * (values[..., 1:] + values[..., :-1])


def _turned(along: Array, up: Array, right: Array, down: Array, aside: Array) -> tuple[Array, Array, Array]:
    """A frame pitched down about its right hand, then turned to the right about its own upper side.

    `up` and `right` may have any equal length, which `along` takes on as it is; only angles change.
    """
    c, s = np.cos(down)[..., None], np.sin(down)[..., None]
    along, up = c * along - s * up, c * up + s * along
    c, s = np.cos(aside)[..., None], np.sin(aside)[..., None]
    return c * along + s * right, up, c * right - s * along


def _square(along: Array, up: Array) -> tuple[Array, Array]:
    """`up` made perpendicular to `along`, and what is to the right of both; all as long as `along`."""
    length = np.sqrt(np.sum(along * along, axis=-1, keepdims=True))
    right = np.cross(along, up)
    right *= length / np.sqrt(np.sum(right * right, axis=-1, keepdims=True))
    return np.cross(right, along) / length, right


def slopes(organs: Sequence[Organ], flat: Flat, half_width: Array, seed: Array) -> Array:
    """`(n, 2, r, s)` radians by which a half rises against the blade's plane, from each column to the next.

    Args:
        organs: n blades with fold_rad and curl_rad.
        flat: their vertices.
        half_width: `(n, 2)` metres.
        seed: `(n,)` of the blades.
    """
    fold = np.clip(measure(organs, "fold_rad", 0.0), -1.4, 1.4)[:, None]
    curl = np.clip(measure(organs, "curl_rad", 0.0), -2.6, 2.6)[:, None]
    along, wide = flat.start, flat.edge / half_width[..., None]
    chance, vary = hashed(seed, 271, 4).reshape(-1, 2, 2), signed(seed, 201, 4).reshape(-1, 2, 2)
    # The fold: each half differs by up to a quarter, opens and closes along the blade, flattens outwards.
    folded = (fold * (1.0 + 0.25 * vary[:, 0]))[..., None] * (
        1.0 + 0.25 * np.sin(2.0 * np.pi * (0.6 * along + chance[..., 0, None]))
    )
    middle = _between(np.concatenate([[0.0], flat.part]))
    opening = (0.7 + 0.6 * np.exp(-middle / 0.3)) / (0.7 + 0.18 * (1.0 - np.exp(-1.0 / 0.3)))
    # The curl: margins that turn far do it near the rim; some stretches do more of it than others.
    power = 1.0 + np.minimum(np.abs(curl), 2.0)
    rim = flat.rim
    stretches = 1.0 + 0.5 * np.sin(2.0 * np.pi * (1.2 * rim + chance[..., 1, None]))
    curled = (curl * (1.0 + 0.3 * vary[:, 1]))[..., None] * stretches * wide
    power = power[..., None]
    return folded[..., None] * opening + curled[..., None] * (middle**power)[:, None]

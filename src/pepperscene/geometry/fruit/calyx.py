"""The calyx: what is left of the flower's sepals, between a fruit and its stalk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.bodies import MeshBatch, fineness
from pepperscene.geometry.fruit.crown import Crowns
from pepperscene.geometry.fruit.fruits import FruitFrames, axes_about, shells
from pepperscene.geometry.organ_arrays import hashed, organ_measure, signed, size
from pepperscene.grammar.plant import Organ

FloatArray = NDArray[np.float64]

_TOOTH = 0.28  # chosen: depth of small points over the radius, as on a sweet pepper's calyx
_THICKNESS = (0.06, 1.0e-3)  # chosen: of the plate, over its radius and in metres; the smaller holds
_SUNK = (0.02, 0.35e-3)  # chosen: of its lower side in the fruit, likewise
_NARROW = (
    1.3,
    0.8,
)  # chosen: exponent of the teeth's outline, less by so much with their depth; less is slimmer
_LIFT = 0.22  # chosen: of the tips of sepals as long as the radius, over the radius
_STALK = 0.18  # chosen: radius of a stalk that is not there, over the calyx's; slimmer under long sepals
_TEETH: Final = {5: 0.45, 6: 0.4, 7: 0.15}  # chosen: how often
# Profile of the plate's upper side: part of the way out (to the edge of the disc at .5, then along the
# teeth), height over the fruit as parts of the thickness, difference of the state. The ring around the stalk
# is swollen and paler.
_UPPER = np.array(
    [
        [0.1, 2.4, -0.12],
        [0.22, 2.2, -0.1],
        [0.32, 1.2, -0.02],
        [0.5, 1.0, 0.02],
        [0.68, 0.85, 0.06],
        [0.86, 0.65, 0.1],
        [1.0, 0.2, 0.12],
    ]
)
_LOWER = np.array([0.96, 0.5, 0.16])  # and of its lower side, from the rim back
_LONG = 0.5  # chosen: depth of teeth from which they count as sepals and get a finer mesh


def calyces(
    organs: Sequence[Organ],
    stalks: Sequence[Organ | None],
    under: NDArray[np.intp],
    seats: tuple[FruitFrames, Crowns] | None,
    detail: float,
) -> MeshBatch:
    """Toothed plates that lie on the fruit's shoulders and close round the end of the fruit stalk.

    Measures: radius_m (to the tip of the longest tooth), tooth (depth of the teeth over the radius: small
    points or long sepals, whose tips are lifted), state_mean, seed. A plate is never narrower than one and a
    half times its stalk.

    Args:
        organs: n calyces; their curves run from the stalk's end to the fruit.
        stalks: what each grows on, or None; of a stalk its end's direction and `radius_tip_m` are taken.
        under: `(n,)` the number in `seats` of the fruit below each, -1 for none: such a calyx is flat.
        seats: the fruit's frames and crowns, or None when there are none.
        detail: fineness of the mesh, 1 as designed.
    """
    n, seed = len(organs), organ_measure(organs, "seed", 0.0)
    tooth = np.clip(organ_measure(organs, "tooth", _TOOTH), 0.02, 0.9)
    stalk, stalk_axis = _stalk_ends(organs, stalks)
    radius = np.maximum(size(organs, "radius_m"), 1.5 * stalk)
    thickness, sunk = (np.minimum(part * radius, most) for part, most in (_THICKNESS, _SUNK))
    # The rim, and the part of the way to the tip of its tooth that each column stands for.
    angle, phase = _columns(seed, float(tooth.max()), detail)
    long = 1.0 - 0.3 * _each(phase, hashed(seed, 403, 8))
    aside = np.abs(2.0 * (phase - np.round(phase)))
    blade = 1.0 - aside ** (_NARROW[0] - _NARROW[1] * tooth)[:, None]
    rim = 1.0 - tooth[:, None] + tooth[:, None] * blade * long
    rim *= (radius / rim.max(axis=1))[:, None]
    disc = np.maximum(0.85 * (1.0 - tooth) * radius, 1.25 * stalk)[:, None]
    rim = np.maximum(rim, 1.12 * disc)
    # The plate, in the fruit's own frame and on its surface, so that it hugs the shoulders.
    lower = _LOWER if tooth.max() <= _LONG else np.insert(_LOWER, 1, 0.75)
    out = np.concatenate([_UPPER[:, 0], lower])[:, None]
    edge = 1.08 * stalk[:, None, None]
    inner, outer = np.clip(out / 0.5, 0.0, 1.0), np.clip(out / 0.5 - 1.0, 0.0, 1.0)
    width = edge + inner * (disc[:, None] - edge) + outer * (rim - disc)[:, None]
    own = _own_frames(organs)
    foot, axes, floor = own.foot, own.axes, np.zeros_like(width)
    sitting = np.flatnonzero(under >= 0)
    if seats is not None and sitting.size:
        fruit = under[sitting]
        foot[sitting], axes[sitting] = seats[0].foot[fruit], seats[0].axes[fruit]
        floor[sitting] = seats[1].height(fruit, width[sitting], angle[sitting])
    # The swollen ring is no higher than the stalk's end.
    gap = np.linalg.norm(foot - np.array([organ.curve[0] for organ in organs]), axis=1)
    swelling = np.minimum(thickness[:, None] * _UPPER[:, 1], np.maximum(0.7 * gap, thickness)[:, None])
    raised = np.concatenate([swelling, np.repeat(-sunk[:, None], len(lower), axis=1)], axis=1)
    tip = _LIFT * (radius * tooth**2)[:, None] * (1.0 + 0.6 * _each(phase, signed(seed, 404, 8))) * blade
    along = floor - raised[..., None] - tip[:, None] * outer**2
    plate = _about(foot, axes, width, angle, along)
    # The collar closes round the stalk: it comes out of it a little before its end.
    end = np.array([organ.curve[0] for organ in organs], dtype=float)
    collar_axes = axes_about(stalk_axis, axes[:, 0])
    widths = np.broadcast_to((stalk[:, None] * [0.92, 1.06])[..., None], (n, 2, angle.shape[1]))
    heights = np.broadcast_to((stalk[:, None] * [-0.7, 0.0])[..., None], widths.shape)
    collar = _about(end, collar_axes, widths, angle, heights)
    rings = np.concatenate([collar, plate], axis=1)
    first = end - 0.7 * stalk[:, None] * collar_axes[:, 2]
    last = foot + (sunk + floor[:, -1].mean(axis=1) * (under < 0))[:, None] * axes[:, 2]
    # Teeth are greener than the swollen ring around the stalk.
    colour = np.concatenate([[-0.12, -0.12], _UPPER[:, 2], 0.1 * (lower > 0.5)])
    state = (
        np.pad(np.repeat(colour, angle.shape[1]), 1, mode="edge")
        + organ_measure(organs, "state_mean", 0.5)[:, None]
    )
    v = np.broadcast_to(np.arange(1, len(colour) + 1) / (len(colour) + 1), (n, len(colour)))
    return shells(rings, first, last, v, state)


def _stalk_ends(organs: Sequence[Organ], stalks: Sequence[Organ | None]) -> tuple[FloatArray, FloatArray]:
    """`(n,)` radius and `(n, 3)` direction of the stalks' ends; without a stalk, as the calyx's own curve."""
    tooth = np.clip(organ_measure(organs, "tooth", _TOOTH), 0.0, 0.9)
    radius = _STALK * size(organs, "radius_m") * (1.0 - 0.6 * tooth)
    axis = np.array([organ.curve[-1] - organ.curve[0] for organ in organs], dtype=float)
    for index, stalk in enumerate(stalks):
        if stalk is not None and stalk.measures.get("radius_tip_m", 0.0) > 0.0:
            radius[index] = stalk.measures["radius_tip_m"]
            axis[index] = stalk.curve[-1] - stalk.curve[-2]
    return radius, axis


def _own_frames(organs: Sequence[Organ]) -> FruitFrames:
    """Frames at the tips of the calyces' curves, for those without fruit."""
    foot = np.array([organ.curve[-1] for organ in organs], dtype=float)
    axis = foot - np.array([organ.curve[0] for organ in organs], dtype=float)
    return FruitFrames(foot, axes_about(axis, np.array([organ.up for organ in organs], dtype=float)))


def _columns(seed: FloatArray, tooth: float, detail: float) -> tuple[FloatArray, FloatArray]:
    """Angles `(n, c)` of the columns, and their places in teeth: tips at whole numbers, gaps half-way.

    Every tip and every gap has a column, so that points stay sharp; long sepals get more columns.
    """
    columns = 2 * max(_TEETH) * fineness(3 if tooth > _LONG else 2, detail, 1)
    share = np.cumsum(list(_TEETH.values()))
    number = np.array(list(_TEETH))[
        np.searchsorted(share / share[-1], hashed(seed, 401, 1)[:, 0], side="right")
    ]
    phase = np.empty((len(seed), columns))
    for teeth in _TEETH:
        marks = np.arange(2 * teeth + 1)
        at = np.round(columns * marks / (2 * teeth))
        phase[number == teeth] = np.interp(np.arange(columns), at, 0.5 * marks)
    # Sepals of unequal width.
    angle = 2.0 * np.pi * (phase / number[:, None] + hashed(seed, 402, 1))
    draw = 2.0 * np.pi * hashed(seed, 405, 2)
    angle = angle + 0.1 * np.sin(angle + draw[:, :1]) + 0.05 * np.sin(2.0 * angle + draw[:, 1:])
    return angle, np.mod(phase, number[:, None])


def _each(phase: FloatArray, values: FloatArray) -> FloatArray:
    """`(n, c)` the number of each column's tooth out of `(n, 8)`; gaps belong to the tooth after them."""
    nearest = np.floor(phase + 0.5).astype(np.intp)
    nearest[nearest > np.floor(phase.max(axis=1, keepdims=True))] = 0
    return np.take_along_axis(values, nearest, axis=1)


def _about(
    foot: FloatArray, axes: FloatArray, width: FloatArray, angle: FloatArray, along: FloatArray
) -> FloatArray:
    """`(n, r, c, 3)` points so far from the axes, at these angles from the upper side and so far along."""
    turn = angle[:, None]
    local = np.stack([width * np.cos(turn), width * np.sin(turn), along], axis=-1)
    placed = FruitFrames(foot, axes).placed(local.reshape(len(foot), -1, 3))
    return placed.reshape(local.shape)

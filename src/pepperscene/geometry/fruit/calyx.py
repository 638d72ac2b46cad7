"""The calyx: the former sepals of the flower, between a fruit and its stalk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pepperscene.geometry.batch import (
    MeshBatch,
    hash_signed,
    hash_uniform,
    read_measure,
    read_positive,
    ring_shells,
    subdivisions,
)
from pepperscene.geometry.fruit.fruits import FruitFrames, Shoulders, axis_frames
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.grammar.plant import Organ

_TOOTH: Final = 0.28  # chosen: depth of small points over the radius, as on a sweet pepper's calyx
_THICKNESS: Final = 0.06, 1.0e-3  # chosen: maximum thickness of the plate, over its radius and in metres
_SUNK: Final = 0.02, 0.35e-3  # chosen: maximum depth of its lower side in the fruit, likewise
_NARROW: Final = 1.3, 0.8  # chosen: exponent of the teeth's outline, and its decrease with their depth
_LIFT: Final = 0.22  # chosen: of the tips of sepals as long as the radius, over the radius
_STALK: Final = 0.18  # chosen: radius of a missing stalk over the calyx's; slimmer under long sepals
_TEETH: Final = {5: 0.45, 6: 0.4, 7: 0.15}  # chosen: number of teeth and its probability
# Of the vein along the middle of each tooth: height over the plate's thickness, decrease of the state;
# chosen.
_VEIN: Final = 0.9, 0.15
_DRY: Final = 0.6, 0.4  # chosen: relative decrease of the state at a dry rim: everywhere, further at the tips
# Profile of the plate's upper side: fraction of the way out (to the edge of the disc at 0.5, then along the
# teeth), height over the fruit in thicknesses, difference of the state. The ring around the stalk is swollen
# and paler.
_UPPER: Final = np.array(
    [
        [0.1, 2.4, -0.12],
        [0.22, 2.2, -0.1],
        [0.32, 1.2, -0.02],
        [0.5, 1.0, 0.02],
        [0.68, 0.85, 0.04],
        [0.86, 0.65, 0.04],
        [1.0, 0.2, 0.0],
    ]
)
_LOWER: Final = np.array([0.96, 0.5, 0.16])  # way out on its lower side, from the rim back
_LONG: Final = 0.5  # chosen: depth of teeth from which they count as sepals and get a finer mesh


def mesh_calyces(
    organs: Sequence[Organ],
    stalks: Sequence[Organ | None],
    under: IndexArray,
    fruit: tuple[FruitFrames, Shoulders] | None,
    detail: float,
) -> MeshBatch:
    """Build toothed plates that rest on the fruit's shoulders and close around the end of the fruit stalk.

    Measures: radius_m (to the tip of the longest tooth), tooth (depth of the teeth over the radius: small
    points or long sepals, whose tips are lifted), state_mean, seed. A plate is never narrower than one and a
    half times its stalk.

    Args:
        organs: n calyces; their curves run from the stalk's end to the fruit.
        stalks: parent of each, or None; the direction of its end and `radius_tip_m` are used.
        under: `(n,)` index of the fruit below each, -1 for none: such a calyx is flat.
        fruit: frames and shoulders of the fruit, or None if there are none.
        detail: fineness of the mesh, 1 as designed.
    """
    n, seed = len(organs), read_measure(organs, "seed", 0.0)
    tooth = np.clip(read_measure(organs, "tooth", _TOOTH), 0.02, 0.9)
    stalk, stalk_axis = _stalk_ends(organs, stalks)
    radius = np.maximum(read_positive(organs, "radius_m"), 1.5 * stalk)
    thickness, sunk = (np.minimum(part * radius, limit) for part, limit in (_THICKNESS, _SUNK))
    # The rim, and for each column the fraction of the way to the tip of its tooth.
    angle, phase = _columns(seed, float(tooth.max()), detail)
    length_factor = 1.0 - 0.3 * _tooth_values(phase, hash_uniform(seed, 403, 8))
    aside = np.abs(2.0 * (phase - np.round(phase)))
    blade = 1.0 - aside ** (_NARROW[0] - _NARROW[1] * tooth)[:, None]
    rim = 1.0 - tooth[:, None] + tooth[:, None] * blade * length_factor
    rim *= (radius / rim.max(axis=1))[:, None]
    disc = np.maximum(0.85 * (1.0 - tooth) * radius, 1.25 * stalk)[:, None]
    rim = np.maximum(rim, 1.12 * disc)
    # The plate, in the fruit's frame and on its surface, so that it follows the shoulders.
    lower = _LOWER if tooth.max() <= _LONG else np.insert(_LOWER, 1, 0.75)
    out = np.concatenate([_UPPER[:, 0], lower])[:, None]
    edge = 1.08 * stalk[:, None, None]
    inner, outer = np.clip(out / 0.5, 0.0, 1.0), np.clip(out / 0.5 - 1.0, 0.0, 1.0)
    width = edge + inner * (disc[:, None] - edge) + outer * (rim - disc)[:, None]
    # Frames and surface of the fruit; without a fruit, at the tip of the calyx's curve and flat.
    stalk_end, foot = (np.array([organ.curve[end] for organ in organs], dtype=float) for end in (0, -1))
    axes = axis_frames(foot - stalk_end, np.array([organ.up for organ in organs], dtype=float))
    surface = np.zeros_like(width)
    on_fruit = np.flatnonzero(under >= 0)
    if fruit is not None and on_fruit.size:
        frames, shoulders = fruit
        index = under[on_fruit]
        foot[on_fruit], axes[on_fruit] = frames.foot[index], frames.axes[index]
        surface[on_fruit] = shoulders.surface(index, width[on_fruit], angle[on_fruit])
    # The swollen ring is no higher than the stalk's end.
    gap = np.linalg.norm(foot - stalk_end, axis=1)
    swelling = np.minimum(thickness[:, None] * _UPPER[:, 1], np.maximum(0.7 * gap, thickness)[:, None])
    raised = np.concatenate([swelling, np.repeat(-sunk[:, None], len(lower), axis=1)], axis=1)[..., None]
    # Veins run from the swollen ring along the middles of the teeth, and fade towards their tips.
    high = _UPPER[:, 1] * np.interp(_UPPER[:, 0], [0.2, 0.4, 0.8, 1.0], [0.0, 1.0, 1.0, 0.0])
    vein = np.pad(high, (0, len(lower)))[:, None] * np.exp(-((aside / 0.33) ** 2))[:, None]
    raised = raised + _VEIN[0] * thickness[:, None, None] * vein
    uneven = 1.0 + 0.6 * _tooth_values(phase, hash_signed(seed, 404, 8))
    tip = _LIFT * (radius * tooth**2)[:, None] * uneven * blade
    along = surface - raised - tip[:, None] * outer**2
    _keep_above_lower_side(along, lower)
    plate = _ring_points(foot, axes, width, angle, along)
    # The collar closes around the stalk: it starts in it a little before its end.
    collar_axes = axis_frames(stalk_axis, axes[:, 0])
    widths = np.broadcast_to((stalk[:, None] * [0.92, 1.06])[..., None], (n, 2, angle.shape[1]))
    heights = np.broadcast_to((stalk[:, None] * [-0.7, 0.0])[..., None], widths.shape)
    collar = _ring_points(stalk_end, collar_axes, widths, angle, heights)
    first = stalk_end - 0.7 * stalk[:, None] * collar_axes[:, 2]
    last = foot + (sunk + surface[:, -1].mean(axis=1) * (under < 0))[:, None] * axes[:, 2]
    # Teeth are greener than the swollen ring around the stalk, and the rim dries, first at the tips.
    colour = np.concatenate([[-0.12, -0.12], _UPPER[:, 2], 0.0 * lower])
    state = read_measure(organs, "state_mean", 0.5)[:, None, None] + np.repeat(
        colour[:, None], angle.shape[1], axis=1
    )
    state[:, 2:] -= _VEIN[1] * vein
    everywhere, at_tips = _DRY
    dry = (0.4 + 0.6 * hash_uniform(seed, 406, 1)) * (everywhere + at_tips * blade)
    state[:, 2 + len(_UPPER) - 1] *= 1.0 - dry
    state[:, 2 + len(_UPPER)] *= 1.0 - 0.8 * dry
    state = np.pad(state.reshape(n, -1), ((0, 0), (1, 1)), mode="edge")
    v = np.broadcast_to(np.arange(1, len(colour) + 1) / (len(colour) + 1), (n, len(colour)))
    return ring_shells(np.concatenate([collar, plate], axis=1), np.stack([first, last], axis=1), v, state)


def _keep_above_lower_side(along: FloatArray, lower: FloatArray) -> None:
    """Move the upper rings of plates `(n, r, c)` above the straight lines between the lower rings, in place.

    Rings are few, so on a shoulder that bends sharply the sides would intersect.
    """
    upper = len(_UPPER)
    way_out, ascending = _UPPER[:, 0], lower[::-1]
    weights = np.array([np.interp(way_out, ascending, unit) for unit in np.eye(len(lower))])
    chord = np.einsum("lu,nlc->nuc", weights, along[:, upper:][:, ::-1])
    between = np.flatnonzero((way_out >= ascending[0]) & (way_out <= ascending[-1]))
    along[:, between] = np.minimum(along[:, between], chord[:, between])


def _stalk_ends(organs: Sequence[Organ], stalks: Sequence[Organ | None]) -> tuple[FloatArray, FloatArray]:
    """`(n,)` radius and `(n, 3)` direction of the stalks' ends; without a stalk, along the calyx's curve."""
    tooth = np.clip(read_measure(organs, "tooth", _TOOTH), 0.0, 0.9)
    radius = _STALK * read_positive(organs, "radius_m") * (1.0 - 0.6 * tooth)
    axis = np.array([organ.curve[-1] - organ.curve[0] for organ in organs], dtype=float)
    for index, stalk in enumerate(stalks):
        if stalk is not None and stalk.measures.get("radius_tip_m", 0.0) > 0.0:
            radius[index] = stalk.measures["radius_tip_m"]
            axis[index] = stalk.curve[-1] - stalk.curve[-2]
    return radius, axis


def _columns(seed: FloatArray, tooth: float, detail: float) -> tuple[FloatArray, FloatArray]:
    """Angles `(n, c)` of the columns, and their phase: whole at the tips of teeth, half-way in the gaps.

    Every tip and every gap has a column, so that points stay sharp; long sepals get more columns.
    """
    columns = 2 * max(_TEETH) * subdivisions(3 if tooth > _LONG else 2, detail, 1)
    cumulative = np.cumsum(list(_TEETH.values()))
    draw = hash_uniform(seed, 401, 1)[:, 0]
    number = np.array(list(_TEETH))[np.searchsorted(cumulative / cumulative[-1], draw, side="right")]
    phase = np.empty((len(seed), columns))
    for teeth in _TEETH:
        marks = np.arange(2 * teeth + 1)
        at = np.round(columns * marks / (2 * teeth))
        phase[number == teeth] = np.interp(np.arange(columns), at, 0.5 * marks)
    # Sepals of unequal width.
    angle = 2.0 * np.pi * (phase / number[:, None] + hash_uniform(seed, 402, 1))
    draws = 2.0 * np.pi * hash_uniform(seed, 405, 2)
    angle = angle + 0.1 * np.sin(angle + draws[:, :1]) + 0.05 * np.sin(2.0 * angle + draws[:, 1:])
    return angle, np.mod(phase, number[:, None])


def _tooth_values(phase: FloatArray, values: FloatArray) -> FloatArray:
    """`(n, c)` value of each column's tooth, from `(n, 8)`; a gap belongs to the tooth after it."""
    nearest = np.floor(phase + 0.5).astype(np.intp)
    nearest[nearest > np.floor(phase.max(axis=1, keepdims=True))] = 0
    return np.take_along_axis(values, nearest, axis=1)


def _ring_points(
    foot: FloatArray, axes: FloatArray, width: FloatArray, angle: FloatArray, along: FloatArray
) -> FloatArray:
    """`(n, r, c, 3)` points at `width` from the axes, at angles from the upper side, and at `along`."""
    rotation = angle[:, None]
    local = np.stack([width * np.cos(rotation), width * np.sin(rotation), along], axis=-1)
    return FruitFrames(foot, axes).to_plant(local.reshape(len(foot), -1, 3)).reshape(local.shape)

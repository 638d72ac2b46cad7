"""Petioles, side shoots, fruit stalks and the scars of cut ones: tubes that grow out of other organs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.bodies import MeshBatch, fineness
from pepperscene.geometry.organ_arrays import hashed, organ_measure, size
from pepperscene.geometry.spine import Spines
from pepperscene.geometry.tubes.tube import (
    Cap,
    Rings,
    centred,
    centrelines,
    circle,
    closed,
    rounded,
    streaked,
)
from pepperscene.grammar.plant import Organ

_FOOT: Final = 1.6  # chosen: width of a stalk's foot over the stalk's, as in photographs of Capsicum
_FOOT_M: Final = 2.2  # chosen: metres per metre of radius within which a foot narrows to the stalk
_CHANNEL: Final = (
    0.5  # chosen: how much nearer the middle of a petiole its channel's bottom is than its sides
)
_RIBS: Final = 5.0  # chosen: ribs of a fruit stalk of Capsicum, one for each sepal
_RIB_DEPTH: Final = 0.13  # chosen: of its radius
_LEAN: Final = 0.9  # chosen: radians; a foot turns no further to go level into its parent
_UNDER: Final = 0.3  # chosen: radians by which a foot's ring leans over, to hide its edge below a leaf


def stalks(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Petioles, side shoots and rachises: a flared foot, a slow taper; petioles have a channel above.

    Measures: radius_m (base, above the foot), radius_tip_m, channel (1 a petiole's channel and flat tip, 0
    round), foot (width of the foot over the stalk's), seed, state_mean, state_spread.
    """
    base, tip = size(organs, "radius_m"), size(organs, "radius_tip_m")
    spine = centrelines(organs, fineness(16, detail, 10))
    foot = np.minimum(_FOOT_M * base, 0.25 * spine.lengths)
    part, along = _rows([0.0, 0.6, 1.6], 0.045, foot, spine, fineness(6, detail, 2))
    place = along / spine.lengths[:, None]
    wider = np.maximum(organ_measure(organs, "foot", _FOOT), 0.2) - 1.0
    flare = wider[:, None] * np.exp(-((along / foot[:, None]) ** 2))
    radius = base[:, None] + (tip - base)[:, None] * place
    # A petiole is a little flat, most of all at its tip, which goes over into the midrib.
    channel = np.clip(organ_measure(organs, "channel", 0.0), 0.0, 1.0)
    angle = circle(fineness(7, detail, 5))
    beside = (angle + np.pi) % (2.0 * np.pi) - np.pi
    inside = np.sqrt(np.sin(np.pi * np.clip(0.03 + place, 0.0, 1.0)))
    depth = _CHANNEL * channel[:, None] * inside
    reach = 1.0 - depth[..., None] * np.exp(-0.5 * (beside / 0.4) ** 2)
    flat = 1.0 - channel[:, None] * (0.08 + 0.32 * np.clip(4.0 * place - 3.0, 0.0, 1.0))
    # The foot widens into the parent to its sides; above and below it is round as a cushion.
    cushion = 1.0 + flare * (1.0 - 1.1 * np.exp(-((along / (0.5 * foot[:, None])) ** 2)))
    flat = flat * cushion / (1.0 + flare)
    right, up = centred(
        reach * np.sin(angle), flat[..., None] * reach * np.cos(angle), radius * (1.0 + flare)
    )
    state = -0.1 * (depth / _CHANNEL)[..., None] * np.broadcast_to(np.cos(angle), right.shape)
    base_cap = _into_parent(spine, radius[:, 0] * (1.0 + flare[:, 0]))
    # A petiole's tip is drawn out under the blade, as its midrib.
    reach_out = np.minimum(tip, spine.lengths) * (0.6 + 2.4 * channel)
    lower = -0.35 * channel * np.minimum(tip, spine.lengths)
    tip_cap = Cap(np.stack([0.6 * reach_out, 0.7 * lower], axis=1), np.stack([reach_out, lower], axis=1), 0.7)
    state = state + streaked(organs, along, len(angle))
    return closed(spine, Rings(_upright(spine, along, up), right, up, part, state), base_cap, tip_cap)


def peduncles(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Fruit stalks: ribbed, with a collar at the foot where they break off, widening towards the calyx.

    Measures: radius_m (base, above the collar, over the ribs), radius_tip_m, ribs (count), seed, state_mean.
    """
    base, tip = size(organs, "radius_m"), size(organs, "radius_tip_m")
    spine = centrelines(organs, fineness(16, detail, 10))
    # Foot, collar and the furrow above it; then even pieces.
    foot = np.minimum(base, 0.12 * spine.lengths)
    part, along = _rows([0.0, 1.3, 1.8, 2.4], 0.075, foot, spine, fineness(5, detail, 2))
    place, high = along / spine.lengths[:, None], along / foot[:, None]
    collar = (
        0.05 * np.exp(-((high / 1.2) ** 2))
        + 0.16 * np.exp(-(((high - 1.3) / 0.45) ** 2))
        - 0.08 * np.exp(-(((high - 1.8) / 0.3) ** 2))
    )
    radius = base[:, None] * (1.0 + collar) + (tip - base)[:, None] * place**3
    # Ribs run along; the grid is turned to them, so that a rib or a furrow is at every point.
    sides, ribs = fineness(15, detail, 6), np.round(organ_measure(organs, "ribs", _RIBS))
    draw = hashed(organ_measure(organs, "seed", 0.0), 111, 2)
    angle = circle(sides)
    furrow = 0.5 - 0.5 * np.cos(ribs[:, None] * angle)
    uneven = 1.0 + 0.3 * np.cos(angle + 2.0 * np.pi * draw[:, 1:])
    out_of_collar = np.clip((high - 0.5) / 2.0, 0.0, 1.0)
    reach = 1.0 - _RIB_DEPTH * out_of_collar[..., None] * (furrow * uneven)[:, None, :]
    turned = angle + 2.0 * np.pi * draw[:, :1]
    right, up = centred(reach * np.sin(turned)[:, None, :], reach * np.cos(turned)[:, None, :], radius)
    # The furrow above the collar is corky; ribs are paler than the furrows between them.
    state = 0.15 * (furrow - 0.5)[:, None, :] * out_of_collar[..., None]
    state = state - 0.2 * np.exp(-(((high - 1.8) / 0.4) ** 2))[..., None]
    state = state + streaked(organs, along, sides)
    caps = _into_parent(spine, radius[:, 0]), rounded(tip, spine.lengths)
    return closed(spine, Rings(_upright(spine, along, up), right, up, part, state), *caps)


# A cut's profile from its foot over the side and the rim into the hollow: height over the curve's length,
# radius over the organ's, state (0 the corky middle, 1 the green rim), and how much of the cut's slant and of
# its ragged edge a ring takes; chosen from photographs of harvested nodes.
_CUT: Final = np.array(
    [
        [0.0, 1.1, 1.0, 0.0],
        [0.5, 0.95, 1.0, 0.3],
        [0.88, 1.0, 0.95, 1.0],
        [1.0, 0.92, 0.75, 1.0],
        [0.9, 0.72, 0.4, 1.0],
        [0.78, 0.4, 0.1, 0.8],
    ]
)


def cuts(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Scars where fruit was harvested: a short stub cut at a slant, a raised rim and a sunken, corky middle.

    Measures: radius_m (of the rim), seed.
    """
    radius, seed = size(organs, "radius_m"), organ_measure(organs, "seed", 0.0)
    spine = centrelines(organs, 4)
    height, profile, green, slanted = _CUT.T
    # A low stub has no room for a waist below its rim.
    squat = np.minimum(1.0, 2.0 * spine.lengths / radius)[:, None]
    width = np.where(profile > 0.9, 1.0 + (profile - 1.0) * squat, profile)
    angle = circle(fineness(10, detail, 6))
    draw = hashed(seed, 131, 4)
    # The knife's slant, up to 15 degrees (chosen), but no more than a fifth of the stub.
    slant = np.minimum(np.tan(0.26 * draw[:, 0]) * radius, 0.2 * spine.lengths)
    turn = 2.0 * np.pi * draw
    lean = np.cos(angle + turn[:, 1:2])
    ragged = 0.05 * np.cos(3.0 * angle + turn[:, 2:3]) * np.cos(angle + turn[:, 3:])
    along = (spine.lengths[:, None] * height)[..., None] + np.einsum(
        "n,nr,nc->nrc", slant, slanted * width, lean
    )
    reach = 1.0 + slanted[:, None] * ragged[:, None, :]
    right, up = centred(reach * np.sin(angle), reach * np.cos(angle), radius[:, None] * width)
    state = np.broadcast_to(green[:, None], right.shape)
    # The hollow's middle lies a little deeper.
    deeper = np.stack([-0.03 * spine.lengths, 0.0 * radius], axis=1)
    hollow = Cap(deeper, 2.0 * deeper, 0.5, within=False)
    part = np.linspace(0.0, 1.0, len(height))
    rings = Rings(along, right, up, part, state)
    return closed(spine, rings, _into_parent(spine, width[:, 0] * radius), hollow)


def _rows(
    knots: Sequence[float], share: float, foot: NDArray[np.float64], spine: Spines, pieces: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where rings lie: `(r,)` v and `(n, r)` metres along; at the foot's knots, then at even distances.

    Args:
        knots: over the foot's length, the first 0.
        share: of the length that a foot usually takes, for v, which is the same for all stalks.
        foot: `(n,)` metres.
        spine: the centrelines.
        pieces: between the last knot and the tip.
    """
    rest = np.arange(1, pieces + 1) / pieces
    near = foot[:, None] * np.array(knots)
    far = near[:, -1:] + (spine.lengths[:, None] - near[:, -1:]) * rest
    usual = share * np.array(knots)
    part = np.concatenate([usual, usual[-1] + (1.0 - usual[-1]) * rest])
    return part, np.concatenate([near, far], axis=1)


def _rise(spine: Spines) -> NDArray[np.float64]:
    """`(n,)` radians by which feet turn down to go level into their parents, towards the stalks' lower side.

    The parent is taken to stand upright, as nodes do; where it does not, the foot is hidden within it anyway.
    """
    tangent = np.cross(spine.normals[:, 0], spine.across[:, 0])
    slope = np.arcsin(np.clip(tangent[:, 2], -1.0, 1.0))
    # The upper side may look down, where a stalk has been turned about itself.
    upright = np.array([0.0, 0.0, 1.0]) - tangent[:, 2:] * tangent
    level = np.einsum("ni,ni->n", upright, spine.normals[:, 0])
    return np.clip(slope * level / np.maximum(np.linalg.norm(upright, axis=1), 1e-9), -_LEAN, _LEAN)


def _upright(spine: Spines, along: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n, r, c)` metres along: the first ring stands upright in the parent's side, the second half so.

    It even leans over a little, so that the foot's lower edge lies deeper, where a node is narrower.
    """
    slant = np.tan(np.minimum(_rise(spine) + _UNDER, _LEAN))[:, None] * up[:, 0]
    # No ring may touch the next.
    most, gap = np.abs(slant).max(axis=1).clip(1e-9), np.diff(along[:, :3], axis=1)
    slant = slant * np.minimum(1.0, np.minimum(1.2 * gap[:, 0], 1.4 * gap[:, 1]) / most)[:, None]
    leant = np.repeat(along[..., None], up.shape[2], axis=2)
    leant[:, 0] += slant
    leant[:, 1] += 0.5 * slant
    return leant


def _into_parent(spine: Spines, radius: NDArray[np.float64]) -> Cap:
    """A cap that turns level into the parent.

    Args:
        spine: the stalks' centrelines.
        radius: `(n,)` metres, of their feet.
    """
    turn, reach = _rise(spine), np.minimum(radius, spine.lengths)[:, None]
    inward = reach * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Cap(0.5 * inward, 0.9 * inward, within=False)

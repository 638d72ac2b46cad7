"""Petioles, side shoots, fruit stalks and the scars of cut ones: tubes that grow out of other organs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pepperscene.geometry.batch import MeshBatch, hash_uniform, read_measure, read_positive, subdivisions
from pepperscene.geometry.mesh import FloatArray
from pepperscene.geometry.spine import Spines, organ_spines
from pepperscene.geometry.tubes.tube import (
    Cap,
    Rings,
    centre_rings,
    ring_angles,
    round_cap,
    state_with_streaks,
    sweep_rings,
)
from pepperscene.grammar.frames import cross
from pepperscene.grammar.plant import Organ

_FOOT: Final = 1.6  # chosen: width of a stalk's foot over the stalk's, as in photographs of Capsicum
_FOOT_M: Final = 2.2  # chosen: metres per metre of radius within which a foot narrows to the stalk
_CHANNEL: Final = 0.5  # chosen: depth of a petiole's channel over the distance of its sides from the axis
_RIBS: Final = 5.0  # chosen: ribs of a fruit stalk of Capsicum, one for each sepal
_RIB_DEPTH: Final = 0.17  # chosen: over its radius
_LEAN: Final = 0.9  # chosen: maximum rotation, radians, of a foot that enters its parent horizontally
_UNDER: Final = 0.3  # chosen: radians by which a foot's ring leans over, to hide its edge below a leaf


def mesh_stalks(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Build petioles, side shoots and rachises: a flared foot, a slow taper; petioles have a channel above.

    Measures: radius_m (base, above the foot), radius_tip_m, channel (1 a petiole's channel and flat tip, 0
    round), foot (width of the foot over the stalk's), seed, state_mean, state_spread.
    """
    base, tip = read_positive(organs, "radius_m"), read_positive(organs, "radius_tip_m")
    spine = organ_spines(organs, subdivisions(16, detail, 10))
    foot = np.minimum(_FOOT_M * base, 0.25 * spine.lengths)
    v, along = _rows([0.0, 0.6, 1.6], 0.045, foot, spine, subdivisions(6, detail, 2))
    fraction = along / spine.lengths[:, None]
    wider = np.maximum(read_measure(organs, "foot", _FOOT), 0.2) - 1.0
    flare = wider[:, None] * np.exp(-((along / foot[:, None]) ** 2))
    radius = base[:, None] + (tip - base)[:, None] * fraction
    # A petiole is a little flat, most of all at its tip, which continues as the midrib.
    channel = np.clip(read_measure(organs, "channel", 0.0), 0.0, 1.0)
    angle = ring_angles(subdivisions(7, detail, 5))
    off_top = (angle + np.pi) % (2.0 * np.pi) - np.pi
    inside = np.sqrt(np.sin(np.pi * np.clip(0.03 + fraction, 0.0, 1.0)))
    depth = _CHANNEL * channel[:, None] * inside
    reach = 1.0 - depth[..., None] * np.exp(-0.5 * (off_top / 0.4) ** 2)
    flat = 1.0 - channel[:, None] * (0.08 + 0.32 * np.clip(4.0 * fraction - 3.0, 0.0, 1.0))
    # The foot widens sideways into the parent; above and below it is round like a cushion.
    cushion = 1.0 + flare * (1.0 - 1.1 * np.exp(-((along / (0.5 * foot[:, None])) ** 2)))
    flat = flat * cushion / (1.0 + flare)
    right, up = centre_rings(
        reach * np.sin(angle), flat[..., None] * reach * np.cos(angle), radius * (1.0 + flare)
    )
    state = -0.1 * (depth / _CHANNEL)[..., None] * np.broadcast_to(np.cos(angle), right.shape)
    state = state + state_with_streaks(organs, along, len(angle))
    base_cap = _cap_into_parent(spine, radius[:, 0] * (1.0 + flare[:, 0]))
    # The tip of a petiole is drawn out under the blade, as its midrib.
    reach_out = np.minimum(tip, spine.lengths) * (0.6 + 2.4 * channel)
    lower = -0.35 * channel * np.minimum(tip, spine.lengths)
    tip_cap = Cap(np.stack([0.6 * reach_out, 0.7 * lower], axis=1), np.stack([reach_out, lower], axis=1), 0.7)
    return sweep_rings(spine, Rings(_slant_feet(spine, along, up), right, up, v, state), base_cap, tip_cap)


def mesh_peduncles(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Build fruit stalks: ribbed, with a collar at the foot where they break off, widening to the calyx.

    Measures: radius_m (base, above the collar, over the ribs), radius_tip_m, ribs (count), seed, state_mean.
    """
    base, tip = read_positive(organs, "radius_m"), read_positive(organs, "radius_tip_m")
    spine = organ_spines(organs, subdivisions(16, detail, 10))
    # Rings at the foot, the collar and the furrow above it; then at even distances.
    foot = np.minimum(base, 0.12 * spine.lengths)
    v, along = _rows([0.0, 1.3, 1.8, 2.4], 0.075, foot, spine, subdivisions(5, detail, 2))
    fraction, high = along / spine.lengths[:, None], along / foot[:, None]
    collar = (
        0.05 * np.exp(-((high / 1.2) ** 2))
        + 0.16 * np.exp(-(((high - 1.3) / 0.45) ** 2))
        - 0.08 * np.exp(-(((high - 1.8) / 0.3) ** 2))
    )
    radius = base[:, None] * (1.0 + collar) + (tip - base)[:, None] * fraction**3
    # The grid is rotated with the ribs, so that every point is on a rib or in a furrow.
    sides, ribs = subdivisions(15, detail, 6), np.round(read_measure(organs, "ribs", _RIBS))
    draw = hash_uniform(read_measure(organs, "seed", 0.0), 111, 2)
    angle = ring_angles(sides)
    furrow = 0.5 - 0.5 * np.cos(ribs[:, None] * angle)
    uneven = 1.0 + 0.3 * np.cos(angle + 2.0 * np.pi * draw[:, 1:])
    above_collar = np.clip((high - 0.5) / 2.0, 0.0, 1.0)
    reach = 1.0 - _RIB_DEPTH * above_collar[..., None] * (furrow * uneven)[:, None, :]
    rotated = angle + 2.0 * np.pi * draw[:, :1]
    right, up = centre_rings(reach * np.sin(rotated)[:, None, :], reach * np.cos(rotated)[:, None, :], radius)
    # The furrow above the collar is corky; ribs are paler than the furrows between them.
    state = 0.15 * (furrow - 0.5)[:, None, :] * above_collar[..., None]
    state = state - 0.2 * np.exp(-(((high - 1.8) / 0.4) ** 2))[..., None]
    state = state + state_with_streaks(organs, along, sides)
    caps = _cap_into_parent(spine, radius[:, 0]), round_cap(tip, spine.lengths)
    return sweep_rings(spine, Rings(_slant_feet(spine, along, up), right, up, v, state), *caps)


# Profile of a scar from its foot over the side and the rim into the hollow: height over the length of the
# curve, radius over the organ's, state of a fresh and of a dry cut, and how much a ring follows the slant and
# the ragged edge of the cut; chosen from photographs of harvested nodes. The side is bark (state 1), the rim
# cortex with its green ring (2/3), the middle pale pith (1/3), and all of the face dries to brown (0).
_CUT: Final = np.array(
    [
        [0.0, 1.1, 1.0, 1.0, 0.0],
        [0.5, 0.95, 1.0, 1.0, 0.3],
        [0.94, 1.0, 0.95, 0.8, 1.0],
        [1.0, 0.93, 0.67, 0.2, 1.0],
        [0.95, 0.72, 0.52, 0.13, 1.0],
        [0.85, 0.4, 0.36, 0.05, 0.8],
    ]
)
_DRY_CUTS: Final = 2.0  # chosen: exponent of the dryness of cuts; most are weeks old and nearly dry


def mesh_cuts(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Build scars of harvested fruit: a stub cut at a slant, whose green rim and pale middle dry to brown.

    Measures: radius_m (of the rim), seed.
    """
    radius, seed = read_positive(organs, "radius_m"), read_measure(organs, "seed", 0.0)
    spine = organ_spines(organs, 4)
    height, profile, fresh, dried, slanted = _CUT.T
    # A low stub has no waist below its rim.
    squat = np.minimum(1.0, 2.0 * spine.lengths / radius)[:, None]
    width = np.where(profile > 0.9, 1.0 + (profile - 1.0) * squat, profile)
    angle = ring_angles(subdivisions(10, detail, 6))
    draw = hash_uniform(seed, 131, 5)
    # The slant of the knife, up to 15 degrees (chosen), but no more than a fifth of the stub.
    slant = np.minimum(np.tan(0.26 * draw[:, 0]) * radius, 0.2 * spine.lengths)
    phase = 2.0 * np.pi * draw
    lean = np.cos(angle + phase[:, 1:2])
    ragged = 0.05 * np.cos(3.0 * angle + phase[:, 2:3]) * np.cos(angle + phase[:, 3:4])
    along = (spine.lengths[:, None] * height)[..., None] + np.einsum(
        "n,nr,nc->nrc", slant, slanted * width, lean
    )
    reach = 1.0 + slanted[:, None] * ragged[:, None, :]
    right, up = centre_rings(reach * np.sin(angle), reach * np.cos(angle), radius[:, None] * width)
    dryness = 1.0 - draw[:, 4:] ** _DRY_CUTS
    state = np.broadcast_to((fresh + dryness * (dried - fresh))[..., None], right.shape)
    # The middle of the hollow is a little deeper.
    deeper = np.stack([-0.03 * spine.lengths, 0.0 * radius], axis=1)
    hollow = Cap(deeper, 2.0 * deeper, 0.5, embedded=False)
    rings = Rings(along, right, up, np.linspace(0.0, 1.0, len(height)), state)
    return sweep_rings(spine, rings, _cap_into_parent(spine, width[:, 0] * radius), hollow)


def _rows(
    knots: Sequence[float], fraction: float, foot: FloatArray, spine: Spines, pieces: int
) -> tuple[FloatArray, FloatArray]:
    """`(r,)` v and `(n, r)` metres along of the rings: at the knots of the foot, then in equal pieces.

    `knots` are over the length of the foot, the first 0; `fraction` is that of the whole length that a foot
    usually takes, for v, which is the same for all stalks.
    """
    steps = np.arange(1, pieces + 1) / pieces
    near = foot[:, None] * np.array(knots)
    far = near[:, -1:] + (spine.lengths[:, None] - near[:, -1:]) * steps
    v = fraction * np.array(knots)
    return np.concatenate([v, v[-1] + (1.0 - v[-1]) * steps]), np.concatenate([near, far], axis=1)


def _foot_pitch(spine: Spines) -> FloatArray:
    """`(n,)` radians by which feet turn to the lower side of the stalks to enter their parents horizontally.

    The parent is taken to be upright, as nodes are; if it is not, it hides the foot anyway.
    """
    tangent = cross(spine.normals[:, 0], spine.binormals[:, 0])
    slope = np.arcsin(np.clip(tangent[:, 2], -1.0, 1.0))
    # The upper side may point down, if a stalk is twisted about its axis.
    upright = np.array([0.0, 0.0, 1.0]) - tangent[:, 2:] * tangent
    level = np.einsum("ni,ni->n", upright, spine.normals[:, 0])
    return np.clip(slope * level / np.maximum(np.linalg.norm(upright, axis=1), 1e-9), -_LEAN, _LEAN)


def _slant_feet(spine: Spines, along: FloatArray, up: FloatArray) -> FloatArray:
    """`(n, r, c)` metres along: the first ring is upright in the parent's side, the second half as much.

    It even leans over a little, so that the lower edge of the foot is deeper, where a node is narrower.
    """
    slant = np.tan(np.minimum(_foot_pitch(spine) + _UNDER, _LEAN))[:, None] * up[:, 0]
    # Rings must not touch each other.
    highest, gap = np.abs(slant).max(axis=1).clip(1e-9), np.diff(along[:, :3], axis=1)
    slant = slant * np.minimum(1.0, np.minimum(1.2 * gap[:, 0], 1.4 * gap[:, 1]) / highest)[:, None]
    result = np.repeat(along[..., None], up.shape[2], axis=2)
    result[:, 0] += slant
    result[:, 1] += 0.5 * slant
    return result


def _cap_into_parent(spine: Spines, radius: FloatArray) -> Cap:
    """A cap that enters the parent horizontally; `radius` is that of the feet, `(n,)` metres."""
    pitch, length = _foot_pitch(spine), np.minimum(radius, spine.lengths)[:, None]
    inward = length * np.stack([np.cos(pitch), np.sin(pitch)], axis=1)
    return Cap(0.5 * inward, 0.9 * inward, embedded=False)

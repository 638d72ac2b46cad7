"""Stems, nodes, side shoots, petioles, fruit stalks and scars: round bodies along a centreline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.body import Bodies, fineness, solids
from pepperscene.geometry.measures import measure, size
from pepperscene.geometry.noise import hashed, smooth_field
from pepperscene.geometry.spine import Spines, spines
from pepperscene.grammar.plant import Organ

_CAP = 0.6  # chosen: a cap's height over its radius; it reaches into the parent and closes the joint
_CAP_RING = (0.65, 0.75)  # chosen: part of the cap's height, part of the radius: a rounded end
_STATE = 0.6  # chosen: greenness of organs whose measures do not say
_STATE_SPREAD = 0.12  # chosen: streaks of lighter and darker green along a stem


def internodes(organs: Sequence[Organ], detail: float) -> Bodies:
    """Main stem sections: angular, with four or five ridges that fade into the nodes.

    Measures: radius_m (base, over the ridges), radius_tip_m, groove_m (depth between ridges), seed.
    """
    base, tip = size(organs, "radius_m"), size(organs, "radius_tip_m")
    part, sides = np.linspace(0.0, 1.0, fineness(3, detail, 2) + 1), fineness(20, detail, 8)
    radius = base[:, None] + (tip - base)[:, None] * part
    # Ridges: as many as the seed says, each as wide as a groove, running along with the stem.
    draw = hashed(measure(organs, "seed", 0.0), 101, 2)
    ridges = np.where(draw[:, :1] < 0.5, 4, 5)
    angle = 2.0 * np.pi * (np.arange(sides) / sides + draw[:, 1:])
    depth = np.clip(measure(organs, "groove_m", 0.0), 0.0, 0.5 * np.minimum(base, tip))
    groove = 0.5 - 0.5 * np.cos(ridges * angle)
    fading = np.sin(np.pi * part) ** 0.5
    rings = radius[..., None] - (depth[:, None, None] * fading[:, None]) * groove[:, None, :]
    # Grooves are darker than ridges.
    state = np.broadcast_to(0.2 * (groove[:, None, :] - 0.5), rings.shape)
    return _tubes(organs, part, rings, fading[:, None] * state)


def nodes(organs: Sequence[Organ], detail: float) -> Bodies:
    """Swellings between two stem sections.

    Measures: radius_m (widest), radius_end_m (both ends), seed.
    """
    widest, end = size(organs, "radius_m"), size(organs, "radius_end_m")
    part, sides = np.linspace(0.0, 1.0, fineness(6, detail, 2) + 1), fineness(10, detail, 6)
    radius = end[:, None] + (widest - end)[:, None] * np.sin(np.pi * part) ** 2
    rings = np.repeat(radius[..., None], sides, axis=2)
    # A node is paler than the stem, the more the wider it is.
    paler = np.broadcast_to(-0.2 * np.sin(np.pi * part)[:, None] ** 2, rings.shape)
    return _tubes(organs, part, rings, paler)


def stalks(organs: Sequence[Organ], detail: float) -> Bodies:
    """Petioles and side shoots: a swollen foot, a slow taper, a shallow channel above.

    Measures: radius_m (base), radius_tip_m.
    """
    base, tip = size(organs, "radius_m"), size(organs, "radius_tip_m")
    part, sides = np.linspace(0.0, 1.0, fineness(8, detail, 3) + 1), fineness(7, detail, 5)
    # The foot is a quarter wider (chosen) within its first tenth.
    radius = (base[:, None] + (tip - base)[:, None] * part) * (1.0 + 0.25 * np.exp(-part / 0.06))
    # The channel is a fifth of the radius deep (chosen) and as wide as one radius.
    angle = 2.0 * np.pi * np.arange(sides) / sides
    channel = np.exp(-(((angle + np.pi) % (2.0 * np.pi) - np.pi) ** 2) / (2.0 * 0.4**2))
    depth = 0.2 * (organs[0].kind == "petiole") * np.sin(np.pi * np.clip(part + 0.05, 0.0, 1.0)) ** 0.5
    rings = radius[..., None] * (1.0 - depth[:, None] * channel)
    return _tubes(organs, part, rings, np.zeros_like(rings))


def peduncles(organs: Sequence[Organ], detail: float) -> Bodies:
    """Fruit stalks: ribbed, even for most of their length, widening towards the calyx.

    Measures: radius_m (base), radius_tip_m, seed.
    """
    base, tip = size(organs, "radius_m"), size(organs, "radius_tip_m")
    part, sides = np.linspace(0.0, 1.0, fineness(8, detail, 3) + 1), fineness(10, detail, 6)
    # The base sits on a collar, the abscission zone; the upper third widens.
    radius = base[:, None] * (1.0 + 0.2 * np.exp(-part / 0.05)) + (tip - base)[:, None] * part**3
    angle = 2.0 * np.pi * (np.arange(sides) / sides + hashed(measure(organs, "seed", 0.0), 111, 1))
    ribs = 0.05 * np.cos(5.0 * angle)  # chosen: five faint ribs
    rings = radius[..., None] * (1.0 + ribs[:, None, :])
    return _tubes(organs, part, rings, np.zeros_like(rings))


def cuts(organs: Sequence[Organ], detail: float) -> Bodies:
    """Scars where fruit was harvested: a short stub with a raised rim and a sunken, corky middle.

    Measures: radius_m.
    """
    radius, sides = size(organs, "radius_m"), fineness(12, detail, 6)
    spine = _spines(organs, 2)
    # Profile from the foot over the side and the rim into the hollow: height over the curve's length, radius
    # over the organ's, state (0 the corky middle, 1 the green rim).
    height, width, state = np.array(
        [
            [0.0, 1.0, 1.0],
            [0.7, 1.03, 1.0],
            [0.93, 1.0, 0.95],
            [1.0, 0.9, 0.8],
            [0.96, 0.72, 0.45],
            [0.8, 0.4, 0.1],
        ]
    ).T
    shape = (len(organs), len(height), sides)
    along = np.broadcast_to((spine.lengths[:, None] * height)[..., None], shape)
    rings = np.broadcast_to((radius[:, None] * width)[..., None], shape)
    ends = (-0.3 * spine.lengths, 0.75 * spine.lengths)
    one = np.ones((len(organs), 1))
    return solids(
        spine, along, rings, ends, np.hstack([one, np.repeat(one * state, sides, axis=1), 0.0 * one])
    )


def _tubes(
    organs: Sequence[Organ],
    part: NDArray[np.float64],
    radius: NDArray[np.float64],
    state: NDArray[np.float64],
) -> Bodies:
    """Tubes with rounded caps.

    Args:
        organs: n of one kind.
        part: `(r,)` where the rings lie, 0 at the base, 1 at the tip.
        radius: `(n, r, c)` metres.
        state: `(n, r, c)` difference to the organ's mean state.
    """
    spine = _spines(organs, max(8, 2 * len(part)))
    along = np.broadcast_to((spine.lengths[:, None] * part)[..., None], radius.shape)
    # A cap goes on as a smaller ring; its height is never more than the tube is long.
    first, last = radius[:, :1], radius[:, -1:]
    foot = _CAP * np.minimum(first.mean(axis=2, keepdims=True), spine.lengths[:, None, None])
    head = _CAP * np.minimum(last.mean(axis=2, keepdims=True), spine.lengths[:, None, None])
    high, wide = _CAP_RING
    along = np.concatenate([along[:, :1] - high * foot, along, along[:, -1:] + high * head], axis=1)
    radius = np.concatenate([wide * first, radius, wide * last], axis=1)
    ends = (-foot[:, 0, 0], spine.lengths + head[:, 0, 0])
    # Greenness varies in streaks, long along the organ and narrow around it.
    state = np.pad(state, ((0, 0), (1, 1), (0, 0)), mode="edge").reshape(len(organs), -1)
    state = np.pad(state, ((0, 0), (1, 1)), mode="edge")
    mean = measure(organs, "state_mean", _STATE)[:, None]
    return solids(spine, along, radius, ends, mean + state + _streaks(organs, along))


def _streaks(organs: Sequence[Organ], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n, 2 + r * c)` smooth variation of the state along and around tubes."""
    n, _, sides = along.shape
    angle = 2.0 * np.pi * np.arange(sides) / sides
    # On a unit cylinder that is 40 mm (chosen) of stem high, so that there is no seam.
    around = np.broadcast_to(np.stack([np.cos(angle), np.sin(angle)], axis=-1), (*along.shape, 2))
    points = np.concatenate([around, along[..., None] / 0.04], axis=-1).reshape(n, -1, 3)
    field = smooth_field(points, measure(organs, "seed", 0.5), 121, 4.0).reshape(along.shape)
    # It fades at both ends, so that no ring shows where organs meet.
    fading = np.sin(np.pi * np.linspace(0.0, 1.0, along.shape[1]))[:, None] ** 0.5
    spread = measure(organs, "state_spread", _STATE_SPREAD)[:, None]
    return np.pad(spread * (fading * field).reshape(len(field), -1), ((0, 0), (1, 1)))


def _spines(organs: Sequence[Organ], steps: int) -> Spines:
    """The organs' centrelines."""
    return spines([organ.curve for organ in organs], [organ.up for organ in organs], steps)

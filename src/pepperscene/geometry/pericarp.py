"""Bell-pepper fruit and the calyx that sits on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.body import Bodies, fineness, solids
from pepperscene.geometry.measures import measure, size
from pepperscene.geometry.noise import hashed, signed, smooth_field
from pepperscene.geometry.spine import Spines, spines
from pepperscene.grammar.plant import Organ

_SQUARENESS = 3.0  # chosen: exponent of the profile's superellipse; 2 is round, bell peppers are blocky
_FURROW = 0.17  # chosen: depth of a typical furrow over the radius, where it is deepest
_CAVITY = 0.2  # chosen: depth of a deep stalk cavity over the length
_FURROW_WIDTH = 0.3  # chosen: rounds the furrows; 0 is a sharp crease, 1 a sine


@dataclass(frozen=True, eq=False)
class FruitWalls:
    """Fruit walls as rings about their axes.

    Attributes:
        spine: the axes, stalk end to blossom end.
        along: `(n, r, c)` metres from the stalk end; the shoulders lie below zero.
        radius: `(n, r, c)` metres from the axis.
        ends: `(n,)` and `(n,)` metres: where the axis meets the stalk cavity and the blossom end.
    """

    spine: Spines
    along: NDArray[np.float64]
    radius: NDArray[np.float64]
    ends: tuple[NDArray[np.float64], NDArray[np.float64]]

    def height(self, fruit: int, radius: NDArray[np.float64], every: int) -> NDArray[np.float64]:
        """Where the stalk side of one fruit lies, metres along its axis.

        Args:
            fruit: which.
            radius: `(q, c // every)` metres from the axis.
            every: the columns are every so many of the wall's.
        """
        found = np.empty_like(radius)
        for column in range(radius.shape[1]):
            wall = self.radius[fruit, :, column * every]
            top = 1 + int(np.argmax(wall))
            at = np.concatenate([[0.0], wall[:top]])
            level = np.concatenate([self.ends[0][fruit : fruit + 1], self.along[fruit, :top, column * every]])
            found[:, column] = np.interp(radius[:, column], at, level)
        return found


def fruit_columns(detail: float) -> int:
    """Vertices around a fruit: a multiple of four, so that calyces can share them."""
    return 4 * fineness(10, detail, 3)


def fruit_walls(organs: Sequence[Organ], detail: float) -> FruitWalls:
    """Blocky fruit with lobes: a stalk cavity between shoulders, furrows, a dimpled blossom end.

    Measures: length_m and diameter_m (greatest, of the whole body), lobes (count), lobe_depth (1 is typical,
    0 has no furrows), shoulder (0 has no stalk cavity, 1 a deep one), taper (diameter near the blossom end
    over the greatest), seed.
    """
    n, seed = len(organs), measure(organs, "seed", 0.0)
    length, diameter = size(organs, "length_m"), size(organs, "diameter_m")
    lobes = np.clip(np.round(measure(organs, "lobes", 4.0)), 1, 6)[:, None, None]
    depth = _FURROW * np.clip(measure(organs, "lobe_depth", 1.0), 0.0, 3.0)[:, None, None]
    sink = _CAVITY * np.clip(measure(organs, "shoulder", 0.5), 0.0, 2.0)[:, None]
    taper = 1.0 - np.clip(measure(organs, "taper", 0.85), 0.2, 1.2)[:, None]
    rings, columns = fineness(25, detail, 6), fruit_columns(detail)
    # A mean profile without lobes, in units of half the length and of the radius.
    width, level, middle = _profile(sink, taper, diameter / length, rings)
    width, level, middle = width[..., None], level[..., None], middle[..., None]
    # Furrows between lobes of unequal width: narrow and deep at both ends, faint at mid-height.
    draw = signed(seed, 301, 8)[:, :, None, None]
    angle = 2.0 * np.pi * np.arange(columns) / columns + np.pi * draw[:, 0]
    warped = (
        angle + 0.16 * np.sin(angle + np.pi * draw[:, 1]) + 0.1 * np.sin(2.0 * angle + np.pi * draw[:, 2])
    )
    crest = np.sqrt(np.cos(0.5 * lobes * warped) ** 2 + _FURROW_WIDTH**2)
    furrow = (np.sqrt(1.0 + _FURROW_WIDTH**2) - crest) / (np.sqrt(1.0 + _FURROW_WIDTH**2) - _FURROW_WIDTH)
    strength = 0.45 + 0.55 * np.abs(middle) ** 1.5
    uneven = (
        1.0 + 0.03 * np.cos(angle + np.pi * draw[:, 3]) + 0.025 * np.cos(2.0 * angle + np.pi * draw[:, 4])
    )
    radius = width * uneven * (1.0 - depth * furrow * strength)
    # The furrows cut into shoulders and blossom end; one lobe reaches further down than the others.
    ring = np.clip(1.0 - ((width - 0.7) / 0.7) ** 2, 0.0, 1.0)
    shoulders, blossom = np.clip(-middle, 0.0, 1.0), np.clip(middle, 0.0, 1.0)
    level = level + ring * furrow * depth * (0.7 * shoulders**3 - 0.8 * blossom**2)
    level = level + 0.07 * (1.0 + draw[:, 5]) * ring * blossom**3 * np.cos(angle + np.pi * draw[:, 6])
    # Small dents.
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = np.concatenate(
        [width[..., None] * direction, np.broadcast_to(middle[..., None], (n, rings, columns, 1))], axis=-1
    )
    dents = smooth_field(points.reshape(n, -1, 3), seed, 311, 1.6).reshape(n, rings, columns)
    radius = radius * (1.0 + 0.012 * dents)
    # To the measured size: callipers across the outline seen along the axis, and from top to bottom.
    scale = diameter / _calliper(np.max(radius, axis=1))
    low, high = level.min(axis=(1, 2)), level.max(axis=(1, 2))
    stretch = length / (high - low)
    spine = spines([organ.curve for organ in organs], [organ.up for organ in organs], fineness(12, detail, 4))
    # The stalk's foot is the curve's base.
    foot, blossom_end = _pole(level[:, :2], width[:, :2]), _pole(level[:, :-3:-1], width[:, :-3:-1])
    along = (level - foot[:, None, None]) * stretch[:, None, None]
    ends = (np.zeros(n), (blossom_end - foot) * stretch)
    return FruitWalls(spine, along, radius * scale[:, None, None], ends)


def fruits(organs: Sequence[Organ], walls: FruitWalls) -> Bodies:
    """Closed fruit out of their walls, with the ripeness of each point as its state.

    Measures: ripeness (mean, 0 unripe to 1 ripe), ripeness_spread (standard deviation over the fruit), seed.
    """
    n, _, columns = walls.along.shape
    seed, ripeness = measure(organs, "seed", 0.0), measure(organs, "ripeness", 0.0)
    # Patches on the fruit, one and a half times wider than tall (chosen), and a trend from shoulder to tip,
    # stronger in some fruit than in others.
    angle = 2.0 * np.pi * np.arange(columns) / columns
    half = 0.5 * measure(organs, "diameter_m")[:, None, None]
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = np.concatenate(
        [(walls.radius / half)[..., None] * direction, (1.5 * walls.along / half)[..., None]], axis=-1
    ).reshape(n, -1, 3)
    axis = np.zeros((n, 1, 3))
    first, last = axis.copy(), axis.copy()
    first[:, 0, 2], last[:, 0, 2] = (1.5 * end / half[:, 0, 0] for end in walls.ends)
    points = np.concatenate([first, points, last], axis=1)
    trend = points[..., 2] - points[..., 2].mean(axis=1, keepdims=True)
    trend /= trend.std(axis=1, keepdims=True)
    field = smooth_field(points, seed, 321, 2.2) + (0.3 + hashed(seed, 325, 1)) * trend
    field -= field.mean(axis=1, keepdims=True)
    field /= field.std(axis=1, keepdims=True)
    state = ripeness[:, None] + measure(organs, "ripeness_spread", 0.0)[:, None] * field
    return solids(walls.spine, walls.along, walls.radius, walls.ends, state)


def calyces(organs: Sequence[Organ], under: Sequence[int], walls: FruitWalls | None, detail: float) -> Bodies:
    """Toothed plates that lie on the fruit's stalk cavity and widen the fruit stalk's end.

    Measures: radius_m (to the tips of the teeth), seed.

    Args:
        organs: n calyces.
        under: the number in `walls` of the fruit below each, -1 for a calyx without fruit, which lies flat.
        walls: of the fruit, or None when there is none.
        detail: fineness of the mesh, 1 as designed.
    """
    n, radius, seed = len(organs), size(organs, "radius_m"), measure(organs, "seed", 0.0)
    every = 2
    columns = fruit_columns(detail) // every
    # Five or six pointed teeth of unequal length.
    draw = hashed(seed, 401, 4)
    teeth = np.where(draw[:, :1] < 0.6, 5, 6)
    angle = 2.0 * np.pi * (np.arange(columns) / columns + draw[:, 1:2])
    tooth = 1.0 - np.abs(np.sin(0.5 * teeth * angle)) ** 0.7
    uneven = 1.0 + 0.08 * np.cos(angle + 2.0 * np.pi * draw[:, 2:3])
    rim = radius[:, None] * (0.72 + 0.28 * tooth) * uneven / 1.08
    # Profile from the stalk over the upper side and the rim back along the lower side, which is sunk into the
    # fruit: part of the rim's radius, height over the fruit as a part of the calyx's radius.
    part, height = np.array(
        [
            [0.16, 0.5], [0.24, 0.3], [0.36, 0.17], [0.6, 0.11], [0.85, 0.1], [0.98, 0.08], [1.0, 0.03],
            [0.97, -0.03], [0.6, -0.06],
        ]
    ).T  # fmt: skip
    width = part[:, None] * rim[:, None, :]
    floor = np.zeros_like(width)
    curves, ups = [organ.curve for organ in organs], [organ.up for organ in organs]
    own = spines(curves, ups, 2)
    spine = Spines(own.points.copy(), own.normals.copy(), own.across.copy(), own.lengths.copy())
    if walls is not None:
        for index, fruit in enumerate(under):
            if fruit < 0:
                continue
            # The fruit's own axis and surface, so that the plate hugs the shoulders.
            axis = walls.spine
            last = axis.points.shape[1] - 1
            spine.points[index] = axis.points[fruit, [0, last // 2, last]]
            spine.normals[index] = axis.normals[fruit, 0]
            spine.across[index] = axis.across[fruit, 0]
            spine.lengths[index] = axis.lengths[fruit]
            floor[index] = walls.height(fruit, width[index], every)
    along = floor - height[:, None] * radius[:, None, None]
    ends = (along[:, 0].mean(axis=1) - 0.05 * radius, along[:, -1].mean(axis=1))
    mean = measure(organs, "state_mean", 0.5)[:, None]
    # Teeth are greener than the swollen ring around the stalk.
    state = np.repeat(0.3 * (part - 0.6)[None, :], n, axis=0)
    state = mean + np.hstack([state[:, :1], np.repeat(state, columns, axis=1), state[:, -1:]])
    return solids(spine, along, width, ends, state)


def _profile(
    sink: NDArray[np.float64], taper: NDArray[np.float64], slimness: NDArray[np.float64], rings: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Mean profiles, cut into rings at equal distances along the wall.

    Args:
        sink: `(n, 1)` depth of the stalk cavity over the length.
        taper: `(n, 1)` lost part of the diameter.
        slimness: `(n,)` diameter over length.
        rings: how many.

    Returns:
        `(n, rings)` each: distance from the axis over the greatest, height over half the length, and the same
        height before the ends were sunk in, -1 to 1.
    """
    # A superellipse, sampled well both near the axis and at the corner.
    near = np.arcsin(np.linspace(0.0, 0.85, 60) ** (0.5 * _SQUARENESS))
    quarter = np.concatenate([near, np.linspace(near[-1], 0.5 * np.pi, 60)[1:]])
    turn = np.concatenate([quarter, np.pi - quarter[-2::-1]])
    width = np.clip(np.sin(turn), 0.0, 1.0) ** (2.0 / _SQUARENESS)
    middle = -np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** (2.0 / _SQUARENESS)
    # The ends sink in around the axis: a wide cavity at the stalk, a smaller dimple at the blossom end.
    cavity = np.clip(1.0 - (width / 0.75) ** 2, 0.0, 1.0) ** 2 * (middle < 0.0)
    dimple = np.clip(1.0 - (width / 0.6) ** 2, 0.0, 1.0) ** 2 * (middle > 0.0)
    level = middle + 2.0 * sink * cavity - 0.16 * dimple
    narrowing = 1.0 - taper * (0.5 * (middle + 1.0)) ** 1.5
    wall = width * narrowing
    step = np.hypot(slimness[:, None] * np.diff(wall, axis=1), np.diff(level, axis=1))
    walked = np.concatenate([np.zeros((len(step), 1)), np.cumsum(step, axis=1)], axis=1)
    found = []
    for row, distance in enumerate(walked):
        at = np.linspace(0.0, distance[-1], rings + 2)[1:-1]
        found.append([np.interp(at, distance, line) for line in (wall[row], level[row], middle)])
    result = np.array(found)
    return result[:, 0], result[:, 1], result[:, 2]


def _calliper(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n,)` greatest width of star-shaped outlines, given as `(n, c)` radii at equal angles."""
    angle = 2.0 * np.pi * np.arange(outline.shape[1]) / outline.shape[1]
    across = np.cos(angle[:, None] - angle)
    reach = (outline[:, None, :] * across).max(axis=2)
    back = (-outline[:, None, :] * across).max(axis=2)
    return (reach + back).max(axis=1)


def _pole(level: NDArray[np.float64], width: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n,)` height on the axis of a wall that meets it at a right angle.

    Args:
        level: `(n, 2, c)` heights of the ring nearest the axis and of the next.
        width: `(n, 2, 1)` their mean distances from the axis.
    """
    # A parabola through both rings.
    near, far = level.mean(axis=2).T
    square = width[..., 0].T ** 2
    return near - (far - near) * square[0] / (square[1] - square[0])

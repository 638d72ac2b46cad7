"""The wall of a fruit: its shape in its own measures, before it is hung anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.bodies import fineness
from pepperscene.geometry.organ_arrays import hashed, organ_measure, signed, size, smooth_field
from pepperscene.grammar.plant import Organ

FloatArray = NDArray[np.float64]

# Chosen by eye, beside photographs of blocky and of pointed sweet peppers and of round tomatoes.
_FURROW = 0.17  # depth of a typical furrow over the radius, where it is deepest
_FURROW_AT_EQUATOR = 0.42  # part of that depth that is left at the widest place
_FURROW_WIDTH = (
    0.22,
    0.75,
)  # rounds the furrows at the ends and at the widest place; 0 is a crease, 1 a sine
_CAVITY = 0.4  # depth of a deep stalk cavity over the radius
_DIMPLE = 0.2  # depth of the blossom end's dimple over the radius
_ROUND, _BLOCKY = 2.0, 4.0  # exponents of the profile's superellipse: without furrows, with deep ones
_POINTED = (1.22, 1.45)  # exponents of a drawn-out tip, of width and height: a cone that swells a little
_SCAR = (0.05, 0.025)  # radius and height over the fruit's radius of the button that the style leaves
_BENT_FROM = 0.3  # part of the axis after which it bends


@dataclass(frozen=True, eq=False)
class Pericarps:
    """Walls of n fruit as rings about straight axes that begin at their stalks' feet.

    Attributes:
        along: `(n, r, c)` metres from the stalk's foot towards the blossom end; shoulders lie below zero.
        radius: `(n, r, c)` metres from the axis, at c equal angles from the fruit's upper side.
        end: `(n,)` metres: where the axis meets the blossom end.
        v: `(n, r)` place along the wall, 0 at the stalk's foot, 1 at the blossom end.
        widest: `(n,)` ring that reaches furthest.
        bend: `(n, 2)` radians by which the blossom end is bent: to the upper side, to the right.
    """

    along: FloatArray
    radius: FloatArray
    end: FloatArray
    v: FloatArray
    widest: NDArray[np.intp]
    bend: FloatArray

    def bent(self, along: FloatArray, up: FloatArray, right: FloatArray) -> FloatArray:
        """`(n, q, 3)` metres up, to the right and along: points about the straight axes once these are bent.

        The axis is straight at first and goes on as an arc, its length kept.
        """
        straight = _BENT_FROM * self.end[:, None]
        far = np.clip(along - straight, 0.0, None)
        angle = np.linalg.norm(self.bend, axis=1)[:, None]
        side = self.bend / np.where(angle > 0.0, angle, 1.0)
        turn = angle * far / (self.end[:, None] - straight)
        # sin(x) / x and (1 - cos(x)) / x hold where nothing bends as well.
        forward = far * np.sinc(turn / np.pi)
        aside = far * 0.5 * turn * np.sinc(0.5 * turn / np.pi) ** 2
        sine, cosine = np.sin(turn), np.cos(turn)
        reach = side[:, :1] * up + side[:, 1:] * right
        across = aside + (cosine - 1.0) * reach
        return np.stack(
            [
                up + side[:, :1] * across,
                right + side[:, 1:] * across,
                np.minimum(along, straight) + forward - sine * reach,
            ],
            axis=-1,
        )


def fruit_columns(detail: float) -> int:
    """Vertices around a fruit."""
    return 4 * fineness(9, detail, 3)


def pericarps(organs: Sequence[Organ], detail: float) -> Pericarps:
    """Fruit with lobes: a stalk cavity between shoulders, furrows, a dimple and a scar at the blossom end.

    Measures: length_m (along the axis) and diameter_m (greatest, of the whole body), lobes (count),
    lobe_depth (1 is typical, 0 has no furrows and is round instead of blocky), shoulder (0 has no stalk
    cavity, 1 a deep one), taper (diameter near the blossom end over the greatest), point (0 blocky, 1 drawn
    out to a point), bend_rad (of the axis, from stalk to tip), seed.
    """
    n, seed = len(organs), organ_measure(organs, "seed", 0.0)
    length, diameter = size(organs, "length_m"), size(organs, "diameter_m")
    lobes = np.clip(np.round(organ_measure(organs, "lobes", 4.0)), 1, 6)[:, None, None]
    lobed = np.clip(organ_measure(organs, "lobe_depth", 1.0), 0.0, 2.5)
    point = np.clip(organ_measure(organs, "point", 0.0), 0.0, 1.0)[:, None, None]
    # What lets a fruit look blocky: without furrows it is round and even.
    blocky = (lobed**2 / (lobed**2 + 0.1))[:, None, None]
    profile = _profile(organs, blocky[..., 0], diameter / length, fineness(24, detail, 6))
    width, level, top, low = (
        part[..., None] for part in (profile.width, profile.level, profile.top, profile.low)
    )
    # Lobes of unequal width.
    columns = fruit_columns(detail)
    draw = signed(seed, 301, 8)[:, :, None, None]
    angle = 2.0 * np.pi * np.arange(columns) / columns
    turned = angle + np.pi * draw[:, 0]
    warped = (
        turned + 0.16 * np.sin(turned + np.pi * draw[:, 1]) + 0.1 * np.sin(2.0 * turned + np.pi * draw[:, 2])
    )
    lobe = lobes * warped / (2.0 * np.pi)
    # Furrows between them: narrow and deep at both ends, faint and broad in the middle, no two alike.
    ends = np.maximum(top, low) ** 2
    narrow, broad = _FURROW_WIDTH
    rounding = broad + (narrow - broad) * ends
    crest = np.sqrt(np.cos(np.pi * lobe) ** 2 + rounding**2)
    furrow = (np.sqrt(1.0 + rounding**2) - crest) / (np.sqrt(1.0 + rounding**2) - rounding)
    depth = _FURROW * lobed[:, None, None] * (1.0 + 0.3 * _each(lobe + 0.5, lobes, signed(seed, 302, 6)))
    fading = 1.0 - 0.75 * point * low
    strength = (_FURROW_AT_EQUATOR + (1.0 - _FURROW_AT_EQUATOR) * ends) * fading
    even = 0.25 + 0.75 * blocky
    oval = 0.03 * np.cos(turned + np.pi * draw[:, 3]) + 0.025 * np.cos(2.0 * turned + np.pi * draw[:, 4])
    bulge = 0.035 * _each(lobe, lobes, signed(seed, 303, 6))
    radius = width * (1.0 + even * (oval + bulge)) * (1.0 - np.clip(depth, 0.0, 0.5) * furrow * strength)
    # They cut into shoulders and blossom end, so that each lobe has a shoulder and a foot of its own, some
    # higher than others.
    shoulder, foot = _ring(width, 0.7, 0.62) * top**3, _ring(width, 0.58, 0.58) * low**2 * (1.0 - point)
    level = level + (diameter / length)[:, None, None] * (
        shoulder * (1.4 * depth * furrow + even * 0.05 * _each(lobe, lobes, signed(seed, 304, 6)))
        - foot * (1.5 * depth * furrow + even * 0.07 * _each(lobe, lobes, signed(seed, 305, 6)))
    )
    # Small dents.
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    slimness = (length / diameter)[:, None, None]
    points = np.empty((n, width.shape[1], columns, 3))
    points[..., :2] = width[..., None] * direction
    points[..., 2] = slimness * level
    dents = smooth_field(points.reshape(n, -1, 3), seed, 311, 1.6).reshape(radius.shape)
    radius = radius * (1.0 + 0.012 * even * dents)
    # To the measured size: callipers across the outline seen along the axis, and from top to bottom.
    radius = radius * (diameter / _calliper(np.max(radius, axis=1)))[:, None, None]
    # The stalk's foot is where along is zero; a button closes the blossom end.
    start, end = profile.foot, level[:, -1].mean(axis=1) + _SCAR[1] * diameter / length
    low_end, high_end = np.minimum(level.min(axis=(1, 2)), start), np.maximum(level.max(axis=(1, 2)), end)
    stretch = length / (high_end - low_end)
    bend = organ_measure(organs, "bend_rad", 0.0)
    aside = 2.0 * np.pi * hashed(seed, 306, 1)[:, 0]
    return Pericarps(
        along=(level - start[:, None, None]) * stretch[:, None, None],
        radius=radius,
        end=(end - start) * stretch,
        v=profile.v,
        widest=np.argmax(profile.width, axis=1),
        bend=np.clip(bend, -2.0, 2.0)[:, None] * np.stack([np.cos(aside), np.sin(aside)], axis=1),
    )


@dataclass(frozen=True, eq=False)
class _Profile:
    """Mean walls of n fruit, `(n, r)` each, in units of the radius across and of half the length along.

    Attributes:
        width: distance from the axis.
        level: height, down the fruit.
        top: 1 at the stalk end to 0 at the widest place and beyond.
        low: 1 at the blossom end to 0 at the widest place and before.
        v: part of the wall's length.
        foot: `(n,)` height on the axis at the stalk end.
    """

    width: FloatArray
    level: FloatArray
    top: FloatArray
    low: FloatArray
    v: FloatArray
    foot: FloatArray


def _profile(organs: Sequence[Organ], blocky: FloatArray, slimness: FloatArray, rings: int) -> _Profile:
    """Profiles, cut into rings that lie closer where the wall bends.

    Args:
        organs: n fruit.
        blocky: `(n, 1)` 0 is round, 1 has corners.
        slimness: `(n,)` diameter over length.
        rings: how many.
    """
    slim = slimness[:, None]
    point = np.clip(organ_measure(organs, "point", 0.0), 0.0, 1.0)[:, None]
    taper = 1.0 - np.clip(organ_measure(organs, "taper", 0.85), 0.2, 1.2)[:, None]
    sink = _CAVITY * np.clip(organ_measure(organs, "shoulder", 0.5), 0.0, 2.0)[:, None]
    # Two quarters of superellipses that meet at the widest place. The shoulders are about as high as wide,
    # whatever the length; the lower part rounds off over its last radius, or runs to a point.
    high = np.clip((0.85 + 0.1 * (1.0 - blocky) - 0.2 * point) * slim, 0.1, 1.0)
    corner = _ROUND + (_BLOCKY - _ROUND) * blocky
    long = np.clip((2.0 - high) / (1.1 * slim), 1.0, 4.0) * corner
    across, down = (
        (end**point) * (start ** (1.0 - point))
        for start, end in zip((corner - 0.1, long), _POINTED, strict=True)
    )
    turn = 0.5 * np.pi * np.linspace(0.0, 1.0, 60) ** 1.5
    quarter_top = np.sin(turn) ** (2.0 / corner), np.cos(turn) ** (2.0 / corner)
    back = turn[-2::-1]
    quarter_low = np.sin(back) ** (2.0 / across), np.cos(back) ** (2.0 / down)
    zero = np.zeros_like(quarter_low[0])
    width = np.concatenate([quarter_top[0], quarter_low[0]], axis=1)
    top = np.concatenate([quarter_top[1], zero], axis=1)
    low = np.concatenate([np.zeros_like(quarter_top[0]), quarter_low[1]], axis=1)
    # The ends sink in around the axis: a wide cavity at the stalk, a smaller dimple at the blossom end.
    level = high - 1.0 - high * top + (2.0 - high) * low
    level += slim * sink * _bowl(width, 0.78) * (top > 0.0)
    level -= slim * _DIMPLE * (0.3 + 0.7 * blocky) * (1.0 - point) * _bowl(width, 0.6) * (low > 0.0)
    wall = width * (1.0 - taper * low**1.5)
    # Rings where as much of the wall's length and bending has been walked; the stalk's seat needs few.
    step = np.stack([slim * np.diff(wall, axis=1), np.diff(level, axis=1)])
    walked = np.hypot(*step)
    heading = np.unwrap(np.arctan2(step[1], step[0]), axis=1)
    bending = np.pad(np.abs(np.diff(heading, axis=1)), ((0, 0), (1, 0)), mode="edge")
    share = walked / walked.sum(axis=1, keepdims=True) + 0.6 * bending / bending.sum(axis=1, keepdims=True)
    share *= np.where((wall[:, 1:] < 0.22) & (top[:, 1:] > 0.0), 0.4, 1.0)
    share, distance = (np.pad(np.cumsum(one, axis=1), ((0, 0), (1, 0))) for one in (share, walked))
    # The last ring is the rim of the scar.
    low_enough = wall + (top > 0.0) >= _SCAR[0]
    last = np.max(np.where(low_enough, share, 0.0), axis=1, keepdims=True)
    at = last * (np.arange(1, rings + 1) / rings)
    wall, high_at, top, low, v = _interpolated(
        at, share, (wall, level, top, low, distance / distance[:, -1:])
    )
    return _Profile(wall, high_at, top, low, v, level[:, 0])


def _interpolated(at: FloatArray, knots: FloatArray, lines: Sequence[FloatArray]) -> list[FloatArray]:
    """Values at `(n, r)` places of piecewise linear lines `(n, k)` over growing knots `(n, k)`."""
    index = np.clip((knots[:, :, None] <= at[:, None]).sum(axis=1) - 1, 0, knots.shape[1] - 2)
    row = np.arange(len(at))[:, None]
    size = knots[row, index + 1] - knots[row, index]
    part = (at - knots[row, index]) / np.where(size > 0.0, size, 1.0)
    return [line[row, index] + part * (line[row, index + 1] - line[row, index]) for line in lines]


def _bowl(width: FloatArray, rim: float) -> FloatArray:
    """1 on the axis, falling smoothly to 0 at the rim."""
    return np.clip(1.0 - (width / rim) ** 2, 0.0, 1.0) ** 2


def _ring(width: FloatArray, middle: float, half: float) -> FloatArray:
    """1 at the middle, 0 further away than half."""
    return np.clip(1.0 - ((width - middle) / half) ** 2, 0.0, 1.0)


def _each(lobe: FloatArray, lobes: FloatArray, values: FloatArray) -> FloatArray:
    """A number of each lobe, blended smoothly from one crest to the next.

    Args:
        lobe: `(n, 1, c)` place around the fruit; the crests are the whole numbers.
        lobes: `(n, 1, 1)` how many.
        values: `(n, 6)` of each.
    """
    before = np.floor(lobe)
    part = np.sin(0.5 * np.pi * (lobe - before)) ** 2
    row = np.arange(len(values))[:, None, None]
    here, there = (np.mod(before + step, lobes).astype(np.intp) for step in (0, 1))
    return values[row, here] * (1.0 - part) + values[row, there] * part


def _calliper(outline: FloatArray) -> FloatArray:
    """`(n,)` greatest width of star-shaped outlines, given as `(n, c)` radii at equal angles."""
    columns = outline.shape[1]
    angle = np.pi * np.arange(columns) / columns
    across = np.cos(angle[:, None] - 2.0 * angle)
    shadow = outline[:, None, :] * across
    return (shadow.max(axis=2) - shadow.min(axis=2)).max(axis=1)

"""The pericarp: the wall of a fruit as rings about a straight axis, in the fruit's own coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepperscene.geometry.batch import (
    hash_signed,
    hash_uniform,
    read_measure,
    read_positive,
    smooth_field,
    subdivisions,
)
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.grammar.plant import Organ

# Chosen from photographs of blocky and of pointed sweet peppers and of round tomatoes.
_FURROW = 0.17  # depth of a typical furrow over the radius, where it is deepest
_FURROW_AT_EQUATOR = 0.42  # fraction of that depth that remains at the widest ring
_FURROW_WIDTH = 0.22, 0.75  # roundness of furrows at the ends and at the widest ring; 0 a crease, 1 a sine
_CAVITY = 0.4  # depth of a deep stalk cavity over the radius
_DIMPLE = 0.2  # depth of the blossom end's dimple over the radius
_ROUND, _BLOCKY = 2.0, 4.0  # exponents of the profile's superellipse: without furrows, with deep ones
_POINTED = 1.22, 1.45  # exponents of a drawn-out tip, of width and height: a cone that swells a little
_SCAR = 0.05, 0.025  # radius and height over the fruit's radius of the button that the style leaves
_BENT_FROM = 0.3  # fraction of the axis after which it bends


@dataclass(frozen=True, eq=False)
class Pericarps:
    """Walls of n fruit as rings about straight axes that start where the stalk meets the fruit."""

    along: FloatArray  # `(n, r, c)` metres along the axis, from the stalk's foot; shoulders are below zero
    radius: FloatArray  # `(n, r, c)` metres from the axis, at c equal angles from the fruit's upper side
    end: FloatArray  # `(n,)` metres along, where the axis meets the blossom end
    v: FloatArray  # `(n, r)` fraction of the wall's length, 0 at the stalk's foot, 1 at the blossom end
    widest: IndexArray  # `(n,)` index of the ring that reaches farthest
    bend: FloatArray  # `(n, 2)` radians by which the blossom end is bent: to the upper side, to the right

    def bend_points(self, along: FloatArray, up: FloatArray, right: FloatArray) -> FloatArray:
        """Move points about the straight axes with the axes as these bend.

        The axis is straight at first and continues as an arc of the same length.

        Returns:
            `(n, q, 3)` metres up, right and along, from `(n, q)` metres each.
        """
        straight = _BENT_FROM * self.end[:, None]
        far = np.clip(along - straight, 0.0, None)
        angle = np.linalg.norm(self.bend, axis=1)[:, None]
        side = self.bend / np.where(angle > 0.0, angle, 1.0)
        arc_angle = angle * far / (self.end[:, None] - straight)
        # sin(x) / x and (1 - cos(x)) / x, also right for x = 0.
        forward = far * np.sinc(arc_angle / np.pi)
        aside = far * 0.5 * arc_angle * np.sinc(0.5 * arc_angle / np.pi) ** 2
        sine, cosine = np.sin(arc_angle), np.cos(arc_angle)
        offset = side[:, :1] * up + side[:, 1:] * right
        across = aside + (cosine - 1.0) * offset
        return np.stack(
            [
                up + side[:, :1] * across,
                right + side[:, 1:] * across,
                np.minimum(along, straight) + forward - sine * offset,
            ],
            axis=-1,
        )


def build_pericarps(organs: Sequence[Organ], detail: float) -> Pericarps:
    """Build fruit with lobes: a stalk cavity between shoulders, furrows, a dimple and a scar at the end.

    Measures: length_m (along the axis) and diameter_m (greatest, of the whole body), lobes (count),
    lobe_depth (1 is typical, 0 has no furrows and is round instead of blocky), shoulder (0 has no stalk
    cavity, 1 a deep one), taper (diameter near the blossom end over the greatest), neck (diameter beside the
    stalk over the greatest), neck_length (of the part that narrows to it, over the length), point (0 blocky,
    1 drawn out to a point), bend_rad (of the axis, from stalk to tip), seed.
    """
    n, seed = len(organs), read_measure(organs, "seed", 0.0)
    length, diameter = read_positive(organs, "length_m"), read_positive(organs, "diameter_m")
    lobes = np.clip(np.round(read_measure(organs, "lobes", 4.0)), 1, 6)[:, None, None]
    lobe_depth = np.clip(read_measure(organs, "lobe_depth", 1.0), 0.0, 2.5)
    point = np.clip(read_measure(organs, "point", 0.0), 0.0, 1.0)[:, None, None]
    # Without furrows a fruit is round and even, with them blocky.
    blocky = (lobe_depth**2 / (lobe_depth**2 + 0.1))[:, None, None]
    *profile, v, start = _mean_profile(organs, blocky[..., 0], diameter / length, subdivisions(24, detail, 6))
    width, level, top, low = (values[..., None] for values in profile)
    # Lobes of unequal width.
    columns = 4 * subdivisions(9, detail, 3)
    draw = hash_signed(seed, 301, 8)[:, :, None, None]
    angle = 2.0 * np.pi * np.arange(columns) / columns
    rotated = angle + np.pi * draw[:, 0]
    warped = (
        rotated
        + 0.16 * np.sin(rotated + np.pi * draw[:, 1])
        + 0.1 * np.sin(2.0 * rotated + np.pi * draw[:, 2])
    )
    lobe = lobes * warped / (2.0 * np.pi)
    # Furrows between them, all different: narrow and deep at both ends, faint and broad in the middle.
    ends = np.maximum(top, low) ** 2
    narrow, broad = _FURROW_WIDTH
    rounding = broad + (narrow - broad) * ends
    crest = np.sqrt(np.cos(np.pi * lobe) ** 2 + rounding**2)
    furrow = (np.sqrt(1.0 + rounding**2) - crest) / (np.sqrt(1.0 + rounding**2) - rounding)
    depth = 1.0 + 0.3 * _blend_lobes(lobe + 0.5, lobes, hash_signed(seed, 302, 6))
    depth = _FURROW * lobe_depth[:, None, None] * depth
    fading = 1.0 - 0.75 * point * low
    strength = (_FURROW_AT_EQUATOR + (1.0 - _FURROW_AT_EQUATOR) * ends) * fading
    even = 0.25 + 0.75 * blocky
    oval = 0.03 * np.cos(rotated + np.pi * draw[:, 3]) + 0.025 * np.cos(2.0 * rotated + np.pi * draw[:, 4])
    bulge = 0.035 * _blend_lobes(lobe, lobes, hash_signed(seed, 303, 6))
    radius = width * (1.0 + even * (oval + bulge)) * (1.0 - np.clip(depth, 0.0, 0.5) * furrow * strength)
    # Furrows cut into both ends, so that each lobe has a shoulder and a foot of uneven height.
    shoulder, foot = _ring(width, 0.7, 0.62) * top**3, _ring(width, 0.58, 0.58) * low**2 * (1.0 - point)
    level = level + (diameter / length)[:, None, None] * (
        shoulder * (1.4 * depth * furrow + even * 0.05 * _blend_lobes(lobe, lobes, hash_signed(seed, 304, 6)))
        - foot * (1.5 * depth * furrow + even * 0.07 * _blend_lobes(lobe, lobes, hash_signed(seed, 305, 6)))
    )
    # Small dents.
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    slimness = (length / diameter)[:, None, None]
    points = np.empty((n, width.shape[1], columns, 3))
    points[..., :2] = width[..., None] * direction
    points[..., 2] = slimness * level
    dents = smooth_field(points.reshape(n, -1, 3), seed, 311, 1.6).reshape(radius.shape)
    radius = radius * (1.0 + 0.012 * even * dents)
    # Scale to the stated size, as callipers measure it across the outline and from top to bottom.
    radius = radius * (diameter / _greatest_width(np.max(radius, axis=1)))[:, None, None]
    # The stalk's foot is at zero; a button closes the blossom end.
    end = level[:, -1].mean(axis=1) + _SCAR[1] * diameter / length
    low_end, high_end = np.minimum(level.min(axis=(1, 2)), start), np.maximum(level.max(axis=(1, 2)), end)
    stretch = length / (high_end - low_end)
    bend = read_measure(organs, "bend_rad", 0.0)
    aside = 2.0 * np.pi * hash_uniform(seed, 306, 1)[:, 0]
    return Pericarps(
        along=(level - start[:, None, None]) * stretch[:, None, None],
        radius=radius,
        end=(end - start) * stretch,
        v=v,
        widest=np.argmax(profile[0], axis=1),
        bend=np.clip(bend, -2.0, 2.0)[:, None] * np.stack([np.cos(aside), np.sin(aside)], axis=1),
    )


def _mean_profile(
    organs: Sequence[Organ], blocky: FloatArray, slimness: FloatArray, rings: int
) -> list[FloatArray]:
    """Mean walls of n fruit, with rings closer together where the wall bends.

    Args:
        organs: n fruit.
        blocky: `(n, 1)` 0 is round, 1 has corners.
        slimness: `(n,)` diameter over length.
        rings: their number.

    Returns:
        `(n, r)` each: distance from the axis, in radii; height, down the fruit, in half lengths; 1 at the
        stalk end to 0 from the widest place on; 1 at the blossom end to 0 up to the widest place; fraction of
        the wall's length. And `(n,)` the height on the axis at the stalk end.
    """
    slim = slimness[:, None]
    point = np.clip(read_measure(organs, "point", 0.0), 0.0, 1.0)[:, None]
    taper = 1.0 - np.clip(read_measure(organs, "taper", 0.85), 0.2, 1.2)[:, None]
    sink = _CAVITY * np.clip(read_measure(organs, "shoulder", 0.5), 0.0, 2.0)[:, None]
    # Two quarters of superellipses that meet at the widest place. The shoulders are about as high as wide,
    # whatever the length; the lower part rounds off over its last radius, or runs to a point.
    high = np.clip((0.85 + 0.1 * (1.0 - blocky) - 0.2 * point) * slim, 0.1, 1.0)
    corner = _ROUND + (_BLOCKY - _ROUND) * blocky
    long = np.clip((2.0 - high) / (1.1 * slim), 1.0, 4.0) * corner
    across, down = (
        (end**point) * (start ** (1.0 - point))
        for start, end in zip((corner - 0.1, long), _POINTED, strict=True)
    )
    angle = 0.5 * np.pi * np.linspace(0.0, 1.0, 60) ** 1.5
    quarter_top = np.sin(angle) ** (2.0 / corner), np.cos(angle) ** (2.0 / corner)
    back = angle[-2::-1]
    quarter_low = np.sin(back) ** (2.0 / across), np.cos(back) ** (2.0 / down)
    width = np.concatenate([quarter_top[0], quarter_low[0]], axis=1)
    top = np.concatenate([quarter_top[1], np.zeros_like(quarter_low[0])], axis=1)
    low = np.concatenate([np.zeros_like(quarter_top[0]), quarter_low[1]], axis=1)
    # The ends sink in around the axis: a wide cavity at the stalk, a smaller dimple at the blossom end.
    level = high - 1.0 - high * top + (2.0 - high) * low
    level += slim * sink * _bowl(width, 0.78) * (top > 0.0)
    level -= slim * _DIMPLE * (0.3 + 0.7 * blocky) * (1.0 - point) * _bowl(width, 0.6) * (low > 0.0)
    wall = width * (1.0 - taper * low**1.5)
    # Rings at equal steps of the wall's length and bending; the cavity around the stalk needs few.
    step = np.stack([slim * np.diff(wall, axis=1), np.diff(level, axis=1)])
    distance = np.hypot(*step)
    heading = np.unwrap(np.arctan2(step[1], step[0]), axis=1)
    bending = np.pad(np.abs(np.diff(heading, axis=1)), ((0, 0), (1, 0)), mode="edge")
    weight = distance / distance.sum(axis=1, keepdims=True)
    weight = weight + 0.6 * bending / bending.sum(axis=1, keepdims=True)
    weight *= np.where((wall[:, 1:] < 0.22) & (top[:, 1:] > 0.0), 0.4, 1.0)
    weight, distance = (np.pad(np.cumsum(values, axis=1), ((0, 0), (1, 0))) for values in (weight, distance))
    # The last ring is the rim of the scar.
    outside_scar = wall + (top > 0.0) >= _SCAR[0]
    last = np.max(np.where(outside_scar, weight, 0.0), axis=1, keepdims=True)
    at = last * (np.arange(1, rings + 1) / rings)
    # Linear interpolation between the samples of each profile.
    index = np.clip((weight[:, :, None] <= at[:, None]).sum(axis=1) - 1, 0, weight.shape[1] - 2)
    row = np.arange(len(at))[:, None]
    size = weight[row, index + 1] - weight[row, index]
    part = (at - weight[row, index]) / np.where(size > 0.0, size, 1.0)
    curves = wall, level, top, low, distance / distance[:, -1:]
    wall, *others = (y[row, index] + part * (y[row, index + 1] - y[row, index]) for y in curves)
    # A neck narrows smoothly towards the stalk.
    neck = 1.0 - np.clip(read_measure(organs, "neck", 1.0), 0.2, 1.0)[:, None]
    reach = 2.0 * np.clip(read_measure(organs, "neck_length", 0.25), 0.02, 1.0)[:, None]
    from_stalk = np.clip((others[0] - level[:, :1]) / reach, 0.0, 1.0)
    return [wall * (1.0 - neck * (1.0 - from_stalk) ** 2), *others, level[:, 0]]


def _bowl(width: FloatArray, rim: float) -> FloatArray:
    """1 on the axis, falling smoothly to 0 at the rim."""
    return np.clip(1.0 - (width / rim) ** 2, 0.0, 1.0) ** 2


def _ring(width: FloatArray, middle: float, half: float) -> FloatArray:
    """1 at the middle, 0 further away than `half`."""
    return np.clip(1.0 - ((width - middle) / half) ** 2, 0.0, 1.0)


def _blend_lobes(lobe: FloatArray, lobes: FloatArray, values: FloatArray) -> FloatArray:
    """One of `(n, 6)` values per lobe, blended smoothly from each crest to the next.

    `lobe` is the position around the fruit, with the crests at whole numbers; `lobes` their number.
    """
    before = np.floor(lobe)
    fraction = np.sin(0.5 * np.pi * (lobe - before)) ** 2
    row = np.arange(len(values))[:, None, None]
    start, end = (np.mod(before + step, lobes).astype(np.intp) for step in (0, 1))
    return values[row, start] * (1.0 - fraction) + values[row, end] * fraction


def _greatest_width(outline: FloatArray) -> FloatArray:
    """`(n,)` greatest width of star-shaped outlines, given as `(n, c)` radii at equal angles."""
    columns = outline.shape[1]
    angle = np.pi * np.arange(columns) / columns
    across = np.cos(angle[:, None] - 2.0 * angle)
    projection = outline[:, None, :] * across
    return (projection.max(axis=2) - projection.min(axis=2)).max(axis=1)

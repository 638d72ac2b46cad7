"""Textures of surfaces over uv, with the slopes of their reliefs filtered to the size of a pixel.

A pixel that covers many texels of a relief sees the mean of their gloss, not the gloss of one of them. So the
relief has levels of half the resolution each; a texel of level l > 0 holds the mean and the variance, over
the cell that it covers, of the slopes of the relief at full resolution (linear in its moments: LEAN mapping,
Olano & Baker 2010). The mean turns the shading normal, and the variance widens the gloss: a GGX lobe of
roughness alpha on facets with the slope variance s^2 per axis becomes one of roughness sqrt(alpha^2 + 2 s^2)
(LEADR mapping, Dupuy et al. 2013). Whatever the level, mean squared slope and variance have the same sum.

Two simplifications, both chosen: the level is the finest whose texels are at most as large as the pixel, read
at the nearest texel, because the samples of a pixel spread over neighbouring texels anyway; and the variance
is the mean of both axes, because a mixed moment and an anisotropic lobe would double the cost of the gloss.
At level 0 the relief is bilinear. Pigments, residue and ageing are not filtered: the reflectance is not
linear in them, so that a filtered leaf would have another colour.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials import Surface
from pepperscene.materials.tissue import texture_count
from pepperscene.render.arrays import device_array
from pepperscene.render.variant import mitsuba_modules

LEVELS: Final = 12
"""Most levels of a relief, with that of full resolution: chosen, for 2048 texels along one side."""

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SlopePyramid:
    """Filtered slopes of a surface's relief in mm per unit of u and v.

    Attributes:
        levels: `(t, h_l, w_l, 4)` for l = 1, 2 and so on to a single texel: mean slope along u and along v,
            and their variances.
        squares: mean squares of both slopes over all textures.
    """

    levels: tuple[Floats, ...]
    squares: tuple[float, float]


@dataclass(frozen=True, eq=False)
class TextureSample:
    """Textures at a hit; slopes and variances are those of the relief in local units per unit of u and v."""

    state: Any  # offset
    residue: Any  # factor
    ageing: Any  # at which the tissue begins to age
    slope_u: Any
    slope_v: Any
    variance_u: Any
    variance_v: Any


@dataclass(frozen=True, eq=False)
class TextureTables:
    """Textures of all surfaces of a scene on the device.

    Attributes:
        sizes: `(k * 4,)` width and height of a surface's textures, and the mean squares of its slopes.
        first_texel: `(k,)` the start of its textures in `texels`.
        texels: `(n * 4,)` offset of the state, relief in local units, factor of the residue, ageing.
        levels: `(k * LEVELS * 4,)` start in `slopes`, width and height of a level's textures, 0; level 0 is
            not used, and the last level is repeated.
        slopes: `(m * 4,)` of `SlopePyramid`, in local units.
    """

    sizes: Any
    first_texel: Any
    texels: Any
    levels: Any
    slopes: Any

    @classmethod
    def pack(cls, surfaces: Sequence[Surface], unit_m: float) -> TextureTables:
        """Transfer the textures of surfaces, with reliefs in local units.

        Raises:
            ValueError: textures of a surface differ in size.
        """
        shapes = [_texture_shape(surface) for surface in surfaces]
        counts = np.array([math.prod(shape) for shape in shapes])
        starts = np.cumsum(counts) - counts
        texels = np.zeros((counts.sum(), 4), np.float32)
        scale = 1e-3 / unit_m
        sizes, levels, first = [], [], 0
        slopes: list[Floats] = []
        for surface, shape, start in zip(surfaces, shapes, starts.tolist(), strict=True):
            _fill_texels(texels[start : start + math.prod(shape)], surface, scale)
            pyramid = slope_pyramid(surface)
            square_u, square_v = pyramid.squares
            sizes.append((shape[2], shape[1], scale**2 * square_u, scale**2 * square_v))
            rows = [(0, 1, 1, 0)]
            for level in pyramid.levels[: LEVELS - 1]:
                rows.append((first, level.shape[2], level.shape[1], 0))
                slopes.append((level * np.array([scale, scale, scale**2, scale**2], np.float32)).ravel())
                first += level[..., 0].size
            levels.append(rows + rows[-1:] * (LEVELS - len(rows)))
        return cls(
            sizes=device_array(sizes),
            first_texel=device_array(starts, np.uint32),
            texels=device_array(texels),
            levels=device_array(levels, np.uint32),
            slopes=device_array(np.concatenate(slopes)),
        )

    def look_up(
        self, si: Any, surface: Any, texture: Any, mirrored: Any, footprint: Any | None, active: Any
    ) -> TextureSample:
        """Textures at hits.

        Args:
            si: with uv and its partial derivatives.
            surface: its number.
            texture: number of its texture.
            mirrored: whether the texture is mirrored in u.
            footprint: area that a pixel covers at the hit, squared local units; None for hits that no camera
                ray found, which see the mean slopes of the whole relief, and the nearest texel.
            active: mask.
        """
        mi, dr = mitsuba_modules()
        size = dr.gather(mi.Vector4f, self.sizes, surface, active)
        u, v = dr.select(mirrored, 1.0 - si.uv.x, si.uv.x), si.uv.y
        count = mi.UInt32(size.x) * mi.UInt32(size.y)
        first = dr.gather(mi.UInt32, self.first_texel, surface, active) + texture * count
        if footprint is None:
            only = dr.gather(mi.Vector4f, self.texels, first + _nearest(u, v, size.x, size.y), active)
            flat = mi.Float(0.0)
            return TextureSample(only.x, only.z, only.w, flat, flat, size.z, size.w)

        left, top = dr.floor(u * size.x - 0.5), dr.floor(v * size.y - 0.5)
        fx, fy = u * size.x - 0.5 - left, v * size.y - 0.5 - top

        def texel(dx: int, dy: int) -> Any:
            # Tubes and fruit are periodic in u; on a leaf this affects half a texel at the margin.
            wrapped = left + dx
            wrapped = dr.select(wrapped < 0.0, wrapped + size.x, wrapped)
            column = mi.UInt32(dr.select(wrapped < size.x, wrapped, wrapped - size.x))
            row = mi.UInt32(dr.clip(top + dy, 0.0, size.y - 1.0))
            return dr.gather(mi.Vector4f, self.texels, first + row * mi.UInt32(size.x) + column, active)

        a, b, c, d = texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)

        def bilinear(a: Any, b: Any, c: Any, d: Any) -> Any:
            return dr.lerp(dr.lerp(a, b, fx), dr.lerp(c, d, fx), fy)

        # The level whose texels are half to one times as large as the pixel.
        area = dr.norm(dr.cross(si.dp_du, si.dp_dv))
        level = dr.floor(0.5 * dr.log2(footprint * size.x * size.y / dr.maximum(area, 1e-30)))
        level = mi.UInt32(dr.select(level > 0.0, dr.minimum(level, LEVELS - 1.0), 0.0))
        filtered = level > 0
        grid = dr.gather(mi.Vector4u, self.levels, surface * LEVELS + level, active & filtered)
        columns, rows = mi.Float(grid.y), mi.Float(grid.z)
        cell = grid.x + texture * (grid.y * grid.z) + _nearest(u, v, columns, rows)
        # A masked gather gives 0.
        mean = dr.gather(mi.Vector4f, self.slopes, cell, active & filtered)
        slope_u = dr.select(filtered, mean.x, dr.lerp(b.y - a.y, d.y - c.y, fy) * size.x)
        slope_v = dr.select(filtered, mean.y, dr.lerp(c.y - a.y, d.y - b.y, fx) * size.y)
        return TextureSample(
            bilinear(a.x, b.x, c.x, d.x),
            bilinear(a.z, b.z, c.z, d.z),
            bilinear(a.w, b.w, c.w, d.w),
            dr.select(mirrored, -slope_u, slope_u),
            slope_v,
            mean.z,
            mean.w,
        )


def _nearest(u: Any, v: Any, columns: Any, rows: Any) -> Any:
    """Number of the texel at (u, v) in a texture with so many columns and rows."""
    mi, dr = mitsuba_modules()
    column = dr.clip(dr.floor(u * columns), 0.0, columns - 1.0)
    row = dr.clip(dr.floor(v * rows), 0.0, rows - 1.0)
    return mi.UInt32(row) * mi.UInt32(columns) + mi.UInt32(column)


def _texture_shape(surface: Surface) -> tuple[int, int, int]:
    """Shape `(t, h, w)` of all textures of a surface; one texel if it has none."""
    shapes = {images.shape for images in surface.textures.values()}
    if len(shapes) > 1:
        raise ValueError(f"{surface.name}: textures differ in size: {sorted(shapes)}")
    t, h, w = shapes.pop() if shapes else (1, 1, 1)
    return t, h, w


def _fill_texels(texels: Floats, surface: Surface, relief_scale: float) -> None:
    """Write the textures of a surface to `(t * h * w, 4)` zeros, as in `TextureTables`."""
    texels[:, 2] = 1.0
    for k, name in enumerate(("pattern", "relief_mm", "residue_pattern", "ageing_order")):
        if name in surface.textures:
            texels[:, k] = surface.textures[name].ravel()
    texels[:, 1] *= np.float32(relief_scale)


_PYRAMIDS: weakref.WeakKeyDictionary[Surface, SlopePyramid] = weakref.WeakKeyDictionary()
"""A recipe's surfaces serve many scenes; their pyramids are computed once."""


def slope_pyramid(surface: Surface) -> SlopePyramid:
    """The filtered slopes of a surface's relief."""
    if surface not in _PYRAMIDS:
        # Without a relief one flat texel for each texture.
        images = np.zeros((texture_count(surface), 1, 1)) if surface.relief_mm is None else surface.relief_mm
        levels = tuple(np.stack(level) for level in zip(*map(_slope_levels, images), strict=True))
        mean = levels[-1][..., :2].astype(float)
        squares = (mean**2 + levels[-1][..., 2:]).mean(axis=(0, 1, 2))
        _PYRAMIDS[surface] = SlopePyramid(levels, (float(squares[0]), float(squares[1])))
    return _PYRAMIDS[surface]


def prepare_surfaces(surfaces: Iterable[Surface]) -> None:
    """Filter the reliefs of surfaces ahead of the scene that needs them, which another thread may build."""
    for surface in surfaces:
        slope_pyramid(surface)


def _slope_levels(height: Floats) -> list[Floats]:
    """`(h_l, w_l, 4)` of each level from 1 on, of one texture `(h, w)`; one texel counts as level 1."""
    h, w = height.shape
    moments = _cell_moments(height)
    levels: list[Floats] = []
    while not levels or moments.shape[:2] != (1, 1):
        step = len(levels) + 1
        moments = _coarser(_coarser(moments, max(h >> step, 1)).swapaxes(0, 1), max(w >> step, 1))
        moments = moments.swapaxes(0, 1)
        mean = moments[..., :2]
        levels.append(np.concatenate([mean, np.maximum(moments[..., 2:] - mean**2, 0.0)], axis=-1))
    return levels


def _cell_moments(height: Floats) -> Floats:
    """`(h, w, 4)` means of the bilinear relief's two slopes over each texel, and of their squares."""
    h, w = height.shape
    along_u = (np.roll(height, -1, axis=1) - height) * np.float32(w)
    along_v = np.diff(height, axis=0, prepend=height[:1], append=height[-1:]) * np.float32(h)
    padded = np.pad(along_u, ((1, 1), (0, 0)), mode="edge")
    u = _moments(padded[:-2], along_u, padded[2:])
    v = _moments(np.roll(along_v, 1, axis=1), along_v, np.roll(along_v, -1, axis=1))
    # A texel reaches from the middle of one step to the middle of the next.
    parts = [0.5 * (np.roll(m, 1, axis=1) + m) for m in u], [0.5 * (m[:-1] + m[1:]) for m in v]
    return np.stack([parts[0][0], parts[1][0], parts[0][1], parts[1][1]], axis=-1)


def _moments(before: Floats, here: Floats, after: Floats) -> tuple[Floats, Floats]:
    """Mean and mean square of slopes that are linear from one texel to the next, over a texel's width."""
    first, last = 0.5 * (before + here), 0.5 * (here + after)
    mean = 0.25 * (first + 2.0 * here + last)
    return mean, (first**2 + first * here + 2.0 * here**2 + here * last + last**2) / 6.0


def _coarser(values: Floats, count: int) -> Floats:
    """Average `(n, ...)` over `count` equal parts of the first axis; parts of texels count in proportion."""
    n = len(values)
    if n % count == 0:
        return np.asarray(values.reshape(count, n // count, *values.shape[1:]).mean(axis=1))
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0, dtype=float)])
    edges = np.linspace(0.0, n, count + 1)
    at_edges = np.stack([total[int(x)] + (x % 1) * values[min(int(x), n - 1)] for x in edges])
    return (np.diff(at_edges, axis=0) * (count / n)).astype(np.float32)

"""Textures of surfaces: filtered slopes, the choice of a texture by organ, and of a level by pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.classes import Appearance, Instance, OrganClass
from pepperscene.geometry import Mesh
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.render.kernel.scene import organ_table
from pepperscene.render.surface.optics import Optics
from pepperscene.render.surface.textures import slope_pyramid
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

NM = np.array([400.0, 700.0])
EXTENT = np.array([0.03, 0.05])
"""Metres of a unit of u and of v in `look_up`."""


def grey(**textures: np.ndarray) -> Surface:
    """A surface whose reflectance is its state."""
    rows = np.linspace(0.0, 1.0, 3)[:, None, None] * np.ones((1, 2, 2))
    return Surface("grey", NM, rows, np.zeros((3, 2)), 1.5, (0.2, 0.2), **textures)


def random_relief(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def bilinear_slopes(height: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes along u and v of the bilinear relief `(h, w)`, periodic in u and clamped in v, by hand."""
    h, w = height.shape
    x, y = u * w - 0.5, v * h - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)

    def texel(dx: int, dy: int) -> np.ndarray:
        return height[np.clip(top + dy, 0, h - 1), (left + dx) % w].astype(float)

    fx, fy = x - left, y - top
    slope_u = ((texel(1, 0) - texel(0, 0)) * (1 - fy) + (texel(1, 1) - texel(0, 1)) * fy) * w
    slope_v = ((texel(0, 1) - texel(0, 0)) * (1 - fx) + (texel(1, 1) - texel(1, 0)) * fx) * h
    return slope_u, slope_v


@pytest.mark.parametrize("shape", [(8, 16), (7, 10), (5, 1), (1, 1)])
def test_each_level_has_the_moments_of_the_slopes(shape):
    # Against the mean over 400 points of each texel's half; slopes are linear or constant between texels.
    surface = grey(relief_mm=random_relief((2, *shape)))
    h, w = shape
    pyramid = slope_pyramid(surface)
    steps = 20
    u, v = np.meshgrid(*((np.arange(2 * n * steps) + 0.5) / (2 * n * steps) for n in (w, h)))
    slopes = [bilinear_slopes(image, u, v) for image in surface.relief_mm]
    squares = [np.mean([np.mean(pair[axis] ** 2) for pair in slopes]) for axis in (0, 1)]
    assert pyramid.squares == pytest.approx(squares, rel=2e-3, abs=1e-6)
    assert pyramid.levels[-1].shape == (2, 1, 1, 4)
    for level in pyramid.levels:
        assert level[..., 2:].min() >= 0.0
        # The sum of squared mean and variance is the same on all levels.
        total = (level[..., :2] ** 2 + level[..., 2:]).mean(axis=(0, 1, 2), dtype=float)
        assert total == pytest.approx(pyramid.squares, rel=1e-5, abs=1e-6)
        # Where no texel is divided: parts of texels count with the mean of the whole.
        rows, columns = level.shape[1:3]
        if h & (h - 1) == 0 and w & (w - 1) == 0:
            for image, pair in zip(level, slopes, strict=True):
                for axis in (0, 1):
                    cells = pair[axis].reshape(rows, -1, columns, u.shape[1] // columns)
                    scale = np.sqrt(squares[axis]) + 1e-9
                    assert image[..., axis] == pytest.approx(cells.mean(axis=(1, 3)), abs=2e-3 * scale)
                    assert image[..., 2 + axis] == pytest.approx(cells.var(axis=(1, 3)), abs=5e-3 * scale**2)


def look_up(surface: Surface, uv: np.ndarray, footprint_m2: float | None, texture: float = 1.0) -> np.ndarray:
    """`(4, n)` slopes in metres per metre along x and y, blur, and state, at `(n, 2)` uv."""
    mi, dr = mitsuba_modules()
    optics = Optics.pack([surface], 400.0, 700.0, organs=np.array([[0.0, texture, 0.0, 0.0]]))
    si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    si.wi = si.n = mi.Normal3f(0.0, 0.0, 1.0)
    si.sh_frame = mi.Frame3f(si.n)
    si.dp_du, si.dp_dv = mi.Vector3f(float(EXTENT[0]), 0.0, 0.0), mi.Vector3f(0.0, float(EXTENT[1]), 0.0)
    si.uv, si.wavelengths = mi.Point2f(*uv.T.astype(np.float32)), mi.Spectrum(550.0)
    footprint = None if footprint_m2 is None else mi.Float(footprint_m2)
    point = optics.point(si, mi.UInt32(0), mi.Float(0.5), mi.Bool(True), footprint)
    normal, square = np.asarray(point.frame.n), np.asarray(point.gloss.square)
    slopes = -normal[:2] / normal[2]
    state = np.asarray(point.reflectance)[0]
    parts = [slopes[0], slopes[1], square - 0.2**2, state]
    return np.stack([np.broadcast_to(part, len(uv)) for part in parts])


def test_level_follows_the_pixel():
    # A relief of 32 x 64 texels of 0.94 mm x 0.78 mm with slopes of some per cent. Level l > 0 has texels of
    # half to one times the pixel's size.
    surface = grey(relief_mm=0.03 * random_relief((1, 32 * 2, 32)))
    height, scale = surface.relief_mm[0], 1e-3
    uv = np.random.default_rng(1).uniform(0.0, 1.0, (4000, 2)).astype(np.float32)
    texel_m2 = (EXTENT / (32, 64)).prod()
    for size in (0.0, 0.5, 1.0, 1.9):
        slope_u, slope_v = bilinear_slopes(height, *uv.T.astype(float))
        found = look_up(surface, uv, size**2 * texel_m2)
        assert found[0] == pytest.approx(slope_u * scale / EXTENT[0], abs=2e-4)
        assert found[1] == pytest.approx(slope_v * scale / EXTENT[1], abs=2e-4)
        assert found[2] == pytest.approx(0.0, abs=1e-6)
    levels = slope_pyramid(surface).levels
    for size, number in ((2.01, 1), (3.9, 1), (4.1, 2), (9.0, 3), (1e4, len(levels))):
        level = levels[number - 1][0]
        rows, columns = level.shape[:2]
        cell = level[(uv[:, 1] * rows).astype(int), (uv[:, 0] * columns).astype(int)]
        found = look_up(surface, uv, size**2 * texel_m2)
        assert found[0] == pytest.approx(cell[:, 0] * scale / EXTENT[0], abs=1e-5)
        assert found[1] == pytest.approx(cell[:, 1] * scale / EXTENT[1], abs=1e-5)
        blur = (cell[:, 2:] * scale**2 / EXTENT**2).sum(axis=1)
        assert found[2] == pytest.approx(blur, rel=1e-3, abs=1e-6)
    # Without a pixel: the mean of all slopes.
    found = look_up(surface, uv, None)
    assert not found[:2].any()
    squares = np.array(slope_pyramid(surface).squares) * scale**2 / EXTENT**2
    assert found[2] == pytest.approx(squares.sum(), rel=1e-3)


def test_textures_of_a_stack_and_their_mirror_images():
    pattern = 0.4 * np.random.default_rng(2).uniform(-1.0, 1.0, (3, 4, 8)).astype(np.float32)
    surface = grey(pattern=pattern, relief_mm=0.2 * random_relief((3, 4, 8)))
    uv = np.random.default_rng(3).uniform(0.0, 1.0, (200, 2)).astype(np.float32)
    mirrored = np.stack([1.0 - uv[:, 0], uv[:, 1]], axis=1)
    seen = [look_up(surface, uv, 0.0, k + 1.0) for k in range(3)]
    for k in range(3):
        alone = grey(pattern=pattern[k : k + 1], relief_mm=surface.relief_mm[k : k + 1])
        assert np.array_equal(seen[k], look_up(alone, uv, 0.0))
        for footprint in (0.0, 1e-4, None):
            found = look_up(surface, uv, footprint, -(k + 1.0))
            expected = look_up(surface, mirrored, footprint, k + 1.0)
            expected[0] *= -1.0
            assert found == pytest.approx(expected, abs=1e-4)
    assert np.abs(seen[0] - seen[1]).max() > 0.1


def triangle_mesh(appearances: list[Appearance], surface: np.ndarray) -> Mesh:
    """A triangle of each appearance and surface `(n,)` of "stacked" (0) and "plain" (1)."""
    n = len(surface)
    return Mesh(
        vertices=np.zeros((3 * n, 3), np.float32),
        normals=np.tile(np.array([0.0, 0.0, 1.0], np.float32), (3 * n, 1)),
        uv=np.zeros((3 * n, 2), np.float32),
        state=np.zeros(3 * n, np.float32),
        faces=np.arange(3 * n, dtype=np.uint32).reshape(-1, 3),
        face_instance=np.zeros(n, np.uint32),
        face_surface=surface.astype(np.uint8),
        face_appearance=np.arange(n, dtype=np.uint32) % len(appearances),
        surfaces=("stacked", "plain"),
        instances=(Instance(OrganClass.LEAF, "leaf"),),
        appearances=tuple(appearances),
    )


def test_organs_choose_their_textures_by_their_variant():
    stacked = replace(grey(pattern=np.zeros((3, 2, 2), np.float32)), name="stacked")
    appearances = [Appearance(residue=0.1 * k, ageing=0.05 * k, variant=k) for k in range(8)]
    surface = np.array([0] * 8 + [1] * 3)
    mesh = triangle_mesh(appearances, surface)
    organs, number = organ_table(Scene(mesh, (stacked, lambertian_surface("plain", 0.5))))
    assert len(organs) == 11
    for face, row in enumerate(number):
        item = appearances[face % 8]
        assert organs[row, [0, 2, 3]].tolist() == [surface[face], item.residue, item.ageing]
        if surface[face] == 1:
            assert organs[row, 1] == 1.0
        else:
            assert abs(organs[row, 1]) == 1 + item.variant % 3
            assert (organs[row, 1] < 0) == (item.variant // 3 % 2 == 1)


def test_raises_on_textures_of_different_sizes():
    surface = grey(pattern=np.zeros((1, 4, 4), np.float32), relief_mm=np.zeros((2, 4, 4), np.float32))
    with pytest.raises(ValueError, match="textures differ in size"):
        Optics.pack([surface], 400.0, 700.0)

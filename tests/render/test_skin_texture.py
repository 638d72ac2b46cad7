"""Fine textures in the optics of surfaces: their size, their filter, and what they leave as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.materials import Surface, load_skin, organ_surfaces
from pepperscene.materials.skin import TEXEL_MM, TILE, skin_tile
from pepperscene.render.surface.optics import Optics
from pepperscene.render.variant import mitsuba_modules

NM = np.arange(400.0, 1001.0, 20.0)
ROUGHNESS = 0.1
TILE_M = 1e-3 * TILE * TEXEL_MM


def organ(skin: str = "leaf") -> Surface:
    """A translucent, glossy sheet that reflects and transmits 0.5 at 700 nm, and little at 400 nm."""
    reflectance = np.interp(NM, [400.0, 700.0, 1000.0], [0.05, 0.5, 0.5])
    rows = np.broadcast_to(reflectance, (2, 2, len(NM))).copy()
    surface = Surface("organ", NM, rows, 0.9 * rows[:, 0], 1.4, (ROUGHNESS, ROUGHNESS))
    return replace(surface, skin=skin_tile(getattr(load_skin("pepper"), skin), "organ", ROUGHNESS))


def look_up(surface, uv, footprint_m2, *, nm=600.0, size_m=(TILE_M, TILE_M), residue=0.0, texture=1.0):
    """`(5, n)` reflectance, transmittance, slopes along x and y, and squared roughness at `(n, 2)` uv."""
    mi, dr = mitsuba_modules()
    optics = Optics.pack([surface], 400.0, 1000.0, organs=np.array([[0.0, texture, residue, 0.0]]))
    si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    si.wi = si.n = mi.Normal3f(0.0, 0.0, 1.0)
    si.sh_frame = mi.Frame3f(si.n)
    si.dp_du, si.dp_dv = mi.Vector3f(float(size_m[0]), 0.0, 0.0), mi.Vector3f(0.0, float(size_m[1]), 0.0)
    si.uv, si.wavelengths = mi.Point2f(*uv.T.astype(np.float32)), mi.Spectrum(nm)
    footprint = None if footprint_m2 is None else mi.Float(footprint_m2)
    point = optics.point(si, mi.UInt32(0), mi.Float(0.5), mi.Bool(True), footprint)
    normal = np.asarray(point.frame.n)
    parts = [
        np.asarray(point.reflectance)[0], np.asarray(point.transmittance)[0],
        -normal[0] / normal[2], -normal[1] / normal[2], np.asarray(point.gloss.square),
    ]  # fmt: skip
    return np.stack([np.broadcast_to(part, len(uv)) for part in parts]).astype(float)


def grid(n: int) -> np.ndarray:
    """`(n * n, 2)` places in the middle of cells."""
    steps = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("skin", ["fruit", "leaf", "stem"])
@pytest.mark.parametrize("nm", [450.0, 550.0, 680.0])
def test_the_mean_is_the_reflectance_without_texture(skin, nm):
    # A texel for each place: whatever the origin of the repeat, all texels are seen once.
    surface = organ(skin)
    seen = look_up(surface, grid(TILE), 0.0, nm=nm)
    plain = look_up(replace(surface, skin=None), grid(1), 0.0, nm=nm)
    total, bare = seen[:2].sum(axis=0), plain[:2].sum(axis=0)
    # At most .5 % from light that meets the relief twice, and from the clipped slopes.
    assert total.mean() == pytest.approx(bare[0], rel=5e-3)
    assert total.std() > 0.005 * bare[0]
    assert total.max() <= 1.0 + 1e-6


def test_where_nothing_is_absorbed_there_is_no_contrast():
    surface = organ()
    rows, flat = np.full_like(surface.reflectance, 0.6), np.zeros_like(surface.skin.slopes)
    skin = replace(surface.skin, slopes=flat)
    white = replace(surface, reflectance=rows, transmittance=1.0 - rows[:, 0], skin=skin)
    seen = look_up(white, grid(64), 0.0)
    assert seen[:2].sum(axis=0) == pytest.approx(np.ones(64 * 64), abs=1e-5)


def test_below_a_pixel_a_skin_is_a_surface_without_texture():
    surface, uv = organ(), np.random.default_rng(1).uniform(0.0, 1.0, (500, 2))
    plain = look_up(replace(surface, skin=None), uv, 0.0)
    for footprint in ((0.6 * TILE_M) ** 2 * 4, 1.0, None):
        assert look_up(surface, uv, footprint) == pytest.approx(plain, abs=2e-6)
    # Pixels of .2, .6 and 2.6 mm: a D405 at 848 columns from 9, 26 and 110 cm.
    sizes = 1e-3 * TEXEL_MM * np.array([5.0, 16.1, 64.1])
    first, second, last = (look_up(surface, grid(128), size**2)[0].std() for size in sizes)
    assert second < 0.7 * first
    assert last < 0.15 * first


def test_a_level_holds_the_means_of_its_texels():
    surface = organ()
    change = surface.skin.change.astype(float)
    means = np.sort(change.reshape(TILE // 8, 8, TILE // 8, 8).mean(axis=(1, 3)).ravel())
    seen = look_up(surface, grid(TILE // 8), (1e-3 * TEXEL_MM * 8.01) ** 2)
    plain = look_up(replace(surface, skin=None), grid(1), 0.0)
    # Linear in the change, apart from the relief: R (1 + d (1 - R - T)), plus what the sheet sends back.
    found = np.sort(seen[:2].sum(axis=0)) / plain[:2].sum()
    assert np.corrcoef(found, means)[0, 1] > 0.999


@pytest.mark.parametrize("texels", [0.0, 2.01, 8.01, 100.0])
def test_shown_slopes_and_roughness_have_the_same_sum(texels):
    # A lobe of roughness alpha stands for slopes of variance alpha^2 / 2 along each axis.
    surface = organ("stem")
    seen = look_up(surface, grid(256), (1e-3 * TEXEL_MM * texels) ** 2)
    shown = (seen[2] ** 2 + seen[3] ** 2).mean()
    assert shown + seen[4].mean() == pytest.approx(ROUGHNESS**2, rel=0.02)
    assert seen[4].min() >= 0.5 * ROUGHNESS**2 - 1e-7
    if texels == 0.0:
        assert shown > 0.4 * ROUGHNESS**2


@pytest.mark.parametrize("size", [(4.0, 4.0), (16.0, 1.0), (0.3, 2.2)])
def test_texels_keep_their_size_on_organs_of_any_size(size):
    # Correlation along u and v at the same distance in millimetres, within the factor sqrt(2) of the repeats.
    surface, size_m = organ("fruit"), TILE_M * np.array(size)
    rng = np.random.default_rng(2)
    uv = rng.uniform(0.1, 0.8, (20_000, 2))
    first = look_up(surface, uv, 0.0, size_m=size_m)[0]
    for axis in (0, 1):
        for distance_mm, low, high in ((0.08, 0.6, 1.0), (2.0, -0.05, 0.05)):
            beside = uv.copy()
            beside[:, axis] += 1e-3 * distance_mm / size_m[axis]
            second = look_up(surface, beside, 0.0, size_m=size_m)[0]
            assert low <= np.corrcoef(first, second)[0, 1] <= high


def test_no_part_is_repeated():
    surface = organ("fruit")
    uv = np.random.default_rng(3).uniform(0.0, 1.0 / 8.0, (5000, 2))
    parts = [
        look_up(surface, uv + np.array([column, row]) / 8.0, 0.0, size_m=(8.0 * TILE_M, 8.0 * TILE_M))[0]
        for column in range(3)
        for row in range(3)
    ]
    correlation = np.corrcoef([*parts, look_up(surface, uv, 0.0, texture=2.0, size_m=(8 * TILE_M,) * 2)[0]])
    assert np.abs(correlation - np.eye(10)).max() < 0.1


def test_surfaces_without_skin_have_no_tables(kaite):
    nm = np.arange(400.0, 701.0, 50.0)
    plain, fine = organ_surfaces(kaite, nm), organ_surfaces(kaite, nm, load_skin("pepper"))
    assert Optics.pack(list(plain.values()), 400.0, 700.0).skins is None
    assert {name for name, surface in fine.items() if surface.skin is None} == {"cut"}
    for name, surface in plain.items():
        assert surface.skin is None
        np.testing.assert_array_equal(surface.reflectance, fine[name].reflectance)
        for texture, images in surface.textures.items():
            np.testing.assert_array_equal(images, fine[name].textures[texture])

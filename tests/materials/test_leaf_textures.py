"""Textures of leaves: relief, pigment pattern, residue and the order of ageing."""

from dataclasses import replace

import numpy as np
import pytest
from plant_colours import lab

from pepperscene.materials.leaf import leaf_optics
from pepperscene.materials.leaf_textures import LAST_ORDER, TEXTURES, leaf_textures
from pepperscene.materials.surface import AGEING_RANGE
from pepperscene.materials.venation import BladeGrid

MIDRIB_MM = 6.0  # half-width of the strip about the midrib, which all leaves have in the same place


@pytest.fixture(scope="module")
def grid():
    return BladeGrid.build((112.0, 135.0))


@pytest.fixture(scope="module")
def textures(grid):
    return leaf_textures(grid, np.random.default_rng(1))


@pytest.fixture(scope="module")
def patches(grid):
    """Residue of leaves with spray and mildew, without dust."""
    return leaf_textures(grid, np.random.default_rng(1), 3, (0.0, 0.3, 0.7)).residue_pattern


@pytest.fixture(scope="module")
def inside(grid):
    """`(h, w)` mask of the blade."""
    return grid.edge_mm > 0


@pytest.fixture(scope="module")
def slopes(textures, grid):
    """`(t, h, w)` slopes of the relief along u and along v."""
    along_v, along_u = np.gradient(textures.relief_mm, grid.pixel_mm, axis=(1, 2))
    return along_u, along_v


def rms(values):
    return np.sqrt(np.mean(np.square(values, dtype=float)))


def correlations(maps, mask):
    """Correlation of each of the textures and mirror images with each other, `(2t, 2t)` without diagonal."""
    vectors = np.concatenate([maps[:, mask], maps[:, :, ::-1][:, mask]])
    table = np.corrcoef(vectors)
    return table[~np.eye(len(table), dtype=bool)]


def test_leaves_have_eight_maps_of_each_kind_and_do_not_share_a_texture(textures, grid, inside):
    for maps in vars(textures).values():
        assert (maps.dtype, maps.shape) == (np.float32, (TEXTURES, 512, 425))
    away = inside & (np.abs(grid.x_mm) > MIDRIB_MM)
    for maps in (textures.pattern, textures.relief_mm):
        assert correlations(maps, away).max() < 0.2
        # With the midrib, which stays in the middle, the mean is.
        assert correlations(maps, inside).mean() < 0.2


def test_relief_is_alike_in_all_directions(slopes, grid, inside):
    """Along and across the blade, and along and across the lateral veins of each half."""
    along_u, along_v = slopes
    assert 1 / 1.2 < rms(along_v[:, inside]) / rms(along_u[:, inside]) < 1.2
    turn = np.radians(52.0)  # the mean angle between lateral veins and midrib
    for side in (-1, 1):
        half = inside & (side * grid.x_mm > MIDRIB_MM)
        u, v = side * along_u[:, half], along_v[:, half]
        along, across = u * np.sin(turn) + v * np.cos(turn), u * np.cos(turn) - v * np.sin(turn)
        assert 1 / 1.2 < rms(along) / rms(across) < 1.2


def test_relief_is_bullate_and_not_too_steep_for_shading(slopes, inside):
    steepness = np.degrees(np.arctan(np.hypot(*slopes)[:, inside]))
    assert 7 < rms(steepness) < 16
    # The renderer limits slopes to 45 degrees.
    assert np.mean(steepness > 45) < 1e-3


def test_cells_bulge_by_about_a_millimetre_every_centimetre(textures, grid, inside):
    """Range of heights and distance of tops over windows of a cell, away from veins and margin."""
    from scipy import ndimage

    deep = ndimage.binary_erosion(inside, iterations=round(8 / grid.pixel_mm))
    deep &= (np.abs(grid.x_mm) > 10) & (grid.height > 0.1) & (grid.height < 0.9)
    window = round(10 / grid.pixel_mm)
    ranges, counts = [], []
    for relief in textures.relief_mm:
        smooth = ndimage.gaussian_filter(relief, 1.0 / grid.pixel_mm)
        high, low = ndimage.maximum_filter(smooth, window), ndimage.minimum_filter(smooth, window)
        ranges.append((high - low)[deep])
        tops = smooth == ndimage.maximum_filter(smooth, round(5 / grid.pixel_mm))
        counts.append(np.count_nonzero(tops & deep) / (np.count_nonzero(deep) * grid.pixel_mm**2))
    assert 0.6 < np.median(ranges) < 1.2
    assert 8.0 < 1 / np.sqrt(np.mean(counts)) < 12.0


def test_veins_are_sunken(textures, grid):
    # Over the heights at which there is a midrib; the bulges next to it are above it.
    row = (grid.height[:, 0] > 0.1) & (grid.height[:, 0] < 0.8)
    profile = textures.relief_mm[:, row].mean(axis=(0, 1))
    centre = int(np.argmin(np.abs(grid.x_mm[0])))
    beside = np.abs(np.abs(grid.x_mm[0]) - 4) < 1
    assert profile[centre - 2 : centre + 3].min() < profile[beside].mean() - 0.15


@pytest.mark.parametrize("state", [0.5, 0.9])
def test_midrib_is_lighter_by_five_to_twelve(textures, grid, kaite, nm, state):
    """CIELAB lightness of the sheet at the pattern's offset, along the middle of the blade's length."""
    row = (grid.height[:, 0] > 0.1) & (grid.height[:, 0] < 0.6)
    offset = textures.pattern[:, row, 200:225].min(axis=2).mean()
    blade, midrib = (
        leaf_optics(kaite.pigments["leaf"], nm, np.array([s]))[0][0] for s in (state, state + offset)
    )
    assert 5 < lab(midrib, nm)[0] - lab(blade, nm)[0] < 12


def test_residue_has_mean_one_evenly_or_in_patches(textures, patches, inside):
    dust = textures.residue_pattern
    for residue in (*dust, *patches):
        assert residue.min() >= 0
        assert residue[inside].mean() == pytest.approx(1, abs=1e-4)
    for residue in dust:
        assert 0.3 < residue[inside].std() < 0.75
    for residue in patches:
        # Uneven, but few places have so much that a mean cover of 10 % fills them.
        assert 0.6 < residue[inside].std() < 3
        assert np.mean(residue[inside] > 9.5) < 0.02


def test_spray_and_mildew_have_patches_of_two_to_twenty_millimetres(patches, grid, inside):
    """Distance at which the autocorrelation of the cover has fallen to 1/e, twice: a patch's diameter."""
    sizes, size = [], (1024, 1024)
    area = np.fft.irfft2(np.abs(np.fft.rfft2(inside.astype(float), size)) ** 2)[0, :200]
    for residue in patches:
        field = np.where(inside, np.minimum(residue, 5.0) - np.minimum(residue, 5.0)[inside].mean(), 0.0)
        correlation = np.fft.irfft2(np.abs(np.fft.rfft2(field, size)) ** 2)[0, :200] / area
        sizes.append(2 * grid.pixel_mm * np.argmax(correlation / correlation[0] < np.exp(-1)))
    assert 2 < min(sizes) <= max(sizes) < 20


def test_more_dust_lies_in_the_midrib_and_more_spray_at_the_tip_too(textures, grid, inside):
    midrib = inside & (np.abs(grid.x_mm) < 1) & (grid.height < 0.8)
    between = inside & (np.abs(grid.x_mm) > 10) & (grid.height < 0.8)
    sprayed = leaf_textures(grid, np.random.default_rng(1), 4, (0.0, 1.0, 0.0))
    dust, spray = (part.residue_pattern.mean(axis=0) for part in (textures, sprayed))
    assert dust[midrib].mean() > 1.2 * dust[between].mean()
    assert spray[midrib].mean() > 1.2 * spray[between].mean()
    assert spray[inside & (grid.height > 0.94)].mean() > 1.2 * spray[between].mean()


def aged(textures, ageing):
    """`(t, h, w)` fraction of the way to dry tissue at the ageing of an organ."""
    return np.clip((ageing - textures.ageing_order) / AGEING_RANGE, 0, 1)


def test_a_healthy_leaf_does_not_age_and_a_leaf_of_ageing_one_is_dry(textures):
    assert aged(textures, 0.0).max() == 0
    assert textures.ageing_order.max() <= LAST_ORDER <= 1 - AGEING_RANGE
    assert aged(textures, 1.0).min() == 1


def yellow(textures, ageing, state=0.72):
    """Where tissue is yellow or dry: beyond state -0.1 on the way from its state to dry."""
    return state - aged(textures, ageing) * (1 + state) < -0.1


def test_ageing_goes_from_rims_and_spots_over_most_of_the_leaf_to_all_of_it(textures, inside):
    share = {a: yellow(textures, a)[:, inside].mean(axis=1) for a in (0.1, 0.2, 0.3, 0.5, 0.9)}
    assert share[0.1].max() < 0.1
    assert share[0.2].min() > 0
    assert 0.02 < share[0.2].mean() < 0.2
    assert 0.08 < share[0.3].mean() < 0.35
    assert share[0.3].max() < 0.6
    assert share[0.5].mean() > 0.6
    assert share[0.9].mean() > 0.99


def test_rims_are_three_to_ten_millimetres_and_uneven(textures, grid, inside):
    """Area of the yellow within 20 mm of the margin over the margin's length, in the middle of the blade."""
    band = inside & (grid.edge_mm < 20) & (grid.height > 0.15) & (grid.height < 0.7)
    margin_mm = 2 * np.count_nonzero((grid.height > 0.15) & (grid.height < 0.7)) * grid.pixel_mm
    widths = [mask[band].sum() * grid.pixel_mm**2 / margin_mm for mask in yellow(textures, 0.3)]
    assert 3 < np.mean(widths) < 10
    # Row by row the width differs, within a texture.
    row = (grid.height[:, 0] > 0.2) & (grid.height[:, 0] < 0.6)
    profile = (yellow(textures, 0.3) & band)[:, row].sum(axis=2) * grid.pixel_mm / 2
    assert np.median(profile.std(axis=1) / profile.mean(axis=1)) > 0.25


def test_spots_are_two_to_six_millimetres(textures, grid, inside):
    """Yellow places that touch neither rim nor midrib, by the diameter of a disc of their area."""
    from scipy import ndimage

    sizes = []
    for mask in yellow(textures, 0.25):
        labels, count = ndimage.label(mask & inside)
        at_rim = np.unique(labels[inside & (grid.edge_mm < 2)])
        area = np.bincount(labels.ravel(), minlength=count + 1)[1:] * grid.pixel_mm**2
        free = ~np.isin(np.arange(1, count + 1), at_rim)
        sizes.extend(2 * np.sqrt(area[free & (area > 1)] / np.pi))
    assert len(sizes) > 10
    assert 2 < np.median(sizes) < 6


def test_veins_age_last(textures, grid, inside):
    """The order's mean over textures is latest on the midrib and earliest at the rim."""
    order = textures.ageing_order.mean(axis=0)
    deep = inside & (grid.edge_mm > 20)
    assert order[deep & (np.abs(grid.x_mm) < 1)].mean() > order[deep & (np.abs(grid.x_mm) > 8)].mean() + 0.1
    assert order[inside & (grid.edge_mm < 2)].mean() < 0.1


def test_textures_are_a_function_of_the_generator(grid):
    small = BladeGrid.build((56.0, 80.0), pixels=96)
    first, again, other = (leaf_textures(small, np.random.default_rng(s), 2) for s in (9, 9, 10))
    for field in vars(first):
        assert np.array_equal(getattr(first, field), getattr(again, field))
        assert not np.array_equal(getattr(first, field), getattr(other, field))


def test_a_palmate_blade_has_pale_main_veins_beside_its_midrib(grid, textures):
    """The lowest lateral veins are paler and deeper by half or more; nothing else changes."""
    palmate = leaf_textures(replace(grid, palmate=True), np.random.default_rng(1), 1)
    paler, lower = textures.pattern[:1] - palmate.pattern, textures.relief_mm[:1] - palmate.relief_mm
    assert paler.min() == 0.0
    assert lower.min() == pytest.approx(0.0, abs=1e-6)
    assert min(paler.max(), lower.max()) > 0.2
    # Three veins on each side take a few hundredths of the blade, below the upper third of the midrib.
    veins = paler > 0.05
    assert 0.01 < veins.mean() < 0.1
    middle = slice(grid.shape[1] * 4 // 10, grid.shape[1] * 6 // 10)
    assert not veins[:, 2 * grid.shape[0] // 3 :, middle].any()
    np.testing.assert_array_equal(palmate.ageing_order, textures.ageing_order[:1])

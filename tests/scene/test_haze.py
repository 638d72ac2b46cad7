"""A hazy sheet loses no light, is reciprocal, and spreads a beam as widely as it says."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.scene.cover import directions, haze

ROWS, COLUMNS, LOWEST = 64, 128, 40
WIDTHS = np.radians([4.0, 12.0, 30.0, 90.0])


def projected(rows=ROWS, columns=COLUMNS):
    """`(rows, 1)` integral of the cosine to the zenith over a texel above the horizon, in closed form."""
    edges = np.sin(np.minimum(np.arange(rows + 1) / rows * np.pi, np.pi / 2)) ** 2
    return (np.diff(edges) * np.pi / columns)[:, None]


def texel(row, column):
    """A map that is dark but for one texel."""
    radiance = np.zeros((1, ROWS, COLUMNS))
    radiance[0, row, column] = 1.0
    return radiance


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("row", [0, 7, 20, 31])
def test_what_comes_in_from_anywhere_goes_out(width, row):
    radiance = texel(row, 17)
    spread = haze(width, ROWS, COLUMNS, LOWEST).spread(radiance)
    assert (spread * projected()).sum() == pytest.approx((radiance * projected()).sum(), rel=1e-9)
    assert spread.min() >= 0.0


@pytest.mark.parametrize("width", WIDTHS)
def test_a_sky_that_is_the_same_everywhere_stays_so(width):
    # Else light could be made brighter by a sheet without power, against the second law.
    spread = haze(width, ROWS, COLUMNS, LOWEST).spread(np.full((2, ROWS, COLUMNS), 3.0))
    np.testing.assert_allclose(spread[:, :LOWEST], 3.0, rtol=1e-8)
    assert not spread[:, LOWEST:].any()


@pytest.mark.parametrize("width", WIDTHS[1:])
@pytest.mark.parametrize(("one", "other"), [((3, 5), (25, 20)), ((30, 100), (31, 3)), ((0, 0), (16, 64))])
def test_light_may_go_either_way(width, one, other):
    sheet = haze(width, ROWS, COLUMNS, LOWEST)
    there = sheet.spread(texel(*one))[0][other] / projected()[one[0], 0]
    back = sheet.spread(texel(*other))[0][one] / projected()[other[0], 0]
    assert there == pytest.approx(back, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("row", [1, 12, 31])
def test_a_beam_spreads_as_a_small_piece_of_sky_does(width, row):
    sheet = haze(width, ROWS, COLUMNS, LOWEST)
    towards = directions(ROWS, COLUMNS)
    lobe = sheet.lobe(towards, towards[row, 40])
    spread = sheet.spread(texel(row, 40))[0]
    np.testing.assert_allclose(lobe / lobe.max(), spread / spread.max(), atol=1e-9)


@pytest.mark.parametrize("width_deg", [3.0, 6.0, 10.0])
def test_the_lobe_is_as_wide_as_told(width_deg):
    # From the zenith, on a fine map: the mean square of the angle is twice the width's where it is small.
    rows, columns = 512, 8
    towards = directions(rows, columns)
    lobe = haze(np.radians(width_deg), rows, columns, rows // 2).lobe(towards, np.array([0.0, 0.0, 1.0]))
    angle = np.arccos(towards[..., 2])
    energy = lobe * projected(rows, columns)
    mean_square = (energy * angle**2).sum() / energy.sum()
    assert np.degrees(np.sqrt(mean_square / 2.0)) == pytest.approx(width_deg, rel=0.03)


def test_haze_has_no_favourite_azimuth():
    sheet = haze(WIDTHS[1], ROWS, COLUMNS, LOWEST)
    radiance = np.random.default_rng(0).random((1, ROWS, COLUMNS))
    turned = np.roll(sheet.spread(radiance), 31, axis=2)
    np.testing.assert_allclose(sheet.spread(np.roll(radiance, 31, axis=2)), turned, rtol=1e-9, atol=1e-12)

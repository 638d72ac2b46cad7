"""Noise of fields against normal deviates, and the photon transfer line against a known gain."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.calibration.noise import YCBCR, chart_noise, photon_transfer
from pepperscene.calibration.photographs import ChartPhotograph


def flat_fields(deviation, gradient=0.0, seed=0):
    """24 squares of 40 x 40 pixels with independent normal noise in red, green and blue."""
    rng = np.random.default_rng(seed)
    slope = gradient * np.linspace(-1.0, 1.0, 40)[:, None, None]
    middles = tuple(0.5 + slope + rng.normal(0.0, deviation, (40, 40, 3)) for _ in range(24))
    codes = np.full((24, 3), 0.5)
    usable = np.ones((24, 3), bool)
    usable[5] = False
    picture = np.zeros((4, 4, 3), np.uint8)
    return ChartPhotograph(
        "x", picture, np.zeros((4, 2)), np.arange(24), codes, usable, np.zeros((24, 2)), middles
    )


def test_deviations_are_those_of_luma_and_chroma():
    noise = chart_noise(flat_fields(0.02, gradient=0.1), np.random.default_rng(0))
    expected = 0.02 * np.sqrt((YCBCR**2).sum(axis=1))
    assert noise.mean()[0] == pytest.approx(expected, rel=0.02)
    # Independent noise falls to a half in means of 2 x 2 pixels.
    assert noise.mean()[1] == pytest.approx(expected / 2.0, rel=0.03)
    assert np.isnan(noise.deviations[5]).all()
    # Of a variance of 1,600 values.
    assert noise.relative_sd == pytest.approx(1.0 / np.sqrt(2.0 * 1600), rel=0.3)


@pytest.mark.parametrize(("electrons", "read_e"), [(500.0, 0.0), (3000.0, 4.0), (20_000.0, 20.0)])
def test_photon_transfer_gives_the_electrons_of_full_scale(electrons, read_e):
    rng = np.random.default_rng(3)
    levels = np.linspace(0.03, 0.9, 24)
    signals = [(rng.poisson(level * electrons, 40_000) + rng.normal(0, read_e, 40_000)) / electrons
               for level in levels]  # fmt: skip
    line = photon_transfer(
        np.array([s.mean() for s in signals]), np.array([s.var() for s in signals]), np.random.default_rng(0)
    )
    assert 1.0 / line.slope == pytest.approx(electrons, rel=0.02)
    assert abs(line.slope - 1.0 / electrons) < 4.0 * line.slope_sd
    assert line.dark == pytest.approx((read_e / electrons) ** 2, abs=0.02 / electrons)

"""Clouds are sums of plane waves, whichever way they are summed."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.scene.sky import _sum_of_waves


@pytest.mark.parametrize("count", [1, 1023, 1024, 5000])
def test_single_precision_sums_the_waves_of_a_sky(count):
    # Places and frequencies as far out as a sky's: 1 / 0.15 on the plane overhead, 24 waves per unit.
    rng = np.random.default_rng(count)
    places = rng.uniform(-1.0, 1.0, (count, 2)) / 0.15
    frequency = np.exp(rng.uniform(0.0, np.log(24.0), 256))
    heading, phase = rng.uniform(0.0, 2.0 * np.pi, (2, 256))
    vectors = frequency * np.stack([np.cos(heading), np.sin(heading)])
    expected = np.cos(places @ vectors + phase) @ (1.0 / frequency)
    spread = np.sqrt(0.5 * np.sum(frequency**-2.0))
    assert np.abs(_sum_of_waves(places, vectors, phase) - expected).max() < 2e-5 * spread

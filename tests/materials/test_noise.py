import numpy as np
import pytest

from pepperscene.materials.patterns import cell_walls, smooth_noise


def test_smooth_noise_is_standard_periodic_and_of_the_wanted_grain():
    field = smooth_noise(np.random.default_rng(1), (256, 192), (3.0, 6.0))
    assert field.shape == (256, 192)
    assert field.mean() == pytest.approx(0, abs=1e-9)
    assert field.std() == pytest.approx(1)
    # White noise under a Gaussian has the autocorrelation exp(-(d / 2 sigma)^2).
    for axis, sigma in ((0, 3.0), (1, 6.0)):
        shifted = np.roll(field, round(sigma), axis=axis)
        assert np.mean(field * shifted) == pytest.approx(np.exp(-0.25), abs=0.06)


def test_cell_walls_are_zero_somewhere_and_positive_inside():
    grid = np.stack(np.meshgrid(np.linspace(0, 50, 120), np.linspace(0, 50, 120)), axis=-1)
    walls = cell_walls(np.random.default_rng(2), grid, 5.0)
    assert walls.shape == (120, 120)
    assert walls.min() >= 0
    assert (walls < 0.5).mean() > 0.1
    assert 2.0 < walls.max() < 10.0

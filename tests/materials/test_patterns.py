"""Smooth noise, cell networks and veins."""

import numpy as np
import pytest

from pepperscene.materials.patterns import cell_walls, grow_veins, smooth_noise, vein_pattern, vein_relief

SIZE_MM = (112.0, 135.0)


def gradient(field):
    """Derivatives along u and v, per millimetre."""
    along_v, along_u = np.gradient(field)
    return along_u * 512 / SIZE_MM[0], along_v * 512 / SIZE_MM[1]


@pytest.fixture(scope="module")
def veins():
    return grow_veins(SIZE_MM, np.random.default_rng(5))


def test_smooth_noise_is_standardised_and_has_its_correlation_length():
    field = smooth_noise(np.random.default_rng(1), (256, 192), (3.0, 6.0))
    assert field.shape == (256, 192)
    assert field.mean() == pytest.approx(0, abs=1e-9)
    assert field.std() == pytest.approx(1)
    # White noise under a Gaussian has the autocorrelation exp(-(d / 2 sigma)^2), also across the edges.
    for axis, sigma in ((0, 3.0), (1, 6.0)):
        shifted = np.roll(field, round(sigma), axis=axis)
        assert np.mean(field * shifted) == pytest.approx(np.exp(-0.25), abs=0.06)


def test_cell_walls_are_zero_on_walls_and_positive_inside():
    grid = np.stack(np.meshgrid(np.linspace(0, 50, 120), np.linspace(0, 50, 120)), axis=-1)
    walls = cell_walls(np.random.default_rng(2), grid, 5.0)
    assert walls.shape == (120, 120)
    assert walls.min() >= 0
    assert (walls < 0.5).mean() > 0.1
    assert 2.0 < walls.max() < 10.0


def test_midrib_is_in_the_middle(veins):
    across = np.abs((np.arange(512) + 0.5) / 512 - 0.5) * SIZE_MM[0]
    # The ripple moves it by some tenths of a millimetre.
    assert np.abs(veins.midrib_mm - across).max() < 2.0
    assert np.abs(veins.midrib_mm.argmin(axis=1) - 256).max() < 10


@pytest.mark.parametrize("column", [180, 332])
def test_each_side_has_six_to_eight_secondary_veins(veins, column):
    """Minima of the distance along a line parallel to the midrib."""
    distance = veins.secondary_mm[:, column]
    minima = (distance[1:-1] < distance[:-2]) & (distance[1:-1] < distance[2:]) & (distance[1:-1] < 0.5)
    assert 6 <= minima.sum() <= 8


def test_secondary_veins_leave_at_45_to_60_degrees_and_bend_to_the_tip(veins):
    """A vein is orthogonal to the gradient of the distance from it."""
    dx, dy = gradient(veins.secondary_mm)
    angle = np.degrees(np.arctan2(np.abs(dy), np.abs(dx)))  # of the vein to the midrib
    next_to_vein = (
        (veins.secondary_mm > 0.4) & (veins.secondary_mm < 2.0) & (veins.height > 0.05) & (veins.height < 0.8)
    )
    near, far = (veins.midrib_mm < 10) & next_to_vein, (veins.reach > 0.8) & next_to_vein
    assert 45 < np.median(angle[near]) < 60
    assert np.median(angle[far]) < np.median(angle[near]) - 10


def test_distances_have_unit_gradient(veins):
    for field in (veins.midrib_mm, veins.secondary_mm):
        steepness = np.hypot(*gradient(field))
        assert np.percentile(steepness, 99) < 1.2
        assert np.median(steepness) == pytest.approx(1.0, abs=0.1)


def test_veins_are_paler_and_sunken(veins):
    pattern, relief = (f(veins, np.random.default_rng(6)) for f in (vein_pattern, vein_relief))
    assert pattern.dtype == relief.dtype == np.float32
    assert pattern.shape == relief.shape == (512, 512)
    on_midrib = veins.midrib_mm < 0.3
    on_secondary = (veins.secondary_mm < 0.2) & (veins.midrib_mm > 5)
    between = (veins.secondary_mm > 4) & (veins.midrib_mm > 5)
    assert pattern[on_midrib].mean() < pattern[on_secondary].mean() - 0.1 < pattern[between].mean() - 0.2
    assert relief[on_midrib].mean() < relief[on_secondary].mean() < relief[between].mean() - 0.2
    # The blade between the veins keeps its state.
    assert abs(np.median(pattern)) < 0.08
    # The relief is shallow enough for shading.
    slope = np.degrees(np.arctan(np.hypot(*gradient(relief))))
    assert 2 < np.median(slope) < 10
    assert slope.max() < 45


def test_same_generator_state_gives_same_bytes():
    patterns = [
        vein_pattern(grow_veins(SIZE_MM, rng, 64), rng) for rng in map(np.random.default_rng, (9, 9, 10))
    ]
    assert patterns[0].tobytes() == patterns[1].tobytes() != patterns[2].tobytes()

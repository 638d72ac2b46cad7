import numpy as np
import pytest

from pepperscene.materials.patterns import grow_veins, vein_pattern, vein_relief

SIZE_MM = (112.0, 135.0)


@pytest.fixture(scope="module")
def veins():
    return grow_veins(SIZE_MM, np.random.default_rng(5))


def test_the_midrib_runs_down_the_middle(veins):
    across = np.abs((np.arange(512) + 0.5) / 512 - 0.5) * SIZE_MM[0]
    # The ripple moves it by some tenths of a millimetre.
    assert np.abs(veins.midrib_mm - across).max() < 2.0
    assert np.abs(veins.midrib_mm.argmin(axis=1) - 256).max() < 10


@pytest.mark.parametrize("column", [180, 332])
def test_each_side_has_six_to_eight_secondary_veins(veins, column):
    """Count them along a line beside the midrib, as minima of the distance."""
    distance = veins.secondary_mm[:, column]
    minima = (distance[1:-1] < distance[:-2]) & (distance[1:-1] < distance[2:]) & (distance[1:-1] < 0.5)
    assert 6 <= minima.sum() <= 8


def test_secondary_veins_leave_at_45_to_60_degrees_and_arc_to_the_tip(veins):
    """The direction along a vein is across the gradient of the distance from it."""
    grad_v, grad_u = np.gradient(veins.secondary_mm)
    dx, dy = grad_u * 512 / SIZE_MM[0], grad_v * 512 / SIZE_MM[1]
    angle = np.degrees(np.arctan2(np.abs(dy), np.abs(dx)))  # of the vein to the midrib
    beside = (
        (veins.secondary_mm > 0.4) & (veins.secondary_mm < 2.0) & (veins.height > 0.05) & (veins.height < 0.8)
    )
    near, far = (veins.midrib_mm < 10) & beside, (veins.reach > 0.8) & beside
    assert 45 < np.median(angle[near]) < 60
    assert np.median(angle[far]) < np.median(angle[near]) - 10


def test_distances_are_distances(veins):
    """Neither grows faster than one goes."""
    for field in (veins.midrib_mm, veins.secondary_mm):
        grad_v, grad_u = np.gradient(field)
        steepness = np.hypot(grad_u * 512 / SIZE_MM[0], grad_v * 512 / SIZE_MM[1])
        assert np.percentile(steepness, 99) < 1.2
        assert np.median(steepness) == pytest.approx(1.0, abs=0.1)


def test_veins_are_paler_and_sunk(veins):
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


def test_relief_is_gentle_enough_for_shading(veins):
    relief = vein_relief(veins, np.random.default_rng(6))
    grad_v, grad_u = np.gradient(relief)
    slope = np.degrees(np.arctan(np.hypot(grad_u * 512 / SIZE_MM[0], grad_v * 512 / SIZE_MM[1])))
    assert 2 < np.median(slope) < 10
    assert slope.max() < 45


def test_same_generator_same_bytes():
    again = [
        vein_pattern(grow_veins(SIZE_MM, rng, 64), rng) for rng in map(np.random.default_rng, (9, 9, 10))
    ]
    assert again[0].tobytes() == again[1].tobytes() != again[2].tobytes()

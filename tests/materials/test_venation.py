"""The veins of a blade: midrib, lateral veins and their loops, the network between."""

import numpy as np
import pytest

from pepperscene.materials.leaf_textures import SIGMAS_MM
from pepperscene.materials.venation import BladeGrid, FieldTile, grow_veins, outline_reach

SIZE_MM = (112.0, 135.0)


@pytest.fixture(scope="module")
def grid():
    return BladeGrid.build(SIZE_MM)


@pytest.fixture(scope="module")
def veins(grid):
    rng = np.random.default_rng(5)
    return grow_veins(grid, FieldTile.build(grid, SIGMAS_MM, rng), rng)


def gradient(field, grid):
    """Derivatives along u and v, per millimetre."""
    along_v, along_u = np.gradient(field, grid.pixel_mm)
    return along_u, along_v


def test_pixels_are_square_and_cover_the_blade(grid):
    assert grid.shape == (512, 425)
    assert grid.pixel_mm == pytest.approx(135 / 512)
    assert grid.x_mm[0, [0, -1]] == pytest.approx([-55.9, 55.9], abs=0.1)
    assert grid.y_mm[[0, -1], 0] == pytest.approx([0.13, 134.87], abs=0.01)


@pytest.mark.parametrize(("widest", "base"), [(0.37, 0.85), (0.34, 0.6), (0.25, 1.0)])
def test_outline_is_zero_at_both_ends_and_widest_where_stated(widest, base):
    along = np.linspace(0.0, 1.0, 1001)
    reach = outline_reach(along, widest, base)
    assert reach[[0, -1]].tolist() == [0.0, 0.0]
    assert along[reach.argmax()] == pytest.approx(widest, abs=0.005)
    assert reach.max() == pytest.approx(1.0, abs=1e-6)
    assert np.all(np.diff(reach[: reach.argmax() + 1]) > 0)
    assert np.all(np.diff(reach[reach.argmax() :]) < 0)


def test_margin_is_at_distance_zero(grid):
    """The distance from the margin has the gradient 1 near it, and its sign changes on the outline."""
    inside = np.abs(grid.x_mm) < grid.half_mm
    assert np.array_equal(grid.edge_mm > 0, inside)
    near = (np.abs(grid.edge_mm) < 3) & (grid.height > 0.1) & (grid.height < 0.9) & (grid.x_mm != 0)
    steepness = np.hypot(*gradient(grid.edge_mm, grid))[near]
    assert np.percentile(steepness, [5, 95]) == pytest.approx([1, 1], abs=0.1)


def test_midrib_is_in_the_middle(grid, veins):
    # The ripple moves it by some tenths of a millimetre.
    assert np.abs(veins.midrib_mm - np.abs(grid.x_mm)).max() < 2.0


@pytest.mark.parametrize("x_mm", [-15.0, 15.0])
def test_each_side_has_six_to_eight_lateral_veins(grid, veins, x_mm):
    """Minima of the distance along a line parallel to the midrib."""
    column = int(np.argmin(np.abs(grid.x_mm[0] - x_mm)))
    within = np.abs(x_mm) < 0.75 * grid.half_mm[:, 0]
    distance = veins.lateral_mm[within, column]
    minima = (distance[1:-1] < distance[:-2]) & (distance[1:-1] < distance[2:]) & (distance[1:-1] < 0.5)
    assert 5 <= minima.sum() <= 8


def test_lateral_veins_leave_at_45_to_60_degrees_and_bend_to_the_tip(grid, veins):
    """A vein is orthogonal to the gradient of the distance from it."""
    dx, dy = gradient(veins.lateral_mm, grid)
    angle = np.degrees(np.arctan2(np.abs(dy), np.abs(dx)))  # of the vein to the midrib
    distance, height = veins.lateral_mm, grid.height
    next_to_vein = (distance > 0.4) & (distance < 2.0) & (height > 0.05) & (height < 0.8)
    near, far = (veins.midrib_mm < 10) & next_to_vein, (veins.out > 0.65) & (veins.out < 0.75) & next_to_vein
    assert 45 < np.median(angle[near]) < 60
    assert np.median(angle[far]) < np.median(angle[near]) - 5


def test_lateral_veins_join_in_loops_before_the_margin(grid, veins):
    """Every path outwards between the first and the last vein crosses one at 80 to 90 % of the half-width."""
    out = np.abs(grid.x_mm) / grid.half_mm
    rows = (grid.height[:, 0] > 0.35) & (grid.height[:, 0] < 0.75)
    for side in (grid.x_mm[0] < 0, grid.x_mm[0] > 0):
        distance, at = veins.lateral_mm[rows][:, side], out[rows][:, side]
        crossing = np.where((at > 0.77) & (at < 0.93), distance, np.inf).min(axis=1)
        assert crossing.max() < 0.7
        # Beyond the loops there is none: no vein runs out into the margin.
        beyond = np.where((at > 0.94) & (at < 1.0), distance, np.inf).min(axis=1)
        assert beyond.min() > 0.5


def test_distances_have_unit_gradient(grid, veins):
    for field, part in ((veins.midrib_mm, 0.99), (veins.lateral_mm, 0.95)):
        steepness = np.hypot(*gradient(field, grid))[(veins.out < 0.9) & (grid.height > 0.05)]
        assert np.quantile(steepness, part) < 1.3
        assert np.median(steepness) == pytest.approx(1.0, abs=0.1)


def test_meshes_of_tertiary_veins_are_three_to_six_millimetres(veins):
    """The mean free path between walls of a plane tessellation of area a and perimeter p is pi a / p."""
    on_wall = veins.mesh_mm[:, 1:] < 0.2
    crossings = np.count_nonzero(on_wall[:, 1:] & ~on_wall[:, :-1], axis=1).mean()
    assert 3.0 < SIZE_MM[0] / crossings < 6.0

"""Smooth noise, random cells, stamped discs and crops of periodic fields."""

import numpy as np
import pytest

from pepperscene.materials.patterns import PeriodicField, random_cells, smooth_noise, stamp_discs


def test_smooth_noise_is_standardised_and_has_its_correlation_length():
    field = smooth_noise(np.random.default_rng(1), (256, 192), (3.0, 6.0))
    assert field.shape == (256, 192)
    assert field.mean() == pytest.approx(0, abs=1e-9)
    assert field.std() == pytest.approx(1)
    # White noise under a Gaussian has the autocorrelation exp(-(d / 2 sigma)^2), also across the edges.
    for axis, sigma in ((0, 3.0), (1, 6.0)):
        shifted = np.roll(field, round(sigma), axis=axis)
        assert np.mean(field * shifted) == pytest.approx(np.exp(-0.25), abs=0.06)


@pytest.mark.parametrize("spacing", [7.0, 17.0, 38.0])
def test_cells_are_distances_on_a_torus(spacing):
    """No distance jumps from pixel to pixel, as where the search missed a centre, or at the edges."""
    cells = random_cells(np.random.default_rng(2), 256, spacing)
    centre, wall = np.moveaxis(cells, -1, 0)
    assert cells.shape == (256, 256, 2)
    for axis in (0, 1):
        for distance in (centre, wall):
            assert np.abs(distance - np.roll(distance, 1, axis)).max() <= 1.0 + 1e-3
    assert wall.min() >= 0.0
    assert wall.min() < 0.5
    # The farthest place of a cell is its centre, about half a spacing from the wall.
    assert 0.4 * spacing < wall.max() < 0.8 * spacing


def test_cells_have_their_spacing():
    pixels, spacing = 400, 20.0
    centre = random_cells(np.random.default_rng(3), pixels, spacing)[..., 0]
    shifts = [np.roll(centre, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    count = np.sum(np.all([centre < shifted for shifted in shifts], axis=0))
    # Of a triangular grid.
    assert count == pytest.approx(pixels**2 / (spacing**2 * np.sqrt(3) / 2), rel=0.1)


def test_discs_have_their_size_and_wrap_around():
    field = np.zeros((100, 100), np.float32)
    discs = np.array([[0.0, 50.0, 10.0, 0.5, 0.0], [5.0, 50.0, 10.0, 0.25, 0.0]])

    def flat(distance, number):
        return np.where(distance < 1, number, 0.0)

    stamp_discs(field, discs[:1], 1.0, flat, np.maximum)
    assert set(np.unique(field)) == {0.0, 0.5}
    assert np.count_nonzero(field) == pytest.approx(np.pi * 10.0**2, rel=0.05)
    assert field[50, 95] == field[50, 5] == 0.5
    # What is there already is combined, not replaced.
    stamp_discs(field, discs[1:], 1.0, flat, np.maximum)
    assert field[50, 0] == 0.5
    assert field[50, 14] == 0.25


def test_crops_are_parts_of_the_field_in_eight_orientations():
    values = np.arange(12.0 * 12.0).reshape(12, 12).astype(np.float32)
    rng = np.random.default_rng(4)
    crops = [PeriodicField(values).crop(rng, (5, 7)) for _ in range(200)]
    assert {crop.shape for crop in crops} == {(5, 7)}
    # Neighbours stay neighbours: the steps along the rows are those of the field's rows or columns.
    steps = {float(step) for crop in crops for step in np.unique(np.diff(crop, axis=1))}
    inner, wrapped = {1.0, -1.0, 12.0, -12.0}, {11.0, -11.0, 132.0, -132.0}
    assert steps == inner | wrapped
    assert len({crop.tobytes() for crop in crops}) > 150


def test_crops_take_all_fields_of_a_stack_together():
    values = np.random.default_rng(5).random((20, 20, 2)).astype(np.float32)
    values[..., 1] = 2.0 * values[..., 0]
    crop = PeriodicField(values).crop(np.random.default_rng(6), (9, 20))
    assert crop.shape == (9, 20, 2)
    assert np.array_equal(crop[..., 1], 2.0 * crop[..., 0])

"""Sample numbers: nets in each pair of dimensions, independent between dimensions, pixels and seeds.

All significance tests are two-sided and Bonferroni-corrected; each fails by chance once in a thousand, and
the seeds are fixed.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy import stats

from pepperscene.render.arrays import device_array, device_uint
from pepperscene.render.transport.owen_sobol import OwenSobol
from pepperscene.render.variant import mitsuba_modules

SIGNIFICANCE = 1e-3


def draw(kinds: str, pixels: np.ndarray, indices: np.ndarray, seed: int = 0) -> list[np.ndarray]:
    """`(pixels, indices)` for each "1" of `kinds`, `(pixels, indices, 2)` for each "2"."""
    pixel, index = (grid.ravel() for grid in np.meshgrid(pixels, indices, indexing="ij"))
    sequence = OwenSobol(device_array(pixel, np.uint32), device_array(index, np.uint32), device_uint(seed))
    _, dr = mitsuba_modules()
    drawn = [sequence.next_1d() if kind == "1" else sequence.next_2d() for kind in kinds]
    dr.eval(drawn)
    shape = len(pixels), len(indices)
    return [
        np.asarray(values).reshape(shape) if kind == "1" else np.asarray(values).T.reshape(*shape, 2)
        for values, kind in zip(drawn, kinds, strict=True)
    ]


def draw_coordinates(kinds: str, pixels: np.ndarray, indices: np.ndarray, seed: int = 0) -> np.ndarray:
    """`(d, pixels, indices)`: the coordinates of all points separately."""
    drawn = draw(kinds, pixels, indices, seed)
    return np.concatenate([v[None] if v.ndim == 2 else np.moveaxis(v, -1, 0) for v in drawn])


@pytest.mark.parametrize(("m", "block"), [(0, 5), (1, 0), (2, 5), (4, 0), (5, 5), (8, 0)])
def test_each_block_of_samples_is_a_net(m, block):
    # One point in each box of area 2^-m, whatever its shape (Niederreiter 1992, definition 4.1: t = 0).
    n = 2**m
    drawn = draw("21221", np.arange(40) * 7919, block * n + np.arange(n), seed=m)
    for points in (drawn[0], drawn[2], drawn[3]):
        for across in range(m + 1):
            x = np.floor(points[..., 0] * 2**across)
            y = np.floor(points[..., 1] * 2 ** (m - across))
            boxes = np.sort(x * 2 ** (m - across) + y, axis=1)
            assert (boxes == np.arange(n)).all(), (m, block, across)
    for values in (drawn[1], drawn[4]):
        assert (np.sort(np.floor(values * n), axis=1) == np.arange(n)).all()


def test_additional_samples_fill_the_gaps():
    # Four samples and then twelve more form a net of sixteen, as for the refinement of edges.
    (first,), (later,) = (draw("2", np.arange(30), np.arange(*span)) for span in ((0, 4), (4, 16)))
    cells = np.floor(np.concatenate([first, later], axis=1) * 4) @ [4, 1]
    assert (np.sort(cells, axis=1) == np.arange(16)).all()


def test_numbers_are_in_the_unit_interval():
    # Also at the limits of 32-bit indices, where rounding up to 1 would show.
    limits = np.array([0, 1, 2**24, 2**31 - 1, 2**31, 2**32 - 1], np.uint64)
    for seed in (0, 2**32 - 1):
        for pixels, indices in ((np.arange(2**14), np.arange(8)), (limits, limits)):
            values = draw_coordinates("12", pixels, indices, seed)
            assert values.shape == (3, len(pixels), len(indices))
            assert values.min() >= 0.0
            assert values.max() < 1.0


def test_numbers_depend_on_pixel_index_and_seed_alone():
    pixels, indices = np.arange(50), np.arange(64)
    every = draw_coordinates("212", pixels, indices, 9)
    assert np.array_equal(every[:, :, 20:37], draw_coordinates("212", pixels, indices[20:37], 9))
    assert np.array_equal(every[:, 31:32], draw_coordinates("212", pixels[31:32], indices, 9))
    assert np.array_equal(every[:, ::-1], draw_coordinates("212", pixels[::-1], indices, 9))
    assert (every != draw_coordinates("212", pixels, indices, 10)).mean() > 0.999


def assert_independent(a: np.ndarray, b: np.ndarray, tests: int) -> None:
    """Numbers `(n,)` in [0, 1): chi-squared over 8x8 boxes, and no correlation."""
    counts = np.histogram2d(a, b, bins=8, range=[[0, 1], [0, 1]])[0]
    assert stats.chisquare(counts.ravel()).pvalue > SIGNIFICANCE / (2 * tests)
    z = 12.0 * ((a - 0.5) * (b - 0.5)).mean() * np.sqrt(a.size)
    assert 2 * stats.norm.sf(abs(z)) > SIGNIFICANCE / (2 * tests), z


@pytest.mark.parametrize("index", [0, 3])
def test_dimensions_are_independent(index):
    # Over pixels, for one sample of each.
    values = draw_coordinates("2121", np.arange(2**15), np.array([index]), 3)[..., 0]
    pairs = list(combinations(values, 2))
    for first, second in pairs:
        assert_independent(first, second, len(pairs) * 2)


@pytest.mark.parametrize("step", [1, 64, 800])
def test_neighbouring_pixels_are_independent(step):
    # Every pixel in one pair only, so that the pairs are independent.
    pixels = np.arange(40 * 800).reshape(-1, 2, step)
    drawn = draw_coordinates("212", pixels.ravel(), np.array([0, 2]), 4)
    for values in np.moveaxis(drawn, 1, -1).reshape(-1, *pixels.shape):
        assert_independent(values[:, 0].ravel(), values[:, 1].ravel(), 40)


def test_seeds_are_independent():
    pixels, seeds = np.arange(2**15), (0, 1, 2**31)
    drawn = [draw_coordinates("21", pixels, np.array([0]), seed)[..., 0] for seed in seeds]
    for first, second in combinations(drawn, 2):
        for k in range(3):
            assert_independent(first[k], second[k], 9)


@pytest.mark.parametrize("n", [4, 16])
def test_dimensions_are_independent_within_a_pixel(n):
    # Padded dimensions have the same stratification and must not have the same order of strata: over the
    # samples of a pixel, products of centred numbers have the mean 0.
    centred = draw_coordinates("2211", np.arange(2**13), np.arange(n), 5) - 0.5
    pairs = list(combinations(centred, 2))
    for first, second in pairs:
        means = (first * second).mean(axis=1)
        z = means.mean() / (means.std(ddof=1) / np.sqrt(means.size))
        assert 2 * stats.norm.sf(abs(z)) > SIGNIFICANCE / (2 * len(pairs)), z


@pytest.mark.parametrize("index", [0, 5])
def test_each_number_is_uniform(index):
    drawn = draw_coordinates("212", np.arange(2**15), np.array([index]), 6)[..., 0]
    for values in drawn:
        assert stats.kstest(values, "uniform").pvalue > SIGNIFICANCE / (2 * len(drawn))


COUNTS = np.array([4, 16, 64, 256])
SMOOTH = (lambda x, y: np.exp(x) * np.sin(3.0 * y), (np.e - 1.0) * (1.0 - np.cos(3.0)) / 3.0)
EDGE = (lambda x, y: (y < 0.3 + 0.55 * x).astype(float), 0.3 + 0.55 / 2)


def rms_errors(values: np.ndarray, truth: float) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square errors over pixels for each of `COUNTS`, and those of independent samples."""
    means = np.array([values[:, :n].mean(axis=1) for n in COUNTS])
    z = (means.mean(axis=1) - truth) / (means.std(axis=1, ddof=1) / np.sqrt(len(values)))
    assert (2 * stats.norm.sf(abs(z)) > SIGNIFICANCE / 12).all(), z
    return np.sqrt(np.square(means - truth).mean(axis=1)), values.std() / np.sqrt(COUNTS)


@pytest.mark.parametrize(
    ("function", "max_slope", "gain"),
    [(EDGE, -0.72, 0.5), (SMOOTH, -1.2, 0.1)],
    ids=["edge", "smooth"],
)
def test_errors_fall_at_the_theoretical_rate(function, max_slope, gain):
    # An edge cuts sqrt(n) of n cells: n^(-3/4) (Mitchell 1996). Smooth: n^(-3/2) and logs (Owen 1997).
    f, truth = function
    (points,) = draw("2", np.arange(2000), np.arange(COUNTS[-1]), 7)
    errors, independent = rms_errors(f(points[..., 0], points[..., 1]), truth)
    slope = np.polyfit(np.log(COUNTS), np.log(errors), 1)[0]
    assert slope < max_slope, slope
    assert (errors < independent).all()
    assert errors[2] < gain * independent[2]

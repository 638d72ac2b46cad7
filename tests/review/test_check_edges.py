"""The shift at which labels fit a photograph best, for images whose shift is known."""

from __future__ import annotations

import numpy as np
import pytest
from disc_set import draw_discs
from scipy import ndimage
from skimage import transform

from pepperscene.review.check.edges import CHANCE, QUARTERS, match_edges


def develop(colour, seed=1, noise=6.0):
    values = colour + np.random.default_rng(seed).normal(0, noise, colour.shape)
    return np.clip(values, 0, 255).astype(np.uint8)


def discs(height, width, seed=0, count=140):
    return draw_discs(height, width, np.random.default_rng(seed), count)


COLOUR, LABELS = discs(240, 320)


def test_correct_labels_fit():
    result = match_edges(develop(COLOUR), LABELS)
    assert result.fits
    assert (result.right_px, result.down_px, result.quarter) == (0, 0, "")


@pytest.mark.parametrize(("right", "down"), [(1, 0), (0, -2), (-3, 5), (-40, 30)])
def test_finds_shift(right, down):
    # Part of a larger image, so that nothing wraps around.
    colour, labels = discs(340, 420, 2, 260)
    inner = np.s_[50:290, 50:370]
    moved = np.roll(labels, (down, right), (0, 1))[inner]
    result = match_edges(develop(colour)[inner], moved)
    assert (result.right_px, result.down_px) == (right, down)
    assert result.fits == (max(abs(right), abs(down)) < 2)


@pytest.mark.parametrize(
    "change",
    [
        lambda colour: colour * 0.2,
        lambda colour: 255 - colour,
        lambda colour: colour * np.linspace(0.1, 1.2, 320)[:, None],
        lambda colour: ndimage.gaussian_filter(colour, (2.5, 2.5, 0)),
        lambda colour: np.where(colour > 120, 255, colour),
        lambda colour: colour.mean(-1, keepdims=True).repeat(3, -1),
    ],
    ids=["dim", "negative", "vignetted", "out of focus", "overexposed", "grey"],
)
def test_light_and_focus_do_not_matter(change):
    assert match_edges(develop(change(COLOUR)), LABELS).fits


def test_mirrored_labels_fit_at_no_shift():
    for mirror in (np.s_[:, ::-1], np.s_[::-1], np.s_[::-1, ::-1]):
        result = match_edges(develop(COLOUR), LABELS[mirror])
        assert not result.fits
        assert result.height < CHANCE


def test_chance_is_below_the_threshold():
    photographs = [develop(discs(240, 320, seed)[0]) for seed in range(5, 11)]
    heights = [match_edges(photograph, LABELS).height for photograph in photographs]
    heights += [match_edges(develop(COLOUR * 0 + 90, seed), LABELS).height for seed in range(4)]
    assert max(heights) < CHANCE


@pytest.fixture(scope="module")
def large():
    colour, labels = discs(600, 800, 3, 900)
    return develop(colour), labels


@pytest.mark.parametrize(("scale", "degrees"), [(1.012, 0), (0.988, 0), (1, 1)])
def test_another_scale_or_angle_is_found_in_a_quarter(large, scale, degrees):
    photograph, labels = large
    centre = transform.SimilarityTransform(translation=(400.0, 300.0))
    change = transform.SimilarityTransform(scale=scale, rotation=np.radians(degrees))
    inverse = (transform.SimilarityTransform(translation=(-400.0, -300.0)) + change + centre).inverse
    changed = transform.warp(labels, inverse, order=0, preserve_range=True).astype(np.uint16)
    assert match_edges(photograph, labels).fits
    result = match_edges(photograph, changed)
    assert not result.fits
    assert result.quarter in QUARTERS


@pytest.mark.parametrize("size", [(151, 203), (1, 1), (1, 400), (600, 2)])
def test_accepts_any_size(size):
    colour, labels = discs(*size)
    result = match_edges(develop(colour), labels)
    assert result is None or result.fits


def test_few_borders_are_not_judged():
    few = np.zeros((240, 320), np.uint16)
    few[50:100, 60:110] = 3
    assert match_edges(develop(COLOUR), few) is None
    assert match_edges(develop(COLOUR), np.zeros_like(few)) is None


def test_rejects_labels_of_another_size():
    with pytest.raises(ValueError, match="must have the same size"):
        match_edges(develop(COLOUR), LABELS[1:])

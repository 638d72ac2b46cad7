"""The shift at which labels fit a photograph best, for pictures whose shift is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from skimage import transform

from pepperscene.dataset.check.edges import CHANCE, QUARTERS, match


def pictures(height, width, seed=0, discs=140):
    """Discs before each other in colours of their own, and their numbers."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:height, :width]
    labels = np.zeros((height, width), np.uint16)
    colour = np.full((height, width, 3), 60.0)
    for number in range(1, discs + 1):
        x, y, radius = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(5, 25)
        inside = (columns - x) ** 2 + (rows - y) ** 2 < radius**2
        labels[inside] = number
        colour[inside] = rng.uniform(40, 200, 3)
    return colour, labels


def developed(colour, seed=1, noise=6.0):
    values = colour + np.random.default_rng(seed).normal(0, noise, colour.shape)
    return np.clip(values, 0, 255).astype(np.uint8)


COLOUR, LABELS = pictures(240, 320)


def test_true_labels_fit():
    found = match(developed(COLOUR), LABELS)
    assert found.fits
    assert (found.right_px, found.down_px, found.quarter) == (0, 0, "")


@pytest.mark.parametrize(("right", "down"), [(1, 0), (0, -2), (2, 0), (-3, 5), (17, -11), (-40, 30)])
def test_a_shift_is_found(right, down):
    # Out of a larger picture, so that nothing comes in again on the other side.
    colour, labels = pictures(340, 420, seed=2, discs=260)
    inner = np.s_[50:290, 50:370]
    moved = np.roll(labels, (down, right), (0, 1))[inner]
    found = match(developed(colour)[inner], moved)
    assert (found.right_px, found.down_px) == (right, down)
    assert found.fits == (max(abs(right), abs(down)) < 2)


@pytest.mark.parametrize(
    "changed",
    [
        lambda colour: colour * 0.2,
        lambda colour: 255 - colour,
        lambda colour: colour * np.linspace(0.1, 1.2, 320)[:, None],
        lambda colour: ndimage.gaussian_filter(colour, (2.5, 2.5, 0)),
        lambda colour: np.where(colour > 120, 255, colour),
        lambda colour: colour.mean(-1, keepdims=True).repeat(3, -1),
    ],
    ids=["dim", "negative", "vignetted", "out of focus", "burnt out", "grey"],
)
def test_light_and_focus_do_not_move_edges(changed):
    assert match(developed(changed(COLOUR)), LABELS).fits


@pytest.mark.parametrize("turned", [np.s_[:, ::-1], np.s_[::-1], np.s_[::-1, ::-1]])
def test_mirrored_labels_fit_nowhere(turned):
    found = match(developed(COLOUR), LABELS[turned])
    assert not found.fits
    assert found.height < CHANCE


def test_chance_stays_below_what_counts():
    photographs = [developed(pictures(240, 320, seed)[0]) for seed in range(5, 11)]
    heights = [match(photograph, LABELS).height for photograph in photographs]
    heights += [match(developed(COLOUR * 0 + 90, seed), LABELS).height for seed in range(4)]
    assert max(heights) < CHANCE


@pytest.mark.parametrize("change", ["larger", "smaller", "turned"])
def test_another_scale_or_angle_shows_in_a_quarter(change):
    colour, labels = pictures(600, 800, seed=3, discs=900)
    middle, factor = np.array([400.0, 300.0]), {"larger": 1.012, "smaller": 0.988, "turned": 1.0}[change]
    angle = np.radians(1.0 if change == "turned" else 0.0)
    whole = transform.SimilarityTransform(scale=factor, rotation=angle)
    moved = transform.SimilarityTransform(translation=-middle) + whole
    moved = (moved + transform.SimilarityTransform(translation=middle)).inverse
    other = transform.warp(labels, moved, order=0, preserve_range=True).astype(np.uint16)
    assert match(developed(colour), labels).fits
    found = match(developed(colour), other)
    assert not found.fits
    assert found.quarter in QUARTERS


@pytest.mark.parametrize("size", [(151, 203), (97, 241), (1, 1), (1, 400), (600, 2)])
def test_any_size_will_do(size):
    colour, labels = pictures(*size)
    found = match(developed(colour), labels)
    assert found is None or found.fits


def test_without_borders_nothing_is_said():
    few = np.zeros((240, 320), np.uint16)
    few[50:100, 60:110] = 3
    assert match(developed(COLOUR), few) is None
    assert match(developed(COLOUR), np.zeros_like(few)) is None


def test_pictures_of_two_sizes_do_not_belong_together():
    with pytest.raises(ValueError, match="belong together"):
        match(developed(COLOUR), LABELS[1:])

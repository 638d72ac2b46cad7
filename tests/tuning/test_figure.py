"""The figure of a fit shows its colours, for any combination of what a fit has."""

from __future__ import annotations

import colorsys
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from example_fit import example_fit
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from pepperscene.camera import decode_tone, encode_tone
from pepperscene.colour import linear_srgb_to_lab
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.tuning.figure import BeforeAfter, before_after_figure, before_after_png


@pytest.fixture(scope="module")
def fit():
    values = {"leaf.chlorophyll": [48.0], "flash.colour": [0.2, 0.1]}
    return example_fit(load_recipe("demo"), values, pixels=3000)


@pytest.fixture(scope="module")
def drawn(fit):
    """The figure and its `(h, w, 3)` pixels."""
    figure = before_after_figure(fit, "demo")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return figure, np.asarray(canvas.buffer_rgba())[..., :3]


def rows_of_kinds(figure):
    """The axes of each kind: measured, before, after, hues."""
    axes = [axis for part in figure.subfigs for axis in part.axes]
    return [axes[i : i + 4] for i, axis in enumerate(axes) if axis.get_title() == "measured"]


def lab_of_image(drawn, axis):
    """`(h, w, 3)` CIELAB of the pixels of an axes, from top to bottom."""
    _, pixels = drawn
    box = axis.get_window_extent()
    height = pixels.shape[0]
    rows = slice(round(height - box.y1) + 2, round(height - box.y0) - 2)
    return linear_srgb_to_lab(decode_tone(pixels[rows, round(box.x0) + 2 : round(box.x1) - 2]))


def test_swatches_have_mean_colours_and_the_measured_one_in_the_middle(fit, drawn):
    rows = rows_of_kinds(drawn[0])
    assert len(rows) == len(fit.kinds)
    for axes, kind in zip(rows, fit.kinds.values(), strict=True):
        for axis, moments in zip(axes, (kind.target, kind.before, kind.after), strict=False):
            lab = lab_of_image(drawn, axis)
            height, width, _ = lab.shape
            # Half a code of 255 is at most a CIELAB unit in dark colours.
            assert np.abs(lab[height // 20, width // 20] - moments[0]).max() < 1.0
            assert np.abs(lab[round(0.35 * height), width // 2] - kind.target[0]).max() < 1.0


def test_strips_show_the_pixels_from_dark_to_bright(fit, drawn):
    for axes, kind in zip(rows_of_kinds(drawn[0]), fit.kinds.values(), strict=True):
        lab = lab_of_image(drawn, axes[0])
        lightness = lab[round(0.75 * len(lab)) :, ..., 0]
        assert (np.diff([part.mean() for part in np.array_split(lightness, 24, axis=1)]) > 0).all()
        assert lightness.mean() == pytest.approx(linear_srgb_to_lab(kind.pixels_target)[:, 0].mean(), abs=0.5)
        assert lightness.std() == pytest.approx(kind.target[1, 0], rel=0.1)


def test_hue_spectra_are_those_of_the_pixels(fit, drawn):
    for axes, kind in zip(rows_of_kinds(drawn[0]), fit.kinds.values(), strict=True):
        sides = (kind.pixels_target, kind.pixels_before, kind.pixels_after)
        for line, pixels in zip(axes[3].lines, sides, strict=True):
            # The pixels of a side differ in brightness, hardly in hue.
            hue = 360.0 * colorsys.rgb_to_hsv(*encode_tone(np.median(pixels, axis=0).astype(np.float32)))[0]
            assert line.get_xdata()[np.argmax(line.get_ydata())] == pytest.approx(hue, abs=3.0)
            assert line.get_ydata().sum() == pytest.approx(100.0, abs=1.0)


def test_frames_are_side_by_side_in_their_proportions(fit):
    red, blue = np.zeros((2, 300, 400, 3), np.uint8)
    red[..., 0] = blue[..., 2] = 255
    image = np.asarray(Image.open(BytesIO(before_after_png(fit, "demo", BeforeAfter(red, blue)))))[..., :3]
    masks = [(image == colour).all(axis=-1) for colour in ((255, 0, 0), (0, 0, 255))]
    for mask in masks:
        rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        assert len(columns) / len(rows) == pytest.approx(4 / 3, rel=0.01)
    assert np.flatnonzero(masks[0].any(axis=0)).max() < np.flatnonzero(masks[1].any(axis=0)).min()


def test_missing_parts_take_no_space(fit, drawn):
    height = drawn[0].get_figheight()
    bare = replace(fit, kinds={}, spectra={}, diagnostics=(), undetermined=())
    assert before_after_figure(bare, "demo").get_figheight() < height - 3.0
    kind = replace(next(iter(fit.kinds.values())), pixels_before=np.zeros((1, 3)))
    assert before_after_figure(replace(fit, kinds={"leaf": kind}), "demo").get_figheight() < height
    # Nor do repeated sentences.
    repeated = replace(fit, diagnostics=(*fit.diagnostics, *fit.undetermined))
    assert before_after_figure(repeated, "demo").get_figheight() == height


def test_any_name_and_number_can_be_drawn(fit):
    """Without warnings about missing letters; text is not mathematics."""
    spectra = {"перец $x$": next(iter(fit.spectra.values()))}
    undefined = {name: np.full(value.size, np.nan) for name, value in fit.variance_reduction.items()}
    odd = replace(fit, spectra=spectra, variance_reduction=undefined)
    assert before_after_png(odd, "名前 $\\frac{" + "long " * 60).startswith(b"\x89PNG")

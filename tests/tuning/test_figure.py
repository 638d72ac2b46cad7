"""The sheet shows the colours that it tells, and copes with whatever a fit has or lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from example_fit import a_fit

from pepperscene.camera import decode_tone
from pepperscene.camera.colorimetry import SRGB_TO_XYZ, xyz_to_lab
from pepperscene.dataset import load_recipe
from pepperscene.tuning.output.figure import WIDTH, BeforeAfter, sheet


@pytest.fixture(scope="module")
def fit():
    return a_fit(load_recipe("demo"), {"leaf.chlorophyll": [48.0], "flash.colour": [0.2, 0.1]}, pixels=3000)


def lab_at(picture, x, y):
    linear = decode_tone(np.asarray(picture)[y, x])
    return xyz_to_lab(SRGB_TO_XYZ @ linear)


def rows_of(picture, column):
    """First row of each field, where a column of the sheet leaves the paper's colour."""
    codes = np.asarray(picture).astype(int)[:, column]
    off = np.abs(codes - codes[0]).max(axis=1) > 12
    starts = np.flatnonzero(off & ~np.roll(off, 1))
    return [start for start in starts if off[start : start + 150].all()]


def test_fields_have_the_mean_colours_and_the_measured_one_in_their_middle(fit):
    picture = sheet(fit, "demo")
    assert picture.width == WIDTH
    tops = rows_of(picture, 225)
    assert len(tops) == len(fit.kinds)
    for top, kind in zip(tops, fit.kinds.values(), strict=True):
        for left, moments in ((220, kind.target), (604, kind.before), (988, kind.after)):
            # Half a code of 255 is at most a CIELAB unit, in dark colours.
            assert np.abs(lab_at(picture, left + 10, top + 8) - moments[0]).max() < 1.0
            assert np.abs(lab_at(picture, left + 183, top + 58) - kind.target[0]).max() < 1.0


def test_strips_show_the_spread_from_dark_to_bright(fit):
    picture = sheet(fit, "demo")
    (top, *_), kind = rows_of(picture, 225), fit.kinds["leaf"]
    strip = decode_tone(np.asarray(picture)[top + 118 : top + 162, 222:586])
    lightness = xyz_to_lab(strip @ SRGB_TO_XYZ.T)[..., 0]
    assert (np.diff(lightness.mean(axis=0).reshape(-1, 14).mean(axis=1)) > 0).all()
    assert lightness.mean() == pytest.approx(
        xyz_to_lab(kind.pixels_target @ SRGB_TO_XYZ.T)[:, 0].mean(), abs=0.5
    )
    assert lightness.std() == pytest.approx(kind.target[1, 0], rel=0.1)


def test_frames_are_shown_side_by_side_in_their_proportions(fit):
    one = np.zeros((300, 400, 3), np.uint8)
    one[..., 0] = 255
    other = np.zeros((300, 400, 3), np.uint8)
    other[..., 2] = 255
    codes = np.asarray(sheet(fit, "demo", BeforeAfter(one, other)))
    red, blue = ((codes == colour).all(axis=-1) for colour in ((255, 0, 0), (0, 0, 255)))
    for found in (red, blue):
        rows, columns = np.flatnonzero(found.any(axis=1)), np.flatnonzero(found.any(axis=0))
        assert len(columns) / len(rows) == pytest.approx(4 / 3, rel=0.01)
    assert np.flatnonzero(red.any(axis=0)).max() < np.flatnonzero(blue.any(axis=0)).min()


def test_whatever_is_missing_leaves_its_place_out(fit):
    whole = sheet(fit, "demo").height
    bare = replace(fit, kinds={}, spectra={}, diagnostics=(), undetermined=())
    assert sheet(bare, "demo").height < whole
    kind = next(iter(fit.kinds.values()))
    empty = replace(kind, pixels_target=np.zeros((0, 3)), pixels_before=np.zeros((1, 3)))
    assert sheet(replace(fit, kinds={"leaf": empty}), "demo").width == WIDTH


def test_odd_words_are_drawn(fit):
    """Names are a user's, and Pillow's own font knows few letters."""
    names = {"перец": next(iter(fit.spectra.values()))}
    told = replace(fit, spectra=names, gained={n: np.full(v.size, np.nan) for n, v in fit.variance_reduction.items()})
    assert sheet(told, "名前 " + "long " * 60).width == WIDTH


def test_words_are_not_said_twice(fit):
    twice = replace(fit, diagnostics=(*fit.diagnostics, *fit.undetermined))
    assert sheet(twice, "demo").height == sheet(fit, "demo").height

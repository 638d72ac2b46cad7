"""Colour calibration by synthetic charts: a known camera is inverted, invalid charts are rejected."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.camera import encode_tone
from pepperscene.camera.image.colorimetry import XYZ_TO_SRGB
from pepperscene.colour import calibrate, delta_e_2000, linear_srgb_to_lab
from pepperscene.colour.patches.chart import chart_linear, chart_names
from pepperscene.colour.patches.chart_detection import grid_corners, map_points
from pepperscene.errors import InputError
from pepperscene.spectra import colour_science

CAMERA = np.array([[0.62, 0.20, 0.06], [0.12, 0.70, 0.08], [0.02, 0.20, 0.50]])
"""Linear sRGB to camera_rgb: overlapping filters, no white balance, and dark enough to clip nothing."""

UPRIGHT = ((100, 100), (500, 100), (500, 367), (100, 367))
TILTED = ((120, 80), (520, 140), (470, 400), (90, 330))
UPSIDE_DOWN = ((400, 420), (120, 380), (160, 150), (430, 200))
ON_ITS_SIDE = ((420, 90), (440, 400), (220, 410), (210, 80))


def draw_chart(corners, camera=CAMERA, *, noise=0.004, tone="srgb", clutter=False):
    """A picture `(480, 640, 3)` of a chart in a black frame, fields 87 % of their pitch wide."""
    rng = np.random.default_rng(3)
    linear = np.full((480, 640, 3), 0.18)
    if clutter:
        # Flat quadrangles of many sizes, and a rough area.
        for _ in range(60):
            x, y, w, h = rng.integers((0, 0, 10, 10), (600, 440, 60, 60))
            linear[y : y + h, x : x + w] = rng.uniform(0.02, 0.6, 3)
        linear[:, 560:] = rng.uniform(0.0, 0.5, (480, 80, 3))
    x, y = np.meshgrid(np.arange(640) + 0.5, np.arange(480) + 0.5)
    place = map_points(np.stack([x, y], axis=-1), np.array(corners, float), grid_corners())
    linear[((place > -0.25) & (place < [6.25, 4.25])).all(axis=-1)] = 0.02
    cell = np.floor(place)
    field = ((np.abs(place - cell - 0.5) < 0.435) & (cell >= 0) & (cell < [6, 4])).all(axis=-1)
    linear[field] = chart_linear()[(cell[..., 1] * 6 + cell[..., 0])[field].astype(int)]
    seen = linear @ camera.T + rng.normal(0.0, noise, linear.shape)
    return encode_tone(seen.astype(np.float32), tone)


def test_chart_colours_agree_with_colour_science():
    """X-Rite's measurement of November 2014: another specimen, adapted from another illuminant."""
    colour = colour_science()
    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    xyz = colour.xyY_to_XYZ(list(chart.data.values()))
    adapted = colour.chromatic_adaptation(
        xyz, colour.xy_to_XYZ(chart.illuminant), colour.xy_to_XYZ([0.3127, 0.3290]), transform="Bradford"
    )
    differences = delta_e_2000(
        linear_srgb_to_lab(chart_linear()), linear_srgb_to_lab(adapted @ XYZ_TO_SRGB.T)
    )
    assert np.median(differences) < 1.5
    assert differences.max() < 5.0


@pytest.mark.parametrize(("corners", "detect"), [(TILTED, False), (UPSIDE_DOWN, True), (ON_ITS_SIDE, True)])
def test_inverts_a_known_camera(corners, detect):
    calibration = calibrate(draw_chart(corners), None if detect else corners)
    assert calibration.after.max() < 1.0
    assert calibration.before.mean() > 5.0
    assert calibration.corners == pytest.approx(np.array(corners, float), abs=2.0)
    # Other colours than the chart's are restored as well.
    others = np.random.default_rng(4).uniform(0.02, 0.9, (200, 3))
    restored = calibration.apply(others @ CAMERA.T)
    assert delta_e_2000(linear_srgb_to_lab(restored), linear_srgb_to_lab(others)).max() < 1.0


def test_detects_a_chart_that_is_in_clutter_large_or_mirrored():
    expected = np.array(TILTED, float)
    mirrored = calibrate(draw_chart(TILTED, clutter=True)[:, ::-1])
    assert mirrored.corners == pytest.approx(np.abs(expected - [640, 0]), abs=2.0)
    assert mirrored.after.max() < 1.0
    large = draw_chart(TILTED).repeat(2, axis=0).repeat(2, axis=1)
    assert calibrate(large).corners == pytest.approx(2.0 * expected, abs=4.0)


def test_calibrates_linear_codes():
    calibration = calibrate(draw_chart(TILTED, tone="linear"), TILTED, tone="linear")
    assert calibration.after.mean() < 1.0
    assert calibration.matrix @ CAMERA == pytest.approx(np.eye(3), abs=0.02)


def test_leaves_fields_clipped_at_zero_out_of_the_fit():
    """Cyan is outside the sRGB gamut."""
    calibration = calibrate(draw_chart(UPRIGHT, np.eye(3), noise=0.0), UPRIGHT)
    assert calibration.left_out == ("cyan",)
    others = [name != "cyan" for name in chart_names()]
    # The black field has nine codes only.
    assert calibration.after[others].max() < 1.0
    assert np.median(calibration.after) < 0.3
    assert calibration.matrix == pytest.approx(np.eye(3), abs=0.01)


@pytest.mark.parametrize(("order", "message"), [
    ((3, 0, 1, 2), "corner 2 and 3"),
    ((2, 3, 0, 1), "corner 3 and 4"),
    ((3, 2, 1, 0), "corner 4 and 3"),
])  # fmt: skip
def test_rejects_corners_in_another_order(order, message):
    with pytest.raises(InputError, match=message):
        calibrate(draw_chart(TILTED), np.array(TILTED)[list(order)])


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        ([(0, 0), (10, 0), (10, 10)], "four pairs"),
        ([(0, 0), (10, 0), (10, 10), (0, 900)], "must be inside"),
        ([(100, 100), (500, 367), (500, 100), (100, 367)], "in order around"),
        ([(10, 10), (22, 10), (22, 18), (10, 18)], "fields of"),
        ([(520, 10), (635, 10), (635, 90), (520, 90)], "shows no ColorChecker"),
    ],
)
def test_rejects_corners_without_a_chart(corners, message):
    with pytest.raises(InputError, match=message):
        calibrate(draw_chart(UPRIGHT), corners)


def test_rejects_a_chart_that_is_saturated_or_too_dark():
    with pytest.raises(InputError, match=r"saturated in the fields .*white"):
        calibrate(draw_chart(TILTED, 1.6 * CAMERA), TILTED)
    with pytest.raises(InputError, match="too dark"):
        calibrate(draw_chart(TILTED, 0.04 * CAMERA, noise=0.0), TILTED)


def test_rejects_a_picture_without_a_chart():
    noise = np.random.default_rng(5).integers(0, 256, (200, 300, 3), dtype=np.uint8)
    for picture in (noise, np.full((200, 300, 3), 90, np.uint8)):
        with pytest.raises(InputError, match="no ColorChecker"):
            calibrate(picture)

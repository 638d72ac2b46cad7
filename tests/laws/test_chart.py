"""A ColorChecker through the whole chain: lamp, kernel, lens, sensor, converter, matrix, tone curve.

Rationale: each step can be right and the chain wrong (a gain applied twice, a matrix transposed, a white
balance of another light). Photographing and measuring a chart, as with a real camera, reveals it.

Set-up: the 24 patches (BabelColor's average of 30 charts; the colour matrix was fitted to those of ISO
17321-1) on a plane at 50 cm, evenly lit with the shipped flash's spectrum, so bright that a perfect diffuser
would fill the fullest photosites to 99.5 %.

Expected: colour-science and NumPy alone: the integrals of SPD x reflectance x response, scaled to the well;
gains and matrix of the camera; sRGB encoded and decoded. Both are compared with the colours for the CIE 1931
observer under that light, adapted to D65 by CIECAT02 (the camera's matrix was fitted with Bradford).

Power: a patch has 64 pixels. Rendered electrons are within .4 % of the integral; the converter's and the
image's steps are 3 % and 4 % of the black patch's light, less of all others, and the 64 pixels of a uniform
patch share the rounding: up to 1.8 dE2000 in a dark patch, with no common sign in 24, whose mean differed by
.11 at most. With noise, the black patch's 200 electrons have a deviation of 30, so 4 in the mean of 64, which
contributes as much again: .17.
"""

from __future__ import annotations

import colour
import numpy as np
import pytest
from bodies import (
    SENSORS,
    axis_camera,
    card,
    columns_of,
    even_lamp,
    irradiance_by_hand,
    matt,
    response_by_hand,
)
from colour_chart import NM, chart, difference, lab_of_rgb, observer_lab

from pepperscene.camera import develop, load_flash, reference_correction
from pepperscene.geometry import concatenate_meshes
from pepperscene.render import render_scene
from pepperscene.scene import assemble_scene

SPD = columns_of("flashes/spectra/lumileds_cool_white")["lumileds_cool_white"]
FILLED = 0.995
SIDE, MARGIN = 12, 2  # pixels of a patch, and of its margin that is not measured


def electrons_by_hand(sensor, reflectance, lux):
    """`(m, 3)` electrons of Lambertian surfaces `(m, n)` under this illuminance."""
    radiance = np.asarray(reflectance) / np.pi * irradiance_by_hand(SPD, lux, NM)
    return np.trapezoid(radiance[:, None] * response_by_hand(sensor, NM), NM)


def chart_scene(sensor):
    """The chart's scene and the camera in front of it."""
    camera = axis_camera(6 * SIDE, 4 * SIDE, sensor=sensor, flash=None)
    lux = FILLED * camera.sensor.full_well_e / electrons_by_hand(sensor, np.ones((1, NM.size)), 1.0).max()
    lamp = even_lamp(load_flash("led_matrix_200klx").spectrum, float(lux))
    camera = axis_camera(6 * SIDE, 4 * SIDE, sensor=sensor, flash=lamp)
    side = SIDE * 0.5 * camera.sensor.pixel_pitch_m / 4.16e-3
    cards = [
        card((number % 6 - 2.5) * side, (number // 6 - 1.5) * side, side, side, str(number))
        for number in range(24)
    ]
    surfaces = {str(number): matt(str(number), NM, values) for number, values in enumerate(chart())}
    return assemble_scene(concatenate_meshes(cards), surfaces), camera


def patch_means(image):
    """`(24, 3)` means of the patches' middles in an image `(48, 72, 3)`."""
    patches = image.reshape(4, SIDE, 6, SIDE, 3).transpose(0, 2, 1, 3, 4).reshape(24, SIDE, SIDE, 3)
    return patches[:, MARGIN:-MARGIN, MARGIN:-MARGIN].mean((1, 2))


def lab_of_codes(codes):
    """`(..., 3)` Lab of 8-bit sRGB, with the perfect diffuser's `FILLED` as white."""
    return lab_of_rgb(colour.cctf_decoding(np.asarray(codes) / 255.0, function="sRGB") / FILLED)


def lab_by_hand(sensor, camera):
    """`(24, 3)` Lab predicted without rendering."""
    lux = camera.flash.illuminance_lx
    filled = np.minimum(electrons_by_hand(sensor, chart(), lux) / camera.sensor.full_well_e, 1.0)
    correction = reference_correction(camera)
    linear = np.minimum(filled * correction.gains, 1.0) @ correction.matrix.T
    return lab_of_codes(255.0 * colour.cctf_encoding(np.clip(linear, 0.0, 1.0), function="sRGB"))


@pytest.mark.parametrize("sensor", SENSORS)
def test_photographed_chart_matches_observer_and_prediction(sensor):
    scene, camera = chart_scene(sensor)
    frame = render_scene(scene, camera, ["electrons", "colour"], "standard", seed=3)
    target, predicted = observer_lab(np.interp(NM, *SPD)), lab_by_hand(sensor, camera)
    noiseless = lab_of_codes(patch_means(develop(frame["electrons"], camera, None)))
    # With noise, as in a frame: average light, not codes.
    linear = colour.cctf_decoding(frame["colour"] / 255.0, function="sRGB")
    noisy = lab_of_rgb(patch_means(linear) / FILLED)
    for lab in (noiseless, noisy):
        assert difference(target, lab).mean() <= 3.0
        assert difference(target, lab).mean() == pytest.approx(difference(target, predicted).mean(), abs=0.3)
    assert difference(predicted, noiseless).mean() < 0.5
    assert difference(predicted, noiseless).max() < 2.5

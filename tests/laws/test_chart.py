"""A ColorChecker through the whole chain: lamp, kernel, lens, sensor, converter, matrix, tone curve.

The 24 patches on a plane at 50 cm, evenly lit with the shipped flash's spectrum, so bright that a perfect
diffuser would fill the fullest photosites to 99.5 %, against colour-science and NumPy alone, and against the
colours for the CIE 1931 observer. Power: rendered electrons are within .4 % of the integral; rounding, which
the 64 pixels of a patch share, gives up to 1.8 dE2000 in a dark patch, .11 in the mean of 24; noise adds .17.
"""

import dataclasses

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

from pepperscene.camera import (
    Camera,
    Developing,
    develop,
    load_flash,
    load_lens,
    load_sensor,
    reference_correction,
)
from pepperscene.camera.image.colorimetry import d65_spectrum
from pepperscene.geometry import concatenate_meshes
from pepperscene.render import render_scene
from pepperscene.scene import assemble_scene
from pepperscene.shipped import shipped_folder

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


# --- every shipped sensor, without rendering ----------------------------------------------------------------


PATCH = 16  # pixels; demosaicing mixes colours only at the borders of patches
COLOUR_SENSORS = [
    name
    for name in sorted(path.stem for path in (shipped_folder("materials") / "sensors").glob("*.toml"))
    if load_sensor(name).channels == 3
]


def photographed_lab(sensor, light, flash, white_balance):
    """`(24, 3)` Lab of the developed 8-bit image of the chart, white at a full well."""
    weight = light.at(NM) * sensor.electrons_per_joule(NM)
    electrons = chart() @ weight.T / weight.sum(axis=1).max() * sensor.full_well_e
    electrons = electrons.reshape(4, 6, 3).repeat(PATCH, axis=0).repeat(PATCH, axis=1)
    small = dataclasses.replace(sensor, columns=6 * PATCH, rows=4 * PATCH)
    developing = Developing(white_balance=white_balance)
    camera = Camera(load_lens("lensagon_cmfa0420nd"), small, flash=flash, developing=developing)
    codes = develop(electrons, camera)[PATCH // 2 :: PATCH, PATCH // 2 :: PATCH].reshape(24, 3)
    return lab_of_rgb(colour.cctf_decoding(codes / 255, function="sRGB"))


def flash_and_light(white_balance):
    flash = load_flash("led_matrix_200klx")
    return flash, flash.spectrum if white_balance == "flash" else d65_spectrum()


@pytest.mark.parametrize("sensor", COLOUR_SENSORS)
@pytest.mark.parametrize("white_balance", ["flash", "daylight"])
def test_chart_colours_are_reproduced(sensor, white_balance):
    flash, light = flash_and_light(white_balance)
    lab = photographed_lab(load_sensor(sensor), light, flash, white_balance)
    error = difference(observer_lab(light.at(NM)), lab)
    assert error.mean() < 3.0
    assert error.max() < 8.0
    # Greys are close; the worst is the white patch, dark below 420 nm where these sensors still respond.
    assert error[18:].max() < 4.0

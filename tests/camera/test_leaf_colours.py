"""Colours of measured leaves and of daylight through the camera: spectra that the matrix was not fitted to.

The fit has leaves by PROSPECT; the thirteen leaves here were measured (Vrhel, Gershon & Iwan 1994). Colours
for the observer are computed by colour-science.
"""

from __future__ import annotations

from dataclasses import replace

import colour
import numpy as np
import pytest
from camera_colours import (
    D65,
    DAYLIGHT,
    FLASH,
    NM,
    SENSOR_NAMES,
    chart_delta_e,
    chroma,
    delta_e,
    lab_of_rgb,
    leaf_reflectances,
    measured_camera,
    observer_lab,
)

from pepperscene.camera import Camera, develop, load_flash, load_lens, load_sensor
from pepperscene.camera.image.colour_correction import colour_correction
from pepperscene.spectra import read_spectra

LEAVES = leaf_reflectances()
PAPER = "ueye_ui5250re"
LIGHTS = {"flash": FLASH, "daylight": DAYLIGHT}
# The measured MT9V024 shows leaves worse than all other measured cameras do, by whichever matrix.
CHROMA_BIAS = {name: 0.065 if name.startswith("onsemi_mt9v024") else 0.05 for name in SENSOR_NAMES}
MEASURED = [
    name.removesuffix("_g")
    for name in read_spectra("sensors/spectra/physlight_camera_sensitivities")
    if name.endswith("_g")
]


def rendered_lab(sensor, light, reflectance, correction):
    """`(m, 3)` Lab of noise-free camera_rgb after gains and matrix, white at 1."""
    electrons = reflectance @ (light.at(NM) * sensor.electrons_per_joule(NM)).T
    white = (light.at(NM) * sensor.electrons_per_joule(NM)).sum(axis=-1)
    np.testing.assert_allclose(correction.gains * white, white.max(), rtol=1e-3)  # infrared is left out here
    return lab_of_rgb(electrons / white @ correction.matrix.T)


@pytest.mark.parametrize(("name", "light"), [(n, "daylight") for n in SENSOR_NAMES] + [(PAPER, "flash")])
def test_chroma_of_measured_leaves_is_kept(name, light):
    sensor = load_sensor(name)
    lab = rendered_lab(sensor, LIGHTS[light], LEAVES, colour_correction(sensor, LIGHTS[light]))
    true = observer_lab(LIGHTS[light].at(NM), LEAVES)
    assert abs(chroma(lab).mean() / chroma(true).mean() - 1) < CHROMA_BIAS[name]
    assert delta_e(true, lab).mean() < 1.5


def test_leaves_in_a_developed_picture_keep_their_chroma():
    # Mosaic, converter, matrix and 8-bit codes of the paper's camera; a quad a leaf, white at a full well.
    sensor = load_sensor(PAPER)
    weight = FLASH.at(NM) * sensor.electrons_per_joule(NM)
    electrons = LEAVES @ weight.T / weight.sum(axis=1).max() * sensor.full_well_e
    wide = np.repeat(electrons[None], 2, axis=0)
    small = replace(sensor, columns=len(LEAVES), rows=2)
    camera = Camera(load_lens("lensagon_cmfa0420nd"), small, flash=load_flash("led_matrix_200klx"))
    linear = colour.cctf_decoding(develop(wide, camera)[0] / 255, function="sRGB")
    lab, true = lab_of_rgb(linear), observer_lab(FLASH.at(NM), LEAVES)
    assert abs(chroma(lab).mean() / chroma(true).mean() - 1) < 0.05
    # Blue is not clipped: linear values of leaves stay well above .002.
    assert linear[:, 2].min() > 0.002


@pytest.mark.parametrize(("balance", "shown"), [("flash", "daylight"), ("daylight", "flash")])
def test_white_under_another_light_has_its_true_colour(balance, shown):
    sensor, reference, light = load_sensor(PAPER), LIGHTS[balance], LIGHTS[shown]
    correction = colour_correction(sensor, reference)
    electrons = (light.at(NM) * sensor.electrons_per_joule(NM)).sum(axis=-1)
    rgb = electrons / electrons[1] * correction.gains
    rendered = correction.matrix @ (rgb / rgb[1])
    luminance = rendered @ np.array([0.2126, 0.7152, 0.0722])
    ratio = light.at(NM) / reference.at(NM)
    true = observer_lab(reference.at(NM), np.where(np.isfinite(ratio), ratio, 0.0)[None])
    # Compare colours of the luminance of white.
    true_xyz = colour.Lab_to_XYZ(true, D65)
    true = colour.XYZ_to_Lab(true_xyz / true_xyz[..., 1:2], D65)
    assert delta_e(true, lab_of_rgb(rendered[None] / luminance))[0] < 6.0
    # The test discriminates: the lights are visibly different.
    assert chroma(true)[0] > 8.0


def test_models_are_like_measured_cameras():
    def errors(sensor):
        correction = colour_correction(sensor, DAYLIGHT)
        lab = rendered_lab(sensor, DAYLIGHT, LEAVES, correction)
        true = observer_lab(DAYLIGHT.at(NM), LEAVES)
        return chart_delta_e(sensor, DAYLIGHT), delta_e(true, lab).mean()

    measured = np.array([errors(measured_camera(name)) for name in MEASURED])
    assert len(measured) == 8
    for name in (PAPER, "generic_rgb"):
        assert np.all(np.array(errors(load_sensor(name))) < measured.max(axis=0))
    # The test discriminates: the MT9V024, on which the models were once based, is worse than all of them.
    assert np.all(np.array(errors(load_sensor("onsemi_mt9v024"))) > measured.max(axis=0))


def test_ev76c570_model_is_computed_from_its_sources():
    columns = read_spectra("sensors/spectra/ev76c570_rgb_qe_MODEL.csv")
    nm = np.arange(400.0, 660.0, 10)
    mean = read_spectra("sensors/spectra/physlight_mean_of_cameras")
    files = "sensors/spectra/ircut_schott_22022010", "filters/spectra/largan_k098_bir690uv"
    cut = np.mean([read_spectra(file)["transmittance"].at(nm) for file in files], axis=0)
    cut = np.where(nm <= 512, cut.max(), cut)
    expected = np.stack([mean[c].at(nm) / nm / cut / (1 + np.exp((nm - 650) / 4.1)) for c in "rgb"])
    model = np.stack([columns[c].at(nm) for c in "rgb"])
    expected *= model[1].max() / expected[1].max()
    np.testing.assert_allclose(model, expected, rtol=0.01, atol=2e-3)
    assert columns["g"].values.max() == pytest.approx(0.47 * 0.93, abs=1e-4)


def test_matrix_is_fitted_once():
    sensor = load_sensor("nikon_d5100")
    assert colour_correction(sensor.with_settings(gain=2.0), FLASH) is colour_correction(sensor, FLASH)

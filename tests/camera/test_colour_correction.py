"""Colorimetry against colour-science, and colour corrections by reference lights or given in numbers."""

from __future__ import annotations

import json
import subprocess
import sys
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
    chroma,
    delta_e,
    lab_of_rgb,
    leaf_reflectances,
    observer_lab,
)
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    colour_transform,
    correct_colours,
    develop,
    load_flash,
    load_lens,
    load_sensor,
    reference_correction,
)
from pepperscene.camera.image.colorimetry import (
    D65_WHITE,
    SRGB_TO_XYZ,
    XYZ_TO_SRGB,
    bradford_adaptation,
    cie_1931_observer,
    colour_correction,
    d65_spectrum,
    srgb_decode,
    srgb_encode,
    white_balance_gains,
    xyz_to_lab,
)
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, photopic_efficiency, read_spectra

SENSOR = load_sensor("ueye_ui5250re")


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_srgb_curve_matches_colour_science_and_keeps_the_type(dtype):
    linear = np.linspace(0, 1, 5000, dtype=dtype)
    encoded = srgb_encode(linear)
    assert encoded.dtype == srgb_decode(encoded).dtype == dtype
    exact = np.linspace(0, 1, 5000)
    np.testing.assert_allclose(encoded, colour.cctf_encoding(exact, function="sRGB"), atol=2e-7)
    rounding = 4 * np.finfo(dtype).eps
    np.testing.assert_allclose(srgb_decode(encoded), linear, rtol=rounding, atol=rounding)


def test_srgb_matrices_and_white_match_colour_science():
    space = colour.RGB_COLOURSPACES["sRGB"]
    np.testing.assert_array_equal(XYZ_TO_SRGB, space.matrix_XYZ_to_RGB)
    np.testing.assert_array_equal(SRGB_TO_XYZ, space.matrix_RGB_to_XYZ)
    np.testing.assert_allclose(colour.xy_to_XYZ(space.whitepoint), D65_WHITE, rtol=1e-12)


def test_observer_matches_colour_science_and_v_lambda():
    observer, table = cie_1931_observer(), colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    np.testing.assert_array_equal(observer.wavelength_nm, table.wavelengths)
    np.testing.assert_array_equal(observer.values, table.values.T)
    # CIE 1931 defined y as V(lambda), which has been tabulated with more digits since.
    v = photopic_efficiency()
    np.testing.assert_allclose(observer.at(v.wavelength_nm)[1], v.values, rtol=0, atol=2e-4)


def test_lab_matches_colour_science_and_is_continuous():
    xyz = np.random.default_rng(0).random((1000, 3)) ** 4 * 1.2
    expected = colour.XYZ_to_Lab(xyz, colour.RGB_COLOURSPACES["sRGB"].whitepoint)
    np.testing.assert_allclose(xyz_to_lab(xyz), expected, rtol=1e-9, atol=1e-9)
    assert xyz_to_lab(D65_WHITE) == pytest.approx([100.0, 0.0, 0.0], abs=1e-12)
    assert xyz_to_lab(np.zeros(3)) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    knee = (6 / 29) ** 3
    below, above = (xyz_to_lab(D65_WHITE * knee * factor) for factor in (1 - 1e-9, 1 + 1e-9))
    np.testing.assert_allclose(below, above, atol=1e-6)


@pytest.mark.parametrize("white", [[1.09850, 1.0, 0.35585], D65_WHITE])
def test_adaptation_matches_colour_science_and_maps_white_to_d65(white):
    adaptation = bradford_adaptation(white)
    expected = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        np.array(white), D65_WHITE, transform="Bradford"
    )
    np.testing.assert_allclose(adaptation, expected, rtol=1e-12, atol=1e-14)
    assert adaptation @ white == pytest.approx(D65_WHITE, rel=1e-12)


def narrow_band(nm, width=10.0):
    at = nm + width * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    return Spectrum(at, np.array([0.0, 0.5, 1.0, 0.5, 0.0]))


@pytest.fixture(scope="module")
def infrared_sensor():
    """The MT9V024 without its filter: all colours see infrared."""
    curves = read_spectra("sensors/spectra/onsemi_mt9v024_rgb_qe.csv")
    efficiency = Spectrum(curves["r"].wavelength_nm, np.stack([curves[c].values for c in "rgb"]))
    return replace(SENSOR, quantum_efficiency=efficiency)


def test_corrections_keep_white_and_differ_between_flash_and_daylight():
    flash = colour_correction(SENSOR, load_flash("led_matrix_200klx").spectrum)
    daylight = colour_correction(SENSOR, d65_spectrum())
    for correction in (flash, daylight):
        np.testing.assert_allclose(correction.matrix.sum(axis=1), 1)
        assert min(correction.gains) == 1
    # A phosphor LED has no violet and a gap around 480 nm, so blue needs more gain than in daylight.
    assert flash.gains[2] > daylight.gains[2] * 1.05


def test_infrared_light_can_be_balanced_but_not_corrected(infrared_sensor):
    light = narrow_band(950.0)
    gains = white_balance_gains(infrared_sensor, light)
    assert np.all(np.isfinite(gains))
    assert gains.min() == 1
    with pytest.raises(InputError, match="needs a visible reference light"):
        colour_correction(infrared_sensor, light)
    for correct in (colour_correction, white_balance_gains):
        with pytest.raises(InputError, match="must see the reference light"):
            correct(SENSOR, narrow_band(1050))
    with pytest.raises(InputError, match="of more colours"):
        colour_correction(SENSOR, narrow_band(600, 3))


@pytest.mark.long
def test_illuminance_and_correction_do_not_import_colour_science():
    code = (
        "import sys; from pepperscene.camera import load_sensor\n"
        "from pepperscene.spectra import illuminance, sun_spectrum; illuminance(sun_spectrum())\n"
        "from pepperscene.camera.image.colorimetry import d65_spectrum\n"
        "from pepperscene.camera.image.colorimetry import colour_correction\n"
        "colour_correction(load_sensor('ueye_ui5250re'), d65_spectrum())\n"
        "assert 'colour' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


SMALL = replace(load_sensor("ueye_ui5250re"), columns=12, rows=8)
LENS, LAMP = load_lens("lensagon_cmfa0420nd"), load_flash("led_matrix_200klx")
GAINS = (1.9, 1.0, 1.5)
MATRIX = ((1.6, -0.4, -0.1), (-0.2, 1.5, -0.4), (0.1, -0.6, 1.7))
ANY_GAINS = st.tuples(*3 * [st.floats(0.1, 10.0)])
ANY_MATRIX = st.tuples(*3 * [st.tuples(*3 * [st.floats(-3.0, 3.0)])])


def camera_with(*, flash=None, gain=1.0, **choices):
    return Camera(LENS, SMALL.with_settings(gain=gain), flash=flash, developing=Developing(**choices))


def electrons_up_to(wells=2.0):
    """Random electrons of all colours, up to some full wells."""
    return np.random.default_rng(0).uniform(0, wells * SMALL.full_well_e, (8, 12, 3))


def linear(electrons, camera):
    return correct_colours(camera_rgb(electrons, camera), camera)


def test_result_can_be_modified_without_side_effects():
    camera = camera_with(flash=LAMP)
    gains, matrix = colour_transform(camera)
    gains *= 2
    matrix *= 2
    np.testing.assert_array_equal(2 * reference_correction(camera).matrix, matrix)
    np.testing.assert_array_equal(2 * colour_transform(camera)[0], gains)


@pytest.mark.parametrize(("balance", "gain"), [("flash", 0.5), ("daylight", 3.0)])
def test_numbers_of_the_reference_light_give_the_same_image(balance, gain):
    named = camera_with(flash=LAMP, gain=gain, white_balance=balance)
    correction = reference_correction(named)
    # Without a flash, because no reference light is needed any more.
    explicit = camera_with(gain=gain, white_balance=tuple(correction.gains), colour_matrix=correction.matrix)
    for seed in (None, 4):
        one, two = (
            develop(electrons_up_to(), camera, seed and np.random.default_rng(seed))
            for camera in (named, explicit)
        )
        np.testing.assert_array_equal(one, two)
    for one, two in zip(colour_transform(named), colour_transform(explicit), strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize(("flash", "named"), [(LAMP, "flash"), (None, "daylight")])
def test_given_gains_with_the_matrix_of_the_reference_light(flash, named):
    expected = reference_correction(camera_with(flash=flash, white_balance=named)).matrix
    gains, matrix = colour_transform(camera_with(flash=flash, white_balance=GAINS))
    np.testing.assert_array_equal(matrix, expected)
    np.testing.assert_array_equal(gains, GAINS)


def test_given_matrix_with_the_gains_of_the_reference_light():
    camera = camera_with(flash=LAMP, colour_matrix=MATRIX)
    gains, matrix = colour_transform(camera)
    np.testing.assert_array_equal(gains, reference_correction(camera).gains)
    np.testing.assert_array_equal(matrix, MATRIX)
    with pytest.raises(ValueError, match="needs a flash"):
        colour_transform(camera_with(colour_matrix=MATRIX))
    gains, matrix = colour_transform(camera_with(white_balance=None, colour_matrix=False))
    np.testing.assert_array_equal(gains, np.ones(3))
    np.testing.assert_array_equal(matrix, np.eye(3))


@given(gains=ANY_GAINS, matrix=ANY_MATRIX)
def test_below_saturation_the_image_is_matrix_times_gained_light(gains, matrix):
    camera = camera_with(white_balance=gains, colour_matrix=matrix, saturation=False)
    rgb = camera_rgb(electrons_up_to(), camera)
    expected = np.einsum("ij,hwj->hwi", np.array(matrix), np.array(gains) * rgb.astype(float))
    size = np.abs(matrix).sum() * max(gains) * rgb.max()
    tolerance = 1e-6 * size + np.finfo(np.float32).tiny
    np.testing.assert_allclose(correct_colours(rgb, camera), expected, atol=tolerance)


@given(gains=ANY_GAINS, gain=st.sampled_from([0.5, 3.0]))
def test_overexposed_light_is_neutral_for_any_gains(gains, gain):
    camera = camera_with(gain=gain, white_balance=gains, colour_matrix=False)
    image = linear(np.full((8, 12, 3), 10 * SMALL.full_well_e), camera)
    # The converter rounds: half a step of a range of some hundred.
    np.testing.assert_allclose(image, min(gain, 1.0) * min(gains), rtol=5e-3)
    assert np.ptp(image, axis=-1).max() <= 5e-3 * min(gains)


@pytest.mark.parametrize("form", [list, np.array])
def test_sequences_become_tuples_of_floats(form):
    developing = Developing(white_balance=form(GAINS), colour_matrix=form([form(row) for row in MATRIX]))
    assert developing == Developing(white_balance=GAINS, colour_matrix=MATRIX)
    assert hash(developing) == hash(Developing(white_balance=GAINS, colour_matrix=MATRIX))
    metadata = Camera(LENS, SMALL, developing=developing).to_metadata()
    # And back from a frame's JSON.
    assert Developing(**json.loads(json.dumps(metadata, allow_nan=False))["developing"]) == developing


def test_raises_on_invalid_gains_and_matrices():
    for gains in (
        (1.0, 1.0), (1.0, 0.0, 1.0), (1.0, -1.0, 1.0), (1.0, np.nan, 1.0), (1.0, np.inf, 1.0), (1e-3, 1, 1),
        (1e3, 1, 1), 1.0, True, [(1.0, 1.0, 1.0)], "tungsten",
    ):  # fmt: skip
        with pytest.raises(ValueError, match="white balance"):
            Developing(white_balance=gains)
    for matrix in (np.eye(2), np.ones(9), np.full((3, 3), np.nan), 1.0, None, np.diag([1, 1, 101.0])):
        with pytest.raises(ValueError, match="colour matrix"):
            Developing(colour_matrix=matrix)


LEAVES = leaf_reflectances()
PAPER = "ueye_ui5250re"
LIGHTS = {"flash": FLASH, "daylight": DAYLIGHT}
# The measured MT9V024 shows leaves worse than all other measured cameras do, by whichever matrix.
CHROMA_BIAS = {name: 0.065 if name.startswith("onsemi_mt9v024") else 0.05 for name in SENSOR_NAMES}


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

"""The closed loop: a chart through hidden processing, its calibration, and what the written recipe shows."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from hidden_cameras import (
    HiddenCamera,
    balanced,
    chart_rgb,
    decoded,
    jpeg,
    natural_reflectances,
    photographed_chart,
)
from PIL import Image

from pepperscene import CalibrationOptions, calibrate, load_recipe
from pepperscene.calibration.edges import chart_sharpness
from pepperscene.calibration.noise import chart_noise
from pepperscene.calibration.photographs import measure_chart
from pepperscene.camera import decode_tone, develop
from pepperscene.camera.image.colorimetry import colour_correction, d65_spectrum
from pepperscene.camera.image.electrons import spread_light
from pepperscene.camera.image.photo import jpeg_bytes, photo_description
from pepperscene.colour import delta_e_2000, linear_srgb_to_lab
from pepperscene.recipe.resolve.load_camera import load_camera

SHAPE = (600, 800)
RECIPE = (
    'extends = "greenhouse"\nname = "small"\n[camera]\nsensor = "generic_rgb"\nwidth = 160\nheight = 120\n'
)
CAMERAS = {
    "plain": HiddenCamera(),
    "webcam": HiddenCamera(contrast=0.4, saturation=1.2, balance=(1.05, 1, 0.93), lift=0.02, vignetting=0.2,
                           sharpening=0.8, quality=90),
    "dull": HiddenCamera(gamma=0.8, white=0.55, balance=(0.9, 1, 1.1), gain=4, noise_blur=0.6, quality=85,
                         saturation=0.8),
    "dark corners": HiddenCamera(contrast=0.45, white=0.8, saturation=1.2, vignetting=0.35, lens_blur=0.9),
    "sharpened": HiddenCamera(gamma=1.15, white=0.8, contrast=-0.3, lift=0.05, quality=88, sharpening=1.2,
                              radius=1.2, lens_blur=0.8),
    "smoothed": HiddenCamera(gain=8, white=0.7, contrast=0.3, chroma_blur=2.0, noise_blur=0.8, quality=95),
}  # fmt: skip


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    path = tmp_path_factory.mktemp("recipe") / "small.toml"
    path.write_text(RECIPE)
    return str(path)


def written_photograph(path, exposure, rgb, seed=None):
    """The photograph of camera_rgb `(h, w, 3)` by the written recipe's camera, as its JPEG shows it."""
    camera = load_camera(load_recipe(path))
    sensor = replace(camera.sensor, columns=rgb.shape[1], rows=rgb.shape[0])
    camera = replace(camera, sensor=sensor)
    reference = colour_correction(sensor, d65_spectrum()).gains
    # The exposure is that of green before the gains, whose smallest is 1 in the recipe.
    light = exposure * reference[1] / camera.developing.white_balance[1] / reference
    electrons = spread_light(rgb * light * sensor.full_well_e / sensor.gain, camera)
    rng = None if seed is None else np.random.default_rng(seed)
    return decoded(jpeg_bytes(develop(electrons, camera, rng), photo_description(camera)))


def differences(first, second):
    return delta_e_2000(*(linear_srgb_to_lab(decode_tone(255.0 * codes)) for codes in (first, second)))


def closed_loop(camera, folder, recipe):
    """The calibration of a chart, and what its recipe shows against the camera: differences and ratios."""
    picture, corners = photographed_chart(replace(camera, quality=None), SHAPE, pitch=90.0)
    chart = folder / "chart.jpg"
    chart.write_bytes(jpeg(picture, camera.quality or 98))
    calibration = calibrate(chart, folder / "camera.toml", CalibrationOptions(recipe=recipe))
    assert calibration.photographs[0].corners == pytest.approx(corners, abs=0.5)
    response, (path, *_) = calibration.response, calibration.files

    # Colours of the chart and of other surfaces, without noise and vignetting.
    fields = balanced(camera.sensor, natural_reflectances())[:56].reshape(7, 8, 3)
    shown = written_photograph(path, response.exposures[0], fields.repeat(32, axis=0).repeat(32, axis=1))
    shown = shown.reshape(7, 32, 8, 32, 3)[:, 12:20, :, 12:20].mean(axis=(1, 3)).reshape(-1, 3) / 255.0
    natural = differences(shown, camera.codes(natural_reflectances()[:56]))
    rgb = chart_rgb(camera.sensor, SHAPE, corners)
    ours = measure_chart(written_photograph(path, response.exposures[0], rgb, seed=5), corners, "ours")
    even = replace(camera, vignetting=0.0, quality=camera.quality or 98)
    theirs = measure_chart(even.photograph(rgb, seed=6), corners, "theirs")
    of_chart = differences(ours.codes, theirs.codes)

    # Sharpness without noise, and noise.
    mtf = []
    for seen in (
        written_photograph(path, response.exposures[0], rgb),
        even.photograph(rgb, seed=None),
    ):
        photograph = measure_chart(seen, corners, "x")
        mtf.append(chart_sharpness(photograph, response.inverse_tone(seen / 255.0)).mtf50)
    noise = [chart_noise(photograph).mean()[0] for photograph in (ours, theirs)]
    chroma = [np.hypot(*deviations[1:]) for deviations in noise]
    return calibration, {
        "chart": np.median(of_chart), "natural": np.median(natural), "mtf": mtf[0] / mtf[1],
        "luma": noise[0][0] / noise[1][0], "chroma": chroma[0] / chroma[1],
    }  # fmt: skip


def check_colours_and_sharpness(figures):
    assert max(figures["chart"], figures["natural"]) <= 1.5, figures
    assert figures["mtf"] == pytest.approx(1.0, abs=0.1), figures


def check_noise(figures, chroma=0.15):
    assert figures["luma"] == pytest.approx(1.0, abs=0.15), figures
    assert figures["chroma"] == pytest.approx(1.0, abs=chroma), figures


@pytest.mark.slow
def test_the_written_recipe_is_like_a_plain_camera(recipe, tmp_path):
    calibration, figures = closed_loop(CAMERAS["plain"], tmp_path, recipe)
    check_colours_and_sharpness(figures)
    check_noise(figures)
    assert [path.name for path in calibration.files] == ["camera.toml", "camera_tone.csv", "camera.html"]
    page = (tmp_path / "camera.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert page.count('src="data:image/') == 3
    assert page.count("<svg") == 2 * 24


@pytest.fixture(scope="module", params=[name for name in CAMERAS if name != "plain"])
def looped(request, recipe, tmp_path_factory):
    """Name and figures of a camera."""
    return request.param, closed_loop(CAMERAS[request.param], tmp_path_factory.mktemp("loop"), recipe)[1]


@pytest.mark.long
def test_the_written_recipe_has_the_colours_and_the_sharpness_of_the_camera(looped):
    check_colours_and_sharpness(looped[1])


MISSED = {"dull": "luma noise after JPEG of quality 85 is 22 % low"}
"""Cameras whose noise is known to be missed, and by how much."""
CHROMA = {"sharpened": 0.2}
"""Bounds of cameras that miss .15 on some machines: the same code has 7 % too much on one, 16 on another."""


@pytest.mark.long
def test_the_written_recipe_has_the_noise_of_the_camera(looped):
    name, figures = looped
    if name not in MISSED:
        check_noise(figures, CHROMA.get(name, 0.15))
        return
    # Fails as soon as the noise is met, so that it is then asked for.
    with pytest.raises(AssertionError):
        check_noise(figures)
    pytest.xfail(MISSED[name])


def test_jpeg_settings_are_those_of_the_file(tmp_path):
    from pepperscene.calibration.photographs import JpegSettings, jpeg_settings

    picture = np.random.default_rng(0).integers(0, 256, (32, 48, 3), dtype=np.uint8)
    for quality, subsampling in ((30, "4:2:0"), (75, "4:2:2"), (92, "4:4:4"), (100, "4:2:0")):
        path, buffer = tmp_path / "x.jpg", io.BytesIO()
        Image.fromarray(picture).save(buffer, "JPEG", quality=quality, subsampling=subsampling)
        path.write_bytes(buffer.getvalue())
        assert jpeg_settings(path) == JpegSettings(quality, subsampling)
    Image.fromarray(picture).save(tmp_path / "x.png")
    assert jpeg_settings(tmp_path / "x.png") is None

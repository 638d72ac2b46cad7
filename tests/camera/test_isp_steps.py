"""Image signal processing: each step against a closed form or another library, and laws of all together."""

from __future__ import annotations

import dataclasses
import typing
from dataclasses import replace

import colour
import cv2
import numpy as np
import pytest
from skimage.filters import unsharp_mask
from skimage.registration import phase_cross_correlation

from pepperscene.camera import (
    Camera,
    Developing,
    ImageProcessor,
    develop,
    load_flash,
    load_lens,
    load_processor,
    load_sensor,
    relative_illumination,
)
from pepperscene.camera.image.developing import apply_tone, s_curve, tone_curve
from pepperscene.camera.isp.steps import (
    apply_local_steps,
    correct_shading,
    displace_red_and_blue,
    guided_filter,
    map_locally,
    reduce_noise,
    resample,
    saturate,
    sharpen,
)
from pepperscene.camera.sensor.rows import row_strips
from pepperscene.units import table_fields

PRESETS = ("webcam", "realsense_colour", "telephone", "machine_vision")
ROWS, COLUMNS = 48, 64
SENSOR = replace(load_sensor("ueye_ui5250re"), columns=COLUMNS, rows=ROWS)
CAMERA = Camera(load_lens("lensagon_cmfa0420nd"), SENSOR, flash=load_flash("led_matrix_200klx"))
LIGHT = np.linspace(0, 1, 257)


def picture(seed=0, shape=(ROWS, COLUMNS, 3)):
    """Smooth areas, edges and noise, in (0, 1)."""
    rng = np.random.default_rng(seed)
    blocks = rng.uniform(0.1, 0.8, (shape[0] // 8, shape[1] // 8, *shape[2:]))
    image = blocks.repeat(8, axis=0).repeat(8, axis=1) + rng.normal(0, 0.02, shape)
    return np.clip(image, 0.01, 0.99).astype(np.float32)


def processed(isp, electrons, **choices):
    return develop(electrons, replace(CAMERA, developing=Developing(isp=isp, **choices)))


def plain(isp, rgb):
    """What a processor makes of camera_rgb, as linear codes, without any other step."""
    steps = dict.fromkeys(("shot_noise", "read_noise", "saturation", "quantise", "colour_matrix"), False)
    electrons = rgb * SENSOR.full_well_e
    return processed(isp, electrons, white_balance=None, tone="linear", **steps).astype(float)


def test_without_a_value_no_byte_changes():
    electrons = picture() * SENSOR.full_well_e
    expected = develop(electrons, CAMERA, np.random.default_rng(1))
    for isp in (ImageProcessor(), load_processor("machine_vision")):
        camera = replace(CAMERA, developing=Developing(isp=isp))
        assert (develop(electrons, camera, np.random.default_rng(1)) == expected).all()


@pytest.mark.parametrize("error", [-0.05, 0.03])
def test_black_level_error_is_added_to_linear_colours(error):
    rgb = picture()
    expected = 255 * np.clip(rgb + error, 0, 1)
    assert np.abs(plain(ImageProcessor(black_level_error=error), rgb) - expected).max() <= 0.51


EVEN = np.ones((ROWS, COLUMNS))


def test_shading_falls_with_the_square_of_the_distance_from_the_centre():
    isp = ImageProcessor(shading=-0.3, shading_cast=(0.1, -0.2))
    even = np.full((ROWS, COLUMNS, 3), 0.5, np.float32)
    shaded = correct_shading(even, slice(0, ROWS), (ROWS, COLUMNS), isp, EVEN) / 0.5
    y, x = np.mgrid[:ROWS, :COLUMNS] + 0.5
    share = np.hypot(x - COLUMNS / 2, y - ROWS / 2) / np.hypot(COLUMNS / 2, ROWS / 2)
    for channel, corner in enumerate((-0.2, -0.3, -0.5)):
        np.testing.assert_allclose(shaded[..., channel], 1 + corner * share**2, rtol=1e-5)


def test_correction_makes_an_even_surface_even_and_keeps_clipped_light_white():
    wide = replace(CAMERA, sensor=replace(SENSOR, pitch_m=10 * SENSOR.pitch_m))
    falloff = relative_illumination(wide)
    assert falloff.min() < 0.8
    light = 0.3 * SENSOR.full_well_e * falloff[..., None].repeat(3, axis=-1)
    steps = {"white_balance": (1, 1, 1), "colour_matrix": False, "quantise": False}

    def image(light, **values):
        isp = ImageProcessor(**values)
        return develop(light, replace(wide, developing=Developing(isp=isp, **steps)))

    assert np.ptp(image(light, shading_correction=1)) <= 1
    expected = 255 * colour.cctf_encoding(0.3 * np.sqrt(falloff), function="sRGB")
    assert np.abs(image(light, shading_correction=0.5)[..., 1] - expected).max() <= 1
    corner = image(10 * light, shading_correction=1, shading=-0.1)[0, 0]
    assert (corner == 255).all()


def test_shading_of_strips_is_that_of_the_whole_image():
    isp, rgb = ImageProcessor(shading=-0.3, black_level_error=0.01, shading_correction=0.8), picture()
    falloff = relative_illumination(CAMERA)
    whole = correct_shading(rgb, slice(0, ROWS), (ROWS, COLUMNS), isp, falloff)
    strips = [slice(top, min(top + 20, ROWS)) for top in range(0, ROWS, 20)]
    parts = [correct_shading(rgb[rows], rows, (ROWS, COLUMNS), isp, falloff[rows]) for rows in strips]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_red_and_blue_are_scaled_about_the_centre_and_green_stays():
    # A plane of light is interpolated exactly.
    y, x = np.mgrid[:ROWS, :COLUMNS] + 0.5
    ramp = (0.3 + 0.003 * (x - COLUMNS / 2) + 0.002 * (y - ROWS / 2)).astype(np.float32)
    rgb = np.stack([ramp] * 3, axis=-1)
    displace_red_and_blue(rgb, ImageProcessor(chromatic_aberration_px=(1.5, -1.0), chromatic_correction=0.25))
    assert (rgb[..., 1] == ramp).all()
    inner = (slice(3, -3), slice(3, -3))
    for channel, pixels in ((0, 1.5), (2, -1.0)):
        scale = 1 + 0.75 * pixels / np.hypot(COLUMNS / 2, ROWS / 2)
        expected = 0.3 + (ramp.astype(float) - 0.3) / scale
        np.testing.assert_allclose(rgb[inner][..., channel], expected[inner], atol=2e-6)


def test_displacement_of_a_corner_is_that_which_phase_correlation_finds():
    rows, columns, size = 240, 320, 64
    texture = cv2.GaussianBlur(np.random.default_rng(0).random((rows, columns), np.float32), (0, 0), 1.0)
    rgb = np.stack([texture] * 3, axis=-1)
    displace_red_and_blue(rgb, ImageProcessor(chromatic_aberration_px=(1.5, 0.0)))
    window, corner = cv2.createHanningWindow((size, size), cv2.CV_32F), (slice(-size, None),) * 2
    moved, fixed = ((image[corner] - image[corner].mean()) * window for image in (rgb[..., 0], texture))
    shift, _, _ = phase_cross_correlation(moved, fixed, upsample_factor=50, normalization=None)
    middle = np.array([rows - size / 2, columns - size / 2]) - np.array([rows, columns]) / 2
    np.testing.assert_allclose(shift, 1.5 * middle / np.hypot(rows / 2, columns / 2), atol=0.06)


def test_resampling_is_that_of_opencv():
    plane = picture()[..., 0].copy()
    rows, columns = np.linspace(-1, ROWS, 50), np.linspace(0.3, COLUMNS - 1.2, 70)
    x, y = np.meshgrid(columns.astype(np.float32), rows.astype(np.float32))
    expected = cv2.remap(plane, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    # OpenCV rounds positions to 1/32 of a pixel.
    np.testing.assert_allclose(resample(plane, rows, columns), expected, atol=0.7 / 32)
    row = resample(plane[:1], np.array([0.0]), np.arange(COLUMNS, dtype=float))
    np.testing.assert_array_equal(row, plane[:1])


def test_saturation_keeps_luminance_and_scales_the_difference_from_grey():
    linear, weights = picture(), colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ[1]
    luminance = (linear @ weights)[..., None]
    for factor in (0.0, 0.5, 1.7):
        result = saturate(linear, factor)
        np.testing.assert_allclose(result - luminance, factor * (linear - luminance), atol=1e-3)
    assert saturate(linear, None) is linear


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        ("srgb", colour.cctf_encoding(LIGHT, function="sRGB")),
        ("linear", LIGHT),
        ("gamma", colour.gamma_function(LIGHT, 1 / 2.4)),
        (((0.0, 0.1), (0.5, 0.1), (1.0, 0.9)), 0.1 + 1.6 * np.maximum(LIGHT - 0.5, 0)),
    ],
)
def test_tone_curves_are_those_of_their_definitions(curve, expected):
    np.testing.assert_allclose(tone_curve(LIGHT, curve, 2.4), expected, atol=1e-6)
    isp = ImageProcessor(tone_curve=curve, gamma=2.4)
    np.testing.assert_allclose(apply_tone(LIGHT.astype(np.float32), isp, "srgb"), expected, atol=4e-4)


@pytest.mark.parametrize("contrast", [-1.0, -0.4, 0.5, 1.0])
@pytest.mark.parametrize("curve", ["srgb", "linear", "gamma", "filmic"])
def test_tones_rise_from_black_to_white(curve, contrast):
    isp = ImageProcessor(tone_curve=curve, contrast=contrast)
    codes = apply_tone(np.linspace(-0.1, 1.1, 5001, dtype=np.float32), isp, "srgb")
    assert (np.diff(codes) >= 0).all()
    assert abs(codes[0]) < 1e-6
    assert abs(codes[-1] - 1) < 1e-6


def test_filmic_is_the_published_fit():
    # Narkowicz (2015): x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14) at 0.6 of the light.
    for light, fit in ((0.01, 0.00188237), (0.5, 0.43849170)):
        expected = colour.cctf_encoding(fit / 0.67329047, function="sRGB")
        assert tone_curve(np.array(light), "filmic") == pytest.approx(float(expected), rel=1e-4)
    # A toe and a shoulder about middle grey.
    light = np.array([0.02, 0.5])
    below, above = tone_curve(light, "filmic") - tone_curve(light, "srgb")
    assert below < -0.03
    assert above > 0.03


def test_s_curve_keeps_black_middle_and_white():
    np.testing.assert_allclose(s_curve(np.array([0, 0.5, 1.0]), 0.7), [0, 0.5, 1])
    assert s_curve(np.array(0.25), 1.0) == pytest.approx(3 * 0.25**2 - 2 * 0.25**3)


def test_guided_filter_is_the_mean_of_linear_fits_in_windows():
    plane, radius, edge = picture()[:12, :14, 0].astype(float), 2, 0.05
    size, padded = 2 * radius + 1, np.pad(plane, radius, mode="symmetric")
    slope, offset = np.empty(plane.shape), np.empty(plane.shape)
    for row, column in np.ndindex(plane.shape):
        values = padded[row : row + size, column : column + size].ravel()
        # Least squares of a line through the values themselves, with a penalty on its slope.
        system = np.column_stack([values, np.ones_like(values)])
        penalty = np.diag([values.size * edge**2, 0.0])
        slope[row, column], offset[row, column] = np.linalg.solve(
            system.T @ system + penalty, system.T @ values
        )
    means = [
        np.lib.stride_tricks.sliding_window_view(np.pad(part, radius, mode="symmetric"), (size, size)).mean(
            (2, 3)
        )
        for part in (slope, offset)
    ]
    result = guided_filter(plane.astype(np.float32), radius, edge)
    np.testing.assert_allclose(result, means[0] * plane + means[1], atol=1e-5)


def test_noise_is_reduced_and_edges_are_kept_as_by_a_bilateral_filter():
    rng = np.random.default_rng(3)
    clean = np.where(np.arange(128) < 64, 0.3, 0.7) * np.ones((96, 1))
    noisy = (clean + rng.normal(0, 0.02, clean.shape)).astype(np.float32)
    ours, bilateral = reduce_noise(noisy, 0.06), cv2.bilateralFilter(noisy, 5, 0.06, 2.0)
    flat = (slice(5, -5), slice(8, 56))
    assert ours[flat].std() < 1.2 * bilateral[flat].std() < 0.012
    edges = [image[:, 64:66].mean() - image[:, 62:64].mean() for image in (ours, bilateral)]
    assert edges[0] > 0.93 * edges[1] > 0.36
    assert ours.mean() == pytest.approx(noisy.mean(), abs=2e-4)


@pytest.mark.parametrize("radius", [0.6, 1.5])
def test_sharpening_is_the_unsharp_mask_of_scikit_image(radius):
    luma = picture()[..., 0]
    expected = unsharp_mask(luma, radius, 0.8)
    np.testing.assert_allclose(np.clip(sharpen(luma, 0.8, radius, 0.0), 0, 1), expected, atol=2e-6)


def test_sharpening_leaves_differences_below_the_threshold():
    luma = np.full((20, 30), 0.5, np.float32)
    luma[:, 15:] = 0.52
    assert (sharpen(luma, 2.0, 1.0, 0.011) == luma).all()
    luma[:, 15:] = 0.9
    mask = (unsharp_mask(luma, 1.0, 2.0, preserve_range=True) - luma)[:, 14:16]
    added = (sharpen(luma, 2.0, 1.0, 0.011) - luma)[:, 14:16]
    np.testing.assert_allclose(added, mask - 2 * 0.011 * np.sign(mask), atol=1e-6)


def test_local_mapping_moves_large_areas_to_the_mean_and_keeps_black_and_white():
    down = np.linspace(0.2, 0.6, 240)[:, None] * np.ones((1, 320))
    luma = down.astype(np.float32)
    mapped = map_locally(luma, 0.6, 0.0)
    inner = slice(20, -20)
    expected = down + 0.6 * 3 * down * (1 - down) * (down.mean() - down)
    np.testing.assert_allclose(mapped[inner], expected[inner], atol=5e-3)
    assert (np.diff(mapped[inner], axis=0) > 0).all()
    np.testing.assert_allclose(map_locally(np.full((40, 50), 0.4, np.float32), 1.0, 2.0), 0.4, atol=1e-6)
    halves = np.repeat(np.float32([0, 1]), 80)[:, None] * np.ones((1, 120), np.float32)
    np.testing.assert_allclose(map_locally(halves, 0.3, 0.0), halves, atol=0.04)


def test_local_contrast_amplifies_fine_patterns():
    x = np.arange(320)
    luma = (0.5 + 0.02 * np.sin(2 * np.pi * x / 10) * np.ones((240, 1))).astype(np.float32)
    amplified = map_locally(luma, 0.0, 0.5)
    assert amplified[40:-40, 40:-40].std() == pytest.approx(1.5 * luma[40:-40, 40:-40].std(), rel=0.05)
    assert amplified.mean() == pytest.approx(luma.mean(), abs=1e-4)


def test_noise_of_chroma_is_reduced_without_a_change_of_luma():
    codes = picture()
    isp = ImageProcessor(chroma_noise_reduction=0.05)
    result = apply_local_steps(codes, isp)
    weights = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-T T.871
    np.testing.assert_allclose(result @ weights, codes @ weights, atol=1e-5)
    blue = [(image[..., 2] - image @ weights)[2:6, 2:6].std() for image in (codes, result)]
    assert blue[1] < 0.5 * blue[0]


NEUTRAL = ImageProcessor(
    black_level_error=0.01,
    shading=-0.2,
    saturation=1.6,
    tone_curve="filmic",
    contrast=0.4,
    luma_noise_reduction=0.05,
    chroma_noise_reduction=0.1,
    local_tone_mapping=0.5,
    local_contrast=0.5,
    sharpening=1.0,
    sharpening_threshold=0.01,
)


def test_grey_stays_grey_through_all_steps_without_a_cast():
    grey = picture()[..., :1].repeat(3, axis=-1)
    codes = plain(NEUTRAL, grey)
    assert np.ptp(codes, axis=-1).max() <= 1
    assert np.ptp(codes) > 100


def test_a_monochrome_image_has_no_steps_of_colour():
    sensor = replace(
        SENSOR, pattern="mono", quantum_efficiency=load_sensor("onsemi_mt9v024_mono").quantum_efficiency
    )
    isp = replace(NEUTRAL, shading_cast=(0.5, -0.5), chromatic_aberration_px=(3.0, 3.0))
    camera = replace(CAMERA, sensor=sensor, developing=Developing(isp=isp, quantise=False))
    without = replace(CAMERA, sensor=sensor, developing=Developing(isp=NEUTRAL, quantise=False))
    electrons = picture()[..., :1] * sensor.full_well_e
    image = develop(electrons, camera)
    assert (image == image[..., :1]).all()
    assert (image == develop(electrons, without)).all()


def random_processor(rng):
    """Values within all bounds; each step is left out in a third of all cases."""
    values = {}
    for name, hint in table_fields(ImageProcessor).items():
        if name in ("preset", "jpeg_quality", "jpeg_subsampling") or rng.random() < 1 / 3:
            continue
        if name == "tone_curve":
            values[name] = str(rng.choice(["srgb", "linear", "gamma", "filmic"]))
            continue
        (kind, *_) = (part for part in typing.get_args(hint) if part is not type(None))
        numbers = [part for part in typing.get_args(kind) if typing.get_origin(part) is typing.Annotated]
        bounds = [_bounds(part) for part in numbers or [hint if not numbers and kind is float else kind]]
        drawn = tuple(float(rng.uniform(*bound)) for bound in bounds)
        values[name] = drawn if numbers else drawn[0]
    return ImageProcessor(**values)


def _bounds(hint):
    for part in (hint, *typing.get_args(hint)):
        for rule in getattr(part, "__metadata__", ()):
            rules = {type(one).__name__: one for one in rule.metadata}
            if {"Ge", "Le"} <= rules.keys():
                return rules["Ge"].ge, rules["Le"].le
    raise AssertionError(hint)


@pytest.mark.parametrize("part", range(4))
def test_two_hundred_random_processors_give_images(part):
    rng = np.random.default_rng(part)
    electrons = picture(part) * SENSOR.full_well_e * 1.5
    seen = set()
    for _ in range(50):
        isp = random_processor(rng)
        seen |= {field.name for field in dataclasses.fields(isp) if getattr(isp, field.name) is not None}
        codes = apply_local_steps(picture(part), isp)
        assert np.isfinite(codes).all()
        image = processed(isp, electrons)
        assert image.dtype == np.uint8
        assert image.shape == (ROWS, COLUMNS, 3)
    assert len(seen) == 17


def test_large_images_are_processed_as_small_ones(monkeypatch):
    electrons = picture() * SENSOR.full_well_e
    isp = load_processor("webcam").completed(load_processor("telephone"))
    whole = processed(isp, electrons)
    monkeypatch.setattr("pepperscene.camera.sensor.rows.LARGEST_WHOLE", 1000)
    monkeypatch.setattr("pepperscene.camera.sensor.rows.STRIP_PIXELS", 700)
    assert len(row_strips(COLUMNS, ROWS)) > 3
    assert (processed(isp, electrons) == whole).all()


@pytest.mark.parametrize("name", PRESETS)
def test_presets_make_images_that_resemble_the_scene(name):
    electrons = picture() * SENSOR.full_well_e
    with_preset = processed(load_processor(name), electrons).astype(float)
    without = processed(None, electrons).astype(float)
    assert np.corrcoef(with_preset.ravel(), without.ravel())[0, 1] > 0.9


@pytest.mark.parametrize("size", [(2, 2), (1, 9), (7, 3)])
def test_tiny_images_are_processed(size):
    codes = np.full((*size, 3), 0.4, np.float32)
    isp = replace(NEUTRAL, chromatic_aberration_px=(2.0, -2.0))
    displace_red_and_blue(codes, isp)
    np.testing.assert_allclose(apply_local_steps(codes, isp), 0.4, atol=1e-5)


@pytest.mark.parametrize(
    ("points", "problem"),
    [
        ([(0, 0)], "2 to 1,025 pairs"),
        ([(0, 0), (0.5, 0.8), (1, 0.7)], "must rise with light"),
        ([(0, 0), (0.5, 0.2), (0.5, 0.3), (1, 1)], "must rise from 0"),
        ([(0.1, 0), (1, 1)], "must rise from 0"),
        ([(0, 0), (1, float("nan"))], "must be 0 to 1"),
        ([(0, 0.5), (1, 0.5)], "must rise with light"),
    ],
)
def test_tone_curves_that_do_not_rise_are_errors(points, problem):
    with pytest.raises(ValueError, match=problem):
        ImageProcessor(tone_curve=points)

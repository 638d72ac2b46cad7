"""Large images, of bands too, are computed in strips of rows and in parts: the same samples, no seams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, cloudy_sky, greenhouse, partners

from pepperscene.camera import Motion
from pepperscene.camera.sensor import rows as row_strips
from pepperscene.outputs import BAND_OUTPUTS, OUTPUTS
from pepperscene.render import QUALITIES, Quality, Renderer
from pepperscene.render.aov import labels
from pepperscene.render.transport import accumulate, adaptive, strips
from pepperscene.render.transport.adaptive import SamplingError, sampling_metadata
from pepperscene.scene import assemble_scene
from pepperscene.spectra import Spectrum

FIXED = Quality(samples=4, soft=2, most=4, bounces=2, target=None, denoise=False)
LABELS = [name for name, output in OUTPUTS.items() if not output.traced and name != "harvest"]


@pytest.fixture(scope="module")
def plants():
    """Two plants under a cloudy sky, in a renderer."""
    first = greenhouse()
    surfaces = dict(zip(first.mesh.surfaces, first.surfaces, strict=True))
    return Renderer(assemble_scene(first.mesh, surfaces, cloudy_sky()))


@pytest.fixture
def in_strips(monkeypatch):
    """Computes something in strips of some rows, with tiles of the denoiser as small as they can be."""

    def compute(rows, view, function):
        with monkeypatch.context() as patch:
            patch.setattr(row_strips, "LARGEST_WHOLE", 1)
            patch.setattr(row_strips, "STRIP_PIXELS", rows * view.width)
            patch.setattr(strips, "TILE_PIXELS", 1)
            assert len(row_strips.row_strips(view.width, view.height)) == -(-view.height // rows)
            return function()

    return compute


def still(view):
    return view


def by_daylight(view):
    """A camera without its flash, whose light is gathered at second hits."""
    return replace(view, flash=None)


def rolling(view):
    """A camera with a rolling shutter that moves, whose flash lights some rows."""
    sensor = replace(view.sensor, line_time_s=1e-4)
    return replace(view, sensor=sensor, exposure_s=3e-3, motion=Motion((0.2, 0.0, 0.1)))


@pytest.mark.parametrize("change", [still, by_daylight, rolling])
def test_a_fixed_number_of_samples_gives_the_bits_of_the_whole_image(plants, in_strips, change):
    view, quality = change(camera(columns=64, rows=48)), replace(FIXED, directions=2)
    whole = plants.render(view, ["electrons"], quality, 3)
    parts = in_strips(10, view, lambda: plants.render(view, ["electrons"], quality, 3))
    np.testing.assert_array_equal(parts["electrons"], whole["electrons"])
    expected = whole.metadata["sampling"]
    for name in ("samples_per_pixel", "soft_samples_per_pixel", "error_codes", "noise_codes"):
        # The error of a pixel follows from its neighbours as well, which are in another strip at the borders.
        assert parts.metadata["sampling"][name] == pytest.approx(expected[name], rel=0.03), name


@pytest.mark.parametrize("change", [still, rolling])
def test_labels_have_the_bits_of_the_whole_image(plants, in_strips, change):
    view = change(camera(columns=64, rows=46))
    whole = plants.render(view, LABELS, partners=partners())
    parts = in_strips(10, view, lambda: plants.render(view, LABELS, partners=partners()))
    for name in LABELS:
        if OUTPUTS[name].is_image:
            np.testing.assert_array_equal(parts[name], whole[name], err_msg=name)
        else:
            assert parts[name] == whole[name]
    assert parts.metadata["instances"] == whole.metadata["instances"]


def test_denoised_strips_show_no_seams(plants, in_strips):
    # Fixed samples: images of one seed differ by what the denoiser sees alone.
    view, quality = camera(columns=320, rows=240), replace(FIXED, denoise=True)
    whole = plants.render(view, ["electrons"], quality, 3)
    other = plants.render(view, ["electrons"], quality, 4)
    parts = in_strips(30, view, lambda: plants.render(view, ["electrons"], quality, 3))
    per_code = view.sensor.full_well_e / 255.0
    by_strips, by_seed, both = (
        (one["electrons"] - two["electrons"]).mean(axis=-1) / per_code
        for one, two in ((parts, whole), (whole, other), (parts, other))
    )
    assert np.sqrt(np.mean(np.square(by_strips))) < 0.02 * whole.metadata["sampling"]["error_codes"]
    columns = _column_seams(view)
    assert len(columns)
    for axis, seams in enumerate((np.arange(30, 240, 30), columns)):
        # Steps from one row, or column, to the next in the difference to an independent image: what strips
        # add to them is far below the standard error of the mean over the seams.
        steps, with_strips = (np.diff(image, axis=axis) for image in (by_seed, both))
        for measure in (np.mean, lambda image, axis: np.abs(image).mean(axis=axis)):
            noise, values = (measure(image, axis=1 - axis) for image in (steps, with_strips))
            added = (values - noise)[seams - 1].mean()
            assert abs(added) < 0.3 * noise.std() / np.sqrt(len(seams))


def _column_seams(view):
    """Columns where tiles of the denoiser begin, if these are as narrow as they can be."""
    count = 1
    while view.width // count > 4 * strips.SURROUNDINGS:
        count += 1
    step = -(-view.width // count)
    return np.arange(step, view.width, step)


def test_each_strip_meets_the_target(plants, in_strips):
    view, target = camera(columns=120, rows=92), QUALITIES["standard"].target
    whole = plants.render(view, ["electrons"], "standard", 3)
    parts = in_strips(24, view, lambda: plants.render(view, ["electrons"], "standard", 3))
    described = [frame.metadata["sampling"] for frame in (whole, parts)]
    assert [item["target"] for item in described] == [target, target]
    assert described[1]["error_to_noise"] < 1.25 * max(target, described[0]["error_to_noise"])
    # Samples follow the noise of a strip instead of that of the image.
    ratio = described[1]["samples_per_pixel"] / described[0]["samples_per_pixel"]
    assert 0.5 < ratio < 2.0
    error, noise = (described[0][name] for name in ("error_codes", "noise_codes"))
    scale = view.sensor.full_well_e / 255.0
    difference = (parts["electrons"] - whole["electrons"]).mean(axis=-1) / scale
    assert np.sqrt(np.mean(np.square(difference))) < 2.0 * error + 0.1 * noise


def test_errors_of_parts_are_weighted_by_their_pixels():
    one = SamplingError(100, 4.0, 2, np.float32(9.0), np.float32(4.0), 0.5)
    other = SamplingError(300, 8.0, 2, np.float32(1.0), np.float32(8.0), 0.9)
    both = sampling_metadata([one, other], 0.6)
    assert both["samples_per_pixel"] == pytest.approx(7.0)
    assert both["error_codes"] == pytest.approx(np.sqrt(3.0))
    assert both["noise_codes"] == pytest.approx(np.sqrt(7.0))
    assert both["error_to_noise"] == pytest.approx(np.sqrt(3.0 / 7.0))
    assert both["below_half_of_noise"] == pytest.approx(0.8)
    assert both["target_met"]
    assert sampling_metadata([one], 0.6)["error_codes"] == 3.0


def banded(count, columns=48, rows=36):
    """A camera with bands of equal width."""
    view = camera(columns=columns, rows=rows)
    nm, centres = view.sensor.quantum_efficiency.wavelength_nm, np.linspace(450.0, 650.0, count)
    curves = 0.5 * np.array([np.interp(nm, centres, row) for row in np.eye(count)])
    sensor = replace(view.sensor, pattern="bands", quantum_efficiency=Spectrum(nm, curves))
    return replace(view, sensor=sensor)


def scanner(view):
    """The camera as a line scanner that moves down the image."""
    sensor = replace(view.sensor, line_scan=True, line_time_s=1e-3)
    view = replace(view, sensor=sensor, exposure_s=1e-3, labels_per_row=True, flash=None)
    return replace(view, motion=Motion((0.0, 0.5, 0.0)))


@pytest.mark.parametrize("change", [still, scanner])
def test_bands_have_the_light_of_the_whole_image(plants, in_strips, change):
    view = change(banded(5))
    names = ["electrons", "radiance", "position", "chlorophyll", "leaf_age"]
    whole = plants.render(view, names, FIXED, 3)
    parts = in_strips(10, view, lambda: plants.render(view, names, FIXED, 3))
    assert whole["electrons"].any()
    for name in names:
        np.testing.assert_array_equal(parts[name], whole[name], err_msg=name)


def test_rays_of_a_line_scanner_do_not_depend_on_strips(in_strips):
    one, other = (scanner(banded(5)) for _ in range(2))
    rows = slice(7, 19)

    def rays(view):
        corners = [view.ray_slopes(slice(None)), view.slope_limits(), *view.border_slopes()]
        return [*corners, view.pixel_directions(rows)]

    assert one.ray_slopes(slice(None)).shape == (2, 49, 2)
    for part, whole in zip(in_strips(10, other, lambda: rays(other)), rays(one), strict=True):
        np.testing.assert_array_equal(part, whole)


def test_without_noise_strips_of_bands_are_measured_as_the_image(plants, in_strips):
    view = banded(5)
    quiet = replace(view.developing, shot_noise=False, read_noise=False, stray_light=False)
    view = replace(view, developing=quiet)
    names = sorted(BAND_OUTPUTS)
    whole = plants.render(view, names, FIXED, 3)
    parts = in_strips(10, view, lambda: plants.render(view, names, FIXED, 3))
    for name in names:
        np.testing.assert_allclose(parts[name], whole[name], rtol=1e-5, atol=1e-3, err_msg=name)


@pytest.mark.parametrize("count", [5, pytest.param(20, marks=pytest.mark.long)])
def test_denoised_strips_of_bands_show_no_seams(plants, in_strips, count):
    # Above twelve bands, the filter takes means over bands, and their factors come from neighbourhoods.
    view, quality = banded(count, 160, 150), replace(FIXED, denoise=True)

    def render():
        return plants.render(view, ["electrons"], quality, 3)["electrons"]

    whole, parts = render(), in_strips(30, view, render)
    difference = (parts - whole).mean(axis=-1)
    level = whole.mean()
    assert np.sqrt(np.mean(np.square(difference))) < 0.01 * level
    steps = np.abs(np.diff(difference, axis=0).mean(axis=1))
    assert steps.max() < 0.002 * level


def test_images_do_not_depend_on_the_size_of_their_parts(plants, monkeypatch):
    names = ["colour", "electrons", "uv", "chlorophyll"]
    whole = plants.render(camera(), names, "standard", 5)
    for module, constant in ((labels, "_UV_PIXELS"), (adaptive, "_ROWS_PIXELS"), (accumulate, "_LANES")):
        monkeypatch.setattr(module, constant, 7 * 80 + 3)
    divided = plants.render(camera(), names, "standard", 5)
    for name in names:
        np.testing.assert_array_equal(divided[name], whole[name])
    assert divided.metadata["sampling"] == whole.metadata["sampling"]

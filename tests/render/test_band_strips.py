"""Large images of bands, and of line scanners, are computed in strips: the same samples, and no seams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, greenhouse

from pepperscene.camera import Motion
from pepperscene.camera.sensor import rows as row_strips
from pepperscene.outputs import BAND_OUTPUTS
from pepperscene.render import Quality, Renderer
from pepperscene.render.transport import strips
from pepperscene.spectra import Spectrum

FIXED = Quality(samples=2, soft=1, most=2, bounces=1, target=None, denoise=False)
ROWS = 10


@pytest.fixture(scope="module")
def plants():
    return Renderer(greenhouse())


@pytest.fixture
def in_strips(monkeypatch):
    """Computes something in strips of some rows, with tiles of the denoiser as small as they can be."""

    def compute(function, rows=ROWS, width=48):
        with monkeypatch.context() as patch:
            patch.setattr(row_strips, "LARGEST_WHOLE", 1)
            patch.setattr(row_strips, "STRIP_PIXELS", rows * width)
            patch.setattr(strips, "TILE_PIXELS", 1)
            return function()

    return compute


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
    return replace(
        view, sensor=sensor, exposure_s=1e-3, motion=Motion((0.0, 0.5, 0.0)), labels_per_row=True, flash=None
    )


@pytest.mark.parametrize("change", [lambda view: view, scanner], ids=["still", "scanner"])
def test_bands_have_the_light_of_the_whole_image(plants, in_strips, change):
    view = change(banded(5))
    names = ["electrons", "radiance", "position", "chlorophyll", "leaf_age"]
    whole = plants.render(view, names, FIXED, 3)
    parts = in_strips(lambda: plants.render(view, names, FIXED, 3))
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
    for part, whole in zip(in_strips(lambda: rays(other)), rays(one), strict=True):
        np.testing.assert_array_equal(part, whole)


def test_without_noise_strips_of_bands_are_measured_as_the_image(plants, in_strips):
    view = banded(5)
    quiet = replace(view.developing, shot_noise=False, read_noise=False, stray_light=False)
    view = replace(view, developing=quiet)
    names = sorted(BAND_OUTPUTS)
    whole = plants.render(view, names, FIXED, 3)
    parts = in_strips(lambda: plants.render(view, names, FIXED, 3))
    for name in names:
        np.testing.assert_allclose(parts[name], whole[name], rtol=1e-5, atol=1e-3, err_msg=name)


@pytest.mark.parametrize("count", [5, 20])
def test_denoised_strips_of_bands_show_no_seams(plants, in_strips, count):
    # Above twelve bands, the filter takes means over bands, and their factors come from neighbourhoods.
    view, quality = banded(count, 128, 120), replace(FIXED, denoise=True)

    def render():
        return plants.render(view, ["electrons"], quality, 3)["electrons"]

    whole, parts = render(), in_strips(render, 30, 128)
    difference = (parts - whole).mean(axis=-1)
    level = whole.mean()
    assert np.sqrt(np.mean(np.square(difference))) < 0.01 * level
    steps = np.abs(np.diff(difference, axis=0).mean(axis=1))
    assert steps.max() < 0.002 * level

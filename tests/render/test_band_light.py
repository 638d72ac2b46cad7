"""Bands: their light equals that of colour channels, and that of fine bands adds up to that of broad ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, greenhouse
from scipy import stats
from test_kernel_reuse import count_compiled
from tracer import Tracer

from pepperscene.camera import (
    Camera,
    Developing,
    Partners,
    develop,
    expected_electrons,
    measured_electrons,
    raw_frame,
)
from pepperscene.camera.image.colorimetry import srgb_encode
from pepperscene.errors import InputError
from pepperscene.outputs import COLOUR_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.render.transport.accumulate import TracedLight
from pepperscene.render.transport.adaptive import code_response
from pepperscene.render.transport.band_denoise import denoise_bands
from pepperscene.render.transport.bands import _slots
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.scene import Scene
from pepperscene.spectra import Spectrum

RUNS, SAMPLES, MOST_BOUNCES = 12, 8, 12
SIGNIFICANT = 1e-3
"""Chosen: smallest p-value of a test, over that of the most significant channel."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Two plants by daylight."""
    return greenhouse()


def banded(view: Camera, curves: np.ndarray | None = None) -> Camera:
    """The camera with these bands, at the wavelengths of its sensor; with its colours by default."""
    efficiency = view.sensor.quantum_efficiency
    curves = efficiency.values if curves is None else curves
    sensor = replace(
        view.sensor, pattern="bands", quantum_efficiency=Spectrum(efficiency.wavelength_nm, curves)
    )
    return replace(view, sensor=sensor)


def narrow(view: Camera, count: int) -> np.ndarray:
    """`(count, n)` parts of the sum of the curves of a colour sensor; they add up to it."""
    efficiency = view.sensor.quantum_efficiency
    nm, centres = efficiency.wavelength_nm, np.linspace(450.0, 650.0, count)
    parts = np.array([np.interp(nm, centres, row) for row in np.eye(count)])
    return parts * efficiency.values.mean(axis=0)


def lights(scene: Scene, view: Camera, first_seed: int) -> list[TracedLight]:
    tracer = Tracer(scene, view)
    sampling = Sampling(SAMPLES, SAMPLES, 2, None, MOST_BOUNCES)
    return [
        trace(tracer.scene, tracer.rays, tracer.response, view.flash, tracer.sky, sampling, first_seed + run)
        for run in range(RUNS)
    ]


def indirect(lights: list[TracedLight]) -> np.ndarray:
    """`(runs, c)` means of images."""
    return np.array([light.indirect.mean(axis=(0, 1), dtype=np.float64) for light in lights])


@pytest.mark.parametrize(
    "flash", [pytest.param(True, id="flash", marks=pytest.mark.long), pytest.param(False, id="daylight")]
)
def test_bands_with_the_curves_of_colours_have_their_light(scene, flash):
    view = camera(columns=24, rows=18, flash=flash)
    colours, bands = lights(scene, view, 0), lights(scene, banded(view), 0)
    # The first hits have the same random numbers, and no wavelengths.
    for part in ("flash", "sky_and_sun", "coverage", "normal"):
        expected = getattr(colours[0], part)
        assert getattr(bands[0], part) == pytest.approx(
            expected, rel=1e-4, abs=1e-6 * float(expected.max())
        ), part
    # The samples of indirect light are others.
    p = stats.ttest_ind(indirect(colours), indirect(bands), axis=0).pvalue
    assert p.min() * 3 > SIGNIFICANT, (p, indirect(colours).mean(axis=0), indirect(bands).mean(axis=0))


def test_light_of_fine_bands_adds_up_to_that_of_a_broad_one(scene):
    view = camera(columns=24, rows=18)
    fine = narrow(view, 6)
    traced = lights(scene, banded(view, np.vstack([fine, fine.sum(axis=0)])), 100)
    for part in ("flash", "sky_and_sun"):
        light = getattr(traced[0], part).astype(float)
        # What a relief scatters twice is not exactly linear in the reflectance of a band.
        assert light[..., :6].sum(axis=-1) == pytest.approx(light[..., 6], rel=1e-3, abs=1e-6 * light.max())
    # The wavelengths of a broad band and of a fine one are drawn from their own responses.
    means = indirect(traced)
    change = means[:, :6].sum(axis=1) / means[:, 6] - 1.0
    assert stats.ttest_1samp(change, 0.0).pvalue > SIGNIFICANT, change.mean()
    assert change.mean() == pytest.approx(0.0, abs=0.05)


def test_slots_are_a_quadrature_of_each_band():
    rng = np.random.default_rng(4)
    weights = rng.random((6, 90)) * (rng.random((6, 90)) > 0.6)
    weights[2] = 0.0
    columns, factors = _slots(weights, rng.random(90))
    for band, row in enumerate(weights):
        found = np.bincount(columns[band], factors[band], minlength=90) / columns.shape[1]
        assert found == pytest.approx(row, rel=1e-12, abs=1e-15)


def test_the_number_of_bands_compiles_nothing(scene):
    view, renderer = camera(columns=24, rows=18), Renderer(scene)

    def render(count: int) -> None:
        frame = renderer.render(banded(view, narrow(view, count)), ["electrons"], "draft")
        assert frame["electrons"].shape == (18, 24, count)

    render(5)
    assert count_compiled(lambda: render(11)) == 0


def test_outputs_of_colours_are_refused(scene):
    view = banded(camera(columns=24, rows=18))
    for output in COLOUR_OUTPUTS:
        with pytest.raises(InputError, match=f"{output}.*has bands: use 'electrons'"):
            Renderer(scene).render(view, [output], "draft", partners=Partners(stereo=view))
    for function in (develop, raw_frame):
        with pytest.raises(ValueError, match="has bands"):
            function(np.zeros((18, 24, 3)), view)


def test_each_band_is_measured_as_by_a_monochrome_sensor():
    view = banded(camera(columns=24, rows=18))
    curve = Spectrum(view.sensor.quantum_efficiency.wavelength_nm, view.sensor.quantum_efficiency.values[:1])
    mono = replace(view, sensor=replace(view.sensor, pattern="mono", quantum_efficiency=curve))
    bands = replace(view, sensor=replace(view.sensor, quantum_efficiency=curve))
    light = np.random.default_rng(1).uniform(0.0, 1.2 * view.sensor.full_well_e, (18, 24, 1))
    one, other = (measured_electrons(light, each, np.random.default_rng(2)) for each in (mono, bands))
    assert np.array_equal(one, other)


@pytest.mark.long
def test_measured_electrons_have_the_noise_that_sampling_assumes():
    view = replace(banded(camera(columns=200, rows=150)), developing=Developing(falloff=False))
    signal = np.ones((150, 200, 3), np.float32) * np.array([1e17, 4e17, 2e17], np.float32)
    response = code_response(signal, np.full(3, 1e17), view)
    measured = measured_electrons(expected_electrons(signal, view), view, np.random.default_rng(3))
    assert measured.mean(axis=(0, 1)) == pytest.approx(expected_electrons(signal, view)[0, 0], rel=1e-3)
    codes = 255.0 * srgb_encode(measured / (view.sensor.full_well_e / view.sensor.gain))
    assert response.noise.mean() == pytest.approx(np.sqrt(codes.var(axis=(0, 1)).mean()), rel=0.02)


@pytest.mark.parametrize("shape", [(5, 7, 4), (70, 90, 30)])
def test_denoised_bands_keep_their_light(shape):
    rng = np.random.default_rng(5)
    smooth = np.cumsum(rng.random((shape[0], shape[1], 3)), axis=1)
    traced = (smooth @ rng.random((3, shape[2]))).astype(np.float32)
    found = denoise_bands(traced, lambda broad, number: broad)
    assert found.mean(axis=(0, 1)) == pytest.approx(traced.mean(axis=(0, 1)), rel=0.005)

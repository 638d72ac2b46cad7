"""Light that is carried by sensor channel equals light that is carried at wavelengths."""

from __future__ import annotations

import numpy as np
import pytest
from greenhouse import camera, greenhouse
from scipy import stats
from tracer import Tracer

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import Surface, greenhouse_surfaces, organ_surfaces
from pepperscene.render.kernel.camera import spectral_response
from pepperscene.render.surface.optics import STEP_NM, Optics, _between_states
from pepperscene.render.surface.scattering import BodyPlace
from pepperscene.render.transport import lights
from pepperscene.render.transport.accumulate import sum_samples
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.samples import Samples, SampleWavelengths
from pepperscene.render.variant import mitsuba_modules

NM = np.arange(360.0, 831.0, 5.0)
GRID = np.arange(380.0, 750.0 + STEP_NM / 2, STEP_NM)
STATES = np.array([0.0, 0.13, 0.5, 0.87, 1.0])


@pytest.fixture(scope="module")
def shipped() -> list[Surface]:
    """All surfaces of plants and of the greenhouse."""
    return list({**organ_surfaces(load_cultivar("kaite"), NM), **greenhouse_surfaces(NM)}.values())


@pytest.fixture(scope="module")
def weights() -> np.ndarray:
    """`(n, 3)` response of the recipe's sensor times its flash and the weights of the trapezoidal rule."""
    view = camera()
    trapezoid = np.ones(GRID.size)
    trapezoid[[0, -1]] = 0.5
    light = view.flash.spectrum.at(GRID)
    return view.sensor.electrons_per_joule(GRID).T * (trapezoid * light)[:, None]


def channel_colours(surfaces: list[Surface], weights: np.ndarray) -> np.ndarray:
    """`(3, surfaces, states, c)`: front, back and through, as the kernel looks them up."""
    mi, dr = mitsuba_modules()
    optics = Optics.pack(surfaces, GRID[0], GRID[-1]).by_channel(weights)
    surface, state = (part.ravel() for part in np.meshgrid(np.arange(len(surfaces)), STATES, indexing="ij"))
    body = dr.gather(mi.Vector4f, optics.bodies, mi.UInt32(surface.astype(np.uint32)))
    between = _between_states(body, mi.Float(state.astype(np.float32)))
    place = BodyPlace(*between, body.w, 0.0, 0.0, True, 1.0, 0.0)
    parts = optics._body(place, optics._columns(None), mi.Bool(True))
    return np.array([np.asarray(part).T.reshape(len(surfaces), STATES.size, -1) for part in parts[:3]])


@pytest.mark.parametrize("channels", [1, 3])
def test_colours_are_integrals_over_wavelength(shipped, weights, channels):
    weights = weights[:, 1:2] if channels == 1 else weights
    colours = channel_colours(shipped, weights)
    assert colours.shape[-1] == channels
    for k, surface in enumerate(shipped):
        rows = len(surface.reflectance)
        for j, state in enumerate(STATES):
            # Spectra are at linspace(first_state, 1, rows) of the state, linear in between.
            position = (state - surface.first_state) / (1.0 - surface.first_state) * (rows - 1)
            low = min(int(position), rows - 1)
            high, fraction = min(low + 1, rows - 1), position - low
            both = (1 - fraction) * surface.reflectance[low] + fraction * surface.reflectance[high]
            through = (1 - fraction) * surface.transmittance[low] + fraction * surface.transmittance[high]
            spectra = [np.interp(GRID, surface.wavelength_nm, spectrum) for spectrum in (*both, through)]
            for side, spectrum in enumerate(spectra):
                # The weights include the steps: a plain sum is the trapezoidal rule.
                expected = weights.T @ spectrum / weights.sum(axis=0)
                assert colours[side, k, j] == pytest.approx(expected, rel=2e-5, abs=1e-7), surface.name


def test_grid_is_fine_enough(shipped, weights):
    # Against a quadrature in steps of a tenth of a nanometre.
    view, fine = camera(), np.arange(GRID[0], GRID[-1] + 0.05, 0.1)
    light = view.flash.spectrum.at(fine) * view.sensor.electrons_per_joule(fine)
    colours = channel_colours(shipped, weights)
    for k, surface in enumerate(shipped):
        spectrum = np.interp(fine, surface.wavelength_nm, surface.reflectance[-1, 0])
        expected = np.trapezoid(light * spectrum, fine) / np.trapezoid(light, fine)
        assert colours[0, k, -1] == pytest.approx(expected, rel=1e-3, abs=1e-6), surface.name


def test_white_is_white_and_no_surface_gains_energy(shipped, weights):
    white = Surface("white", NM, np.ones((2, 2, NM.size)), np.zeros((2, NM.size)))
    colours = channel_colours([*shipped, white], weights)
    assert colours[:2, -1] == pytest.approx(1.0, rel=1e-6)
    assert colours.min() >= 0.0
    assert (colours[:2] + colours[2]).max() <= 1.0 + 1e-5


def test_channel_without_light_is_black_and_weights_may_have_any_scale(shipped, weights):
    dark = channel_colours(shipped, 1e17 * weights * [1.0, 1.0, 0.0])
    assert not dark[..., 2].any()
    assert dark[..., :2] == pytest.approx(channel_colours(shipped, weights)[..., :2], rel=1e-6)


def first_hit_light(
    tables: FrameTables, samples: Samples, wavelengths: SampleWavelengths | None
) -> list[object]:
    """Flash and sun at the first hit, and the sky seen directly: by channel, or at wavelengths."""
    mi, _ = mitsuba_modules()
    active, si, hit = tables.scene.intersect(samples.ray, coherent=True)
    if wavelengths is None:
        assert tables.sun_optics is not None
        spectra, optics = tables.colours, (tables.flash_optics, tables.sun_optics)
    else:
        spectra, optics = wavelengths.spectra, (None, None)
        si = mi.SurfaceInteraction3f(si)
        si.wavelengths = wavelengths.nm
    flash_point, sun_point = (tables.scene.surface_point(si, hit, active, packed) for packed in optics)
    light = samples.flash_light(si, flash_point, active, spectra)
    light += samples.sky_radiance(samples.ray.d, ~active, spectra, with_sun=True)
    light += samples.sun_light(si, sun_point, active, spectra)
    return [*light] if wavelengths is None else wavelengths.channels(light)


@pytest.mark.parametrize("flash", [True, False], ids=["flash", "daylight"])
def test_light_by_channel_equals_light_at_wavelengths(flash, monkeypatch):
    monkeypatch.setattr(lights, "_VISIBLE_SUN", 0.0)
    tables = Tracer(greenhouse(), camera(columns=40, rows=30, flash=flash)).tables()

    def both_ways(tables, samples):
        # The same rays and shadow rays, so that hardly any noise but that of the wavelengths is left.
        wavelengths = SampleWavelengths(tables, samples.next_1d())
        replay = Replay(samples.next_2d)
        samples.next_2d = replay.next
        by_channel = first_hit_light(tables, samples, None)
        replay.rewind()
        return [[*by_channel, *first_hit_light(tables, samples, wavelengths)]]

    # (runs, 6, pixels)
    runs = np.array([sum_samples(tables, None, 0, 16, seed, both_ways) for seed in range(24)])
    by_channel, at_wavelengths = runs[:, :3], runs[:, 3:]
    assert by_channel.any()
    change = (at_wavelengths - by_channel).mean(axis=2) / by_channel.mean(axis=(0, 2))
    # Student's test over seeds, for each channel: the smallest p-value of three must exceed 0.001.
    p = stats.ttest_1samp(change, 0.0, axis=0).pvalue
    assert p.min() * 3 > 1e-3, (p, change.mean(axis=0))
    # The nearest entries of the grid, against the entries themselves.
    assert change.mean(axis=0) == pytest.approx(0.0, abs=1e-3)


class Replay:
    """Points that are drawn once and returned a second time after `rewind`."""

    def __init__(self, draw) -> None:
        self._draw, self._drawn, self._position = draw, [], 0

    def next(self):
        if self._position == len(self._drawn):
            self._drawn.append(self._draw())
        self._position += 1
        return self._drawn[self._position - 1]

    def rewind(self) -> None:
        self._position = 0


def test_white_of_a_frame_is_the_light_of_a_white_body():
    view = camera(columns=8, rows=6)
    tables, grid = Tracer(greenhouse(), view).tables(), spectral_response(view, greenhouse()).grid_nm
    light = view.flash.radiant_intensity(grid) * view.flash_duty
    expected = np.trapezoid(light * view.sensor.electrons_per_joule(grid), grid, axis=-1)
    assert tables.white == pytest.approx(expected, rel=1e-9)
    assert [1.0 / scale.numpy()[0] for scale in tables.per_white] == pytest.approx(expected, rel=1e-6)

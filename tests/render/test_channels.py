"""Light that is carried by sensor channel is the same light as that carried at wavelengths."""

from __future__ import annotations

import numpy as np
import pytest
from greenhouse import camera, greenhouse
from scipy import stats

from pepperscene.camera import Camera
from pepperscene.cultivar import load_cultivar
from pepperscene.materials import Surface, greenhouse_surfaces, organ_surfaces
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene, sky_tables
from pepperscene.render.surface.channels import ChannelOptics
from pepperscene.render.surface.optics import Optics
from pepperscene.render.transport import samples as samples_module
from pepperscene.render.transport.samples import FrameTables, Samples, SpectralTables, Wavelengths
from pepperscene.render.transport.trace import _hit, _summed
from pepperscene.render.variant import mitsuba_modules

NM = np.arange(360.0, 831.0, 5.0)
GRID = np.arange(380.0, 751.0)
STATES = np.array([0.0, 0.13, 0.5, 0.87, 1.0])


@pytest.fixture(scope="module")
def shipped() -> list[Surface]:
    """All surfaces of plants and of the greenhouse."""
    return list({**organ_surfaces(load_cultivar("kaite"), NM), **greenhouse_surfaces(NM)}.values())


@pytest.fixture(scope="module")
def weights() -> np.ndarray:
    """`(n, 3)` the recipe's sensor under its flash, with the trapezoidal rule's steps."""
    lens = camera()
    steps = np.ones(GRID.size)
    steps[[0, -1]] = 0.5
    light = lens.flash.spectrum.at(GRID)
    return lens.sensor.electrons_per_joule(GRID).T * (steps * light)[:, None]


def colours(optics: ChannelOptics, surfaces: int) -> np.ndarray:
    """`(3, surfaces, states, c)`: front, back and through, as the kernel finds them."""
    mi, _ = mitsuba_modules()
    surface, state = (part.ravel() for part in np.meshgrid(np.arange(surfaces), STATES, indexing="ij"))
    parts = optics._body(
        None, mi.UInt32(surface.astype(np.uint32)), mi.Float(state.astype(np.float32)), mi.Bool(True)
    )
    return np.array([np.asarray(part).T.reshape(surfaces, STATES.size, -1) for part in parts])


@pytest.mark.parametrize("channels", [1, 3])
def test_colours_are_integrals_over_wavelength(shipped, weights, channels):
    weights = weights[:, 1 : 1 + channels] if channels == 1 else weights
    optics = by_channel(Optics.pack(shipped, GRID[0], GRID[-1]), weights)
    found = colours(optics, len(shipped))
    for k, surface in enumerate(shipped):
        rows = len(surface.reflectance)
        for j, state in enumerate(STATES):
            # Spectra lie at linspace(0, 1, rows) of the state, linear in between.
            place = state * (rows - 1)
            low = min(int(place), rows - 1)
            up, share = min(low + 1, rows - 1), place - low
            both = (1 - share) * surface.reflectance[low] + share * surface.reflectance[up]
            through = (1 - share) * surface.transmittance[low] + share * surface.transmittance[up]
            spectra = [np.interp(GRID, surface.wavelength_nm, one) for one in (*both, through)]
            for side, spectrum in enumerate(spectra):
                # The weights hold the steps already: a plain sum is the trapezoidal rule.
                wanted = weights.T @ spectrum / weights.sum(axis=0)
                assert found[side, k, j] == pytest.approx(wanted, rel=2e-5, abs=1e-7), (surface.name, state)
    assert found.shape[-1] == channels


def test_the_grid_is_fine_enough(shipped, weights):
    # Against a quadrature in steps of a tenth of a nanometre.
    lens, fine = camera(), np.arange(GRID[0], GRID[-1] + 0.05, 0.1)
    light = lens.flash.spectrum.at(fine) * lens.sensor.electrons_per_joule(fine)
    found = colours(by_channel(Optics.pack(shipped, GRID[0], GRID[-1]), weights), len(shipped))
    for k, surface in enumerate(shipped):
        spectrum = np.interp(fine, surface.wavelength_nm, surface.reflectance[-1, 0])
        wanted = np.trapezoid(light * spectrum, fine) / np.trapezoid(light, fine)
        assert found[0, k, -1] == pytest.approx(wanted, rel=1e-3, abs=1e-6), surface.name


def test_white_is_white_and_nothing_is_gained(shipped, weights):
    white = Surface("white", NM, np.ones((2, 2, NM.size)), np.zeros((2, NM.size)))
    surfaces = [*shipped, white]
    found = colours(by_channel(Optics.pack(surfaces, GRID[0], GRID[-1]), weights), len(surfaces))
    assert found[:2, -1] == pytest.approx(1.0, rel=1e-6)
    assert found.min() >= 0.0
    assert (found[:2] + found[2]).max() <= 1.0 + 1e-5


def test_a_channel_without_light_has_no_colour(shipped, weights):
    dark = weights.copy()
    dark[:, 2] = 0.0
    found = colours(by_channel(Optics.pack(shipped, GRID[0], GRID[-1]), dark), len(shipped))
    assert not found[..., 2].any()
    assert found[..., :2].any()


def test_the_scale_of_the_weights_does_not_matter(shipped, weights):
    optics = Optics.pack(shipped, GRID[0], GRID[-1])
    one, many = (by_channel(optics, weights * scale) for scale in (1.0, 1e17))
    assert colours(one, len(shipped)) == pytest.approx(colours(many, len(shipped)), rel=1e-6)
    # Neither are the surfaces themselves touched.
    assert optics.columns.numpy()[0] == GRID.size


# --- the same light, both ways ------------------------------------------------------------------------------


def carried(tables: FrameTables, samples: Samples, waves: Wavelengths | None) -> list:
    """Flash and sun at the first hit, and the sky seen: by channel, or at wavelengths."""
    mi, _ = mitsuba_modules()
    active, si, hit = _hit(tables.scene, samples.ray, coherent=True)
    towards = samples.ray.d
    if waves is None:
        point = tables.scene.point(si, hit, active, tables.lit)
        light = samples.whole_flash(si, point, active, tables.lamps)
        light += samples.sky(towards, ~active, tables.lamps, seen=True)
        assert tables.sunlit is not None
        point = tables.scene.point(si, hit, active, tables.sunlit)
        return [*(light + samples.sun(si, point, active, tables.lamps))]
    si = mi.SurfaceInteraction3f(si)
    si.wavelengths = waves.nm
    point = tables.scene.point(si, hit, active)
    light = samples.whole_flash(si, point, active, waves.lamps)
    light += samples.sky(towards, ~active, waves.lamps, seen=True)
    return waves.channels(light + samples.sun(si, point, active, waves.lamps))


def small(lens: Camera):
    """Tables of the greenhouse scene whose sun counts as distinct, and their spectra."""
    scene = greenhouse()
    spectral = spectral_response(lens, scene)
    grid = spectral.grid_nm
    built = light_scene(scene, float(grid[0]), float(grid[-1]))
    tables = FrameTables(built, camera_rays(lens), spectral, lens.flash, sky_tables(scene, grid))
    return tables, SpectralTables(tables)


@pytest.mark.parametrize("flash", [True, False], ids=["flash", "daylight"])
def test_light_by_channel_is_light_at_wavelengths(flash, monkeypatch):
    monkeypatch.setattr(samples_module, "_DISTINCT_SUN", 0.0)
    tables, spectra = small(camera(columns=40, rows=30, flash=flash))

    def difference(tables, samples):
        # The same rays and shadow rays both ways, so that little but the wavelengths' noise is left.
        start = samples.next_1d, samples.next_2d
        waves = Wavelengths(spectra, start[0]())
        sequence = Replayed(start[1])
        samples.next_2d = sequence.next
        by_channel = carried(tables, samples, None)
        sequence.again()
        at_wavelengths = carried(tables, samples, waves)
        return [*by_channel, *at_wavelengths]

    runs = np.array(
        [_summed(tables, None, 0, 16, seed, difference) for seed in range(24)]
    )  # (runs, 6, pixels)
    by_channel, at_wavelengths = runs[:, :3], runs[:, 3:]
    assert by_channel.any()
    change = (at_wavelengths - by_channel).mean(axis=2) / by_channel.mean(axis=(0, 2))
    # Student's test over seeds, for each channel: the smallest p-value of three must exceed 0.001.
    p = stats.ttest_1samp(change, 0.0, axis=0).pvalue
    assert p.min() * 3 > 1e-3, (p, change.mean(axis=0))
    # The nearest of entries that are a nanometre apart, against the entries themselves.
    assert change.mean(axis=0) == pytest.approx(0.0, abs=2e-3)


class Replayed:
    """Points that are drawn once and given out a second time."""

    def __init__(self, draw) -> None:
        self._draw, self._kept, self._place = draw, [], 0

    def next(self):
        if self._place == len(self._kept):
            self._kept.append(self._draw())
        self._place += 1
        return self._kept[self._place - 1]

    def again(self) -> None:
        self._place = 0


def test_the_white_of_a_frame_is_a_white_bodys_light():
    lens = camera(columns=8, rows=6)
    tables, _ = small(lens)
    grid = tables.spectral.grid_nm
    light = lens.flash.radiant_intensity(grid) * lens.flash_duty
    wanted = np.trapezoid(light * lens.sensor.electrons_per_joule(grid), grid, axis=-1)
    assert tables.white == pytest.approx(wanted, rel=1e-9)
    assert [1.0 / scale.numpy()[0] for scale in tables.per_white] == pytest.approx(wanted, rel=1e-6)

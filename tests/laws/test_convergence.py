"""Light transport converges as Monte Carlo must, and its mean does not depend on the number of samples.

Rationale: a sampler whose numbers are correlated, a weight that does not belong to its density or a pass that
repeats another all leave pictures that look right. They show in the rate and in the mean.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import bench_camera, sheet, sphere
from scipy import stats

from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene, sky_tables
from pepperscene.render.transport import trace as transport
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.scene import Sky, Sun, assemble_scene
from pepperscene.spectra import Spectrum, sky_spectrum, sun_spectrum, with_illuminance

NM = np.arange(380.0, 781.0, 5.0)
PARTS = ("flash", "sky", "soft")


def glossy_leaf() -> Surface:
    red_edge = 0.05 + 0.4 / (1.0 + np.exp(-(NM - 600.0) / 15.0))
    both = np.stack([red_edge, red_edge * 1.1])[None]
    return Surface("leaf", NM, both, 0.8 * red_edge[None], 1.45, (0.3, 0.4))


def bench():
    """A sphere and a leaf before a card in the sky: edges, half-shadows, light through a leaf."""
    mesh = concatenate_meshes(
        [
            sphere((0.03, 0.02, 0.45), 0.06, "matt", subdivisions=3),
            sheet(0.15, 0.4, 0.4, "leaf").moved(np.eye(3), np.array([-0.12, 0.0, 0.0])),
            sheet(0.3, 0.2, 0.6, "matt"),
        ]
    )
    # A sky of two halves and a sun as wide as a hand, behind the camera, so that its half-shadows are seen.
    irradiance = with_illuminance(sky_spectrum("d65"), 20_000.0)
    halves = np.array([[[1.0, 1.0, 3.0, 3.0]] * 2], np.float32)
    towards = np.array([0.4, -0.5, -1.0]) / np.linalg.norm([0.4, -0.5, -1.0])
    sun = Sun(towards, with_illuminance(sun_spectrum(), 20_000.0), angular_radius=0.05)
    sky = Sky(halves, Spectrum(irradiance.wavelength_nm, irradiance.values[None] / np.pi), sun)
    return assemble_scene(mesh, {"matt": lambertian_surface("matt", 0.6), "leaf": glossy_leaf()}, sky)


class Tracer:
    """Traces the bench with any number of samples."""

    def __init__(self) -> None:
        scene, camera = bench(), bench_camera(columns=32, rows=24)
        # Large pixels, so that few of them see all of it.
        self.camera = replace(camera, sensor=replace(camera.sensor, binning=20))
        self.spectral = spectral_response(self.camera, scene)
        first, last = float(self.spectral.grid_nm[0]), float(self.spectral.grid_nm[-1])
        self.scene = light_scene(scene, first, last)
        self.sky = sky_tables(scene, self.spectral.grid_nm)
        self.view = camera_rays(self.camera)

    def light(self, count: int, seed: int):
        sampling = Sampling(count, count, 2)
        return trace(self.scene, self.view, self.spectral, self.camera.flash, self.sky, sampling, seed)

    def parts(self, count: int, stream: int, runs: int) -> dict[str, np.ndarray]:
        """`(runs, h, w, 3)` of each part, with seeds drawn as a renderer draws them from its own seed."""
        seeds = np.random.SeedSequence(stream).generate_state(runs)
        lights = [self.light(count, int(seed)) for seed in seeds]
        return {part: np.array([getattr(light, part) for light in lights], float) for part in PARTS}


@pytest.fixture(scope="module")
def tracer():
    return Tracer()


@pytest.fixture(scope="module")
def truth(tracer):
    """Each part over 40 seeds of 256 samples."""
    return tracer.parts(256, 1, 40)


def test_error_falls_at_least_as_fast_as_monte_carlo(tracer, truth):
    counts = np.array([4, 16, 64])
    errors = {part: [] for part in (*PARTS, "total")}
    for count in counts:
        found = tracer.parts(int(count), 2, 8)
        difference = {part: found[part] - truth[part].mean(0) for part in PARTS}
        difference["total"] = sum(difference.values())
        for part, values in difference.items():
            errors[part].append(np.sqrt((values**2).mean()))
    for part, values in errors.items():
        # Independent samples give -1/2, stratified ones more. The tolerance covers what 8 seeds leave open.
        slope = np.polyfit(np.log(counts), np.log(values), 1)[0]
        assert slope < -0.5 + 0.05, (part, slope, values)
        # Neither may it be better than the reference itself is: that would be the same numbers again.
        assert slope > -1.6, (part, slope, values)


@pytest.fixture(scope="module")
def four(tracer):
    """Four samples, as the soft light of standard frames gets, over 400 seeds."""
    return tracer.parts(4, 3, 400)


@pytest.mark.parametrize(("count", "runs"), [(1, 400), (16, 100)])
def test_the_mean_does_not_depend_on_the_samples(tracer, truth, count, runs):
    # A single sample has nothing to be correlated with: it must agree with many, as must what lies between.
    assert_same_mean(tracer.parts(count, 3, runs), truth)


def test_the_mean_of_four_samples_is_that_of_many(four, truth):
    assert_same_mean(four, truth)


def test_soft_light_of_four_samples_is_right_to_three_per_cent_in_each_block(four, truth):
    found, wanted = (blocks(part["soft"]).mean(axis=0) for part in (four, truth))
    lit = wanted > 1e-3 * wanted.mean()
    assert lit.sum() > 20
    # 400 seeds leave 0.3 % of noise; three are chosen, less than an eye can tell.
    assert found[lit] == pytest.approx(wanted[lit], rel=0.03)


def test_the_mean_does_not_depend_on_the_passes(tracer, truth, monkeypatch):
    # 64 samples in 16 passes of four.
    monkeypatch.setattr(transport, "_LANES", 4 * 32 * 24)
    many, few = tracer.parts(64, 4, 24), tracer.parts(4, 4, 24)
    assert_same_mean(many, truth)
    # Passes that repeated the first one would be as noisy as four samples are.
    for part in PARTS:
        noise = many[part].std(axis=0, ddof=1).mean() / few[part].std(axis=0, ddof=1).mean()
        assert noise < 0.35, (part, noise)


def blocks(values: np.ndarray) -> np.ndarray:
    """`(runs, k)` means over 8x8 pixels by channel."""
    runs, rows, columns, channels = values.shape
    return values.reshape(runs, rows // 8, 8, columns // 8, 8, channels).mean((2, 4)).reshape(runs, -1)


def assert_same_mean(found: dict[str, np.ndarray], truth: dict[str, np.ndarray]) -> None:
    """Welch's test between seeds on blocks of 8x8 pixels.

    The smallest p-value, Bonferroni-corrected, must exceed 0.001.
    """
    for part in PARTS:
        a, b = blocks(found[part]), blocks(truth[part])
        assert np.isfinite(a).all()
        noisy = (a.std(axis=0) > 0) & (b.std(axis=0) > 0)
        p = stats.ttest_ind(a[:, noisy], b[:, noisy], equal_var=False).pvalue
        assert p.size > 10, part
        assert p.min() * p.size > 1e-3, (part, p.min(), p.size, a.mean() / b.mean())
        assert a.mean() == pytest.approx(b.mean(), rel=0.01), part

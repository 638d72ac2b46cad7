"""Light transport converges like Monte Carlo integration, to a mean that does not depend on the samples.

Rationale: correlated random numbers, a weight that does not match its density, or a pass that repeats another
leave images that look right. They are visible in the rate of convergence and in the mean.
"""

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera, card, sheet, sphere
from scipy import stats
from tracer import Tracer

from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.render.transport import accumulate
from pepperscene.scene import Sky, Sun, assemble_scene
from pepperscene.spectra import Spectrum, scale_to_illuminance, sky_spectrum, sun_spectrum

NM = np.arange(380.0, 781.0, 5.0)
PARTS = ("flash", "sky_and_sun", "indirect")


def glossy_leaf() -> Surface:
    red_edge = 0.05 + 0.4 / (1.0 + np.exp(-(NM - 600.0) / 15.0))
    both = np.stack([red_edge, red_edge * 1.1])[None]
    return Surface("leaf", NM, both, 0.8 * red_edge[None], 1.45, (0.3, 0.4))


def sphere_and_leaf():
    """In front of a card under the sky: edges, penumbras, light through a leaf."""
    ball = sphere((0.03, 0.02, 0.45), 0.06, "matt", subdivisions=3)
    leaf = card(-0.12, 0.0, 0.15, 0.4, "leaf", 0.4)
    mesh = concatenate_meshes([ball, leaf, sheet(0.3, 0.2, 0.6, "matt")])
    # A sky of two halves, and a wide sun behind the camera, whose penumbras are visible.
    irradiance = scale_to_illuminance(sky_spectrum("d65"), 20_000.0)
    halves = np.array([[[1.0, 1.0, 3.0, 3.0]] * 2], np.float32)
    direction = np.array([0.4, -0.5, -1.0]) / np.linalg.norm([0.4, -0.5, -1.0])
    sun = Sun(direction, scale_to_illuminance(sun_spectrum(), 20_000.0), angular_radius=0.05)
    sky = Sky(halves, Spectrum(irradiance.wavelength_nm, irradiance.values[None] / np.pi), sun)
    return assemble_scene(mesh, {"matt": lambertian_surface("matt", 0.6), "leaf": glossy_leaf()}, sky)


class PartTracer(Tracer):
    def parts(self, count: int, stream: int, runs: int) -> dict[str, np.ndarray]:
        """`(runs, h, w, 3)` of each part of the light, with seeds drawn as a renderer draws them."""
        seeds = np.random.SeedSequence(stream).generate_state(runs)
        lights = [self.light(count, count, seed=int(seed)) for seed in seeds]
        return {part: np.array([getattr(light, part) for light in lights], float) for part in PARTS}


@pytest.fixture(scope="module")
def tracer():
    # Few large pixels show the whole scene.
    camera = axis_camera(32, 24)
    return PartTracer(sphere_and_leaf(), replace(camera, sensor=replace(camera.sensor, binning=20)))


@pytest.fixture(scope="module")
def converged(tracer):
    """Each part over 24 seeds of 256 samples."""
    return tracer.parts(256, 1, 24)


def test_error_falls_at_least_as_fast_as_that_of_independent_samples(tracer, converged):
    counts = np.array([4, 16, 64])
    errors = {part: [] for part in (*PARTS, "total")}
    for count in counts:
        light = tracer.parts(int(count), 2, 8)
        difference = {part: light[part] - converged[part].mean(0) for part in PARTS}
        difference["total"] = sum(difference.values())
        for part, values in difference.items():
            errors[part].append(np.sqrt((values**2).mean()))
    for part, values in errors.items():
        # Independent samples give -1/2, stratified ones less. The tolerance covers the noise of 8 seeds.
        slope = np.polyfit(np.log(counts), np.log(values), 1)[0]
        assert slope < -0.5 + 0.05, (part, slope, values)
        # A much steeper slope would mean that the converged light has the same random numbers.
        assert slope > -1.6, (part, slope, values)


@pytest.mark.long
@pytest.mark.parametrize(("count", "runs"), [(1, 400), (4, 400), (16, 100)])
def test_mean_does_not_depend_on_the_number_of_samples(tracer, converged, count, runs):
    # A single sample cannot be correlated with others: it must agree with many.
    assert_same_mean(tracer.parts(count, 3, runs), converged)


@pytest.mark.long
def test_mean_does_not_depend_on_the_passes(tracer, converged, monkeypatch):
    # 64 samples in 16 passes of four.
    monkeypatch.setattr(accumulate, "_LANES", 4 * 32 * 24)
    many, few = tracer.parts(64, 4, 24), tracer.parts(4, 4, 24)
    assert_same_mean(many, converged)
    # Passes that repeat the first one would have the noise of four samples.
    for part in PARTS:
        noise = many[part].std(axis=0, ddof=1).mean() / few[part].std(axis=0, ddof=1).mean()
        assert noise < 0.35, (part, noise)


def blocks(values: np.ndarray) -> np.ndarray:
    """`(runs, k)` means over 8x8 pixels by channel."""
    runs, rows, columns, channels = values.shape
    return values.reshape(runs, rows // 8, 8, columns // 8, 8, channels).mean((2, 4)).reshape(runs, -1)


def assert_same_mean(light: dict[str, np.ndarray], converged: dict[str, np.ndarray]) -> None:
    """Welch's test between seeds on blocks of 8x8 pixels, Bonferroni-corrected, at 0.001."""
    for part in PARTS:
        a, b = blocks(light[part]), blocks(converged[part])
        assert np.isfinite(a).all()
        noisy = (a.std(axis=0) > 0) & (b.std(axis=0) > 0)
        p = stats.ttest_ind(a[:, noisy], b[:, noisy], equal_var=False).pvalue
        assert p.size > 10, part
        assert p.min() * p.size > 1e-3, (part, p.min(), p.size, a.mean() / b.mean())
        assert a.mean() == pytest.approx(b.mean(), rel=0.01), part

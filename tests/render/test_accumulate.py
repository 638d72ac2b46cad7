"""Sums of samples against the samples themselves; sums of the parts of an exposure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera
from greenhouse import camera, greenhouse
from tracer import Tracer

from pepperscene.camera import Motion
from pepperscene.render.transport import accumulate
from pepperscene.render.transport.accumulate import SampleAccumulator, SampleVariance, TracedLight
from pepperscene.render.transport.trace import exposure_parts, in_rows, sum_of_parts

HEIGHT, WIDTH = 5, 7
PIXELS = HEIGHT * WIDTH
WHITE = {1: np.array([3.0e8]), 3: np.array([2.0e8, 5.0e8, 1.0e9])}


class RandomSamples:
    """Random samples of all quantities in every pixel, in double precision."""

    def __init__(self, channels: int, count: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.white = WHITE[channels]
        scale = self.white[:, None, None]
        self.flash, self.sky_and_sun, self.indirect = (
            scale * level * rng.gamma(2.0, 0.5, (channels, PIXELS, count)) for level in (1.0, 0.2, 0.1)
        )
        self.albedo = rng.random((channels, PIXELS, count))
        self.normal = rng.uniform(-1.0, 1.0, (3, PIXELS, count))
        self.hit = (rng.random((1, PIXELS, count)) < 0.8).astype(float)

    def accumulator(self) -> SampleAccumulator:
        return SampleAccumulator(HEIGHT, WIDTH, self.white)

    def direct(self, pixels, begin: int, end: int) -> list[np.ndarray]:
        """Sums as for `add_direct`: 3 c + 5 arrays."""
        which = np.s_[:, slice(None) if pixels is None else pixels, begin:end]
        light = (self.flash + self.sky_and_sun)[which] / self.white[:, None, None]
        parts = [self.flash, self.sky_and_sun, self.albedo, self.normal, self.hit]
        sums = np.concatenate([part[which].sum(axis=-1) for part in parts])
        return [*sums.astype(np.float32), np.square(light).sum(axis=(0, -1)).astype(np.float32)]

    def all_light(self, begin: int, end: int) -> list[np.ndarray]:
        """Sums as for `add_all`: c + 1 arrays more."""
        indirect = self.indirect[:, :, begin:end]
        squares = np.square(indirect / self.white[:, None, None]).sum(axis=(0, -1))
        sums = indirect.sum(axis=-1).astype(np.float32)
        return [*self.direct(None, begin, end), *sums, squares.astype(np.float32)]


def variance(samples: np.ndarray, white: np.ndarray):
    """Unbiased variance of one sample `(c, n)`, summed over the channels in units of white.

    The tolerance is what single precision leaves of a difference between squares.
    """
    in_whites = samples / white[:, None]
    lost = 2e-6 * float(np.square(in_whites).mean(axis=-1).sum())
    return pytest.approx(float(in_whites.var(axis=-1, ddof=1).sum()), rel=1e-5, abs=lost)


@pytest.mark.parametrize("channels", [1, 3])
def test_means_and_variances_equal_those_of_the_samples(channels):
    samples = RandomSamples(channels, 16, 1)
    accumulator = samples.accumulator()
    accumulator.add_all(samples.all_light(0, 2), 2)
    accumulator.add_direct(samples.direct(None, 2, 4), 2)
    # Some pixels continue to 8 samples, some of these and others to 16.
    eight, sixteen = np.array([3, 4, 11, 34]), np.array([4, 20, 34])
    accumulator.add_direct(samples.direct(eight, 4, 8), 4, eight)
    for pixel in sixteen.tolist():
        begin = int(accumulator.samples[pixel])
        chosen = np.array([pixel])
        accumulator.add_direct(samples.direct(chosen, begin, 16), 16 - begin, chosen)

    counts = np.full(PIXELS, 4)
    counts[eight], counts[sixteen] = 8, 16
    assert np.array_equal(accumulator.samples, counts)
    light = accumulator.light()
    assert light.variance.indirect_samples == 2
    assert np.array_equal(light.variance.samples, counts.reshape(HEIGHT, WIDTH))
    for pixel, n in enumerate(counts):
        at = divmod(pixel, WIDTH)
        flash, sky, indirect = (
            part[:, pixel, :count]
            for part, count in ((samples.flash, n), (samples.sky_and_sun, n), (samples.indirect, 2))
        )
        assert light.flash[at] == pytest.approx(flash.mean(axis=-1), rel=1e-5)
        assert light.sky_and_sun[at] == pytest.approx(sky.mean(axis=-1), rel=1e-5)
        assert light.indirect[at] == pytest.approx(indirect.mean(axis=-1), rel=1e-5)
        assert light.albedo[at] == pytest.approx(samples.albedo[:, pixel, :n].mean(axis=-1), rel=1e-5)
        assert light.normal[at] == pytest.approx(samples.normal[:, pixel, :n].mean(axis=-1), abs=1e-6)
        coverage = [samples.hit[0, pixel, :n].mean(), samples.hit[0, pixel, :2].mean()]
        assert light.coverage[at] == pytest.approx(coverage, abs=1e-6)
        assert light.variance.direct[at] == variance(flash + sky, samples.white)
        assert light.variance.indirect[at] == variance(indirect, samples.white)
        mean = flash.mean(axis=-1) + sky.mean(axis=-1) + indirect.mean(axis=-1)
        assert light.total()[at] == pytest.approx(mean, rel=1e-5)
    assert np.allclose(accumulator.total(), light.total(), rtol=1e-6)
    assert np.array_equal(accumulator.direct_variance(), light.variance.direct)
    assert np.array_equal(accumulator.indirect_variance(), light.variance.indirect)


def test_images_have_their_shapes_and_later_samples_do_not_change_them():
    samples = RandomSamples(3, 4, 3)
    accumulator = samples.accumulator()
    accumulator.add_all(samples.all_light(0, 2), 2)
    light = accumulator.light()
    for name in ("flash", "sky_and_sun", "indirect", "normal"):
        image = getattr(light, name)
        assert (image.shape, image.dtype) == ((HEIGHT, WIDTH, 3), np.float32), name
        assert image.flags.c_contiguous, name
    images = light.flash, light.variance.samples, light.variance.direct
    before = [image.copy() for image in images]
    accumulator.add_direct(samples.direct(None, 2, 4), 2)
    assert all(np.array_equal(image, copy) for image, copy in zip(images, before, strict=True))


def test_without_indirect_samples_there_is_no_indirect_light():
    samples = RandomSamples(3, 4, 4)
    accumulator = samples.accumulator()
    accumulator.add_direct(samples.direct(None, 0, 4), 4)
    light = accumulator.light()
    assert not light.indirect.any()
    assert not light.variance.indirect.any()
    # Their coverage is then that of all samples.
    assert np.array_equal(light.coverage[..., 0], light.coverage[..., 1])
    assert np.array_equal(light.total(), light.flash + light.sky_and_sun)


def test_equal_samples_have_no_variance():
    # Up to what single precision leaves of a difference between a square and itself.
    samples = RandomSamples(3, 1, 5)
    for copies, rounding in ((1, 1e-6), (64, 1e-5)):
        accumulator = samples.accumulator()
        accumulator.add_all([np.float32(copies) * part for part in samples.all_light(0, 1)], copies)
        direct = accumulator.direct_variance().ravel()
        assert (direct >= 0.0).all()
        light = (samples.flash + samples.sky_and_sun)[:, :, 0] / samples.white[:, None]
        assert (direct <= rounding * np.square(light).sum(axis=0)).all()
        assert np.isfinite(accumulator.indirect_variance()).all()


@pytest.mark.parametrize("scale", [1e-20, 1e17])
def test_variances_do_not_depend_on_the_unit_of_light(scale):
    # They are in units of white, so that squares stay within single precision.
    results = []
    for factor in (1.0, scale):
        samples = RandomSamples(3, 8, 7)
        for part in ("flash", "sky_and_sun", "indirect", "white"):
            setattr(samples, part, getattr(samples, part) * factor)
        accumulator = samples.accumulator()
        accumulator.add_all(samples.all_light(0, 8), 8)
        results.append(accumulator.light().variance)
    assert np.allclose(results[0].direct, results[1].direct, rtol=1e-4)
    assert np.allclose(results[0].indirect, results[1].indirect, rtol=1e-4)


@pytest.fixture(scope="module")
def tracer():
    view = camera(columns=24, rows=16)
    return Tracer(greenhouse(), replace(view, sensor=replace(view.sensor, binning=60)))


def test_splitting_into_passes_does_not_change_direct_light(tracer, monkeypatch):
    single = tracer.light(8, 4)
    for lanes in (8 * 100, 8 * 24 * 16 - 1):
        monkeypatch.setattr(accumulate, "_LANES", lanes)
        split = tracer.light(8, 4)
        for part in ("flash", "sky_and_sun", "albedo", "normal", "coverage"):
            assert np.array_equal(getattr(single, part), getattr(split, part)), (part, lanes)
        assert np.array_equal(single.variance.direct, split.variance.direct)
        # Scattered rays end one after the other, and Embree rounds differently in nearly empty packets.
        assert np.allclose(single.indirect, split.indirect, rtol=1e-5)


def test_refinement_adds_the_samples_that_would_have_come_next(tracer):
    # Sixteen at once, or four and then twelve more in half of the pixels: the same samples in other sums.
    chosen = np.arange(24 * 16) % 2 == 0

    def required(accumulator):
        return np.where(chosen, 16, accumulator.samples).astype(np.int32)

    few, many, mixed = tracer.light(4, 4), tracer.light(16, 4), tracer.light(4, 4, required)
    chosen = chosen.reshape(16, 24)
    assert np.array_equal(mixed.variance.samples, np.where(chosen, 16, 4))
    for part in ("flash", "sky_and_sun", "albedo", "normal"):
        expected = np.where(chosen[..., None], getattr(many, part), getattr(few, part))
        assert np.allclose(getattr(mixed, part), expected, rtol=1e-4, atol=1e-5 * abs(expected).max()), part
    assert np.array_equal(mixed.indirect, few.indirect)


@pytest.mark.long
def test_variance_of_traced_samples_equals_that_of_independent_samples(tracer):
    # One sample per frame, over 128 seeds, has the variance that 256 samples of a frame report: well-spread
    # samples cover what independent ones do. Indirect light is left out, as rare paths make most of its
    # variance. Deviations are compared, in which the few pixels with the brightest edges weigh less.
    singles = [tracer.light(1, 1, seed=100 + seed) for seed in range(128)]
    light = np.array([single.flash.astype(float) + single.sky_and_sun for single in singles])
    reported = tracer.light(256, 1).variance
    independent = np.sqrt((light / reported.white).var(axis=0, ddof=1).sum(axis=-1))
    deviation = np.sqrt(reported.direct)
    assert deviation.mean() == pytest.approx(independent.mean(), rel=0.1)
    assert np.corrcoef(deviation.ravel(), independent.ravel())[0, 1] > 0.95


SHAPE = (4, 3)
MOTION = Motion((1.0, 0.0, 0.0))


def traced(seed: int, indirect_samples: int = 4) -> TracedLight:
    """Random light of three channels, with different numbers of samples in its pixels."""
    rng = np.random.default_rng(seed)
    images = [rng.random((*SHAPE, n)).astype(np.float32) for n in (3, 3, 3, 3, 3, 2)]
    direct, indirect = rng.random((2, *SHAPE)).astype(np.float32)
    samples = rng.integers(2, 32, SHAPE).astype(np.int32)
    return TracedLight(*images, SampleVariance(samples, indirect_samples, direct, indirect, np.ones(3)))


def variances_of_means(light: TracedLight) -> tuple[np.ndarray, np.ndarray]:
    """Of direct and indirect light, as `AdaptiveSampler` defines them."""
    variance = light.variance
    return variance.direct * variance.samples**-1.5, variance.indirect / variance.indirect_samples


def view(line_time_s: float = 0.0, motion: Motion | None = None, *, flash: bool = True):
    camera = axis_camera(8, 64, flash=flash)
    sensor = replace(camera.sensor, line_time_s=line_time_s)
    return replace(camera, sensor=sensor, motion=motion, exposure_s=1e-3)


@pytest.mark.parametrize(
    ("camera", "has_daylight", "expected"),
    [
        (view(), True, []),
        (view(1e-5), True, []),  # all rows are exposed while the flash is on
        (view(1e-4), True, ["daylight", "flash"]),
        (view(1e-4), False, ["flash"]),
        (view(1e-4, flash=False), True, []),
        (view(motion=Motion()), True, []),
        (view(motion=MOTION), True, ["daylight", "flash"]),
        (view(motion=MOTION, flash=False), True, ["daylight"]),
        (view(motion=MOTION, flash=False), False, ["daylight"]),
    ],
)
def test_an_exposure_is_divided_if_its_lights_have_different_times(camera, has_daylight, expected):
    parts = exposure_parts(camera, has_daylight=has_daylight)
    assert all(part.has_flash != part.has_daylight for part in parts)
    assert ["flash" if part.has_flash else "daylight" for part in parts] == expected


def test_light_and_the_variances_of_means_add_up():
    parts = [traced(1, 4), traced(2, 2)]
    whole = sum_of_parts(parts)
    np.testing.assert_allclose(whole.total(), sum(part.total() for part in parts), rtol=1e-6)
    assert whole.variance.indirect_samples == 6
    np.testing.assert_array_equal(whole.variance.samples, sum(part.variance.samples for part in parts))
    for k in range(2):
        expected = sum(variances_of_means(part)[k] for part in parts)
        np.testing.assert_allclose(variances_of_means(whole)[k], expected, rtol=1e-5)


def test_a_factor_of_rows_applies_to_light_and_its_square_to_variances():
    light, share = traced(3), np.array([1.0, 0.5, 0.25, 0.0])
    scaled = in_rows(light, share)
    np.testing.assert_allclose(scaled.total(), share[:, None, None] * light.total(), rtol=1e-6)
    for after, before in zip(variances_of_means(scaled), variances_of_means(light), strict=True):
        np.testing.assert_allclose(after, share[:, None] ** 2 * before, rtol=1e-6)
    assert in_rows(light, None) is light

"""Sums of samples against the samples themselves: means, variances, subsets of pixels, cuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, greenhouse

from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene, sky_tables
from pepperscene.render.transport import trace as transport
from pepperscene.render.transport.accumulate import SampleAccumulator
from pepperscene.render.transport.trace import Sampling, trace

HEIGHT, WIDTH = 5, 7
PIXELS = HEIGHT * WIDTH
WHITE = {1: np.array([3.0e8]), 3: np.array([2.0e8, 5.0e8, 1.0e9])}


class Drawn:
    """Samples of all kinds for every pixel, kept one by one in double precision."""

    def __init__(self, channels: int, most: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.c, self.white = channels, WHITE[channels]
        scale = self.white[:, None, None]
        self.flash, self.sky, self.soft = (
            scale * level * rng.gamma(2.0, 0.5, (channels, PIXELS, most)) for level in (1.0, 0.2, 0.1)
        )
        self.albedo = rng.random((channels, PIXELS, most))
        self.normal = rng.uniform(-1.0, 1.0, (3, PIXELS, most))
        self.hit = (rng.random((1, PIXELS, most)) < 0.8).astype(float)

    def sharp(self, pixels, begin: int, end: int) -> list[np.ndarray]:
        """What a wavefront of flash and sky gives: 3 c + 5 sums."""
        which = np.s_[:, slice(None) if pixels is None else pixels, begin:end]
        light = (self.flash + self.sky)[which] / self.white[:, None, None]
        parts = [self.flash, self.sky, self.albedo, self.normal, self.hit]
        sums = np.concatenate([part[which].sum(axis=-1) for part in parts])
        return [*sums.astype(np.float32), np.square(light).sum(axis=(0, -1)).astype(np.float32)]

    def both(self, begin: int, end: int) -> list[np.ndarray]:
        """And soft light behind it: c + 1 more."""
        soft = self.soft[:, :, begin:end]
        squares = np.square(soft / self.white[:, None, None]).sum(axis=(0, -1))
        sums = soft.sum(axis=-1).astype(np.float32)
        return [*self.sharp(None, begin, end), *sums, squares.astype(np.float32)]


def variance(samples: np.ndarray, white: np.ndarray):
    """Of one sample `(c, n)`, unbiased, summed over the channels in units of white.

    To what single precision leaves of a difference between squares.
    """
    whites = samples / white[:, None]
    lost = 2e-6 * float(np.square(whites).mean(axis=-1).sum())
    return pytest.approx(float(whites.var(axis=-1, ddof=1).sum()), rel=1e-5, abs=lost)


@pytest.mark.parametrize("channels", [1, 3])
def test_means_and_variances_are_those_of_the_samples(channels):
    drawn = Drawn(channels, 16, 1)
    there = SampleAccumulator(HEIGHT, WIDTH, drawn.white)
    there.add_both(drawn.both(0, 2), 2)
    there.add_sharp(drawn.sharp(None, 2, 4), 2)
    # Some go on to 8, some of those and others to 16.
    some, more = np.array([3, 4, 11, 34]), np.array([4, 20, 34])
    there.add_sharp(drawn.sharp(some, 4, 8), 4, some)
    for pixel in more.tolist():
        begin = int(there.samples[pixel])
        there.add_sharp(drawn.sharp(np.array([pixel]), begin, 16), 16 - begin, np.array([pixel]))

    wanted = np.full(PIXELS, 4)
    wanted[some], wanted[more] = 8, 16
    assert np.array_equal(there.samples, wanted)
    light = there.light()
    assert light.spread.soft_samples == 2
    assert np.array_equal(light.spread.samples, wanted.reshape(HEIGHT, WIDTH))
    for pixel, n in enumerate(wanted):
        at = divmod(pixel, WIDTH)
        flash, sky, soft = (
            part[:, pixel, :count] for part, count in ((drawn.flash, n), (drawn.sky, n), (drawn.soft, 2))
        )
        assert light.flash[at] == pytest.approx(flash.mean(axis=-1), rel=1e-5)
        assert light.sky[at] == pytest.approx(sky.mean(axis=-1), rel=1e-5)
        assert light.soft[at] == pytest.approx(soft.mean(axis=-1), rel=1e-5)
        assert light.albedo[at] == pytest.approx(drawn.albedo[:, pixel, :n].mean(axis=-1), rel=1e-5)
        assert light.normal[at] == pytest.approx(drawn.normal[:, pixel, :n].mean(axis=-1), abs=1e-6)
        hits = [drawn.hit[0, pixel, :n].mean(), drawn.hit[0, pixel, :2].mean()]
        assert light.covered[at] == pytest.approx(hits, abs=1e-6)
        assert light.spread.sharp[at] == variance(flash + sky, drawn.white)
        assert light.spread.soft[at] == variance(soft, drawn.white)
        mean = flash.mean(axis=-1) + sky.mean(axis=-1) + soft.mean(axis=-1)
        assert light.total()[at] == pytest.approx(mean, rel=1e-5)
    assert np.allclose(there.total(), light.total(), rtol=1e-6)
    assert np.array_equal(there.sharp_variance(), light.spread.sharp)
    assert np.array_equal(there.soft_variance(), light.spread.soft)


@pytest.mark.parametrize("channels", [1, 3])
def test_shapes_and_types(channels):
    drawn = Drawn(channels, 2, 2)
    there = SampleAccumulator(HEIGHT, WIDTH, drawn.white)
    there.add_both(drawn.both(0, 2), 2)
    light = there.light()
    for name, depth in (("flash", channels), ("sky", channels), ("soft", channels), ("normal", 3)):
        image = getattr(light, name)
        assert (image.shape, image.dtype) == ((HEIGHT, WIDTH, depth), np.float32), name
        assert image.flags.c_contiguous, name
    assert light.covered.shape == (HEIGHT, WIDTH, 2)
    assert light.spread.sharp.shape == light.spread.soft.shape == (HEIGHT, WIDTH)


def test_later_sums_do_not_change_a_light_that_was_taken():
    drawn = Drawn(3, 4, 3)
    there = SampleAccumulator(HEIGHT, WIDTH, drawn.white)
    there.add_both(drawn.both(0, 2), 2)
    light = there.light()
    before = light.flash.copy(), light.spread.samples.copy(), light.spread.sharp.copy()
    there.add_sharp(drawn.sharp(None, 2, 4), 2)
    assert np.array_equal(light.flash, before[0])
    assert np.array_equal(light.spread.samples, before[1])
    assert np.array_equal(light.spread.sharp, before[2])


def test_without_soft_samples_there_is_no_soft_light():
    drawn = Drawn(3, 4, 4)
    there = SampleAccumulator(HEIGHT, WIDTH, drawn.white)
    there.add_sharp(drawn.sharp(None, 0, 4), 4)
    light = there.light()
    assert not light.soft.any()
    assert not light.spread.soft.any()
    # What soft samples hit is then what all samples hit.
    assert np.array_equal(light.covered[..., 0], light.covered[..., 1])
    assert np.array_equal(light.total(), light.flash + light.sky)


def test_a_single_sample_tells_no_variance():
    drawn = Drawn(3, 1, 5)
    there = SampleAccumulator(HEIGHT, WIDTH, drawn.white)
    there.add_both(drawn.both(0, 1), 1)
    light = there.light()
    # What single precision leaves of a difference between a square and itself.
    squares = np.square((drawn.flash + drawn.sky)[:, :, 0] / drawn.white[:, None]).sum(axis=0)
    assert (light.spread.sharp.ravel() <= 1e-6 * squares).all()
    assert np.isfinite(light.spread.soft).all()


def test_equal_samples_have_no_variance():
    drawn = Drawn(3, 1, 6)
    there = SampleAccumulator(HEIGHT, WIDTH, drawn.white)
    one = drawn.both(0, 1)
    there.add_both([64.0 * part for part in one], 64)
    squares = np.square((drawn.flash + drawn.sky)[:, :, 0] / drawn.white[:, None]).sum(axis=0)
    assert (there.sharp_variance() >= 0.0).all()
    assert (there.sharp_variance().ravel() <= 1e-5 * squares).all()


@pytest.mark.parametrize("scale", [1e-20, 1.0, 1e17])
def test_the_unit_of_light_does_not_matter(scale):
    # Variances are told in units of white, so that squares stay within single precision.
    found = []
    for factor in (1.0, scale):
        drawn = Drawn(3, 8, 7)
        for part in ("flash", "sky", "soft", "white"):
            setattr(drawn, part, getattr(drawn, part) * factor)
        there = SampleAccumulator(HEIGHT, WIDTH, drawn.white)
        there.add_both(drawn.both(0, 8), 8)
        found.append(there.light().spread)
    assert np.allclose(found[0].sharp, found[1].sharp, rtol=1e-4)
    assert np.allclose(found[0].soft, found[1].soft, rtol=1e-4)


# --- what is traced -----------------------------------------------------------------------------------------


class Traced:
    """Two small plants, and their light by any plan."""

    def __init__(self) -> None:
        scene, lens = greenhouse(), camera(columns=24, rows=16)
        self.camera = replace(lens, sensor=replace(lens.sensor, binning=60))
        self.spectral = spectral_response(self.camera, scene)
        grid = self.spectral.grid_nm
        self.scene = light_scene(scene, float(grid[0]), float(grid[-1]))
        self.sky = sky_tables(scene, grid)
        self.view = camera_rays(self.camera)

    def light(self, samples: int, soft: int, more=None, seed: int = 3):
        plan = Sampling(samples, soft, 2, more)
        return trace(self.scene, self.view, self.spectral, self.camera.flash, self.sky, plan, seed)


@pytest.fixture(scope="module")
def traced():
    return Traced()


PARTS = ("flash", "sky", "soft", "albedo", "normal", "covered")


def test_the_cut_into_passes_does_not_change_a_bit(traced, monkeypatch):
    whole = traced.light(8, 4)
    for lanes in (8, 8 * 100, 8 * 24 * 16 - 1):
        monkeypatch.setattr(transport, "_LANES", lanes)
        cut = traced.light(8, 4)
        for part in set(PARTS) - {"soft"}:
            assert np.array_equal(getattr(whole, part), getattr(cut, part)), (part, lanes)
        assert np.array_equal(whole.spread.sharp, cut.spread.sharp)
        # Scattered rays end one by one, and Embree rounds otherwise in packets that are hardly filled.
        assert np.allclose(whole.soft, cut.soft, rtol=1e-5)


def test_samples_added_later_are_those_that_would_have_come(traced):
    # Sixteen at once, or four and in half of the pixels twelve more: the same samples in other sums.
    chosen = np.arange(24 * 16) % 2 == 0

    def more(there):
        return np.where(chosen, 16, there.samples).astype(np.int32)

    few, many, mixed = traced.light(4, 4), traced.light(16, 4), traced.light(4, 4, more)
    chosen = chosen.reshape(16, 24)
    assert np.array_equal(mixed.spread.samples, np.where(chosen, 16, 4))
    for part in ("flash", "sky", "albedo", "normal"):
        wanted = np.where(chosen[..., None], getattr(many, part), getattr(few, part))
        assert np.allclose(getattr(mixed, part), wanted, rtol=1e-4, atol=1e-5 * abs(wanted).max()), part
    assert np.array_equal(mixed.soft, few.soft)


def test_the_spread_of_traced_samples_is_that_of_single_ones(traced):
    # One sample a frame, over 128 seeds, has the variance that 256 samples of a frame tell: well-spread
    # samples cover what independent ones do. Soft light is left out: rare paths make most of its variance.
    # Deviations are compared, in which the few pixels with the brightest edges weigh less.
    singles = [traced.light(1, 1, seed=100 + seed) for seed in range(128)]
    light = np.array([one.flash.astype(float) + one.sky for one in singles])
    spread = traced.light(256, 1).spread
    single = np.sqrt((light / spread.white).var(axis=0, ddof=1).sum(axis=-1))
    told = np.sqrt(spread.sharp)
    assert told.mean() == pytest.approx(single.mean(), rel=0.1)
    assert np.corrcoef(told.ravel(), single.ravel())[0, 1] > 0.95


def test_four_samples_tell_the_spread_that_many_tell(traced):
    # As the stop asks them: on the mean over the picture, where edges that four miss weigh with others. So
    # small a picture has few edges: frames differ by half, the mean over 48 of them by 7 %.
    many = traced.light(256, 1, seed=1).spread.sharp.mean()
    few = np.mean([traced.light(4, 1, seed=seed).spread.sharp.mean() for seed in range(48)])
    assert few == pytest.approx(many, rel=0.2)

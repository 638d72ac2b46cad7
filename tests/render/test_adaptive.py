"""How light and noise show in a picture, against the pictures themselves, and where samples go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    correct_colours,
    expected_electrons,
    load_flash,
    load_lens,
    load_sensor,
)
from pepperscene.render.transport.accumulate import SampleAccumulator
from pepperscene.render.transport.adaptive import GAIN, SOFT_LEFT, AdaptiveSampler, _least_scale, shown
from pepperscene.spectra import Spectrum

HEIGHT, WIDTH = 24, 32


def a_camera(*, flash: bool = True, mono: bool = False, **steps) -> Camera:
    """The recipe's camera, small; or one that sees no colours."""
    sensor = replace(load_sensor("ueye_ui5250re"), columns=WIDTH, rows=HEIGHT)
    if mono:
        curve = sensor.quantum_efficiency
        grey = Spectrum(curve.wavelength_nm, curve.values[1:2])
        sensor = replace(sensor, quantum_efficiency=grey, pattern="mono", binning=2)
    lamp = load_flash("led_matrix_200klx") if flash else None
    if not flash:
        steps.setdefault("white_balance", "daylight")
    return Camera(
        load_lens("lensagon_cmfa0420nd"), sensor, np.eye(4), 50e-6, lamp, developing=Developing(**steps)
    )


CAMERAS = {
    "flash": a_camera(),
    "daylight": a_camera(flash=False),
    "linear": a_camera(tone="linear"),
    "no matrix": a_camera(colour_matrix=False),
    "no balance": a_camera(white_balance=None, colour_matrix=False),
    "no fall-off": a_camera(falloff=False),
    "mono": a_camera(mono=True),
    "mono, linear": a_camera(mono=True, flash=False, tone="linear"),
}


def light_of(
    camera: Camera, level: float, seed: int = 1, colourful: float = 0.3
) -> tuple[np.ndarray, np.ndarray]:
    """`(h, w, c)` light about a level of the full well, of colours near grey, and a unit `(c,)` of white."""
    rng, c = np.random.default_rng(seed), camera.sensor.channels
    full = camera.sensor.full_well_e / expected_electrons(np.ones((HEIGHT, WIDTH, c)), camera).max()
    colours = 1.0 + colourful * rng.uniform(-1.0, 1.0, (HEIGHT, WIDTH, c))
    signal = level * full * colours * rng.uniform(0.5, 1.5, (HEIGHT, WIDTH, 1))
    return signal.astype(np.float32), full * np.array([0.7, 1.0, 0.5])[:c]


def linear_of(signal: np.ndarray, camera: Camera) -> np.ndarray:
    """`(h, w, k)` linear values before the tone curve, without noise and converter steps."""
    smooth = replace(camera, developing=replace(camera.developing, quantise=False))
    return correct_colours(camera_rgb(expected_electrons(signal, smooth), smooth), smooth).astype(float)


def codes_of(linear: np.ndarray, tone: str) -> np.ndarray:
    """Codes that are not rounded (IEC 61966-2-1)."""
    value = np.clip(linear, 0.0, 1.0)
    if tone == "srgb":
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return 255.0 * value


# --- how light shows ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("level", [1e-3, 0.02, 0.3])
def test_codes_per_light_are_the_slope_of_developing(camera, level):
    signal, white = light_of(camera, level)
    found = shown(signal, white, camera)
    # The pixel's own light is made a little brighter and a little darker.
    step = 1e-2
    ends = [linear_of(signal * np.float32(1.0 + side * step), camera) for side in (-1, 1)]
    change = codes_of(ends[1], camera.developing.tone) - codes_of(ends[0], camera.developing.tone)
    length = np.sqrt(np.square(signal / white).sum(axis=-1))
    slope = np.sqrt(np.square(change).mean(axis=-1)) / (2.0 * step * length)
    inside = ((ends[0] > 0.0) & (ends[1] < 1.0)).all(axis=-1)
    assert inside.mean() > 0.6
    # Where the curve's straight part ends its slope has a step of 2 %.
    assert found.per_white[inside] == pytest.approx(slope[inside], rel=0.01)


@pytest.mark.parametrize("name", ["flash", "linear", "mono"])
def test_above_white_the_curve_goes_on(name):
    # Electrons are an output as well, and the picture's clipping is not theirs.
    camera = CAMERAS[name]
    signal, white = light_of(camera, 5.0)
    endless = replace(camera, developing=replace(camera.developing, saturation=False))
    ends = [linear_of(signal * np.float32(1.0 + side * 1e-2), endless) for side in (-1, 1)]
    assert min(np.median(end) for end in ends) > 1.0
    codes = [255.0 * (end if name == "linear" else 1.055 * end ** (1 / 2.4) - 0.055) for end in ends]
    length = np.sqrt(np.square(signal / white).sum(axis=-1))
    slope = np.sqrt(np.square(codes[1] - codes[0]).mean(axis=-1)) / (2e-2 * length)
    found = shown(signal, white, camera)
    assert found.per_white == pytest.approx(slope, rel=5e-3)
    assert (found.noise > 0.0).all()


def test_the_unit_of_white_drops_out():
    camera = CAMERAS["flash"]
    signal, white = light_of(camera, 0.1)
    one, ten = shown(signal, white, camera), shown(signal, 10.0 * white, camera)
    assert ten.per_white == pytest.approx(10.0 * one.per_white, rel=1e-4)
    assert np.array_equal(one.noise, ten.noise)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_no_light_gives_numbers(camera):
    signal = np.zeros((HEIGHT, WIDTH, camera.sensor.channels), np.float32)
    found = shown(signal, light_of(camera, 1.0)[1], camera)
    assert np.isfinite(found.per_white).all()
    assert np.isfinite(found.noise).all()
    assert (found.noise > 0.0).all()  # the read noise is there in the dark


def test_a_camera_without_a_white_balance_gives_numbers():
    # It can give electrons, and no picture that its light could be weighed in.
    camera = a_camera(flash=False, white_balance="flash")
    signal, white = light_of(camera, 0.1)
    found = shown(signal, white, camera)
    assert np.isfinite(found.per_white).all()
    assert (found.noise > 0.0).all()


# --- how noise shows ----------------------------------------------------------------------------------------


def spread_of(signal: np.ndarray, camera: Camera, frames: int = 300) -> np.ndarray:
    """`(h, w)` deviation of developed pictures, root mean square over colours, before rounding to codes."""
    electrons, squares, sums = expected_electrons(signal, camera), 0.0, 0.0
    for seed in range(frames):
        linear = correct_colours(camera_rgb(electrons, camera, np.random.default_rng(seed)), camera)
        codes = codes_of(linear.astype(float), camera.developing.tone)
        squares, sums = squares + np.square(codes), sums + codes
    variance = (squares - np.square(sums) / frames) / (frames - 1)
    return np.sqrt(variance.mean(axis=-1))


@pytest.mark.parametrize("name", ["flash", "daylight", "linear", "no matrix", "mono", "mono, linear"])
@pytest.mark.parametrize("level", [0.05, 0.3])
def test_noise_is_the_spread_of_developed_pictures(name, level):
    camera = CAMERAS[name]
    signal, white = light_of(camera, level, colourful=0.1)
    found = shown(signal, white, camera).noise
    spread = spread_of(signal, camera)
    # Well below white; what is brighter is cut off in the picture.
    linear = linear_of(signal, camera)
    clear = (linear.max(axis=-1) < 0.9) & (linear.min(axis=-1) > 0.0)
    assert clear.mean() > 0.6
    # 300 frames tell a deviation to 4 %, and their mean over the pixels far better; the rest is curvature.
    assert found[clear].mean() == pytest.approx(spread[clear].mean(), rel=0.03)
    assert found[clear] == pytest.approx(spread[clear], rel=0.25)


def test_noise_in_the_dark_is_of_the_right_size():
    # Cut off at black it is no Gaussian any more: within a factor of two.
    camera = CAMERAS["flash"]
    signal, white = light_of(camera, 1e-4)
    ratio = shown(signal, white, camera).noise.mean() / spread_of(signal, camera).mean()
    assert 0.5 < ratio < 2.0


# --- where samples go ---------------------------------------------------------------------------------------


def spreads(seed: int, n: int = 8192) -> np.ndarray:
    """Variances of one sample as pictures have them: most hardly any, some a million times more."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(-3.0, 3.0, n)).astype(np.float32) * (rng.random(n) < 0.7)


def left(spread: np.ndarray, samples: np.ndarray) -> float:
    """Mean variance by Mitchell's law."""
    return float(np.mean(GAIN * spread.astype(float) * samples**-1.5))


def shared_out(spread: np.ndarray, allowed: float, most: int) -> np.ndarray:
    """Samples, not yet rounded."""
    scale = _least_scale(spread, allowed, most)
    return np.clip(np.power(scale * spread.astype(float), 0.4), 1.0, most)


@pytest.mark.parametrize("share", [0.5, 0.05, 0.005])
def test_the_mean_variance_is_as_allowed(share):
    spread = spreads(1)
    allowed = share * left(spread, np.ones(spread.size))
    assert left(spread, shared_out(spread, allowed, 1 << 20)) == pytest.approx(allowed, rel=1e-4)


@pytest.mark.parametrize("share", [0.3, 0.03])
@pytest.mark.parametrize("most", [64, 1 << 20])
def test_no_other_sharing_out_of_as_many_samples_does_better(share, most):
    spread, rng = spreads(2), np.random.default_rng(3)
    allowed = max(share * left(spread, np.ones(spread.size)), 1.2 * left(spread, np.full(spread.size, most)))
    best = shared_out(spread, allowed, most)
    least = left(spread, best)
    # Even, by the deviation, by the variance, and at random about the best; all cut and scaled to as many.
    others = [np.ones(spread.size), spread**0.5, spread, spread**0.25, spread**0.3]
    others += [
        best * np.exp(size * rng.normal(size=best.size)) for size in (0.01, 0.1, 0.5) for _ in range(5)
    ]
    for other in others:
        assert left(spread, as_many(other.astype(float), best.sum(), most)) > least * (1.0 - 1e-9)


def as_many(weights: np.ndarray, total: float, most: int) -> np.ndarray:
    """Samples that go with weights, in [1, most], `total` in all."""
    low, high = -200.0, 200.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        found = np.clip(weights * 2.0**middle, 1.0, most)
        low, high = (middle, high) if found.sum() < total else (low, middle)
    assert found.sum() == pytest.approx(total, rel=1e-6)
    return found


def test_samples_are_powers_of_two_about_that_many():
    # They spread best; rounding costs little and the target is met nevertheless, to what rounding leaves.
    stop, spread = AdaptiveSampler(CAMERAS["flash"], 0.1, 1024, denoised=True), spreads(4)
    for share in (0.3, 0.1, 0.03):
        allowed = share * left(spread, np.ones(spread.size))
        samples, smooth = stop._shared_out(spread, allowed), shared_out(spread, allowed, 1024)
        assert np.array_equal(np.exp2(np.rint(np.log2(samples))), samples)
        assert left(spread, samples) == pytest.approx(allowed, rel=0.15)
        assert samples.sum() == pytest.approx(smooth.sum(), rel=0.1)


@pytest.mark.parametrize("size", [(512, 512), (1024, 1280), (600, 800), (480, 640)])
def test_stripes_are_seen_by_the_sum_over_some_pixels(size):
    # Large pictures are summed up over some pixels; which must not follow the picture's columns.
    spread = np.full(size, 1e-3, np.float32)
    spread[:, ::16] = 1.0
    stop = AdaptiveSampler(CAMERAS["flash"], 0.1, 1024, denoised=True)
    allowed = 0.05 * left(spread, np.ones(size))
    samples = stop._shared_out(spread.ravel(), allowed)
    assert left(spread.ravel(), samples) == pytest.approx(allowed, rel=0.5)


@pytest.mark.parametrize(("share", "wanted"), [(2.0, 1), (1e-9, 64)])
def test_targets_beyond_reach_take_the_least_and_the_most(share, wanted):
    stop, spread = AdaptiveSampler(CAMERAS["flash"], 0.1, 64, denoised=True), spreads(5)
    allowed = share * left(spread, np.ones(spread.size))
    samples = stop._shared_out(spread, allowed)
    assert (samples[spread > 0.0] == wanted).mean() > 0.95
    assert samples.min() >= 1
    assert samples.max() <= 64


def test_nothing_to_share_out():
    stop = AdaptiveSampler(CAMERAS["flash"], 0.1, 64, denoised=True)
    assert (stop._shared_out(np.zeros(100, np.float32), 1.0) == 1).all()
    assert (stop._shared_out(np.zeros(100, np.float32), 0.0) == 1).all()


# --- on sums of samples -------------------------------------------------------------------------------------


def gathered(
    camera: Camera, level: float, sharp: np.ndarray, soft: np.ndarray, n: int = 4
) -> SampleAccumulator:
    """Sums whose means are grey light of a level, and whose variances are given, `(h, w)` each."""
    c = camera.sensor.channels
    signal, white = light_of(camera, level)
    there = SampleAccumulator(HEIGHT, WIDTH, white)
    flash = signal.reshape(-1, c).T.astype(float)
    square = np.square(flash / white[:, None]).sum(axis=0)
    zero = np.zeros(HEIGHT * WIDTH)
    # Half of the light is soft.
    squares = [0.25 * square + (n - 1) / n * part.ravel() for part in (sharp, soft)]
    sums = [*(0.5 * flash), *[zero] * (2 * c + 4), squares[0], *(0.5 * flash), squares[1]]
    there.add_both([(n * one).astype(np.float32) for one in sums], n)
    return there


def a_spread(camera: Camera, level: float) -> np.ndarray:
    """`(h, w)` variances of sharp light: an edge across the picture and hardly any beside it."""
    signal, white = light_of(camera, level)
    square = np.square(signal / white).sum(axis=-1)
    edge = np.abs(np.arange(WIDTH) - WIDTH / 2) < 2.0
    return square * np.where(edge, 0.3, 1e-4)[None]


@pytest.mark.parametrize("denoised", [True, False])
def test_the_error_told_is_that_of_the_variances(denoised):
    camera = CAMERAS["flash"]
    sharp, soft = a_spread(camera, 0.1), 0.1 * a_spread(camera, 0.1)
    there = gathered(camera, 0.1, sharp, soft)
    told = AdaptiveSampler(camera, 0.14, 64, denoised=denoised).achieved(there.light())
    # By hand: Mitchell's law for sharp light, plain Monte Carlo for what is left of soft light.
    shows = shown(there.total(), there.white, camera)
    variance = 0.8 * ndimage.uniform_filter(sharp, 3, mode="nearest") * 4**-1.5
    variance += soft / 4 * (SOFT_LEFT**2 if denoised else 1.0)
    error, noise = shows.per_white**2 * variance, shows.noise**2
    assert told["error_codes"] == pytest.approx(np.sqrt(error.mean()), rel=5e-3)
    assert told["noise_codes"] == pytest.approx(np.sqrt(noise.mean()), rel=1e-4)
    assert told["error_to_noise"] == pytest.approx(np.sqrt(error.mean() / noise.mean()), rel=5e-3)
    assert told["below_half_of_noise"] == pytest.approx((error <= 0.25 * noise).mean(), abs=0.01)
    assert (told["target"], told["samples_per_pixel"], told["soft_samples_per_pixel"]) == (0.14, 4.0, 4)


@pytest.mark.parametrize("target", [0.1, 0.2, 0.4])
def test_what_is_asked_for_meets_the_target(target):
    camera = CAMERAS["flash"]
    sharp = a_spread(camera, 0.1)
    there = gathered(camera, 0.1, sharp, 1e-6 * sharp)
    wanted = np.full(HEIGHT * WIDTH, 4, np.int32)
    stop = AdaptiveSampler(camera, target, 1 << 14, denoised=True)
    for _ in range(8):  # each time at most four times as many
        more = stop.wanted(there)
        assert (more >= there.samples).all()
        assert (more <= 4 * there.samples).all()
        if (more == wanted).all():
            break
        wanted = more
        # As if the samples had come, all with the same mean and variance.
        there = gathered(camera, 0.1, sharp, 1e-6 * sharp)
        there._sharp *= (wanted / 4).astype(np.float32)
        there.samples[:] = wanted
        there._sharp[-1] += (sharp.ravel() * (0.75 * wanted - (wanted - 1)) * -1.0).astype(np.float32)
    told = stop.achieved(there.light())
    # Four samples everywhere are more than flat parts need, and powers of two are coarse.
    assert 0.7 * target < told["error_to_noise"] < 1.15 * target
    assert (
        wanted.reshape(HEIGHT, WIDTH)[:, WIDTH // 2].mean() > 3 * wanted.reshape(HEIGHT, WIDTH)[:, 2].mean()
    )


def test_soft_light_alone_asks_for_no_end_of_sharp_samples():
    # Where soft light is above the target by itself, half of the error is left to sharp light.
    camera = CAMERAS["flash"]
    sharp = a_spread(camera, 0.1)
    there = gathered(camera, 0.1, sharp, 1e3 * sharp)
    stop = AdaptiveSampler(camera, 0.3, 1 << 14, denoised=True)
    shows = shown(there.total(), there.white, camera)
    spread = (shows.per_white**2 * ndimage.uniform_filter(sharp, 3, mode="nearest")).ravel()
    allowed = 0.5 * 0.3**2 * float(np.square(shows.noise).mean())
    expected = np.clip(stop._shared_out(spread.astype(np.float32), allowed), 4, 16)
    assert (stop.wanted(there) == expected).mean() > 0.99


def test_black_frames_want_no_more():
    camera = CAMERAS["flash"]
    sharp = a_spread(camera, 0.0)
    there = gathered(camera, 0.0, sharp, sharp)
    stop = AdaptiveSampler(camera, 0.14, 64, denoised=True)
    assert np.array_equal(stop.wanted(there), there.samples)
    told = stop.achieved(there.light())
    assert told["error_codes"] == 0.0
    assert told["error_to_noise"] == 0.0
    assert told["below_half_of_noise"] == 1.0


def test_blown_out_frames_are_asked_for_no_end_of_samples():
    camera = CAMERAS["flash"]
    sharp = a_spread(camera, 50.0)
    there = gathered(camera, 50.0, sharp, sharp)
    stop = AdaptiveSampler(camera, 0.14, 64, denoised=True)
    assert stop.wanted(there).max() <= 64
    told = stop.achieved(there.light())
    assert all(np.isfinite(value) for value in told.values())


def test_without_a_target_nothing_is_asked_for():
    camera = CAMERAS["flash"]
    sharp = a_spread(camera, 0.1)
    there = gathered(camera, 0.1, sharp, sharp)
    assert AdaptiveSampler(camera, None, 64, denoised=True).wanted(there) is there.samples


def test_more_than_the_most_is_kept_where_it_is_there():
    # A least number above the most: no pixel is to lose samples.
    camera = CAMERAS["flash"]
    there = gathered(camera, 0.1, a_spread(camera, 0.1), a_spread(camera, 0.1), n=128)
    assert np.array_equal(AdaptiveSampler(camera, 0.01, 64, denoised=True).wanted(there), there.samples)

"""Light and noise in codes against developed images, and the distribution of samples over pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    colour_transform,
    correct_colours,
    expected_electrons,
    load_flash,
    load_lens,
    load_sensor,
)
from pepperscene.render.transport.accumulate import SampleAccumulator
from pepperscene.render.transport.adaptive import (
    _GATHERED_COST,
    _GATHERED_ERROR,
    _INDIRECT_COST,
    VARIANCE_GAIN,
    AdaptiveSampler,
    _variance_scale,
    balanced_samples,
    code_response,
    denoised_error,
)
from pepperscene.spectra import Spectrum

HEIGHT, WIDTH = 24, 32


def small_camera(*, flash: bool = True, mono: bool = False, **developing) -> Camera:
    """The recipe's camera with few pixels, or a monochrome one."""
    sensor = replace(load_sensor("ueye_ui5250re"), columns=WIDTH, rows=HEIGHT)
    if mono:
        curve = sensor.quantum_efficiency
        grey = Spectrum(curve.wavelength_nm, curve.values[1:2])
        sensor = replace(sensor, quantum_efficiency=grey, pattern="mono", binning=2)
    led = load_flash("led_matrix_200klx") if flash else None
    if not flash:
        developing.setdefault("white_balance", "daylight")
    lens = load_lens("lensagon_cmfa0420nd")
    return Camera(lens, sensor, np.eye(4), 50e-6, led, developing=Developing(**developing))


CAMERAS = {
    "flash": small_camera(),
    "daylight": small_camera(flash=False),
    "linear": small_camera(tone="linear"),
    "no matrix": small_camera(colour_matrix=False),
    "no balance": small_camera(white_balance=None, colour_matrix=False),
    "no fall-off": small_camera(falloff=False),
    "mono": small_camera(mono=True),
    "mono, linear": small_camera(mono=True, flash=False, tone="linear"),
}


def random_light(camera: Camera, level: float, saturation: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """`(h, w, c)` nearly grey light, about a fraction of the full well, and a unit `(c,)` of white.

    Grey is what the camera's white balance makes grey.
    """
    rng, c = np.random.default_rng(1), camera.sensor.channels
    full = camera.sensor.full_well_e / expected_electrons(np.ones((HEIGHT, WIDTH, c)), camera).max()
    colours = 1.0 + saturation * rng.uniform(-1.0, 1.0, (HEIGHT, WIDTH, c))
    if c == 3 and camera is not NO_IMAGE:
        gains = colour_transform(camera)[0]
        colours = colours * (gains.mean() / gains)
    signal = level * full * colours * rng.uniform(0.5, 1.5, (HEIGHT, WIDTH, 1))
    return signal.astype(np.float32), full * np.array([0.7, 1.0, 0.5])[:c]


def linear_values(signal: np.ndarray, camera: Camera) -> np.ndarray:
    """`(h, w, k)` linear values before the tone curve, without noise and quantisation."""
    smooth = replace(camera, developing=replace(camera.developing, quantise=False))
    return correct_colours(camera_rgb(expected_electrons(signal, smooth), smooth), smooth).astype(float)


def unrounded_codes(linear: np.ndarray, tone: str) -> np.ndarray:
    """Codes without rounding (IEC 61966-2-1)."""
    value = np.clip(linear, 0.0, 1.0)
    if tone == "srgb":
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return 255.0 * value


def slope_per_white(below, above, signal, white, step):
    """`(h, w)` codes per white, from codes of light that is darker and brighter by the relative step."""
    length = np.sqrt(np.square(signal / white).sum(axis=-1))
    return np.sqrt(np.square(above - below).mean(axis=-1)) / (2.0 * step * length)


@pytest.mark.parametrize(
    ("name", "level"),
    [*((name, 0.02) for name in CAMERAS), ("flash", 1e-3), ("mono", 0.3)],
)
def test_codes_per_light_equal_the_slope_of_developing(name, level):
    camera = CAMERAS[name]
    signal, white = random_light(camera, level)
    codes = code_response(signal, white, camera)
    ends = [linear_values(signal * np.float32(factor), camera) for factor in (0.99, 1.01)]
    below, above = (unrounded_codes(end, camera.developing.tone) for end in ends)
    slope = slope_per_white(below, above, signal, white, 0.01)
    inside = ((ends[0] > 0.0) & (ends[1] < 1.0)).all(axis=-1)
    assert inside.mean() > 0.6
    # At the end of its linear part the slope of the tone curve has a step of 2 %.
    assert codes.per_white[inside] == pytest.approx(slope[inside], rel=0.01)


@pytest.mark.parametrize("name", ["flash", "linear", "mono"])
def test_tone_curve_is_extended_above_white(name):
    # Electrons are an output as well, and they are not clipped like the image.
    camera = CAMERAS[name]
    signal, white = random_light(camera, 5.0)
    unsaturated = replace(camera, developing=replace(camera.developing, saturation=False))
    ends = [linear_values(signal * np.float32(factor), unsaturated) for factor in (0.99, 1.01)]
    assert min(np.median(end) for end in ends) > 1.0
    below, above = (255.0 * (end if name == "linear" else 1.055 * end ** (1 / 2.4) - 0.055) for end in ends)
    codes = code_response(signal, white, camera)
    assert codes.per_white == pytest.approx(slope_per_white(below, above, signal, white, 0.01), rel=5e-3)
    assert (codes.noise > 0.0).all()


# A camera without the flash of its white balance gives electrons, but no image.
NO_IMAGE = small_camera(flash=False, white_balance="flash")


@pytest.mark.parametrize("camera", [*CAMERAS.values(), NO_IMAGE], ids=[*CAMERAS, "no image"])
def test_codes_are_finite(camera):
    signal, white = random_light(camera, 1.0)
    for level in (0.0, 0.1):
        codes = code_response(signal * np.float32(level), white, camera)
        assert np.isfinite(codes.per_white).all()
        assert np.isfinite(codes.noise).all()
        assert (codes.noise > 0.0).all()  # read noise


def image_deviation(signal: np.ndarray, camera: Camera, frames: int = 300) -> np.ndarray:
    """`(h, w)` standard deviation of developed images, root mean square over colours, without rounding."""
    electrons, squares, sums = expected_electrons(signal, camera), 0.0, 0.0
    for seed in range(frames):
        linear = correct_colours(camera_rgb(electrons, camera, np.random.default_rng(seed)), camera)
        codes = unrounded_codes(linear.astype(float), camera.developing.tone)
        squares, sums = squares + np.square(codes), sums + codes
    variance = (squares - np.square(sums) / frames) / (frames - 1)
    return np.sqrt(variance.mean(axis=-1))


# Light far above the noise, where the formula's slope holds over the noise: the camera's red is balanced by a
# gain above 2.
@pytest.mark.parametrize(
    ("name", "level"), [("flash", 0.1), ("daylight", 0.3), ("linear", 0.3), ("mono, linear", 0.1)]
)
def test_noise_equals_the_deviation_of_developed_images(name, level):
    camera = CAMERAS[name]
    signal, white = random_light(camera, level, saturation=0.1)
    noise = code_response(signal, white, camera).noise
    deviation = image_deviation(signal, camera)
    # Brighter pixels are clipped in the image.
    linear = linear_values(signal, camera)
    unclipped = (linear.max(axis=-1) < 0.9) & (linear.min(axis=-1) > 0.0)
    assert unclipped.mean() > 0.6
    # 300 frames give a deviation to 4 %, and its mean over the pixels far better; the rest is curvature.
    assert noise[unclipped].mean() == pytest.approx(deviation[unclipped].mean(), rel=0.03)
    assert noise[unclipped] == pytest.approx(deviation[unclipped], rel=0.25)


def random_variances(seed: int, n: int = 8192) -> np.ndarray:
    """Variances of one sample like those of images: most are small, some a million times larger."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(-3.0, 3.0, n)).astype(np.float32) * (rng.random(n) < 0.7)


def mean_variance(variance: np.ndarray, samples: np.ndarray) -> float:
    """Of the pixels' means, after Mitchell."""
    return float(np.mean(VARIANCE_GAIN * variance.astype(float) * samples**-1.5))


def distribute(variance: np.ndarray, allowed: float, most: int) -> np.ndarray:
    """Samples without rounding."""
    scale = _variance_scale(variance, allowed, most)
    return np.clip(np.power(scale * variance.astype(float), 0.4), 1.0, most)


@pytest.mark.parametrize(("fraction", "most"), [(0.3, 64), (0.03, 1 << 20)])
def test_no_other_distribution_of_as_many_samples_is_better(fraction, most):
    variance, rng = random_variances(2), np.random.default_rng(3)
    allowed = max(
        fraction * mean_variance(variance, np.ones(variance.size)),
        1.2 * mean_variance(variance, np.full(variance.size, most)),
    )
    best = distribute(variance, allowed, most)
    least = mean_variance(variance, best)
    # Uniform, by deviation, by variance, and random ones near the best; all clipped and scaled to as many.
    others = [np.ones(variance.size), variance**0.5, variance, variance**0.25, variance**0.3]
    others += [best * np.exp(size * rng.normal(size=best.size)) for size in (0.01, 0.1, 0.5)]
    for other in others:
        samples = scale_to_total(other.astype(float), best.sum(), most)
        assert mean_variance(variance, samples) > least * (1.0 - 1e-9)


def scale_to_total(weights: np.ndarray, total: float, most: int) -> np.ndarray:
    """Samples in proportion to weights, in [1, most], `total` together."""
    low, high = -200.0, 200.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        samples = np.clip(weights * 2.0**middle, 1.0, most)
        low, high = (middle, high) if samples.sum() < total else (low, middle)
    assert samples.sum() == pytest.approx(total, rel=1e-6)
    return samples


def test_samples_are_powers_of_two_that_meet_the_target():
    # Powers of two variance best; rounding to them costs little.
    sampler, variance = AdaptiveSampler(CAMERAS["flash"], 0.1, 1024, denoised=True), random_variances(4)
    for fraction in (0.3, 0.1, 0.03):
        allowed = fraction * mean_variance(variance, np.ones(variance.size))
        samples, smooth = sampler._distribute(variance, allowed), distribute(variance, allowed, 1024)
        assert np.array_equal(np.exp2(np.rint(np.log2(samples))), samples)
        assert mean_variance(variance, samples) == pytest.approx(allowed, rel=0.15)
        assert samples.sum() == pytest.approx(smooth.sum(), rel=0.1)


@pytest.mark.parametrize("size", [(1024, 1280), (480, 640)])
def test_subset_of_pixels_does_not_follow_the_columns(size):
    # For large images the scale is computed from a subset of pixels, which must not miss stripes.
    variance = np.full(size, 1e-3, np.float32)
    variance[:, ::16] = 1.0
    sampler = AdaptiveSampler(CAMERAS["flash"], 0.1, 1024, denoised=True)
    allowed = 0.05 * mean_variance(variance, np.ones(size))
    samples = sampler._distribute(variance.ravel(), allowed)
    assert mean_variance(variance.ravel(), samples) == pytest.approx(allowed, rel=0.5)


@pytest.mark.parametrize(("fraction", "expected"), [(2.0, 1), (1e-9, 64)])
def test_unreachable_targets_give_the_minimum_and_the_maximum(fraction, expected):
    sampler, variance = AdaptiveSampler(CAMERAS["flash"], 0.1, 64, denoised=True), random_variances(5)
    allowed = fraction * mean_variance(variance, np.ones(variance.size))
    samples = sampler._distribute(variance, allowed)
    assert (samples[variance > 0.0] == expected).mean() > 0.95
    assert samples.min() >= 1
    assert samples.max() <= 64
    for allowed in (1.0, 0.0):  # no variance needs one sample
        assert (sampler._distribute(np.zeros(100, np.float32), allowed) == 1).all()


def accumulated(
    camera: Camera, level: float, direct: np.ndarray, indirect: np.ndarray, n: int = 4
) -> SampleAccumulator:
    """Sums with the means of grey light of a level and the given variances, `(h, w)` each."""
    c = camera.sensor.channels
    signal, white = random_light(camera, level)
    accumulator = SampleAccumulator(HEIGHT, WIDTH, white)
    flash = signal.reshape(-1, c).T.astype(float)
    square = np.square(flash / white[:, None]).sum(axis=0)
    zero = np.zeros(HEIGHT * WIDTH)
    # Half of the light is indirect.
    squares = [0.25 * square + (n - 1) / n * part.ravel() for part in (direct, indirect)]
    sums = [*(0.5 * flash), *[zero] * (2 * c + 4), squares[0], *(0.5 * flash), squares[1]]
    accumulator.add_all([(n * part).astype(np.float32) for part in sums], n)
    return accumulator


def edge_variance(camera: Camera, level: float) -> np.ndarray:
    """`(h, w)` variances of direct light: large at an edge across the image, small elsewhere."""
    signal, white = random_light(camera, level)
    square = np.square(signal / white).sum(axis=-1)
    edge = np.abs(np.arange(WIDTH) - WIDTH / 2) < 2.0
    return square * np.where(edge, 0.3, 1e-4)[None]


@pytest.mark.parametrize("gathered", [True, False])
@pytest.mark.parametrize("denoised", [True, False])
def test_reported_error_follows_from_the_variances(denoised, gathered):
    camera = CAMERAS["flash"]
    direct, indirect = edge_variance(camera, 0.1), 0.1 * edge_variance(camera, 0.1)
    accumulator = accumulated(camera, 0.1, direct, indirect)
    light = accumulator.light()
    reported = AdaptiveSampler(camera, 0.14, 64, denoised=denoised, gathered=gathered).metadata(light)
    # By hand: Mitchell's equation for direct light, plain Monte Carlo for the rest of the indirect light.
    codes = code_response(accumulator.total(), accumulator.white, camera)
    variance = 0.8 * ndimage.uniform_filter(direct, 3, mode="nearest") * 4**-1.5
    remaining = _GATHERED_ERROR * 4**0.25 if gathered else denoised_error(0.5)
    variance += indirect / 4 * (remaining**2 if denoised else 1.0)
    error, noise = codes.per_white**2 * variance, codes.noise**2
    assert reported["error_codes"] == pytest.approx(np.sqrt(error.mean()), rel=5e-3)
    assert reported["noise_codes"] == pytest.approx(np.sqrt(noise.mean()), rel=1e-4)
    assert reported["error_to_noise"] == pytest.approx(np.sqrt(error.mean() / noise.mean()), rel=5e-3)
    assert reported["below_half_of_noise"] == pytest.approx((error <= 0.25 * noise).mean(), abs=0.01)
    samples = reported["samples_per_pixel"], reported["soft_samples_per_pixel"]
    assert (reported["target"], *samples) == (0.14, 4.0, 4)


# Larger targets allow so much error that four samples are almost enough at the edge too.
@pytest.mark.parametrize("target", [0.1, 0.3])
def test_required_samples_meet_the_target(target):
    camera = CAMERAS["flash"]
    direct = edge_variance(camera, 0.1)
    accumulator = accumulated(camera, 0.1, direct, 1e-6 * direct)
    samples = np.full(HEIGHT * WIDTH, 4, np.int32)
    sampler = AdaptiveSampler(camera, target, 1 << 14, denoised=True)
    for _ in range(8):  # at most four times as many each time
        required = sampler.required(accumulator)
        assert (required >= accumulator.samples).all()
        assert (required <= 4 * accumulator.samples).all()
        if (required == samples).all():
            break
        samples = required
        # As if the samples had been taken, all with the same mean and variance.
        accumulator = accumulated(camera, 0.1, direct, 1e-6 * direct)
        accumulator._direct *= (samples / 4).astype(np.float32)
        accumulator.samples[:] = samples
        accumulator._direct[-1] += (direct.ravel() * (0.25 * samples - 1)).astype(np.float32)
    reported = sampler.metadata(accumulator.light())
    # Uniform parts need fewer than four samples, and powers of two are coarse.
    assert 0.7 * target < reported["error_to_noise"] < 1.15 * target
    columns = samples.reshape(HEIGHT, WIDTH).mean(axis=0)
    assert columns[WIDTH // 2] > 3 * columns[2]


def test_noisy_indirect_light_does_not_multiply_direct_samples():
    # Direct light may then still have half of the allowed error, or more.
    camera = CAMERAS["flash"]
    direct = edge_variance(camera, 0.1)
    accumulator = accumulated(camera, 0.1, direct, 1e3 * direct)
    sampler = AdaptiveSampler(camera, 0.3, 1 << 14, denoised=True)
    codes = code_response(accumulator.total(), accumulator.white, camera)
    variance = (codes.per_white**2 * ndimage.uniform_filter(direct, 3, mode="nearest")).ravel()
    allowed = 0.5 * 0.3**2 * float(np.square(codes.noise).mean())
    expected = np.clip(sampler._distribute(variance.astype(np.float32), allowed), 4, 16)
    assert (sampler.required(accumulator) <= expected).all()


def test_black_and_overexposed_frames_stay_within_the_maximum():
    camera = CAMERAS["flash"]
    sampler = AdaptiveSampler(camera, 0.14, 64, denoised=True)
    black, white = (
        accumulated(camera, level, edge_variance(camera, level), edge_variance(camera, level))
        for level in (0.0, 50.0)
    )
    assert np.array_equal(sampler.required(black), black.samples)
    for light in (black, white):
        draft = AdaptiveSampler(camera, None, 64, denoised=True, gathered=True).required(light)
        assert (draft >= light.samples).all()
        assert draft.max() <= 64
    reported = sampler.metadata(black.light())
    names = "error_codes", "error_to_noise", "below_half_of_noise"
    assert [reported[name] for name in names] == [0.0, 0.0, 1.0]
    assert sampler.required(white).max() <= 64
    assert all(np.isfinite(value) for value in sampler.metadata(white.light()).values())


def test_no_target_and_a_minimum_above_the_maximum_require_no_more_samples():
    camera = CAMERAS["flash"]
    direct = edge_variance(camera, 0.1)
    accumulator = accumulated(camera, 0.1, direct, direct, n=128)
    assert AdaptiveSampler(camera, None, 64, denoised=True).required(accumulator) is accumulator.samples
    required = AdaptiveSampler(camera, 0.01, 64, denoised=True).required(accumulator)
    assert np.array_equal(required, accumulator.samples)


@pytest.mark.parametrize("power", [1.0, 0.5])
@pytest.mark.parametrize(("time", "remaining"), [(36.0, 0.01), (72.0, 1.0), (36.0, 3.0)])
def test_balanced_samples_have_the_smallest_product_of_time_and_variance(time, remaining, power):
    variance, taken = random_variances(5), np.full(8192, 8, np.int32)
    best = np.maximum(balanced_samples(variance, remaining, taken, time, power), 8.0).astype(float)
    assert 0.02 < np.mean(best > 8.0) < 0.9

    def product(samples):
        return (time + samples.mean()) ** power * (remaining + mean_variance(variance, samples))

    # More or fewer samples in all pixels, or in the noisiest, or in those with few more than the least.
    rank = np.argsort(np.argsort(variance))
    few = (best > 8.0) & (best < 16.0)
    for pixels in (rank >= 0, rank > 8000, few):
        for factor in (0.5, 0.8, 1.25, 2.0):
            other = np.maximum(np.where(pixels, factor * best, best), 8.0)
            assert product(other) > product(best)


def balanced_by_gathered_light(camera, accumulator, direct, indirect):
    """The samples of direct light of a first round, before they are rounded, by iteration to the end."""
    codes = code_response(accumulator.total(), accumulator.white, camera)
    taken = accumulator.samples
    variance = (codes.per_white**2 * ndimage.uniform_filter(direct, 3, mode="nearest")).ravel().astype(float)
    remaining = float(np.mean(codes.per_white**2 * indirect)) * _GATHERED_ERROR**2 / 2.0
    samples = taken.astype(float)
    for _ in range(50):
        image, time = remaining + mean_variance(variance, samples), 4 * _GATHERED_COST + samples.mean()
        samples = np.maximum((1.5 * VARIANCE_GAIN * variance * time / (0.5 * image)) ** 0.4, taken)
    return samples


# A draft has no target: its direct samples are in balance with gathered light wherever that is.
@pytest.mark.parametrize("target", [0.15, None])
def test_direct_samples_are_in_balance_with_gathered_light(target):
    camera = CAMERAS["flash"]
    direct = edge_variance(camera, 0.1)
    indirect = 30.0 * direct
    accumulator = accumulated(camera, 0.1, direct, indirect)
    expected = balanced_by_gathered_light(camera, accumulator, direct, indirect)
    assert expected.max() > 8.0
    assert expected.min() == 4.0
    required = AdaptiveSampler(camera, target, 1 << 14, denoised=True, gathered=True).required(accumulator)
    # Rounded to powers of two, after fewer steps.
    np.testing.assert_array_less(required, 1.6 * np.clip(expected, 4.0, 16.0))
    np.testing.assert_array_less(0.65 * np.clip(expected, 4.0, 16.0), required)


def test_direct_samples_are_in_balance_where_indirect_light_misses_the_target():
    camera = CAMERAS["flash"]
    direct = edge_variance(camera, 0.1)
    indirect = 1e3 * direct
    accumulator = accumulated(camera, 0.1, direct, indirect)
    codes = code_response(accumulator.total(), accumulator.white, camera)
    required = AdaptiveSampler(camera, 0.15, 1 << 14, denoised=True).required(accumulator)
    # The number that is wanted, before the limits of a round: at most four times as many as there are.
    assert required.max() <= 16
    remaining = float(np.mean(codes.squared(indirect, 510.0))) * denoised_error(0.5) ** 2 / 4
    variance = (codes.per_white**2 * ndimage.uniform_filter(direct, 3, mode="nearest")).ravel()
    wanted = balanced_samples(variance, remaining, accumulator.samples, 4 * _INDIRECT_COST, 1.0)
    np.testing.assert_array_less(required, 1.42 * np.clip(wanted, 4, 16))
    np.testing.assert_array_less(0.7 * np.clip(wanted, 4, 16), required)

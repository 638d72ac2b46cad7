"""Exposures in parts: which there are, and the sums of their light and variances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera

from pepperscene.camera import Motion
from pepperscene.render.transport.accumulate import SampleVariance, TracedLight
from pepperscene.render.transport.trace import exposure_parts, in_rows, sum_of_parts

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

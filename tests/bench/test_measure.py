"""Rounds, time limits and settings, with a renderer of known noise and run time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pepperscene.bench.measure import measure_settings
from pepperscene.bench.reference import Reference
from pepperscene.bench.settings import PLAIN, Setting, settings
from pepperscene.render import QUALITIES


@pytest.fixture
def reference(subject):
    """The picture without noise."""
    camera = subject.camera
    return Reference(np.full((camera.height, camera.width, 3), subject.renderer.level_e), 0.0, 0.0, 2, 0.0)


def samples(*counts):
    return [
        Setting("test", f"{n} spp", dataclasses.replace(QUALITIES["reference"], samples=n, soft=n, most=n))
        for n in counts
    ]


@pytest.mark.usefixtures("simulated_clock")
def test_settings_are_interleaved_at_shifted_views(subject, reference):
    results = measure_settings(subject, samples(1, 4, 16), reference, 3)
    for result, count in zip(results, (1, 4, 16), strict=True):
        assert result.seconds == pytest.approx([0.01 * count] * 3)
        assert result.median_s == pytest.approx(0.01 * count)
    # First the frame of each setting at the subject's camera; then rounds A B C A B C.
    calls = subject.renderer.calls
    assert all(camera is subject.camera for camera, *_ in calls[:3])
    assert [quality.samples for _, quality, _ in calls[3:]] == [1, 4, 16] * 3
    views = [subject.path.index(camera) for camera, *_ in calls[3:]]
    # No setting renders a view twice, and none is always the first at one.
    for number in range(3):
        assert sorted(views[number::3]) == [0, 1, 2]
    assert len({seed for *_, seed in calls}) == len(calls)


def test_error_falls_with_the_number_of_samples(subject, reference):
    results = measure_settings(subject, samples(1, 4, 16, 64), reference, 1)
    logs = np.log([[result.effort["samples"], result.errors.relative_mse] for result in results])
    # Four points of 1,296 values each.
    assert np.polyfit(*logs.T, 1)[0] == pytest.approx(-1.0, abs=0.05)
    expected = (subject.renderer.noise_e / subject.renderer.level_e) ** 2 / 1.01
    assert results[0].errors.relative_mse == pytest.approx(expected, rel=0.15)


@pytest.mark.usefixtures("simulated_clock")
def test_time_limit_skips_late_settings_and_rounds(subject, reference):
    lines = []
    settings = samples(1, 1, 200, 300)
    results = measure_settings(subject, settings, reference, 5, limit_s=3.0, on_progress=lines.append)
    # After the third setting 2.02 s have passed, more than half: the fourth is skipped, and rounds end early.
    assert [result.effort["samples"] for result in results] == [1, 1, 200]
    assert {len(result.seconds) for result in results} == {1}
    assert any("no time for test, 300 spp" in line for line in lines)
    assert any("no time for more than 1 of 5 rounds" in line for line in lines)


def test_settings_are_distinct_and_comparable():
    full, quick = settings(), settings(quick=True)
    assert len({(setting.family, setting.name) for setting in full}) == len(full)
    assert {setting.quality.denoise for setting in full} == {True, False}
    plain = [setting.quality for setting in full if setting.family == PLAIN]
    assert len(plain) >= 3
    assert all((one.integrator, one.sampler, one.denoise) == ("path", "independent", False) for one in plain)
    # Both integrators follow the same number of bounces.
    assert {one.bounces for one in plain} == {QUALITIES["standard"].bounces}
    assert {(setting.family, setting.name) for setting in quick} < {
        (setting.family, setting.name) for setting in full
    }

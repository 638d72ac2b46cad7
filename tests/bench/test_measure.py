"""Rounds, time limits and settings, with a renderer of known noise and run time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pepperscene.bench.image_errors import Reference
from pepperscene.bench.measure import measure_settings
from pepperscene.bench.settings import ADAPTIVE, NAMED, PLAIN, Setting, settings
from pepperscene.render import QUALITIES


@pytest.fixture
def reference(subject):
    """The picture without noise."""
    camera = subject.camera
    return Reference(np.full((2, camera.height, camera.width, 3), subject.renderer.level_e), camera)


def samples(*counts, family="test"):
    return [
        Setting(family, f"{n} spp", dataclasses.replace(QUALITIES["reference"], samples=n, soft=n, most=n))
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
    logs = np.log([[result.effort["samples"], result.errors.relative.mean] for result in results])
    # Four points of 1,296 values each.
    assert np.polyfit(*logs.T, 1)[0] == pytest.approx(-1.0, abs=0.05)
    expected = (subject.renderer.noise_e / subject.renderer.level_e) ** 2 / 1.01
    assert results[0].errors.relative.mean == pytest.approx(expected, rel=0.15)


@pytest.mark.usefixtures("simulated_clock")
def test_settings_that_would_end_late_are_not_started(subject, reference):
    lines = []
    settings = samples(1, 200, 300)
    results = measure_settings(subject, settings, reference, 5, limit_s=5.0, on_progress=lines.append)
    # 200 samples take 2 s: a first and a timed frame end in time. Those of 300 samples would take 6 s.
    assert [result.effort["samples"] for result in results] == [1, 200]
    assert {quality.samples for _, quality, _ in subject.renderer.calls} == {1, 200}
    assert "test: no time for test, 300 spp" in lines
    # The slow setting is left out of the rounds for which there is no time.
    assert [len(result.seconds) for result in results] == [5, 1]
    assert "test: test, 200 spp: no time after 1 rounds" in lines
    assert subject.renderer.now < 5.0
    # Named qualities are measured without time.
    settings = [*samples(100, 200, family=NAMED), *samples(400)]
    results = measure_settings(subject, settings, reference, 5, limit_s=-1.0)
    assert [(result.name, len(result.seconds)) for result in results] == [("100 spp", 1), ("200 spp", 1)]


@pytest.mark.usefixtures("simulated_clock")
def test_compilation_does_not_count_as_time_of_later_settings(subject, reference, monkeypatch):
    # The first frame of all takes 2 s more. 16 samples would take 16 * 2.01 s if that were for each sample.
    render, calls = subject.renderer.render, subject.renderer.calls

    def render_compiled(*args, **kwargs):
        subject.renderer.now += 0.0 if calls else 2.0
        return render(*args, **kwargs)

    monkeypatch.setattr(subject.renderer, "render", render_compiled)
    results = measure_settings(subject, samples(1, 16, 1000), reference, 2, limit_s=10.0)
    assert [result.effort["samples"] for result in results] == [1, 16]
    assert [len(result.seconds) for result in results] == [2, 2]


def test_samples_are_compared_within_a_method_only():
    by_name = {(setting.family, setting.name): setting for setting in settings()}
    standard, draft = by_name[NAMED, "standard"], by_name[NAMED, "draft"]
    fine = by_name[ADAPTIVE, "target 0.07"]
    # More samples than the ratio of the targets; README: 2.0 times the time.
    assert 2.0 < fine.relative_samples(standard) < 4.0
    paths = [by_name[PLAIN, f"{count} spp"] for count in (4, 64)]
    assert paths[1].relative_samples(paths[0]) == 16.0
    assert paths[0].relative_samples(draft) is None
    assert paths[0].relative_samples(standard) is None


def test_settings_are_distinct_and_comparable():
    full, default, quick = settings(all_settings=True), settings(), settings(quick=True)
    assert len({(setting.family, setting.name) for setting in full}) == len(full)
    assert {setting.quality.denoise for setting in full} == {True, False}
    names = {(setting.family, setting.name) for setting in default}
    assert {(setting.family, setting.name) for setting in quick} < names
    assert names < {(setting.family, setting.name) for setting in full}
    # By default, only qualities, other targets and the path tracer.
    assert {setting.family for setting in default} == {NAMED, ADAPTIVE, PLAIN}
    for chosen in (default, quick):
        assert [setting.name for setting in chosen[:2]] == ["draft", "standard"]
    plain = [setting.quality for setting in full if setting.family == PLAIN]
    assert [one.samples for one in plain] == [4, 16, 64, 256]
    assert all((one.integrator, one.sampler, one.denoise) == ("path", "independent", False) for one in plain)
    # Both integrators follow the same number of bounces.
    assert {one.bounces for one in plain} == {QUALITIES["standard"].bounces}

"""Rounds, limits and references with a renderer whose noise and clock follow a known law."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pepperscene.bench.measure import measure_settings
from pepperscene.bench.reference import Converged, codes, converged, rms
from pepperscene.bench.settings import PLAIN, Setting, settings
from pepperscene.render import QUALITIES


def truth(subject):
    """The picture that the made-up noise lies about."""
    camera = subject.camera
    shape = (camera.height, camera.width, camera.sensor.channels)
    return Converged(np.full(shape, subject.renderer.level), 0.0, 0.0, 2, 0.0)


def of_samples(*counts):
    return [
        Setting("made", f"{n} spp", dataclasses.replace(QUALITIES["reference"], samples=n, soft=n, most=n))
        for n in counts
    ]


def test_every_setting_is_timed_in_turn_at_shifted_places(subject):
    renderer = subject.renderer
    found = measure_settings(
        subject, of_samples(1, 4, 16), truth(subject), 3, flip=False, clock=renderer.clock
    )
    assert [len(one.seconds) for one in found] == [3, 3, 3]
    for one, count in zip(found, (1, 4, 16), strict=True):
        assert one.seconds == pytest.approx([0.01 * count] * 3)
    # First each setting's own frame at the subject's camera; then rounds A B C A B C.
    asked = renderer.asked
    assert all(camera is subject.camera for camera, *_ in asked[:3])
    assert [quality.samples for _, quality, _ in asked[3:]] == [1, 4, 16] * 3
    places = [subject.path.index(camera) for camera, *_ in asked[3:]]
    # No setting meets a place twice, and none is always the first there.
    for number in range(3):
        assert sorted(places[number::3]) == [0, 1, 2]
    assert len({seed for *_, seed in asked}) == len(asked)


def test_the_error_follows_the_law_of_the_noise(subject):
    found = measure_settings(subject, of_samples(1, 4, 16, 64), truth(subject), 1, flip=False)
    logs = np.log([[one.effort["samples"], one.errors.relative_mse] for one in found])
    slope = np.polyfit(*logs.T, 1)[0]
    # The squared error of a mean falls with the number of samples: four points of 1,296 values each.
    assert slope == pytest.approx(-1.0, abs=0.05)
    expected = (subject.renderer.noise / subject.renderer.level) ** 2 / 1.01
    assert found[0].errors.relative_mse == pytest.approx(expected, rel=0.15)


def test_a_limit_leaves_out_late_settings_and_rounds(subject):
    renderer, told = subject.renderer, []
    found = measure_settings(
        subject, of_samples(1, 1, 200, 300), truth(subject), 5, flip=False, limit_s=3.0, told=told.append,
        clock=renderer.clock,
    )  # fmt: skip
    # 2.02 s are spent after the third setting, more than half: the fourth has no time, and rounds end early.
    assert [one.effort["samples"] for one in found] == [1, 1, 200]
    assert {len(one.seconds) for one in found} == {1}
    assert any("no time for made, 300 spp" in line for line in told)
    assert any("no time for more than 1 of 5 rounds" in line for line in told)


def test_the_reference_knows_its_own_error(subject, tmp_path):
    found = converged(subject, tmp_path, wanted_codes=0.05)
    wrong = rms(codes(found.electrons, subject.camera) - codes(truth(subject).electrons, subject.camera))
    assert found.error_codes <= 0.05
    assert found.error_codes == pytest.approx(wrong, rel=0.15)
    assert found.relative_mse == pytest.approx(
        np.mean((found.electrons / subject.renderer.level - 1) ** 2) / 1.01, rel=0.2
    )


def test_the_reference_is_paid_for_once(subject, tmp_path):
    first = converged(subject, tmp_path, wanted_codes=0.2)
    paid = len(subject.renderer.asked)
    again = converged(subject, tmp_path, wanted_codes=0.2)
    assert len(subject.renderer.asked) == paid
    np.testing.assert_array_equal(again.electrons, first.electrons)
    # A finer one goes on from there: as many pictures in all as if it had been asked for at once.
    finer = converged(subject, tmp_path, wanted_codes=0.1)
    assert len(subject.renderer.asked) == finer.renders
    seeds = [seed for *_, seed in subject.renderer.asked]
    assert len(set(seeds)) == len(seeds)
    # Another camera, scene or size is another picture.
    moved = dataclasses.replace(subject, camera=dataclasses.replace(subject.camera, exposure_s=1e-3))
    assert moved.digest() != subject.digest()
    assert subject.digest() == dataclasses.replace(subject, renderer=None, scene=None).digest()


def test_a_damaged_reference_is_made_anew(subject, tmp_path):
    converged(subject, tmp_path, wanted_codes=0.5)
    (kept,) = tmp_path.iterdir()
    kept.write_bytes(kept.read_bytes()[:100])
    assert converged(subject, tmp_path, wanted_codes=0.5).renders >= 2


def test_a_time_limit_still_gives_two_halves(subject, tmp_path):
    assert converged(subject, tmp_path, wanted_codes=1e-9, limit_s=0.0).renders == 2


def test_settings_are_distinct_and_hold_what_is_compared():
    every = settings()
    assert len({(one.family, one.name) for one in every}) == len(every)
    assert {one.quality.denoise for one in every} == {True, False}
    plain = [one.quality for one in every if one.family == PLAIN]
    assert len(plain) >= 3
    assert all((one.integrator, one.sampler, one.denoise) == ("path", "independent", False) for one in plain)
    # Both integrators follow the same number of bounces.
    assert {one.bounces for one in plain} == {QUALITIES["standard"].bounces}
    assert {(one.family, one.name) for one in settings(quick=True)} < {
        (one.family, one.name) for one in every
    }

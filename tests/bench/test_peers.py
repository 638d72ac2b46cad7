"""Cycles' pictures on the bench's yardsticks, with made-up pictures in the place of Blender's."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.bench import peers
from pepperscene.bench.cycles import CyclesRun
from pepperscene.bench.cycles_settings import STANDARD_SETTINGS

LEVEL_E, NOISE_E = 2000.0, 100.0


@pytest.fixture
def blender(monkeypatch):
    """Renders an even grey with noise that falls with the root of the samples; notes what was asked for."""
    asked = []

    def render(scene, camera, settings, folder, seeds=1, **_):
        asked.append(settings)
        runs = []
        for number, setting in enumerate(settings):
            rng = np.random.default_rng(number)
            noise = rng.normal(size=(setting.frames or seeds, camera.height, camera.width, 3))
            images = (LEVEL_E + NOISE_E * noise / np.sqrt(setting.spp)).astype(np.float32)
            runs.append(CyclesRun(setting, 0.1 * setting.spp, 2.0, 900.0, images, "4.5"))
        return runs

    monkeypatch.setattr(peers, "render_cycles", render)
    return asked


def test_errors_are_taken_against_its_own_reference(subject, blender, tmp_path):
    found, floor = peers.measure_cycles(subject, tmp_path, 3, quick=True, flip=False)
    assert [one.name for one in found] == ["raw 1", "raw 4", "denoised 4"]
    assert {one.runs for one in found} == {3}
    # The reference's own error, two frames of 64 samples that are far from enough, is taken off in squares.
    assert floor > 0.0
    first, second = found[0].errors, found[1].errors
    assert first.relative_mse == pytest.approx((NOISE_E / LEVEL_E) ** 2 / 1.01, rel=0.1)
    assert first.rmse_codes / second.rmse_codes == pytest.approx(2.0, rel=0.1)
    assert (found[0].seconds, found[0].first_s) == ((0.1,), 2.1)


def test_its_reference_is_paid_for_once(subject, blender, tmp_path):
    first, floor = peers.measure_cycles(subject, tmp_path, 1, quick=True, flip=False)
    again, same_floor = peers.measure_cycles(subject, tmp_path, 1, quick=True, flip=False)
    assert [len(settings) for settings in blender] == [4, 3]
    assert floor == same_floor
    assert [one.errors.rmse_codes for one in again] == [one.errors.rmse_codes for one in first]


def test_settings_fall_into_families():
    families = {setting.name: peers.family(setting) for setting in STANDARD_SETTINGS}
    assert families["raw 16"] == "Cycles, raw"
    assert families["denoised 16"] == "Cycles, denoised"
    assert families["clamped denoised 16"] == "Cycles, clamped denoised"
    assert families["Blender's defaults"] == "Cycles, adaptive raw"
    assert families["as BlenderProc"] == "Cycles, adaptive denoised"

"""Notes on frames whose rendering error is above its target, in the result of a build and of a check."""

from __future__ import annotations

import pytest
from stand_in import StandIn

from pepperscene.frame import TARGET_TOLERANCE, Frame, RenderingErrors
from pepperscene.review.check import check_dataset

pytestmark = pytest.mark.usefixtures("empty_scenes")
NOISE_CODES = 8.0


class NoisyLight(StandIn):
    """States a rendering error of half the sensor noise in frames of odd seeds, and a tenth in others."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        frame = super().render(camera, outputs, quality, seed, **others)
        error = NOISE_CODES * (0.5 if seed % 2 else 0.1)
        sampling = {"target": 0.15, "error_codes": error, "noise_codes": NOISE_CODES}
        return Frame(frame.images, {**frame.metadata, "sampling": sampling})


def notes_of(*frames):
    errors = RenderingErrors()
    for frame in frames:
        errors.add(*frame)
    return list(errors.notes())


def test_missed_targets_are_one_note():
    assert notes_of((0.15, 1.2, 8.0), (0.15, 0.15 * TARGET_TOLERANCE * 8.0, 8.0)) == []
    (note,) = notes_of((0.15, 1.2, 8.0), (0.15, 4.0, 8.0), (0.15, 2.4, 8.0), (0.15, 2.4, 4.0))
    assert note == (
        "in 3 of 4 frames the rendering error is above its target of 0.15 times the sensor noise: 0.5 "
        "times (median), at most 4.0 codes of 255; a smaller --target-error takes more samples"
    )


def test_unknown_values_give_no_note():
    for target in (None, "0.15", True, 0.0, float("nan")):
        assert notes_of((target, 4.0, 8.0)) == []
    for error in (None, "4", float("inf"), -1.0):
        assert notes_of((0.15, error, 8.0), (0.15, 4.0, None)) == []


def test_build_and_check_tell_missed_targets(build_small, tmp_path):
    result = build_small("set", "0:12", renderer=NoisyLight)
    missed = [
        index for index in range(12) if result.dataset.metadata(index)["sampling"]["error_codes"] == 4.0
    ]
    assert 0 < len(missed) < 12
    (note,) = result.notes
    assert note.startswith(f"in {len(missed)} of 12 frames the rendering error is above its target of 0.15")
    assert note in check_dataset(tmp_path / "set").notes
    # Frames that exist already count as well, and without a target there is no note.
    again = build_small("set", "0:12", renderer=NoisyLight)
    assert (again.made, again.notes) == ((), result.notes)
    assert build_small("draft", "0:12", renderer=NoisyLight, quality="draft").notes == ()

"""Rendering time against error; settings are interleaved frame by frame, so that other load affects all.

The module also runs as a script, for other variants of Mitsuba: a process keeps the variant that it started
with, so variants cannot be interleaved.
"""

from __future__ import annotations

import json
import math
import os
import statistics
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from pepperscene.bench.image_errors import Errors, Reference, measure_errors
from pepperscene.bench.reference import OnProgress, render_reference
from pepperscene.bench.scenes import SCENES, BenchSubject, load_subject
from pepperscene.bench.settings import ADAPTIVE, NAMED, Setting, settings
from pepperscene.errors import SetupError


@dataclass(frozen=True)
class BenchResult:
    """Times and errors of a setting."""

    scene: str  # name of the benchmark scene
    family: str  # of the setting
    name: str  # of the setting
    effort: Mapping[str, Any]  # values of its quality
    errors: Errors  # of the frame at the subject's camera
    seconds: tuple[float, ...]  # of the timed frames, in the order of the rounds
    first_s: float  # of the first frame with this setting, which compiles kernels
    sampling: Mapping[str, Any] = field(default_factory=dict)  # sampling statistics of the frame
    variant: str = ""  # of Mitsuba

    @property
    def median_s(self) -> float:
        """Median of the timed frames."""
        return statistics.median(self.seconds)

    @property
    def label(self) -> str:
        """Name of the setting in tables, without the family where the name suffices."""
        if self.family.startswith(NAMED):
            target = self.effort.get("target")
            target_text = "" if target is None else f" (target {target:g})"
            return f"{self.name}{target_text}{self.family.removeprefix(NAMED)}"
        return (
            self.name if self.family == ADAPTIVE else f"{self.family.split('pepperscene, ')[-1]}, {self.name}"
        )


def measure_settings(
    subject: BenchSubject,
    settings: Sequence[Setting],
    reference: Reference,
    runs: int,
    *,
    limit_s: float = math.inf,
    on_progress: OnProgress = lambda _: None,
) -> list[BenchResult]:
    """Measure settings on a subject.

    Each setting first renders the frame whose error is measured, which compiles kernels and is not timed.
    Then follow rounds, in which every setting renders one frame. Settings and cameras are shifted against
    each other from round to round, so that no setting is always the first at a view.

    Args:
        subject: scene, cameras, renderers.
        settings: to compare.
        reference: converged image of the subject's camera.
        runs: number of rounds.
        limit_s: approximate time limit. Settings without time for a first frame and a timed one are left
            out, except named qualities. After the first round, the slowest settings are left out of rounds
            that would end late.
        on_progress: receives progress lines.
    """
    measurement = _Measurement(subject, reference, perf_counter() + limit_s, on_progress)
    late = measurement.first_frames(enumerate(settings))
    measurement.round(0)
    # Times without compilation show whether there is time for some of the others after all.
    for _, setting in measurement.first_frames(late):
        on_progress(f"{subject.name}: no time for {setting.family}, {setting.name}")
    measurement.round(0)
    on_progress(f"{subject.name}: round 1 of {runs} done")
    for round_ in range(1, runs):
        measurement.drop_slowest()
        if not any(one.is_active for one in measurement.measured):
            on_progress(f"{subject.name}: no time for more than {round_} of {runs} rounds")
            break
        measurement.round(round_)
        on_progress(f"{subject.name}: round {round_ + 1} of {runs} done")
    return [replace(one.result, seconds=tuple(one.times)) for one in measurement.measured]


@dataclass(eq=False)
class _MeasuredSetting:
    number: int
    setting: Setting
    result: BenchResult  # of the first frame
    times: list[float] = field(default_factory=list)  # of the other frames
    is_active: bool = True  # whether further rounds include it


class _Measurement:
    """First frames and timed frames of settings on a subject, within a time limit."""

    def __init__(
        self, subject: BenchSubject, reference: Reference, end_s: float, on_progress: OnProgress
    ) -> None:
        self.subject, self.reference = subject, reference
        self.end_s, self.on_progress = end_s, on_progress
        self.measured: list[_MeasuredSetting] = []  # by number

    def first_frames(self, settings: Iterable[tuple[int, Setting]]) -> list[tuple[int, Setting]]:
        """Render the frames whose errors are measured; returns the settings that seem to be late."""
        late = []
        for number, setting in settings:
            # One timed frame of this setting and of those that have none yet must follow.
            round_s = sum(one.result.first_s for one in self.measured if not one.times)
            needed_s = round_s + 2.0 * self._expected_seconds(setting)
            if setting.family != NAMED and perf_counter() + needed_s > self.end_s:
                late.append((number, setting))
                continue
            before = perf_counter()
            frame = self.subject.render(setting.quality, 1 + number, full=setting.full_scene)
            first_s = perf_counter() - before
            result = BenchResult(
                self.subject.name,
                setting.family,
                setting.name,
                setting.effort(),
                measure_errors([frame["electrons"]], self.reference),
                (),
                first_s,
                frame.metadata.get("sampling", {}),
                str(frame.metadata.get("variant", "")),
            )
            self.on_progress(f"{self.subject.name}: {result.label}: first frame {first_s:.2f} s")
            self.measured.append(_MeasuredSetting(number, setting, result))
            # A 4k image has 100 MB.
            del frame
        self.measured.sort(key=lambda one: one.number)
        return late

    def _expected_seconds(self, setting: Setting) -> float:
        """Least time of a setting's frame by the measured ones of the same method; 0 if there are none."""
        expected = [
            ratio * min([one.result.first_s, *one.times])
            for one in self.measured
            if (ratio := setting.relative_samples(one.setting)) is not None
        ]
        return min(expected, default=0.0)

    def drop_slowest(self) -> None:
        """Leave the slowest settings out of the following rounds until the next one ends in time."""
        active = sorted((one for one in self.measured if one.is_active), key=lambda one: one.times[-1])
        while active and perf_counter() + sum(one.times[-1] for one in active) > self.end_s:
            slowest = active.pop()
            slowest.is_active = False
            rounds = len(slowest.times)
            self.on_progress(f"{self.subject.name}: {slowest.result.label}: no time after {rounds} rounds")

    def round(self, number_of_round: int) -> None:
        """Render a frame of each active setting that has not had this round."""
        path = self.subject.path
        for one in self.measured:
            if not one.is_active or len(one.times) > number_of_round:
                continue
            # Settings and views are shifted against each other from round to round.
            camera = path[(number_of_round + one.number) % len(path)]
            seed = 1000 * (number_of_round + 1) + one.number
            before = perf_counter()
            self.subject.render(one.setting.quality, seed, camera, full=one.setting.full_scene)
            one.times.append(perf_counter() - before)


def other_variants() -> tuple[str, ...]:
    """The variants that run on this machine, without the one of this process."""
    from pepperscene.render.variant import VARIANTS, choose_variant, variant_name

    available = []
    for name in VARIANTS:
        try:
            available.append(choose_variant(name))
        except SetupError:
            continue
    return tuple(name for name in available if name != variant_name())


def measure_variant(
    variant: str,
    scene: str,
    size: tuple[int, int] | None,
    runs: int,
    references: Path,
    *,
    limit_s: float = math.inf,
) -> list[BenchResult]:
    """Measure the named qualities of a scene with another variant of Mitsuba, in a subprocess.

    `references` is the folder with the cached reference. Each quality exceeds the time limit if it must.

    Raises:
        SetupError: the process failed.
    """
    task = {
        "scene": scene,
        "size": size,
        "runs": runs,
        "references": str(references),
        "limit_s": None if math.isinf(limit_s) else limit_s,
    }
    completed = subprocess.run(
        [sys.executable, "-P", "-m", "pepperscene.bench.measure", json.dumps(task)],
        env={**os.environ, "PEPPERSCENE_VARIANT": variant},
        capture_output=True,
        text=True,
    )
    if completed.returncode:
        last = (completed.stderr.strip().splitlines() or ["no message"])[-1]
        raise SetupError(f"the benchmark process for {variant} failed: {last}")
    return [
        BenchResult(
            **{**result, "errors": Errors.from_json(result["errors"]), "seconds": tuple(result["seconds"])}
        )
        for result in json.loads(completed.stdout.splitlines()[-1])
    ]


def _measure_named(task: dict[str, Any]) -> list[dict[str, Any]]:
    """Measure the named qualities in this process; results as JSON data."""
    start = perf_counter()
    limit_s = math.inf if task["limit_s"] is None else task["limit_s"]
    size = tuple(task["size"]) if task["size"] else None
    subject = load_subject(SCENES[task["scene"]], size, task["runs"])
    # The parent has rendered the reference; the cached one is used as it is.
    reference = render_reference(subject, Path(task["references"]), limit_s=0.0)
    named = [setting for setting in settings() if setting.family == NAMED]
    left_s = limit_s - (perf_counter() - start)
    results = measure_settings(subject, named, reference, task["runs"], limit_s=left_s)
    return [{**asdict(result), "family": f"{NAMED}, {result.variant}"} for result in results]


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure_named(json.loads(sys.argv[1]))) + "\n")

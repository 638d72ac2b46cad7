"""Rendering time against error; settings are interleaved frame by frame, so that other load affects all.

The module also runs as a script, for other variants of Mitsuba: a process keeps the variant that it started
with, so variants cannot be interleaved.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from pepperscene.bench.reference import Errors, OnProgress, Reference, measure_errors, render_reference
from pepperscene.bench.scenes import SCENES, BenchSubject, load_subject
from pepperscene.bench.settings import NAMED, Setting, settings
from pepperscene.errors import SetupError

_FIRST_FRAMES: Final = 0.5
"""Chosen: fraction of a time limit for the first frames; the rest is enough to time each setting once."""


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


def measure_settings(
    subject: BenchSubject,
    settings: Sequence[Setting],
    reference: Reference,
    runs: int,
    *,
    limit_s: float | None = None,
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
        limit_s: approximate time limit. Settings whose first frame would be late are left out; rounds end
            early, after at least one.
        on_progress: receives progress lines.
    """
    start = perf_counter()
    first_frames: list[BenchResult] = []
    for number, setting in enumerate(settings):
        if limit_s is not None and first_frames and perf_counter() - start > _FIRST_FRAMES * limit_s:
            names = "; ".join(f"{skipped.family}, {skipped.name}" for skipped in settings[number:])
            on_progress(f"{subject.name}: no time for {names}")
            break
        before = perf_counter()
        frame = subject.render(setting.quality, 1 + number, full=setting.full_scene)
        first_s = perf_counter() - before
        errors = measure_errors(frame["electrons"], reference.electrons, subject.camera)
        errors = errors.subtract(reference.error_codes, reference.relative_mse)
        on_progress(
            f"{subject.name}: {setting.family}, {setting.name}: {errors.rmse_codes:.2f} codes, "
            f"first frame {first_s:.2f} s"
        )
        first_frames.append(
            BenchResult(
                subject.name,
                setting.family,
                setting.name,
                setting.effort(),
                errors,
                (),
                first_s,
                frame.metadata.get("sampling", {}),
                str(frame.metadata.get("variant", "")),
            )
        )
        # A 4k image has 100 MB.
        del frame

    seconds: list[list[float]] = [[] for _ in first_frames]
    for round_ in range(runs):
        if round_ and limit_s is not None and perf_counter() - start > limit_s:
            on_progress(f"{subject.name}: no time for more than {round_} of {runs} rounds")
            break
        for number, setting in enumerate(settings[: len(first_frames)]):
            camera = subject.path[(round_ + number) % len(subject.path)]
            before = perf_counter()
            subject.render(setting.quality, 1000 * (round_ + 1) + number, camera, full=setting.full_scene)
            seconds[number].append(perf_counter() - before)
        on_progress(f"{subject.name}: round {round_ + 1} of {runs} done")
    return [
        replace(result, seconds=tuple(times)) for result, times in zip(first_frames, seconds, strict=True)
    ]


# --- other variants of Mitsuba ------------------------------------------------------------------------------


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
    variant: str, scene: str, size: tuple[int, int] | None, runs: int, references: Path, *, quick: bool
) -> list[BenchResult]:
    """Measure the named qualities of a scene with another variant, in a subprocess.

    Raises:
        SetupError: the process failed.
    """
    task = {"scene": scene, "size": size, "runs": runs, "references": str(references), "quick": quick}
    completed = subprocess.run(
        [sys.executable, "-m", "pepperscene.bench.measure", json.dumps(task)],
        env={**os.environ, "PEPPERSCENE_VARIANT": variant},
        capture_output=True,
        text=True,
    )
    if completed.returncode:
        last = (completed.stderr.strip().splitlines() or ["no message"])[-1]
        raise SetupError(f"the benchmark process for {variant} failed: {last}")
    return [
        BenchResult(**{**result, "errors": Errors(**result["errors"]), "seconds": tuple(result["seconds"])})
        for result in json.loads(completed.stdout.splitlines()[-1])
    ]


def _measure_named(task: dict[str, Any]) -> list[dict[str, Any]]:
    """Measure the named qualities in this process; results as JSON data."""
    size = tuple(task["size"]) if task["size"] else None
    subject = load_subject(SCENES[task["scene"]], size, task["runs"])
    # The parent has rendered the reference; the cached one is used as it is.
    reference = render_reference(subject, Path(task["references"]), limit_s=0.0)
    named = [setting for setting in settings(quick=task["quick"]) if setting.family == NAMED]
    results = measure_settings(subject, named, reference, task["runs"])
    return [{**asdict(result), "family": f"{NAMED}, {result.variant}"} for result in results]


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure_named(json.loads(sys.argv[1]))) + "\n")

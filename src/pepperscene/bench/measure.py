"""Run time against error: settings take turns frame by frame, so that other load hits all alike."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Final

from pepperscene.bench.reference import Converged, Errors, errors
from pepperscene.bench.scenes import BenchSubject
from pepperscene.bench.settings import Setting

Told = Callable[[str], None]
Clock = Callable[[], float]

_WARM_SHARE: Final = 0.5
"""Chosen: of a time limit, what the first frames may take; the rest is enough to time each of them once."""


@dataclass(frozen=True)
class BenchResult:
    """What a setting took and what came of it.

    Attributes:
        scene: of the bench.
        family, name: of the setting.
        effort: its values.
        errors: of the frame at the subject's own camera.
        seconds: of the timed frames in sequence, in the order of their rounds.
        first_s: of the first frame with this setting: where it compiles.
        sampling: what the frame tells of its sampling.
        variant: of Mitsuba, or the other program.
        peak_mib: most memory of its process, where it has one of its own.
        frames: that were timed, where `seconds` holds their median alone.
    """

    scene: str
    family: str
    name: str
    effort: Mapping[str, Any]
    errors: Errors
    seconds: tuple[float, ...]
    first_s: float
    sampling: Mapping[str, Any] = field(default_factory=dict)
    variant: str = ""
    peak_mib: float | None = None
    frames: int | None = None

    @property
    def runs(self) -> int:
        """How many frames were timed."""
        return len(self.seconds) if self.frames is None else self.frames

    @property
    def median_s(self) -> float:
        """Of the timed frames."""
        return statistics.median(self.seconds)


def measure_settings(
    subject: BenchSubject,
    settings: Sequence[Setting],
    reference: Converged,
    runs: int,
    *,
    flip: bool = True,
    limit_s: float | None = None,
    told: Told = lambda _: None,
    clock: Clock = perf_counter,
) -> list[BenchResult]:
    """Measure settings on a subject.

    Each setting renders the frame whose error is taken, which compiles what it needs and is not timed. Then
    follow rounds: in each of them every setting renders one frame. Settings and cameras are shifted against
    each other from round to round, so that no setting always comes first to a place.

    Args:
        subject: scene, cameras, renderer.
        settings: to compare.
        reference: converged picture of the subject's camera.
        runs: rounds.
        flip: whether to take FLIP, .2 s for 800 x 600.
        limit_s: about how long it may take. Settings whose first frame would come too late are left out;
            rounds end early, but there is one.
        told: is told how it goes.
        clock: gives seconds.
    """
    start = clock()
    firsts: list[tuple[Setting, float, Errors, Mapping[str, Any], str]] = []
    for number, setting in enumerate(settings):
        if limit_s is not None and firsts and clock() - start > _WARM_SHARE * limit_s:
            told(f"{subject.name}: no time for {_names(settings[number:])}")
            break
        before = clock()
        frame = subject.frame(setting.quality, 1 + number, whole=setting.whole)
        took = clock() - before
        found = errors(frame["electrons"], reference.electrons, subject.camera, flip=flip)
        found = found.without(reference.error_codes, reference.relative_mse)
        told(f"{subject.name}: {_name(setting)}: {found.rmse_codes:.2f} codes, first frame {took:.2f} s")
        firsts.append(
            (setting, took, found, frame.metadata.get("sampling", {}), str(frame.metadata.get("variant", "")))
        )
        # A picture of 4k holds 100 MB.
        del frame

    seconds: list[list[float]] = [[] for _ in firsts]
    for turn in range(runs):
        if turn and limit_s is not None and clock() - start > limit_s:
            told(f"{subject.name}: no time for more than {turn} of {runs} rounds")
            break
        for number, (setting, *_) in enumerate(firsts):
            camera = subject.path[(turn + number) % len(subject.path)]
            before = clock()
            subject.frame(setting.quality, 1000 * (turn + 1) + number, camera, whole=setting.whole)
            seconds[number].append(clock() - before)
        told(f"{subject.name}: round {turn + 1} of {runs} done")
    return [
        BenchResult(
            subject.name, setting.family, setting.name, setting.effort(), found, tuple(times), took, facts, by
        )
        for (setting, took, found, facts, by), times in zip(firsts, seconds, strict=True)
    ]


def _name(setting: Setting) -> str:
    return f"{setting.family}, {setting.name}"


def _names(settings: Sequence[Setting]) -> str:
    return "; ".join(_name(setting) for setting in settings)

"""Blender Cycles on the bench's scenes, measured by the same yardsticks against its own converged picture."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.bench.cycles import CyclesRun, available, bpy_python, render_cycles
from pepperscene.bench.cycles_scene import pinhole
from pepperscene.bench.cycles_settings import REFERENCE, STANDARD_SETTINGS, CyclesSetting
from pepperscene.bench.cycles_table import reference_error
from pepperscene.bench.measure import BenchResult, Told
from pepperscene.bench.reference import Errors, errors, read_arrays, relative_mse, write_arrays
from pepperscene.bench.scenes import BenchSubject
from pepperscene.errors import SetupError

CYCLES: Final = "Cycles"

_QUICK: Final = (
    CyclesSetting("raw 1", 1, denoise=False),
    CyclesSetting("raw 4", 4, denoise=False),
    CyclesSetting("denoised 4", 4, denoise=True),
)
_QUICK_REFERENCE: Final = CyclesSetting("reference", 64, denoise=False, frames=2)


def check_peers() -> None:
    """Find out before anything is measured whether Cycles is there.

    Raises:
        SetupError: it is not.
    """
    if not available():
        raise SetupError(
            f"--peers needs bpy, which {bpy_python()} does not have: `pip install bpy` in an "
            "environment of its own, with Python 3.11, and name its Python in PEPPERSCENE_BPY_PYTHON"
        )


def measure_cycles(
    subject: BenchSubject,
    folder: Path,
    runs: int,
    *,
    quick: bool,
    flip: bool = True,
    told: Told = lambda _: None,
) -> tuple[list[BenchResult], float | None]:
    """Cycles' settings on a subject, and the estimated error of its reference in codes (None: not known).

    Args:
        subject: whose scene and camera it renders.
        folder: of the cache, where its converged picture is kept.
        runs: frames of each setting, one after the other; Cycles has a process to itself.
        quick: few and cheap settings.
        flip: whether to take FLIP.
        told: is told how it goes.

    Raises:
        SetupError: there is no bpy, or Blender failed.
        OSError: the cache cannot be written to.
    """
    wanted = _QUICK_REFERENCE if quick else REFERENCE
    asked = _QUICK if quick else STANDARD_SETTINGS
    cache = folder / f"{subject.name}_cycles_{_digest(subject, wanted)}.npz"
    kept = read_arrays(cache)
    told(f"{subject.name}: Cycles, {len(asked)} settings{'' if kept else ' and its reference'}")
    # Its own converged picture is not paid for twice.
    every = asked if kept else (*asked, wanted)
    made = render_cycles(subject.scene, subject.camera, every, folder / f"{subject.name}_cycles", runs)
    if kept is None:
        last = made.pop()
        kept = {
            "electrons": np.asarray(last.mean),
            "error_codes": np.array(reference_error(last, subject.camera)),
            "relative_mse": np.array(_relative(last)),
        }
        write_arrays(cache, **kept)
    reference, own = kept["electrons"], float(kept["error_codes"])
    camera, found = pinhole(subject.camera), []
    for run in made:
        wrong = _mean([errors(image, reference, camera, flip=flip) for image in run.images])
        wrong = wrong.without(own, float(kept["relative_mse"]))
        told(f"{subject.name}: Cycles, {run.setting.name}: {wrong.rmse_codes:.2f} codes, {run.seconds:.2f} s")
        found.append(
            BenchResult(
                scene=subject.name,
                family=family(run.setting),
                name=run.setting.name,
                effort=dataclasses.asdict(run.setting),
                errors=wrong,
                seconds=(run.seconds,),
                first_s=run.seconds + run.fixed_seconds,
                variant=f"Blender {run.blender}",
                peak_mib=run.peak_mib,
                frames=len(run.images),
            )
        )
    return found, own if own == own else None


def family(setting: CyclesSetting) -> str:
    """Which line of the plot a setting belongs to."""
    parts = ["adaptive"] if setting.adaptive is not None else ["clamped"] if setting.clamp else []
    parts.append("denoised" if setting.denoise else "raw")
    return f"{CYCLES}, {' '.join(parts)}"


def _mean(every: Sequence[Errors]) -> Errors:
    """Of several pictures: squares are averaged as squares."""
    return Errors(
        rmse_codes=math.sqrt(statistics.fmean(one.rmse_codes**2 for one in every)),
        relative_mse=statistics.fmean(one.relative_mse for one in every),
        flip=statistics.fmean(one.flip for one in every),
    )


def _relative(run: CyclesRun) -> float:
    """Estimated relative MSE of the mean of a run's frames, from two halves of them; nan for a single one."""
    if len(run.images) < 2:
        return float("nan")
    halves = [run.images[part::2].mean(axis=0, dtype=float) for part in (0, 1)]
    return relative_mse(run.mean + (halves[0] - halves[1]) / 2, run.mean)


def _digest(subject: BenchSubject, setting: CyclesSetting) -> str:
    told = json.dumps(dataclasses.asdict(setting), sort_keys=True)
    return hashlib.sha256(f"{subject.digest()}{told}".encode()).hexdigest()[:20]

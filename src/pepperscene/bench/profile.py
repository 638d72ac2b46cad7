"""Time of a frame by stage, measured in child processes."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from pepperscene.bench.frames_child import PLANT_STAGES, FramesTask
from pepperscene.bench.records import BenchmarkFiles, machine_info, write_results
from pepperscene.bench.reference import OnProgress
from pepperscene.bench.report import time_table
from pepperscene.bench.run import DEFAULT_RUNS, check_arguments
from pepperscene.bench.scenes import SCENES, BenchScene
from pepperscene.building.scenes.row_cache import CACHE
from pepperscene.errors import SetupError

LABELS: Final = ("class", "instance", "distance")

_CHILD: Final = Path(__file__).with_name("frames_child.py")
"""Run as a file: as a module, its package would be imported before its clock starts."""

_START_STAGES: Final = ("import", "start Mitsuba")
"""Stages of a process; all others are stages of a scene."""

_SCENE_STAGES: Final = (
    *_START_STAGES, "plants", "place row and resolve contacts", "cull hidden geometry", "surfaces and sky",
    "kernel scene",
)  # fmt: skip
_FRAME_STAGES: Final = ("trace", "denoise", "develop", "labels", "encode")
_ONE_PROCESS: Final = {"PEPPERSCENE_PROCESSES": "1"}

_START_UP: Final = {
    "python -c pass": ("-c", "pass"),
    "import pepperscene": ("-c", "import pepperscene"),
    "pepperscene --help": ("-m", "pepperscene", "--help"),
}


def profile_frames(
    out: str | Path,
    scenes: Sequence[BenchScene] = tuple(SCENES.values()),
    size: tuple[int, int] | None = None,
    *,
    runs: int = DEFAULT_RUNS,
    quick: bool = False,
    on_progress: OnProgress = lambda _: None,
) -> BenchmarkFiles:
    """Time the stages of first and next frames, labels alone, and start-up; write `profile.*`.

    Arguments and errors are those of `run_benchmark`; no extra is needed. `quick` renders drafts.
    """
    folder = Path(out)
    check_arguments(folder, runs)
    machine, quality = machine_info(), "draft" if quick else "standard"
    chapters: list[str] = []
    profiles = {}
    for scene in scenes:
        task = FramesTask(scene.recipe, dict(scene.changes), scene.index, size, runs, quality=quality)
        profiles[scene.name] = profile = _profile_scene(task, runs, scene.name, on_progress)
        width, height = profile["size"]
        chapters += [
            f"#### {scene.name.capitalize()}",
            f"{width}x{height}, {profile['triangles']:,} triangles, quality `{quality}`, "
            f"{profile['variant']}.",
            time_table(profile["seconds"].items(), "stage"),
            "; ".join(f"{what}: at most {peak:,.0f} MiB" for what, peak in profile["peaks_mib"].items())
            + ".",
        ]
    on_progress("start-up")
    start_up = {
        what: [time_command([sys.executable, "-P", *arguments]) for _ in range(runs)]
        for what, arguments in _START_UP.items()
    }
    chapters += ["#### Start-up", time_table(start_up.items())]
    content = {"scenes": profiles, "start_up": start_up}
    return write_results(folder, "profile", machine, content, chapters)


def run_child(task: FramesTask, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Run one child process and return its measurements; errors as of `run_children`."""
    return run_children([task], environment)[0]


def run_children(
    tasks: Sequence[FramesTask], environment: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """Run several child processes at the same time and return their measurements.

    Raises:
        SetupError: one failed.
    """
    results, errors = [], []
    with ExitStack() as stack:
        processes = []
        for task in tasks:
            process = subprocess.Popen(
                [sys.executable, "-P", str(_CHILD), json.dumps(asdict(task))],
                # Rows that an earlier process has kept would leave nothing to time.
                env={**os.environ, CACHE: "none", **(environment or {})},
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            # The children of a benchmark that is interrupted end with it.
            stack.callback(process.kill)
            processes.append(process)
        for process in processes:
            output, messages = process.communicate()
            if process.returncode:
                errors.append((messages.strip().splitlines() or [f"exit code {process.returncode}"])[-1])
            else:
                results.append(json.loads(output.splitlines()[-1]))
    if errors:
        raise SetupError(f"a benchmark process failed: {errors[0]}")
    return results


def time_command(command: Sequence[str]) -> float:
    """Seconds that a command takes."""
    start = perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    return perf_counter() - start


def _profile_scene(task: FramesTask, runs: int, name: str, on_progress: OnProgress) -> dict[str, Any]:
    """Seconds by stage over several processes, peak memory, and facts about the scene."""
    # The first process is not counted: it warms the caches of the disk and of compiled kernels.
    on_progress(f"{name}: first frame, not counted")
    run_child(replace(task, frames=0))
    children = []
    for number in range(runs):
        on_progress(f"{name}: process {number + 1} of {runs}")
        children.append(run_child(task))
    on_progress(f"{name}: without compiled kernels, and labels alone")
    with tempfile.TemporaryDirectory() as empty:
        # Dr.Jit caches its kernels in the home folder.
        cold = run_child(replace(task, frames=1), {"HOME": empty})
    labels = run_child(replace(task, outputs=LABELS, encode=False))
    on_progress(f"{name}: plants in one process")
    single = [run_child(replace(task, outputs=("class",), frames=0), _ONE_PROCESS) for _ in range(runs)]
    first, second = (frame.get("trace", 0.0) for frame in cold["frames"][:2])
    return {
        "seconds": {
            **_stage_times(children),
            "labels alone, next frames": [frame["labels"] for frame in labels["frames"][1:]],
            "first frame, in addition to a next one: trace, without cached kernels": [first - second],
            **{
                f"all plants in one process: {stage}": [child["plants"][stage] for child in single]
                for stage in PLANT_STAGES
                if stage in single[0]["plants"]
            },
        },
        "peaks_mib": {
            "photographs and labels": max(child["peaks_mib"][-1] for child in children),
            "labels alone": labels["peaks_mib"][-1],
        },
        **{key: children[0][key] for key in ("triangles", "size", "variant")},
    }


def _stage_times(children: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """Times of a new scene, of its first frame, and of the next frames, by stage."""
    next_frames = [frame for child in children for frame in child["frames"][1:]]
    stages = [stage for stage in _FRAME_STAGES if stage in next_frames[0]]
    # Additional time of the first frame: kernels are compiled or loaded, libraries imported.
    additional = {
        stage: [
            child["frames"][0][stage] - statistics.median(frame[stage] for frame in child["frames"][1:])
            for child in children
        ]
        for stage in stages
    }
    per_scene = [
        scene_seconds(child) + sum(times[number] for times in additional.values())
        for number, child in enumerate(children)
    ]
    scene_stages = sorted(children[0]["scene"], key=_SCENE_STAGES.index)
    return {
        **{f"new scene: {stage}": [child["scene"][stage] for child in children] for stage in scene_stages},
        **{f"first frame, in addition to a next one: {stage}": times for stage, times in additional.items()},
        "new scene: total, without import and start": per_scene,
        "from the import to the end of the first frame": [
            sum(child["scene"].values()) + sum(child["frames"][0].values()) for child in children
        ],
        **{f"next frames: {stage}": [frame[stage] for frame in next_frames] for stage in stages},
        "next frames: total": [sum(frame.values()) for frame in next_frames],
    }


def scene_seconds(child: Mapping[str, Any]) -> float:
    """Seconds of a new scene, without the start of the process."""
    return sum(seconds for stage, seconds in child["scene"].items() if stage not in _START_STAGES)

"""Cost of frames as scenes, images and data sets grow, one quantity at a time, in child processes."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, Final

import numpy as np

from pepperscene.bench.frames_child import FramesTask
from pepperscene.bench.profile import run_child, run_children, scene_seconds
from pepperscene.bench.records import BenchmarkFiles, machine_info, write_results
from pepperscene.bench.reference import OnProgress
from pepperscene.bench.report import format_time, markdown_table
from pepperscene.bench.run import DEFAULT_RUNS, check_arguments
from pepperscene.bench.scenes import SCENES, BenchScene
from pepperscene.building.subprocess_rpc import available_cores

_PLANTS: Final = ((1, 0), (3, 0), (4, 3), (7, 6), (14, 12))
"""Plants in the front and the back row."""

_SCALES: Final = (0.25, 0.5, 1.0, 2.0)
"""Factors of the image's width and height, chosen."""

_FRAMES: Final = 40
"""Frames of the run that measures memory growth, chosen."""

_HEADERS: Final = {
    "scene_s": "new scene", "frame_s": "frame", "least_s": "min", "most_s": "max",
    "together_s": "total, with the scene", "each_s": "per frame", "peak_mib": "memory",
    "frames_per_s": "frames/s", "with_start_s": "with start and scene",
}  # fmt: skip

_SLOPES: Final = ("plants", "triangles", "pixels")
"""Quantities whose power is fitted to the time of a frame."""

Row = dict[str, Any]


def measure_scaling(
    out: str | Path,
    scenes: Sequence[BenchScene] = (SCENES["flash"],),
    size: tuple[int, int] | None = None,
    *,
    runs: int = DEFAULT_RUNS,
    quick: bool = False,
    on_progress: OnProgress = lambda _: None,
) -> BenchmarkFiles:
    """Measure cost against plants, triangles, pixels, frames and workers; write `scaling.*`.

    Powers of plants, triangles and pixels are fitted to the time of a frame.

    Arguments and errors as of `run_benchmark`; no extra is needed. `quick` renders fewer, smaller drafts.
    """
    folder = Path(out)
    check_arguments(folder, runs)
    machine, quality = machine_info(), "draft" if quick else "standard"
    chapters: list[str] = []
    measured, slopes = {}, {}
    for scene in scenes:
        task = FramesTask(scene.recipe, dict(scene.changes), scene.index, size, runs, quality=quality)
        # Not counted: it warms the caches of the disk and of compiled kernels.
        first = run_child(replace(task, frames=0))
        task = replace(task, size=tuple(first["size"]))
        measured[scene.name] = tables = {
            **{
                name: _measure_costs(head, tasks, on_progress)
                for name, (head, tasks) in _cost_tasks(task, quick).items()
            },
            "frames": _measure_frames(task, quick, on_progress),
            "workers": _measure_workers(task, on_progress),
        }
        slopes[scene.name] = {name: fit_slope(tables[name], name) for name in _SLOPES}
        chapters.append(f"#### {scene.name.capitalize()}, quality `{quality}`")
        for name, table in tables.items():
            chapters.append(_table(table))
            if name in _SLOPES:
                power = round(slopes[scene.name][name], 2) + 0.0  # no minus sign before 0
                chapters.append(f"The time of a frame grows as {name}^{power:.2f}.")
    content = {"scenes": measured, "slopes": slopes}
    return write_results(folder, "scaling", machine, content, chapters)


def fit_slope(rows: Sequence[Row], quantity: str) -> float:
    """Power of a quantity with which the time of a frame grows: slope of log(time) over log(quantity)."""
    counts = [
        math.prod(map(int, row[quantity].split("x"))) if quantity == "pixels" else row[quantity]
        for row in rows
    ]
    return float(np.polyfit(np.log(counts), np.log([row["frame_s"] for row in rows]), 1)[0])


def _cost_tasks(task: FramesTask, quick: bool) -> dict[str, tuple[str, dict[Any, FramesTask]]]:
    """The head of a column and its values, by quantity.

    There are more plants in both rows, smaller triangles of the same surfaces, and larger images of a view.
    """
    assert task.size is not None
    plants = {}
    for front, back in _PLANTS[:2] if quick else _PLANTS:
        changes = {**task.changes, "row.plants_front": front, "row.plants_back": back}
        plants[front + back] = replace(task, changes=changes)
    pixels = {}
    for scale in _SCALES[:3] if quick else _SCALES:
        width, height = (max(round(length * scale), 1) for length in task.size)
        pixels[f"{width}x{height}"] = replace(task, size=(width, height))
    divided = {4**times: replace(task, divided=times) for times in (0, 1)}
    return {
        "plants": ("plants", plants),
        "triangles": ("divided into", divided),
        "pixels": ("pixels", pixels),
    }


def _measure_costs(quantity: str, tasks: Mapping[Any, FramesTask], on_progress: OnProgress) -> list[Row]:
    """Cost of a scene and of its next frames for each value of a quantity."""
    rows = []
    for value, task in tasks.items():
        on_progress(f"{quantity}: {value}")
        child = run_child(task)
        times = _frame_times(child)[1:]
        rows.append(
            {
                quantity: value,
                "triangles": child["triangles"],
                "scene_s": scene_seconds(child),
                "frame_s": statistics.median(times),
                "least_s": min(times),
                "most_s": max(times),
                "seconds": times,
                "peak_mib": child["peaks_mib"][-1],
            }
        )
    return rows


def _measure_frames(task: FramesTask, quick: bool, on_progress: OnProgress) -> list[Row]:
    """A long sequence: the fixed cost of a scene per frame, and the growth of memory."""
    count = 8 if quick else _FRAMES
    on_progress(f"{count} frames in sequence")
    child = run_child(replace(task, frames=count - 1))
    fixed = sum(child["scene"].values())
    times = _frame_times(child)
    return [
        {
            "frames": frames,
            "together_s": fixed + sum(times[:frames]),
            "each_s": (fixed + sum(times[:frames])) / frames,
            "peak_mib": child["peaks_mib"][frames - 1],
        }
        for frames in sorted({1, 2, 4, 8, count // 2, count})
    ]


def _measure_workers(task: FramesTask, on_progress: OnProgress) -> list[Row]:
    """Several processes at a time with separate frames, up to the number of cores."""
    rows = []
    for workers in sorted({1, 2, available_cores()}):
        on_progress(f"{workers} workers")
        start = perf_counter()
        children = run_children([replace(task, index=task.index + number) for number in range(workers)])
        total = perf_counter() - start
        # The rate while all processes render: without the first frame of each.
        medians = [statistics.median(_frame_times(child)[1:]) for child in children]
        rows.append(
            {
                "workers": workers,
                "frame_s": statistics.median(medians),
                "frames_per_s": sum(1.0 / median for median in medians),
                "with_start_s": total,
                "peak_mib": sum(child["peaks_mib"][-1] for child in children),
            }
        )
    return rows


def _frame_times(child: dict[str, Any]) -> list[float]:
    return [sum(frame.values()) for frame in child["frames"]]


def _table(rows: Sequence[Row]) -> str:
    """Rows with the same keys as Markdown; lists are written to the JSON file only."""
    keys = [key for key, value in rows[0].items() if not isinstance(value, list)]
    cells = [[_format_cell(key, row[key]) for key in keys] for row in rows]
    return markdown_table([_HEADERS.get(key, key) for key in keys], cells, left=0)


def _format_cell(key: str, value: Any) -> str:
    if key == "frames_per_s":
        return f"{value:.2f}"
    if key.endswith("_s"):
        return format_time(value)
    if key == "peak_mib":
        return f"{value:,.0f} MiB"
    return f"{value:,}" if isinstance(value, int) else str(value)

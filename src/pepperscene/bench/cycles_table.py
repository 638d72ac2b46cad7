"""What Cycles takes for which error: all settings on one scene, as JSON and as a Markdown table.

    python -m pepperscene.bench.cycles_table --out FOLDER

Errors are root mean squares of 8-bit codes of the developed, noise-free picture, against Cycles' own
reference; what the reference itself errs by, as the spread of its frames tells, is taken off in squares.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pepperscene.bench.cycles import CyclesRun, render_cycles
from pepperscene.bench.cycles_scene import pinhole
from pepperscene.bench.cycles_settings import REFERENCE, STANDARD_SETTINGS, CyclesSetting
from pepperscene.bench.reference import codes, rms
from pepperscene.bench.scenes import SCENES, resized, scenes_named, size_of
from pepperscene.camera import Camera
from pepperscene.errors import ArgumentError, PepperError


@dataclass(frozen=True)
class Row:
    """A setting's line.

    Attributes:
        setting: which.
        frames: that were rendered.
        seconds: of a frame in a sequence.
        peak_mib: most memory.
        codes: error of one frame, the mean square over its frames; nan for the reference of a single frame.
        energy: mean of the picture over that of the reference, before developing.
    """

    setting: CyclesSetting
    frames: int
    seconds: float
    peak_mib: float
    codes: float
    energy: float


def rows(runs: Sequence[CyclesRun], reference: CyclesRun, camera: Camera) -> list[Row]:
    """The settings' errors against the reference, whose own error is told in its own line.

    Args:
        runs: to be judged; the reference may be among them.
        reference: of Cycles, of two frames or more: of one alone nobody can tell how far it is to be trusted.
        camera: that all were rendered for.
    """
    exact, own = reference.mean, reference_error(reference, camera)
    wanted = codes(exact, pinhole(camera))
    table = []
    for run in runs:
        squares = [rms(codes(image, pinhole(camera)) - wanted) ** 2 for image in run.images]
        error = math.sqrt(max(float(np.mean(squares)) - (own**2 if own == own else 0.0), 0.0))
        energy = float(run.images.mean(dtype=float) / exact.mean(dtype=float))
        found = own if run is reference else error
        table.append(Row(run.setting, len(run.images), run.seconds, run.peak_mib, found, energy))
    return table


def reference_error(reference: CyclesRun, camera: Camera) -> float:
    """RMSE of the mean of a run's frames, in codes, from their spread; nan where there is but one."""
    count = len(reference.images)
    if count < 2:
        return float("nan")
    pictures = np.stack([codes(image, pinhole(camera)) for image in reference.images])
    return float(np.sqrt(pictures.var(axis=0, ddof=1).mean() / count))


def markdown(table: Sequence[Row], reference: CyclesRun, title: str) -> str:
    """The table for a page."""
    lines = [
        f"Cycles (Blender {reference.blender}) on {title}: the first frame of a scene takes "
        f"{reference.fixed_seconds:.1f} s more.",
        "",
        "| setting | s a frame | codes | energy | MiB |",
        "|---|---|---|---|---|",
    ]
    for row in table:
        cells = [f"{row.seconds:.1f}", f"{row.codes:.2f}", f"{row.energy:.4f}", f"{row.peak_mib:.0f}"]
        lines.append(f"| {' | '.join([row.setting.name, *cells])} |")
    return "\n".join([*lines, ""])


def measure(
    scene_name: str,
    size: tuple[int, int] | None,
    folder: Path,
    settings: Sequence[CyclesSetting] = (*STANDARD_SETTINGS, REFERENCE),
    seeds: int = 1,
    threads: int = 0,
) -> str:
    """Renders a bench scene with all settings, writes `cycles.json` and `cycles.md`, and returns the latter.

    Args:
        scene_name: one of the bench's scenes.
        size: of the picture, or None for the camera's own.
        folder: for both, and for what goes to Blender and comes back.
        settings: the last one is the reference.
        seeds: frames of each setting that does not say otherwise.
        threads: of Cycles; 0 are as many as there are.

    Raises:
        InputError: there is no such scene.
        SetupError: there is no bpy, or Blender failed.
    """
    from pepperscene.dataset import FrameRenderer

    (chosen,) = scenes_named(scene_name)
    recipe = chosen.load()
    stage, shot = FrameRenderer(recipe), recipe.plan.frame(chosen.index)
    camera = resized(stage.camera(shot), size)
    runs = render_cycles(stage.scene(shot), camera, settings, folder, seeds, threads=threads)
    reference = runs[-1]
    table = rows(runs, reference, camera)
    title = f"`{chosen.name}`, {camera.width} x {camera.height}, {os.cpu_count()} threads"
    facts = {
        "scene": chosen.name,
        "size": [camera.width, camera.height],
        "blender": reference.blender,
        "machine": platform.processor() or platform.machine(),
        "threads": threads or os.cpu_count(),
        "fixed_seconds": reference.fixed_seconds,
        "rows": [_plain(row) for row in table],
    }
    (folder / "cycles.json").write_text(json.dumps(facts, indent=1))
    (folder / "cycles.md").write_text(markdown(table, reference, title))
    return markdown(table, reference, title)


def _plain(row: Row) -> dict[str, Any]:
    """A line for JSON, which knows no nan."""
    values = {**dataclasses.asdict(row), **dataclasses.asdict(row.setting), "frames": row.frames}
    del values["setting"]
    return {key: None if value != value else value for key, value in values.items()}


def chosen_settings(names: str, reference_s: float) -> list[CyclesSetting]:
    """The standard settings of a list with commas, all where it is empty, and the reference.

    Raises:
        InputError: a name is unknown.
    """
    by_name = {setting.name: setting for setting in STANDARD_SETTINGS}
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in by_name]
    if unknown:
        allowed = f"unknown setting {unknown[0]!r}; allowed are {', '.join(by_name)}"
        raise ArgumentError("settings", allowed)
    return [
        *(by_name[name] for name in (wanted or by_name)),
        dataclasses.replace(REFERENCE, limit_s=reference_s),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m pepperscene.bench.cycles_table")
    parser.add_argument("--out", type=Path, required=True, help="folder of cycles.json and cycles.md")
    parser.add_argument("--scene", default="standard", help=f"one of {', '.join(SCENES)}")
    parser.add_argument("--size", default="", help="WIDTHxHEIGHT; the camera's own by default")
    parser.add_argument("--settings", default="", help="names with commas; all by default")
    parser.add_argument("--seeds", type=int, default=1, help="frames of each setting")
    parser.add_argument("--threads", type=int, default=0, help="of Cycles; all by default")
    parser.add_argument("--reference-s", type=float, default=REFERENCE.limit_s, help="time for the reference")
    given = parser.parse_args(arguments)
    try:
        settings = chosen_settings(given.settings, given.reference_s)
        size = size_of(given.size) if given.size else None
        sys.stdout.write(measure(given.scene, size, given.out, settings, given.seeds, given.threads))
    except PepperError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

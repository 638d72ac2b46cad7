"""Measuring in processes of their own, one after the other or several at a time."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from pepperscene.bench.frames_child import PLANT_STAGES, Asked
from pepperscene.bench.measure import Told
from pepperscene.bench.records import FORMAT, machine_info, plain, sentence, write_all
from pepperscene.bench.run import LEAST_RUNS, BenchmarkFiles, check_arguments
from pepperscene.bench.scenes import SCENES, BenchScene
from pepperscene.bench.tables import time_table
from pepperscene.dataset.store.atomic import canonical_json
from pepperscene.errors import SetupError

_CHILD: Final = Path(__file__).with_name("frames_child.py")
"""Run as a file: as a module, its room would be imported before its clock starts."""


def in_child(asked: Asked, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """What one process found.

    Raises:
        SetupError: it failed.
    """
    return in_children([asked], environment)[0]


def in_children(asked: Sequence[Asked], environment: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """What several processes found that ran at the same time.

    Raises:
        SetupError: one failed.
    """
    running = [
        subprocess.Popen(
            [sys.executable, "-P", str(_CHILD), json.dumps(asdict(one))],
            env={**os.environ, **(environment or {})},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for one in asked
    ]
    found, faults = [], []
    for process in running:
        out, said = process.communicate()
        if process.returncode:
            faults.append((said.strip().splitlines() or [f"exit code {process.returncode}"])[-1])
        else:
            found.append(json.loads(out.splitlines()[-1]))
    if faults:
        raise SetupError(f"a process of the bench failed: {faults[0]}")
    return found


def seconds_of(command: Sequence[str]) -> float:
    """Seconds that a command takes, from its start to its end.

    Raises:
        SetupError: it failed.
    """
    start = perf_counter()
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        raise SetupError(f"{' '.join(command)} failed: {done.stderr.strip()[-200:]}")
    return perf_counter() - start


LABELS: Final = ("class", "instance", "distance")
_FRAME: Final = ("trace", "denoise", "develop", "labels", "encode")
_SCENE: Final = (
    "import", "start Mitsuba", "plants", "place and settle row", "leave out what is not seen",
    "surfaces and sky", "kernel scene",
)  # fmt: skip
_ONE_PROCESS: Final = {"PEPPERSCENE_PROCESSES": "1"}


def profile_frames(
    out: str | Path,
    scenes: Sequence[BenchScene] = tuple(SCENES.values()),
    size: tuple[int, int] | None = None,
    *,
    runs: int = LEAST_RUNS,
    quick: bool = False,
    told: Told = lambda _: None,
) -> BenchmarkFiles:
    """Measure the stages of first and following frames, labels alone, and the start-up; write `profile.*`.

    Args, Raises: as `bench`; no extra is needed. `quick` takes drafts.
    """
    folder = Path(out)
    check_arguments(folder, runs)
    on, quality = machine_info(), "draft" if quick else "standard"
    chapters, found = [sentence(on)], {}
    for scene in scenes:
        asked = Asked(scene.recipe, dict(scene.changes), scene.index, size, runs, quality=quality)
        found[scene.name] = one = _measured(asked, runs, scene.name, told)
        width, height = one["size"]
        chapters += [
            f"#### {scene.name.capitalize()}",
            f"{width}x{height}, {one['triangles']:,} triangles, quality `{quality}`, {one['variant']}.",
            time_table(one["seconds"].items(), "stage"),
            "; ".join(f"{what}: at most {peak:,.0f} MiB" for what, peak in one["peaks_mib"].items()) + ".",
        ]
    told("start-up")
    python = sys.executable
    start_up = {
        what: [seconds_of([python, *command]) for _ in range(runs)]
        for what, command in {
            "python -c pass": ["-c", "pass"],
            "import pepperscene": ["-c", "import pepperscene"],
            "pepperscene --help": ["-m", "pepperscene", "--help"],
        }.items()
    }
    chapters += ["#### Start-up", time_table(start_up.items())]
    markdown = "\n\n".join(chapters) + "\n"
    record = {"format": FORMAT, "machine": on, "scenes": found, "start_up": start_up}
    files = {"profile.json": canonical_json(plain(record)), "profile.md": markdown.encode()}
    return BenchmarkFiles(write_all(folder, files), markdown)


def _measured(asked: Asked, runs: int, name: str, told: Told) -> dict[str, Any]:
    """Seconds by stage over several processes, the peaks of memory, and what the scene was."""
    # One process more than counted: the first warms the disk's cache and that of compiled kernels.
    told(f"{name}: first frame, a run that is not counted")
    in_child(replace(asked, frames=0))
    children = []
    for number in range(runs):
        told(f"{name}: process {number + 1} of {runs}")
        children.append(in_child(asked))
    told(f"{name}: without compiled kernels, and labels alone")
    with tempfile.TemporaryDirectory() as empty:
        # Dr.Jit keeps its kernels below the home folder.
        cold = in_child(replace(asked, frames=1), {"HOME": empty})
    labels = in_child(replace(asked, outputs=LABELS, encode=False))
    told(f"{name}: plants in one process")
    alone = [in_child(replace(asked, outputs=("class",), frames=0), _ONE_PROCESS) for _ in range(runs)]
    return {
        "seconds": {**_by_stage(children), **_of_labels(labels), **_cold(cold), **_of_plants(alone)},
        "peaks_mib": {
            "photographs and labels": max(child["peaks_mib"][-1] for child in children),
            "labels alone": labels["peaks_mib"][-1],
        },
        "triangles": children[0]["triangles"],
        "size": children[0]["size"],
        "variant": children[0]["variant"],
    }


def _by_stage(children: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """Of a new scene, its first frame, and the frames behind it."""
    once = ("import", "start Mitsuba")
    following = [one for child in children for one in child["frames"][1:]]
    held = [what for what in _FRAME if what in following[0]]
    # What the first frame takes longer than those behind it: kernels compiled or loaded, libraries imported.
    on_top = {
        what: [
            child["frames"][0][what] - statistics.median(one[what] for one in child["frames"][1:])
            for child in children
        ]
        for what in held
    }
    per_scene = [
        sum(seconds for what, seconds in child["scene"].items() if what not in once)
        + sum(more[number] for more in on_top.values())
        for number, child in enumerate(children)
    ]
    whole = [sum(child["scene"].values()) + sum(child["frames"][0].values()) for child in children]
    return {
        **{f"new scene: {what}": [child["scene"][what] for child in children] for what in _order(children)},
        **{f"first frame, on top of a next one: {what}": more for what, more in on_top.items()},
        "new scene: all of that, without import and start": per_scene,
        "from the import to the end of the first frame": whole,
        **{f"next frames: {what}": [one[what] for one in following] for what in held},
        "next frames: all of it": [sum(one.values()) for one in following],
    }


def _order(children: Sequence[dict[str, Any]]) -> list[str]:
    """The stages of a scene in the order in which they run."""
    held = children[0]["scene"]
    return [*(what for what in _SCENE if what in held), *(what for what in held if what not in _SCENE)]


def _of_plants(alone: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    return {
        f"all plants in one process: {what}": [child["plants"][what] for child in alone]
        for what in PLANT_STAGES
        if what in alone[0]["plants"]
    }


def _of_labels(labels: dict[str, Any]) -> dict[str, list[float]]:
    return {"labels alone, next frames": [one["labels"] for one in labels["frames"][1:]]}


def _cold(cold: dict[str, Any]) -> dict[str, list[float]]:
    first, second = (frame.get("trace", 0.0) for frame in cold["frames"][:2])
    return {"first frame, on top of a next one: trace, with no kernels on disk": [first - second]}

"""What frames cost as scenes, pictures and data sets grow: one thing at a time, in processes of their own."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from pepperscene.bench.frames_child import Asked
from pepperscene.bench.measure import Told
from pepperscene.bench.profile import in_child, in_children
from pepperscene.bench.records import FORMAT, cores, machine_info, plain, sentence, write_all
from pepperscene.bench.run import LEAST_RUNS, BenchmarkFiles, check_arguments
from pepperscene.bench.scenes import SCENES, BenchScene
from pepperscene.bench.tables import duration
from pepperscene.dataset.store.atomic import canonical_json

_PLANTS: Final = ((1, 0), (3, 0), (4, 3), (7, 6), (14, 12))
"""Front and back row."""

_SHARES: Final = (0.25, 0.5, 1.0, 2.0)
"""Of the picture's width and height."""

_DIVIDED: Final = (0, 1)
"""How often triangles are cut into four."""

_FRAMES: Final = 40
"""Of the run that is watched for growth."""


def measure_scaling(
    out: str | Path,
    scenes: Sequence[BenchScene] = (SCENES["standard"],),
    size: tuple[int, int] | None = None,
    *,
    runs: int = LEAST_RUNS,
    quick: bool = False,
    told: Told = lambda _: None,
) -> BenchmarkFiles:
    """Measure the cost against plants, triangles, pixels, frames and workers; write `scaling.*`.

    Args, Raises: as `bench`; no extra is needed. `quick` takes drafts of fewer and smaller scenes.
    """
    folder = Path(out)
    check_arguments(folder, runs)
    on, quality = machine_info(), "draft" if quick else "standard"
    chapters, found = [sentence(on)], {}
    for scene in scenes:
        asked = Asked(scene.recipe, dict(scene.changes), scene.index, size, runs, quality=quality)
        # Not counted: it warms the disk's cache and that of compiled kernels.
        plainest = in_child(replace(asked, frames=0))
        asked = replace(asked, size=tuple(plainest["size"]))
        found[scene.name] = one = {
            "plants": _plants(asked, quick, told),
            "triangles": _triangles(asked, told),
            "pixels": _pixels(asked, quick, told),
            "frames": _frames(asked, quick, told),
            "workers": _workers(asked, told),
        }
        chapters += [f"#### {scene.name.capitalize()}, quality `{quality}`", *map(_table, one.values())]
    markdown = "\n\n".join(chapters) + "\n"
    record = {"format": FORMAT, "machine": on, "scenes": found}
    files = {"scaling.json": canonical_json(plain(record)), "scaling.md": markdown.encode()}
    return BenchmarkFiles(write_all(folder, files), markdown)


def _plants(asked: Asked, quick: bool, told: Told) -> list[dict[str, Any]]:
    """More plants in both rows."""
    rows = []
    for front, back in _PLANTS[:2] if quick else _PLANTS:
        told(f"{front + back} plants")
        changes = {**asked.changes, "row.plants_front": front, "row.plants_back": back}
        rows.append({"plants": front + back, **_cost(in_child(replace(asked, changes=changes)))})
    return rows


def _triangles(asked: Asked, told: Told) -> list[dict[str, Any]]:
    """The same bodies out of more triangles."""
    rows = []
    for divided in _DIVIDED:
        told(f"each triangle as {4**divided}")
        rows.append({"cut into": 4**divided, **_cost(in_child(replace(asked, divided=divided)))})
    return rows


def _pixels(asked: Asked, quick: bool, told: Told) -> list[dict[str, Any]]:
    """Larger pictures of the same view."""
    assert asked.size is not None
    rows = []
    for share in _SHARES[:3] if quick else _SHARES:
        size = (max(round(asked.size[0] * share), 1), max(round(asked.size[1] * share), 1))
        told(f"{size[0]}x{size[1]} pixels")
        rows.append({"pixels": f"{size[0]}x{size[1]}", **_cost(in_child(replace(asked, size=size)))})
    return rows


def _frames(asked: Asked, quick: bool, told: Told) -> list[dict[str, Any]]:
    """A long run: what the fixed cost of a scene comes to, and whether memory grows."""
    count = 8 if quick else _FRAMES
    told(f"{count} frames in sequence")
    found = in_child(replace(asked, frames=count - 1))
    fixed = sum(found["scene"].values())
    each = [sum(frame.values()) for frame in found["frames"]]
    marks = sorted({1, 2, 4, 8, count // 2, count})
    return [
        {
            "frames": mark,
            "together_s": fixed + sum(each[:mark]),
            "each_s": (fixed + sum(each[:mark])) / mark,
            "peak_mib": found["peaks_mib"][mark - 1],
        }
        for mark in marks
    ]


def _workers(asked: Asked, told: Told) -> list[dict[str, Any]]:
    """As many processes at a time, each with frames of its own, from one to the machine's cores."""
    rows = []
    for workers in sorted({1, 2, cores()}):
        told(f"{workers} workers")
        start = perf_counter()
        parts = [replace(asked, index=asked.index + number) for number in range(workers)]
        found = in_children(parts)
        together = perf_counter() - start
        # The rate while all are at work: frames behind the first of each process.
        rate = sum(1.0 / _median(child) for child in found)
        rows.append(
            {
                "workers": workers,
                "frame_s": statistics.median(_median(child) for child in found),
                "frames_per_s": rate,
                "with_start_s": together,
                "peak_mib": sum(child["peaks_mib"][-1] for child in found),
            }
        )
    return rows


def _cost(found: dict[str, Any]) -> dict[str, Any]:
    """A scene's and a frame's cost, with each time."""
    times = [sum(frame.values()) for frame in found["frames"][1:]]
    once = ("import", "start Mitsuba")
    return {
        "triangles": found["triangles"],
        "scene_s": sum(seconds for what, seconds in found["scene"].items() if what not in once),
        "frame_s": statistics.median(times),
        "least_s": min(times),
        "most_s": max(times),
        "seconds": times,
        "peak_mib": found["peaks_mib"][-1],
    }


def _median(found: dict[str, Any]) -> float:
    return statistics.median(sum(frame.values()) for frame in found["frames"][1:])


_HEADS: Final = {
    "scene_s": "new scene", "frame_s": "frame", "least_s": "least", "most_s": "most",
    "together_s": "together, with the scene", "each_s": "for each", "peak_mib": "memory",
    "frames_per_s": "frames a second", "with_start_s": "with start and scene",
}  # fmt: skip


def _table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows of equal keys as Markdown; lists are for the JSON alone."""
    keys = [key for key, value in rows[0].items() if not isinstance(value, list)]
    lines = [f"| {' | '.join(_HEADS.get(key, key) for key in keys)} |", f"|{'---:|' * len(keys)}"]
    lines += [f"| {' | '.join(_cell(key, row[key]) for key in keys)} |" for row in rows]
    return "\n".join(lines)


def _cell(key: str, value: Any) -> str:
    if key == "frames_per_s":
        return f"{value:.2f}"
    if key.endswith("_s"):
        return duration(value)
    if key == "peak_mib":
        return f"{value:,.0f} MiB"
    return f"{value:,}" if isinstance(value, int) else str(value)

"""Everything that was measured as files: every single time in JSON and CSV, with what it was taken on."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from pepperscene.bench.measuring import Measured
from pepperscene.dataset.atomic import json_bytes, replacing
from pepperscene.errors import OutputError

FORMAT: Final = "pepperscene bench 1"

EFFORT: Final = (
    "integrator",
    "sampler",
    "samples",
    "soft",
    "most",
    "bounces",
    "target",
    "denoise",
    "whole_scene",
    "spp",
)
"""Of a setting, in the table; all of it is in the JSON."""


def row(one: Measured) -> dict[str, Any]:
    """A measurement, ready for JSON; None for what is not known."""
    wrong = one.errors
    return {
        "scene": one.scene,
        "family": one.family,
        "name": one.name,
        "effort": dict(one.effort),
        "rmse_codes": _finite(wrong.rmse_codes),
        "relative_mse": _finite(wrong.relative_mse),
        "flip": _finite(wrong.flip),
        "median_s": one.median_s,
        "seconds": list(one.seconds),
        "first_s": one.first_s,
        "sampling": dict(one.sampling),
        "variant": one.variant,
        "peak_mib": one.peak_mib,
        "runs": one.runs,
    }


def csv_text(measured: Sequence[Measured]) -> str:
    """A line for each setting, its times in the last columns."""
    most = max((len(one.seconds) for one in measured), default=0)
    head = (
        "scene", "family", "name", *EFFORT, "variant", "rmse_codes", "relative_mse", "flip", "median_s",
        "least_s", "most_s", "first_s", "runs", *(f"run_{number + 1}_s" for number in range(most)),
    )  # fmt: skip
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(head)
    for one in measured:
        told = row(one)
        table.writerow(
            [
                *(told[key] for key in ("scene", "family", "name")),
                *(_cell(one.effort.get(key)) for key in EFFORT),
                *(_cell(told[key]) for key in ("variant", "rmse_codes", "relative_mse", "flip", "median_s")),
                min(one.seconds), max(one.seconds), one.first_s, one.runs,
                *one.seconds, *[""] * (most - len(one.seconds)),
            ]
        )  # fmt: skip
    return text.getvalue()


def write_all(folder: Path, files: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Write files into a folder, and only when all are whole let them take their places.

    Raises:
        OutputError: the folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            for name, content in files.items():
                stack.enter_context(replacing(folder / name)).write_bytes(content)
    except OSError as fault:
        raise OutputError(f"{fault.filename or folder}: cannot be written ({fault.strerror})") from None
    return tuple(folder / name for name in files)


def plain(content: Any) -> Any:
    """The content as JSON gives it back: tables, lists, text and finite numbers."""
    return json.loads(json_bytes(_without_nan(content)))


def _without_nan(thing: Any) -> Any:
    if isinstance(thing, Mapping):
        return {str(key): _without_nan(value) for key, value in thing.items()}
    if isinstance(thing, list | tuple):
        return [_without_nan(value) for value in thing]
    return _finite(thing) if isinstance(thing, float) else thing


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _cell(value: Any) -> Any:
    return "" if value is None else value

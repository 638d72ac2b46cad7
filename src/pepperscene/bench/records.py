"""Everything that was measured as files: every single time in JSON and CSV, with what it was taken on."""

from __future__ import annotations

import csv
import datetime
import io
import json
import math
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from pepperscene.bench.measure import BenchResult
from pepperscene.dataset.store.atomic import atomic_write, canonical_json
from pepperscene.errors import OutputError

PACKAGES: Final = (
    "pepperscene", "mitsuba", "drjit", "numpy", "pyoidn", "karellen-llvm-core", "flip-evaluator",
)  # fmt: skip


def machine_info() -> dict[str, Any]:
    """What figures are taken on, ready for JSON."""
    return {
        "date": datetime.date.today().isoformat(),
        "cpu": cpu_model(),
        "cores": cores(),
        "memory_mib": memory_mib(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
        "load_average": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
    }


def sentence(on: dict[str, Any]) -> str:
    """The machine in one sentence for the head of a table."""
    packages = ", ".join(f"{name} {number}" for name, number in on["packages"].items() if number)
    load = on["load_average"]
    return (
        f"On {on['cores']} core{'' if on['cores'] == 1 else 's'} of {on['cpu']}, {on['system']}, "
        f"{on['date']}{f', load average {load[0]:.1f} before' if load else ''}; "
        f"Python {on['python']}, {packages}."
    )


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cpu_model() -> str:
    """The processor's name as the system tells it."""
    told = Path("/proc/cpuinfo")
    if told.is_file():
        for line in told.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def memory_mib() -> int | None:
    """Memory of the machine; None where the system does not tell."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") >> 20
    except (AttributeError, ValueError, OSError):
        return None


def version(package: str) -> str | None:
    """The installed version of a package, or None."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def peak_mib() -> float:
    """The most memory that this process has held at once."""
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


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


def row(one: BenchResult) -> dict[str, Any]:
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


def csv_text(measured: Sequence[BenchResult]) -> str:
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
                stack.enter_context(atomic_write(folder / name)).write_bytes(content)
    except OSError as fault:
        raise OutputError(f"{fault.filename or folder}: cannot be written ({fault.strerror})") from None
    return tuple(folder / name for name in files)


def plain(content: Any) -> Any:
    """The content as JSON gives it back: tables, lists, text and finite numbers."""
    return json.loads(canonical_json(_without_nan(content)))


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

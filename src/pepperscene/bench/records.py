"""The machine that figures were measured on, and result files in JSON and CSV."""

from __future__ import annotations

import csv
import dataclasses
import datetime
import io
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import psutil

from pepperscene.atomic import canonical_json, plain_values, write_files
from pepperscene.bench.measure import BenchResult
from pepperscene.building.subprocess_rpc import available_cores

FORMAT: Final = "pepperscene bench 2"

_PACKAGES: Final = (
    "pepperscene", "mitsuba", "drjit", "numpy", "pyoidn", "karellen-llvm-core", "flip-evaluator",
)  # fmt: skip

_EFFORT: Final = (
    "integrator", "sampler", "samples", "soft", "most", "bounces", "most_bounces", "target", "denoise",
    "whole_scene",
)  # fmt: skip
"""Values of a setting in the CSV file; the JSON file has all of them."""

_ERRORS: Final = (
    "rmse_codes", "rmse_codes_uncertainty", "rmse_codes_limit",
    "relative_mse", "relative_mse_uncertainty", "relative_mse_limit", "flip",
)  # fmt: skip


def machine_info() -> dict[str, Any]:
    """The machine, the versions of the packages and the load, as JSON data."""
    return {
        "date": datetime.date.today().isoformat(),
        "cpu": _cpu_model(),
        "cores": available_cores(),
        "memory_mib": psutil.virtual_memory().total >> 20,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": {name: _package_version(name) for name in _PACKAGES},
        "load_average": list(psutil.getloadavg()),
    }


def describe_machine(machine: Mapping[str, Any]) -> str:
    """The machine in one sentence, as the heading of a table."""
    packages = ", ".join(f"{name} {number}" for name, number in machine["packages"].items() if number)
    cores, load = machine["cores"], machine["load_average"]
    return (
        f"On {cores} core{'' if cores == 1 else 's'} of {machine['cpu']}, {machine['system']}, "
        f"{machine['date']}{f', load average {load[0]:.1f} before' if load else ''}; "
        f"Python {machine['python']}, {packages}."
    )


def peak_memory_mib() -> float:
    """Peak memory of this process so far."""
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def _cpu_model() -> str:
    file = Path("/proc/cpuinfo")
    if file.is_file():
        for line in file.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _package_version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def result_json(result: BenchResult) -> dict[str, Any]:
    """A result as JSON data.

    An error that is not measurable is None; its upper limit is given instead.
    """
    codes, relative = result.errors.codes, result.errors.relative
    return {
        "scene": result.scene,
        "family": result.family,
        "name": result.name,
        "effort": dict(result.effort),
        "rmse_codes": codes.root,
        "rmse_codes_uncertainty": codes.root_uncertainty,
        "rmse_codes_limit": None if codes.is_measurable else codes.root_limit,
        "relative_mse": relative.mean if relative.is_measurable else None,
        "relative_mse_uncertainty": relative.standard_error if relative.is_measurable else None,
        "relative_mse_limit": None if relative.is_measurable else relative.root_limit**2,
        "flip": result.errors.flip,
        "errors": dataclasses.asdict(result.errors),
        "median_s": result.median_s,
        "seconds": list(result.seconds),
        "first_s": result.first_s,
        "sampling": dict(result.sampling),
        "variant": result.variant,
        "runs": len(result.seconds),
    }


def results_csv(results: Sequence[BenchResult]) -> str:
    """Results as CSV, one line a setting, with all its times in the last columns."""
    runs = [f"run_{number + 1}_s" for number in range(max((len(one.seconds) for one in results), default=0))]
    keys = ("variant", *_ERRORS, "median_s", "least_s", "most_s", "first_s", "runs")
    text = io.StringIO()
    heads = ("scene", "family", "name", *_EFFORT, *keys, *runs)
    table = csv.DictWriter(text, heads, extrasaction="ignore", lineterminator="\n")
    table.writeheader()
    for result in results:
        times = dict(zip(runs, result.seconds, strict=False))
        limits = {"least_s": min(result.seconds), "most_s": max(result.seconds)}
        table.writerow({**result.effort, **result_json(result), **limits, **times})
    return text.getvalue()


@dataclass(frozen=True)
class BenchmarkFiles:
    """Results of a benchmark.

    Attributes:
        files: paths of the written files.
        markdown: the tables.
    """

    files: tuple[Path, ...]
    markdown: str


def write_results(
    folder: Path,
    name: str,
    machine: Mapping[str, Any],
    content: Mapping[str, Any],
    chapters: Iterable[str],
    extra_files: Mapping[str, bytes] | None = None,
) -> BenchmarkFiles:
    """Write `name.json`, `name.md` and other files into a folder, all or none.

    The machine, of `machine_info`, is part of the JSON file and the first chapter of the other.

    Raises:
        OutputError: the folder cannot be written.
    """
    markdown = "\n\n".join([describe_machine(machine), *chapters]) + "\n"
    files = {
        f"{name}.json": canonical_json(plain_values({"format": FORMAT, "machine": machine, **content})),
        f"{name}.md": markdown.encode(),
        **(extra_files or {}),
    }
    return BenchmarkFiles(write_files(folder, files), markdown)

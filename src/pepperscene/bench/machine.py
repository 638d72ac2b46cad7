"""What figures were taken on: processor, cores, system, versions, load, day."""

from __future__ import annotations

import datetime
import os
import platform
import sys
from importlib import metadata
from pathlib import Path
from typing import Any, Final

PACKAGES: Final = (
    "pepperscene", "mitsuba", "drjit", "numpy", "pyoidn", "karellen-llvm-core", "flip-evaluator",
)  # fmt: skip


def machine() -> dict[str, Any]:
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

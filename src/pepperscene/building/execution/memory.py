"""The memory that this process may use: of the machine, of its control group, and by `ulimit`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from pepperscene.errors import InputError, SetupError

MEMORY: Final = "PEPPERSCENE_MEMORY"
"""Environment variable: the memory that a build may use ("40 GB"), or "off" for no check."""

_SIZE: Final = re.compile(r"(\d+(?:\.\d+)?) ?([kMGT]?)(i?)B?", re.ASCII | re.IGNORECASE)
_PREFIXES: Final = ("", "k", "m", "g", "t")
_MAX_BYTES: Final = 1e15  # chosen: more than any machine has
_UNLIMITED: Final = 1 << 60
"""Chosen: version 1 of control groups reports the largest page-aligned integer if there is no limit."""

_GROUP_FILES: Final = {
    "cgroup2": ("memory.max", "memory.current"),
    "cgroup": ("memory.limit_in_bytes", "memory.usage_in_bytes"),
}
"""Files with the limit and the usage of a control group, by the type of its file system."""
_GROUP_CACHE: Final = {
    "cgroup2": ("active_file", "inactive_file"),
    "cgroup": ("total_active_file", "total_inactive_file"),
}
"""Lines of its `memory.stat` that are freed when memory is needed: files in the cache."""


@dataclass(frozen=True)
class MemoryLimit:
    """A limit of the memory that further allocations may take.

    Attributes:
        size: bytes.
        reason: what sets the limit, as the end of "are ...".
        is_shared: whether processes of a build share it; False is a limit of the address space of each.
    """

    size: int
    reason: str
    is_shared: bool = True


def memory_limits() -> tuple[MemoryLimit, ...]:
    """All known limits; none where the system reports none, or `MEMORY` is "off".

    Raises:
        InputError: `MEMORY` is neither a size nor "off".
    """
    text = os.environ.get(MEMORY, "").strip()
    if text.lower() == "off":
        return ()
    if text:
        return (MemoryLimit(_parse_size(text), f"allowed by {MEMORY}"),)
    machine = _machine_memory()
    return (*machine, *group_limits(), *_process_limits())


def least(limits: tuple[MemoryLimit, ...], *, is_shared: bool) -> MemoryLimit | None:
    """The smallest limit of one kind, or None."""
    return min((limit for limit in limits if limit.is_shared == is_shared), key=_size, default=None)


def _size(limit: MemoryLimit) -> int:
    return limit.size


def shortage(needed: int, reserved: int, limits: tuple[MemoryLimit, ...]) -> str | None:
    """The figures, as the end of "needs ...", if one process exceeds a limit.

    Args:
        needed: bytes of memory.
        reserved: bytes of address space beyond these.
        limits: to compare with.
    """
    shared, own = (least(limits, is_shared=is_shared) for is_shared in (True, False))
    if shared is not None and needed > shared.size:
        return f"about {format_size(needed)} of memory, and {format_size(shared.size)} are {shared.reason}"
    if own is not None and needed + reserved > own.size:
        space = format_size(needed + reserved)
        return f"about {space} of address space, and {format_size(own.size)} are {own.reason}"
    return None


def format_size(size: float) -> str:
    """Bytes in GB with two or three digits."""
    return f"{size / 1e9:.0f} GB" if size >= 99.5e9 else f"{size / 1e9:.1f} GB"


@contextmanager
def report_memory_errors() -> Iterator[None]:
    """Raise `SetupError` instead of the errors by which Python and the libraries report missing memory."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        raise SetupError(
            "memory ran out; complete frames are kept: use fewer pixels, fewer outputs or fewer plants, or a "
            "machine with more memory"
        ) from None


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that memory ran out; Dr.Jit and Open Image Denoise raise `RuntimeError`."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or "out of memory" in text or "bad_alloc" in text


def _parse_size(text: str) -> int:
    match = _SIZE.fullmatch(text)
    size = 0.0
    if match is not None:
        base = 1024 if match[3] else 1000
        size = float(match[1]) * base ** _PREFIXES.index(match[2].lower())
    if not 1 <= size <= _MAX_BYTES:
        raise InputError(MEMORY, f'must be a size such as "40 GB", or "off", not {text!r}')
    return int(size)


def _machine_memory() -> tuple[MemoryLimit, ...]:
    """Free memory of this machine, or on systems that do not report it, all of it."""
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        available = next(line for line in lines if line.startswith("MemAvailable:"))
        return (MemoryLimit(1024 * int(available.split()[1]), "available on this machine"),)
    with suppress(AttributeError, OSError, ValueError):
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        if size > 0:
            return (MemoryLimit(size, "installed in this machine"),)
    return ()


def group_limits(proc: Path = Path("/proc/self")) -> tuple[MemoryLimit, ...]:
    """What the control groups of a process leave, of versions 1 and 2: its own and all above.

    Args:
        proc: the folder of the process.
    """
    limits = []
    for kind, mount, root, path in _memory_groups(proc):
        # In a container, the group's path can be that of the host, and the mount shows a part of the tree.
        inside = path.relative_to(root) if path.is_relative_to(root) else PurePosixPath()
        for folder in (mount / inside, *(mount / inside).parents):
            if not folder.is_relative_to(mount):
                break
            size = _group_memory(kind, folder)
            if size is not None:
                limits.append(MemoryLimit(size, f"left in the control group {folder}"))
    return tuple(limits)


def _memory_groups(proc: Path) -> Iterator[tuple[str, Path, PurePosixPath, PurePosixPath]]:
    """File system, mount point and its root, and path of each control group that limits memory."""
    try:
        groups = [line.split(":", 2) for line in (proc / "cgroup").read_text().splitlines()]
        mounts = (proc / "mountinfo").read_text().splitlines()
    except OSError:
        return
    # "0::/path" is of version 2, "4:memory:/path" of version 1.
    paths = {
        "cgroup2" if not controllers else "cgroup": PurePosixPath(path)
        for _, controllers, path in (group for group in groups if len(group) == 3)
        if not controllers or "memory" in controllers.split(",")
    }
    for line in mounts:
        before, _, after = line.partition(" - ")
        fields, (kind, *options) = before.split(), after.split() or [""]
        is_memory = kind == "cgroup2" or (kind == "cgroup" and "memory" in options[-1].split(","))
        if is_memory and kind in paths and len(fields) > 4:
            yield kind, Path(fields[4]), PurePosixPath(fields[3]), paths[kind]


def _group_memory(kind: str, folder: Path) -> int | None:
    """Bytes that a control group may still take; None without a limit."""
    try:
        limit, usage = ((folder / name).read_text().strip() for name in _GROUP_FILES[kind])
        if limit == "max" or int(limit) >= _UNLIMITED:
            return None
        used = int(usage)
        with suppress(OSError, ValueError):
            counts = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            used -= sum(int(counts.get(name, 0)) for name in _GROUP_CACHE[kind])
        return max(int(limit) - max(used, 0), 0)
    except (OSError, ValueError):
        return None


def _process_limits() -> tuple[MemoryLimit, ...]:
    """Limits of the address space of one process. Linux ignores RLIMIT_RSS, so it is not one of them."""
    try:
        import resource
    except ImportError:
        return ()
    limits = []
    for name, option in (("RLIMIT_AS", "-v"), ("RLIMIT_DATA", "-d")):
        size = resource.getrlimit(getattr(resource, name))[0] if hasattr(resource, name) else -1
        if size != resource.RLIM_INFINITY and 0 <= size < _UNLIMITED:
            limits.append(MemoryLimit(size, f"allowed by `ulimit {option}`", is_shared=False))
    return tuple(limits)

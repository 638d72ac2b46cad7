"""Choice of the Mitsuba variant and of the LLVM library that it compiles with.

The library is never left to chance: LLVM 14 is refused by Dr.Jit, and LLVM 15 aborts the whole process at the
first kernel ("Cannot select: fmaximum"; x86 gained that instruction's selection in LLVM 17). Dr.Jit reads
`DRJIT_LIBLLVM_PATH` while it is imported, so the choice comes before.
"""

from __future__ import annotations

import functools
import os
import re
import subprocess
import sys
import threading
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from pepperscene.errors import SetupError

VARIANTS: Final = ("cuda_ad_spectral", "llvm_ad_spectral")
"""Usable variants, best first. Scalar variants would call the Python plugins ray by ray."""

OLDEST_LLVM: Final = 17
LLVM_VARIABLE: Final = "DRJIT_LIBLLVM_PATH"
THREADS_VARIABLE: Final = "PEPPERSCENE_THREADS"
_MOST_THREADS: Final = 4096  # chosen: more than any machine's
_LLVM_PACKAGE: Final = "karellen-llvm-core"
_SYSTEM_FOLDERS: Final = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm/lib",
    "/usr/local/opt/llvm/lib",
)
_one_at_a_time = threading.RLock()
_ASK_VERSION: Final = (
    "import ctypes, sys\n"
    "numbers = [ctypes.c_uint() for _ in range(3)]\n"
    "ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*map(ctypes.byref, numbers))\n"
    "print(numbers[0].value)\n"
)


def find_llvm() -> Path | None:
    """The LLVM library to use: the one named by the environment, the installed package's, or the system's.

    Raises:
        SetupError: `DRJIT_LIBLLVM_PATH` names a library that is missing, or is known to abort.
    """
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        return _checked(Path(named))
    for path in (*_packaged(), *_installed()):
        version = llvm_version(path)
        if version is not None and version >= OLDEST_LLVM:
            return path
    return None


def llvm_version(path: Path) -> int | None:
    """The major version of an LLVM library by its file's name, else by asking it in a child process.

    None where there is no telling: no library, or one so old that it cannot be asked.
    """
    found = re.search(r"libLLVM(?:-|\.so\.|\.)(\d+)", path.resolve().name)
    if found:
        return int(found.group(1))
    try:
        answer = subprocess.run(
            [sys.executable, "-c", _ASK_VERSION, str(path)], capture_output=True, text=True, timeout=60
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return int(answer.stdout) if answer.returncode == 0 and answer.stdout.strip().isdigit() else None


def choose_variant(wanted: str | None = None) -> str:
    """The best variant that runs here, after pointing Dr.Jit at a usable LLVM.

    Args:
        wanted: take this one of `VARIANTS` or fail; default `PEPPERSCENE_VARIANT` from the environment.

    Raises:
        SetupError: no variant of `VARIANTS` runs; the message says what to install.
    """
    wanted = wanted or os.environ.get("PEPPERSCENE_VARIANT") or None
    if wanted is not None and wanted not in VARIANTS:
        raise SetupError(f"variant {wanted!r} is not supported; allowed are {', '.join(VARIANTS)}")
    library = find_llvm()
    if library is not None:
        os.environ[LLVM_VARIABLE] = str(library)
    for variant in (wanted,) if wanted else VARIANTS:
        if _runs(variant, library):
            return variant
    raise SetupError(
        f"no usable renderer: {wanted or 'llvm_ad_spectral'} needs "
        + (
            "a CUDA GPU with its driver"
            if wanted == "cuda_ad_spectral"
            else f"LLVM {OLDEST_LLVM} or newer; `pip install {_LLVM_PACKAGE}` brings one on Linux x86-64, "
            f"elsewhere install LLVM and set {LLVM_VARIABLE} to its shared library"
        )
    )


@functools.cache
def mitsuba_modules() -> tuple[Any, Any]:
    """The modules `mitsuba`, with the variant set, and `drjit`.

    All of this room imports the two through this function: a bare `import drjit` would load whichever LLVM
    the system names first.

    Raises:
        SetupError: no JIT variant runs here.
    """
    with _one_at_a_time:
        return _started()


@functools.cache
def _started() -> tuple[Any, Any]:
    variant = choose_variant()
    import drjit
    import mitsuba

    mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    threads = wanted_threads()
    if threads is not None:
        drjit.set_thread_count(threads)
    return mitsuba, drjit


def wanted_threads() -> int | None:
    """How many threads Mitsuba is to work with, as the environment says; None for one on each core.

    Raises:
        SetupError: the environment says no number above 0.
    """
    told = os.environ.get(THREADS_VARIABLE, "").strip()
    if not told:
        return None
    if not (told.isascii() and told.isdigit() and 0 < int(told) <= _MOST_THREADS):
        raise SetupError(f"{THREADS_VARIABLE} = {told!r}: must be a number of threads, 1 to {_MOST_THREADS}")
    return int(told)


def variant_name() -> str:
    """The variant that renders here, for the facts of a frame."""
    return str(mitsuba_modules()[0].variant())


def _checked(path: Path) -> Path:
    """The library named by the environment, unless it is missing or would abort the process."""
    if not path.is_file():
        raise SetupError(f"{LLVM_VARIABLE} = {str(path)!r}: there is no such file")
    version = llvm_version(path)
    if version is None or version < OLDEST_LLVM:
        told = "an unknown version" if version is None else f"version {version}"
        raise SetupError(
            f"{LLVM_VARIABLE} = {str(path)!r}: is {told} of LLVM, which can abort the process; "
            f"version {OLDEST_LLVM} or newer is needed (`pip install {_LLVM_PACKAGE}`)"
        )
    return path


def _packaged() -> list[Path]:
    """The library inside the installed LLVM package, the fully versioned file first."""
    try:
        files = metadata.files(_LLVM_PACKAGE) or []
    except metadata.PackageNotFoundError:
        return []
    found = {Path(str(file.locate())).resolve() for file in files if file.name.startswith("libLLVM.so")}
    return sorted((path for path in found if path.is_file()), key=lambda path: -len(path.name))


def _installed() -> list[Path]:
    """LLVM libraries in the system's folders, newest first."""
    found = [
        path
        for folder in _SYSTEM_FOLDERS
        for path in Path(folder).glob("libLLVM*")
        if path.suffix != ".a" and path.is_file()
    ]
    return sorted(found, key=lambda path: (-(llvm_version(path) or 0), str(path)))


def _runs(variant: str, library: Path | None) -> bool:
    """Whether Dr.Jit can start the variant's backend; LLVM only with a library of our choice."""
    if variant.startswith("llvm") and library is None:
        return False
    import drjit

    if variant.startswith("cuda"):
        return bool(drjit.has_backend(drjit.JitBackend.CUDA))
    loaded = drjit.detail.llvm_version() if drjit.has_backend(drjit.JitBackend.LLVM) else None
    if loaded is not None and loaded[0] < OLDEST_LLVM:
        raise SetupError(
            f"Dr.Jit was imported before pepperscene and runs with LLVM {loaded[0]}, which can "
            f"abort the process; import pepperscene.render first, or set {LLVM_VARIABLE} = {library} "
            f"before Python starts"
        )
    return loaded is not None

"""Choice of the Mitsuba variant and of the LLVM library that it compiles with.

The library is chosen explicitly: Dr.Jit rejects LLVM 14, and LLVM 15 aborts the whole process at the first
kernel ("Cannot select: fmaximum"; x86 got that instruction selection in LLVM 17). Dr.Jit reads
`DRJIT_LIBLLVM_PATH` during its import, so the choice comes before.
"""

from __future__ import annotations

import functools
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from pepperscene.errors import SetupError

VARIANTS: Final = ("cuda_ad_spectral", "llvm_ad_spectral")
"""Usable variants, best first. Scalar variants would call the Python plugins once per ray."""

OLDEST_LLVM: Final = 17
LLVM_VARIABLE: Final = "DRJIT_LIBLLVM_PATH"
THREADS_VARIABLE: Final = "PEPPERSCENE_THREADS"
_MAX_THREADS: Final = 4096  # chosen: more than any machine has
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
_PRINT_LLVM_VERSION: Final = (
    "import ctypes, sys\n"
    "numbers = [ctypes.c_uint() for _ in range(3)]\n"
    "ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*map(ctypes.byref, numbers))\n"
    "print(numbers[0].value)\n"
)


def find_llvm() -> Path | None:
    """Find the LLVM library to use: from the environment, the installed package, or the system's folders.

    Raises:
        SetupError: `DRJIT_LIBLLVM_PATH` names a missing library, or one that is known to abort.
    """
    if named := os.environ.get(LLVM_VARIABLE):
        return _check_named_library(Path(named))
    for path in (*_packaged_libraries(), *_system_libraries()):
        version = llvm_version(path)
        if version is not None and version >= OLDEST_LLVM:
            return path
    return None


def llvm_version(path: Path) -> int | None:
    """Major version of an LLVM library, from its file name or else from the library, in a child process.

    None if it cannot be determined: the file is no library, or a very old one.
    """
    match = re.search(r"libLLVM(?:-|\.so\.|\.)(\d+)", path.resolve().name)
    if match:
        return int(match.group(1))
    try:
        process = subprocess.run(
            [sys.executable, "-c", _PRINT_LLVM_VERSION, str(path)], capture_output=True, text=True, timeout=60
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    printed = process.stdout.strip()
    return int(printed) if process.returncode == 0 and printed.isdigit() else None


def choose_variant(requested: str | None = None) -> str:
    """Choose the best variant that runs on this machine, and set the LLVM library that Dr.Jit will load.

    Args:
        requested: this one of `VARIANTS` and no other; default `PEPPERSCENE_VARIANT` from the environment.

    Raises:
        SetupError: no variant runs; the message says what to install.
    """
    requested = requested or os.environ.get("PEPPERSCENE_VARIANT") or None
    if requested is not None and requested not in VARIANTS:
        raise SetupError(f"variant {requested!r} is not supported; allowed are {', '.join(VARIANTS)}")
    library = find_llvm()
    if library is not None:
        os.environ[LLVM_VARIABLE] = str(library)
    for variant in (requested,) if requested else VARIANTS:
        if _can_run(variant, library):
            return variant
    if requested == "cuda_ad_spectral":
        raise SetupError("no usable renderer: cuda_ad_spectral needs a CUDA GPU with its driver")
    raise SetupError(
        f"no usable renderer: llvm_ad_spectral needs LLVM {OLDEST_LLVM} or newer; on Linux x86-64 run "
        f"`pip install {_LLVM_PACKAGE}`, elsewhere install LLVM and set {LLVM_VARIABLE} to its shared library"
    )


@functools.cache
def mitsuba_modules() -> tuple[Any, Any]:
    """Return the modules `mitsuba`, with the variant set, and `drjit`.

    All code of this package imports them through this function: a plain `import drjit` would load any LLVM
    that the system names first.

    Raises:
        SetupError: no JIT variant runs on this machine.
    """
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
    """Number of Mitsuba's threads from the environment; None for one on each core.

    Raises:
        SetupError: the variable is not a number of threads.
    """
    value = os.environ.get(THREADS_VARIABLE, "").strip()
    if value and not (value.isascii() and value.isdigit() and 0 < int(value) <= _MAX_THREADS):
        raise SetupError(f"{THREADS_VARIABLE} = {value!r}: must be a number of threads, 1 to {_MAX_THREADS}")
    return int(value) if value else None


def variant_name() -> str:
    """The variant in use, for the metadata of a frame."""
    return str(mitsuba_modules()[0].variant())


def _check_named_library(path: Path) -> Path:
    """Reject a library from the environment that is missing or would abort the process."""
    if not path.is_file():
        raise SetupError(f"{LLVM_VARIABLE} = {str(path)!r}: there is no such file")
    version = llvm_version(path)
    if version is None or version < OLDEST_LLVM:
        description = "an unknown version" if version is None else f"version {version}"
        raise SetupError(
            f"{LLVM_VARIABLE} = {str(path)!r}: is {description} of LLVM, which can abort the process; "
            f"version {OLDEST_LLVM} or newer is needed (`pip install {_LLVM_PACKAGE}`)"
        )
    return path


def _packaged_libraries() -> list[Path]:
    """Libraries inside the installed LLVM package, the one with the full version in its name first."""
    try:
        files = metadata.files(_LLVM_PACKAGE) or []
    except metadata.PackageNotFoundError:
        return []
    paths = {Path(str(file.locate())).resolve() for file in files if file.name.startswith("libLLVM.so")}
    return sorted((path for path in paths if path.is_file()), key=lambda path: -len(path.name))


def _system_libraries() -> list[Path]:
    """LLVM libraries in the system's folders, newest first."""
    paths = [
        path
        for folder in _SYSTEM_FOLDERS
        for path in Path(folder).glob("libLLVM*")
        if path.suffix != ".a" and path.is_file()
    ]
    return sorted(paths, key=lambda path: (-(llvm_version(path) or 0), str(path)))


def _can_run(variant: str, library: Path | None) -> bool:
    """Whether Dr.Jit can start the variant's backend; LLVM only with a library that we chose."""
    if variant.startswith("llvm") and library is None:
        return False
    import drjit

    if variant.startswith("cuda"):
        return bool(drjit.has_backend(drjit.JitBackend.CUDA))
    loaded = drjit.detail.llvm_version() if drjit.has_backend(drjit.JitBackend.LLVM) else None
    if loaded is not None and loaded[0] < OLDEST_LLVM:
        raise SetupError(
            f"Dr.Jit was imported before pepperscene and uses LLVM {loaded[0]}, which can abort the process; "
            f"import pepperscene.render first, or set {LLVM_VARIABLE} = {library} before Python starts"
        )
    return loaded is not None

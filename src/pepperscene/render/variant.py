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

VARIANTS: Final = ("llvm_ad_spectral", "cuda_ad_spectral")
"""Usable variants; the first is the default. Scalar variants would call the Python plugins once per ray.

The GPU is used on request only: the guarded tests run on the CPU, and on a GPU a first frame takes longer.
"""

VARIANT_VARIABLE: Final = "PEPPERSCENE_VARIANT"
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
_TIME_LIMIT_S: Final = 60.0  # of this process; chosen: it takes a tenth of a second
_LONGEST_REASON: Final = 300  # characters; chosen: more than any usual error message
LACKS_MEMORY: Final = re.compile("MemoryError|cannot allocate memory|failed to map segment", re.IGNORECASE)
"""Words of Python and of the dynamic loader for too little memory."""


class LlvmExaminationError(SetupError):
    """The process that asks a library for its version could not run, which says nothing about the library."""


def find_llvm() -> Path | None:
    """Find the LLVM library to use: from the environment, the installed package, or the system's folders.

    Raises:
        SetupError: `DRJIT_LIBLLVM_PATH` names a missing library, one that is known to abort, or one whose
            version cannot be determined.
    """
    return _search_llvm()[0]


def llvm_problems() -> tuple[str, ...]:
    """Why libraries could not be examined, if `find_llvm` finds none; a sentence for each. Raises as it."""
    return _search_llvm()[1]


def _search_llvm() -> tuple[Path | None, tuple[str, ...]]:
    """The library to use, and what prevented the examination of others before it."""
    if named := os.environ.get(LLVM_VARIABLE):
        return _check_named_library(Path(named)), ()
    problems: list[str] = []
    for find in (_packaged_libraries, _system_libraries):
        usable: list[tuple[int, Path]] = []
        for path in find():
            try:
                version = llvm_version(path)
            except LlvmExaminationError as error:
                problems.append(str(error))
            else:
                usable += [(version, path)] if version is not None and version >= OLDEST_LLVM else []
        if usable:
            # The newest; of equal ones the first.
            return max(usable, key=lambda library: library[0])[1], tuple(problems)
    return None, tuple(problems)


def llvm_version(path: Path) -> int | None:
    """Major version of an LLVM library, from its file name or else from the library, in a child process.

    None if the file is no library, or a very old one.

    Raises:
        LlvmExaminationError: the child process could not run.
    """
    match = re.search(r"libLLVM(?:-|\.so\.|\.)(\d+)", path.resolve().name)
    if match:
        return int(match.group(1))
    command = [sys.executable, "-P", "-c", _PRINT_LLVM_VERSION, str(path)]
    try:
        process = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_TIME_LIMIT_S
        )
    except OSError as error:
        raise _examination_error(path, error.strerror or str(error)) from None
    except subprocess.TimeoutExpired:
        raise _examination_error(path, f"it did not end within {_TIME_LIMIT_S:g} s") from None
    errors = process.stderr.strip().splitlines() or [""]
    # An error of the operating system or a missing name is the library's fault, all others are not.
    is_library_error = errors[-1].startswith(("OSError", "AttributeError"))
    if process.returncode != 0 and (not is_library_error or LACKS_MEMORY.search(errors[-1])):
        raise _examination_error(path, errors[-1][:_LONGEST_REASON] or f"exit code {process.returncode}")
    printed = process.stdout.strip()
    return int(printed) if process.returncode == 0 and printed.isdigit() else None


def _examination_error(path: Path, reason: str) -> LlvmExaminationError:
    subject = f"the version of the LLVM library {str(path)!r} is unknown"
    return LlvmExaminationError(
        f"{subject}: the process that asks for it could not run, because of: {reason}"
    )


def choose_variant(requested: str | None = None) -> str:
    """Check that the requested variant runs on this machine, and set the LLVM library that Dr.Jit will load.

    Args:
        requested: one of `VARIANTS`; default as for `requested_variant`.

    Raises:
        SetupError: the variant is unknown or does not run; the message says what to install.
    """
    requested = requested or requested_variant()
    if requested not in VARIANTS:
        raise SetupError(f"variant {requested!r} is not supported; allowed are {', '.join(VARIANTS)}")
    library, problems = _search_llvm()
    if library is not None:
        os.environ[LLVM_VARIABLE] = str(library)
    if _can_run(requested, library):
        return requested
    if requested == "cuda_ad_spectral":
        raise SetupError("no usable renderer: cuda_ad_spectral needs a CUDA GPU with its driver")
    if library is not None:
        raise SetupError(
            f"no usable renderer: Dr.Jit cannot load the LLVM library {str(library)!r}; the file is damaged, "
            "or memory or address space (`ulimit -v`) is too small"
        )
    if problems:
        raise SetupError(f"no usable renderer: {'; '.join(problems)}")
    raise SetupError(
        f"no usable renderer: llvm_ad_spectral needs LLVM {OLDEST_LLVM} or newer; on Linux x86-64 "
        f"run `pip install {_LLVM_PACKAGE}`, elsewhere install LLVM and set {LLVM_VARIABLE} to its library, "
        f"or use an NVIDIA GPU with {VARIANT_VARIABLE}=cuda_ad_spectral"
    )


def requested_variant() -> str:
    """The variant that `PEPPERSCENE_VARIANT` names, else the first of `VARIANTS`; neither is checked."""
    return os.environ.get(VARIANT_VARIABLE) or VARIANTS[0]


@functools.cache
def mitsuba_modules() -> tuple[Any, Any]:
    """Return the modules `mitsuba`, with the variant set, and `drjit`.

    All code of this package imports them through this function: a plain `import drjit` would load any LLVM
    that the system names first.

    Raises:
        SetupError: the variant does not run on this machine.
    """
    variant = choose_variant()
    import drjit

    mitsuba = import_mitsuba(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    threads = wanted_threads()
    if threads is not None:
        drjit.set_thread_count(threads)
    return mitsuba, drjit


def import_mitsuba(variant: str) -> Any:
    """Import Mitsuba with a variant; it loads plugins from its own folder alone.

    By default it looks for `plugins/*.so` in the current folder first, and would run what it finds there.
    """
    import mitsuba

    # Its attributes are loaded on first use, so they have no types.
    loaded: Any = mitsuba
    resolver = loaded.file_resolver()
    resolver.clear()
    resolver.append(str(Path(loaded.__file__).parent))
    loaded.set_variant(variant)
    return loaded


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
    """LLVM libraries in the system's folders."""
    return sorted(
        path
        for folder in _SYSTEM_FOLDERS
        for path in Path(folder).glob("libLLVM*")
        if path.suffix != ".a" and path.is_file()
    )


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

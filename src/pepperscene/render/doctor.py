"""Checks of the installation, without risk to the calling process.

Everything that loads native code (Dr.Jit, LLVM, Mitsuba, the denoiser) runs in a child process, because an
unsuitable library does not raise an error but aborts the process. The output of the child and the way it
ended become one line of the report.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from typing import Final

from pepperscene.errors import SetupError
from pepperscene.render.variant import (
    LACKS_MEMORY,
    LLVM_VARIABLE,
    OLDEST_LLVM,
    VARIANT_VARIABLE,
    LlvmExaminationError,
    choose_variant,
    find_llvm,
    import_mitsuba,
    llvm_problems,
    llvm_version,
)
from pepperscene.version import __version__

TIME_LIMIT_S: Final = 120.0
"""Chosen: a first render with kernel compilation takes seconds; two minutes allow for a busy machine."""

_REFLECTANCE: Final = 0.5  # of the sphere in the test render; chosen
_TEST_RENDER: Final = "from pepperscene.render.doctor import render_test_scene; render_test_scene()"
_TEST_DENOISER: Final = (
    "from pepperscene.render.transport.denoise import open_image_denoise\n"
    "with open_image_denoise().Device() as device:\n"
    "    device.commit()\n"
    "    assert device.get_error() is None, device.get_error()\n"
)
_REINSTALL: Final = "reinstall pepperscene with its dependencies: `pip install .` in the checkout"
_INSTALL_LLVM: Final = (
    f"install LLVM {OLDEST_LLVM} or newer (`pip install karellen-llvm-core` on Linux x86-64), "
    f"or set {LLVM_VARIABLE} to another library"
)
_FREE_MEMORY: Final = (
    "free some memory and processor time, or raise the limits on them (`ulimit -a`), and try again"
)


@dataclass(frozen=True)
class Check:
    """The result of one check."""

    what: str  # the subject ("LLVM", "test render")
    found: str  # the result in a few words
    good: bool = True  # False if rendering is impossible, or gives wrong results
    advice: str = ""  # how to fix it; "" if nothing is wrong


@dataclass(frozen=True)
class Diagnosis:
    """The results of all checks, from the interpreter to a rendered image."""

    lines: tuple[Check, ...]

    @property
    def healthy(self) -> bool:
        """Whether all checks passed."""
        return all(line.good for line in self.lines)


def diagnose(*, test_code: str = _TEST_RENDER, time_limit_s: float = TIME_LIMIT_S) -> Diagnosis:
    """Check the installation; takes some seconds, most of them for the test render.

    Args:
        test_code: Python code of the test render's process; it prints what `render_test_scene` prints.
        time_limit_s: after which that process is killed.
    """
    lines = [Check("Python", platform.python_version()), Check("pepperscene", __version__)]
    lines += [_check_package("mitsuba"), _check_package("drjit")]
    llvm = _check_llvm()
    # The cores that this process may use, which can be fewer than the machine has.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    lines += [llvm, Check("cores", str(cores))]
    if llvm.good:
        lines += _check_rendering(_run_child(test_code, time_limit_s))
    else:
        lines.append(Check("test render", "skipped", good=False, advice="fix LLVM first, see above"))
    lines.append(_check_denoiser())
    return Diagnosis(tuple(lines))


def render_test_scene() -> None:
    """Render a matt grey sphere in a uniform sky at 32x32, and print results as one JSON object per line.

    In a uniform sky of radiance L, a convex Lambertian body of reflectance r has the radiance r L everywhere
    (the light that it sends out never meets it again), so the centre of the image must be r times its
    corners. Run it in its own process, which ends if a native library aborts.
    """
    try:
        variant = choose_variant()
    except SetupError as error:
        _print_result(setup=str(error))
        sys.exit(1)
    _print_result(variant=variant)
    import drjit

    _print_result(cuda=bool(drjit.has_backend(drjit.JitBackend.CUDA)))
    _print_result(furnace=_furnace_ratio(variant))


def _print_result(**result: object) -> None:
    """Send a result to the parent process, before the next step, which may be the last."""
    print(json.dumps(result), flush=True)  # noqa: T201


def _furnace_ratio(variant: str) -> float:
    """Radiance of a sphere of `_REFLECTANCE` over that of the uniform sky around it."""
    import numpy as np

    mi = import_mitsuba(variant)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sky": {"type": "constant"},
            "ball": {
                "type": "sphere",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": _REFLECTANCE}},
            },
            "sensor": {
                "type": "perspective",
                "fov": 40.0,
                "to_world": mi.ScalarTransform4f().look_at([0, -5, 0], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 64},
            },
        }
    )
    # The sphere spans 23 of the 40 degrees: the middle 8x8 pixels show it, the corners do not.
    picture = np.asarray(mi.render(scene, seed=0))
    edge = np.r_[0:4, -4:0]
    return float(picture[12:20, 12:20].mean() / picture[np.ix_(edge, edge)].mean())


@dataclass(frozen=True)
class _ChildResult:
    """Exit status and output of a child process."""

    code: int | None  # exit status, negative for a signal; None if it was killed at the time limit
    printed: Mapping[str, object]  # the JSON objects on its standard output, merged
    error: str  # the last line of its standard error

    @property
    def advice(self) -> str:
        """How to make the process succeed."""
        # A process that did not end by itself, or lacked memory, says nothing about the libraries.
        is_starved = self.code is None or LACKS_MEMORY.search(self.error)
        return _FREE_MEMORY if is_starved else _INSTALL_LLVM

    def __str__(self) -> str:
        """The end of the process in words."""
        if self.code is None:
            return self.error
        words = f"failed with exit code {self.code}"
        if self.code < 0:
            names = {number.value: number.name for number in signal.Signals}
            words = f"crashed ({names.get(-self.code, f'signal {-self.code}')})"
        return f"{words}: {self.error}" if self.error else words


def _run_child(code: str, time_limit_s: float = TIME_LIMIT_S) -> _ChildResult:
    """Run Python code in a child process to its end or to the time limit."""
    try:
        child = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, timeout=time_limit_s)
    except OSError as error:
        return _ChildResult(None, {}, f"could not run, because of: {error.strerror or error}")
    except subprocess.TimeoutExpired as error:
        return _ChildResult(None, _parse_json_lines(error.stdout or b""), "no answer within the time limit")
    errors = child.stderr.decode(errors="replace").strip().splitlines()
    return _ChildResult(child.returncode, _parse_json_lines(child.stdout), errors[-1][:300] if errors else "")


def _parse_json_lines(output: bytes) -> dict[str, object]:
    """The JSON objects among the lines of a child's output, merged; other lines are ignored."""
    merged: dict[str, object] = {}
    for line in output.decode(errors="replace").splitlines():
        try:
            item = json.loads(line)
        except ValueError:
            continue
        if isinstance(item, dict):
            merged |= item
    return merged


def _check_rendering(child: _ChildResult) -> list[Check]:
    """Variant, GPU and image, as far as the test render got."""
    printed = child.printed
    lines = []
    if "variant" in printed:
        lines.append(Check("variant", str(printed["variant"])))
    if "cuda" in printed:
        lines.append(Check("GPU", _describe_gpu(str(printed.get("variant")), bool(printed["cuda"]))))

    ratio = printed.get("furnace")
    if child.code == 0 and isinstance(ratio, float):
        # 64 samples on 64 pixels leave well below 1 % of noise; 3 % separates wrong images from correct ones.
        right = abs(ratio / _REFLECTANCE - 1) < 0.03
        result = f"32x32, furnace ratio {ratio:.3f} (expected {_REFLECTANCE})"
        advice = "" if right else f"the renderer gives wrong results on this machine; {_INSTALL_LLVM}"
        lines.append(Check("test render", result, right, advice))
    elif "setup" in printed:
        lines.append(Check("variant", "none", good=False, advice=str(printed["setup"])))
    elif "variant" not in printed:
        lines.append(Check("variant", f"none: {child}", good=False, advice=child.advice))
    else:
        lines.append(Check("test render", str(child), good=False, advice=child.advice))
    return lines


def _describe_gpu(variant: str, is_usable: bool) -> str:
    if not is_usable:
        return "no usable CUDA GPU; using the CPU"
    if variant.startswith("cuda"):
        return "CUDA, in use"
    return f"CUDA, not in use; {VARIANT_VARIABLE}=cuda_ad_spectral renders with it"


def _check_package(name: str) -> Check:
    try:
        return Check(name, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(name, "not installed", good=False, advice=_REINSTALL)


def _check_llvm() -> Check:
    """The library that would be used; one that is known to abort is never loaded, not even by a child."""
    try:
        library = find_llvm()
        version = None if library is None else llvm_version(library)
        problems = llvm_problems() if library is None else ()
    except LlvmExaminationError as error:
        return Check("LLVM", str(error), good=False, advice=_FREE_MEMORY)
    except SetupError as error:
        return Check("LLVM", str(error), good=False, advice=f"unset {LLVM_VARIABLE}, or {_INSTALL_LLVM}")
    if library is None:
        # With the variant of a GPU this is no error; the test render decides.
        return Check("LLVM", "; ".join(problems) or f"no library of version {OLDEST_LLVM} or newer")
    return Check("LLVM", f"{version} ({library})")


def _check_denoiser() -> Check:
    package = _check_package("pyoidn")
    if not package.good:
        return Check("denoiser", "pyoidn is not installed", good=False, advice=_REINSTALL)
    child = _run_child(_TEST_DENOISER)
    if child.code != 0:
        advice = _FREE_MEMORY if child.advice == _FREE_MEMORY else _REINSTALL
        return Check("denoiser", f"pyoidn {package.found} {child}", good=False, advice=advice)
    return Check("denoiser", f"Open Image Denoise, pyoidn {package.found}")

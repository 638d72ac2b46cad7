"""What this machine has and lacks for rendering, found out without risk to the calling process.

Whatever loads native code (Dr.Jit, LLVM, Mitsuba, the denoiser) runs in a child process, because an
unsuitable library does not raise, it aborts. What the child said before its end, and how it ended, become one
clear line.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Final

from pepperscene.errors import SetupError
from pepperscene.render.variant import LLVM_VARIABLE, OLDEST_LLVM, find_llvm, llvm_version
from pepperscene.version import __version__

OLDEST_PYTHON: Final = (3, 11)
SMOKE_LIMIT_S: Final = 120.0
"""Chosen: a first render with kernel compilation takes seconds; two minutes forgive a loaded machine."""

_GREY: Final = 0.5
"""Reflectance of the sphere in the smoke render; chosen."""

_SMOKE: Final = (sys.executable, "-c", "from pepperscene.render.doctor import smoke_render; smoke_render()")
_DENOISER: Final = (
    sys.executable,
    "-c",
    "import pyoidn\n"
    "with pyoidn.Device() as device:\n"
    "    device.commit()\n"
    "    assert device.get_error() is None, device.get_error()\n",
)
_REINSTALL: Final = "install pepperscene again with all it depends on: `pip install .` in the checkout"


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes:
        what: the thing looked at ("LLVM", "smoke render").
        found: what there is, in a few words.
        good: False when rendering cannot work, or not as documented.
        advice: what to do about it; "" when all is well.
    """

    what: str
    found: str
    good: bool = True
    advice: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All findings, from the interpreter up to a rendered picture."""

    lines: tuple[Check, ...]

    @property
    def healthy(self) -> bool:
        """Whether nothing is amiss."""
        return all(line.good for line in self.lines)


def diagnose(*, smoke_command: Sequence[str] = _SMOKE, limit_s: float = SMOKE_LIMIT_S) -> Diagnosis:
    """Examine the machine; takes some seconds, most of them for the smoke render.

    Args:
        smoke_command: the child process to run as smoke render; it reports like `smoke_render` does.
        limit_s: seconds after which that child is given up.
    """
    # What stands in files and in the operating system's tables needs no child.
    lines = [_python(), Check("pepperscene", __version__), _package("mitsuba"), _package("drjit")]
    llvm = _llvm()
    lines += [llvm, _cores()]

    # A library that is known to abort is never loaded, not even by the child.
    if llvm.good:
        lines += _rendering(_run(smoke_command, limit_s))
    else:
        lines.append(Check("smoke render", "not tried", good=False, advice="mend LLVM first, see above"))
    lines.append(_denoiser())
    return Diagnosis(tuple(lines))


def smoke_render() -> None:
    """Render a matt grey sphere in a uniform sky at 32x32 and print what was found, one JSON object a line.

    In a uniform sky of radiance L a convex Lambertian body of reflectance r has the radiance r L everywhere
    (the light that it sends out never meets it again), so that the centre of the picture must be r times its
    corners. Meant to be run in a process of its own; a native library that aborts ends that process.
    """
    from pepperscene.render.variant import choose_variant

    try:
        variant = choose_variant()
    except SetupError as fault:
        _report(setup=str(fault))
        sys.exit(1)
    _report(variant=variant)
    import drjit

    _report(cuda=bool(drjit.has_backend(drjit.JitBackend.CUDA)))
    _report(furnace=_furnace_ratio(variant))


def _report(**found: object) -> None:
    """Tell the parent process, before the next step, which may be the last."""
    print(json.dumps(found), flush=True)  # noqa: T201


def _furnace_ratio(variant: str) -> float:
    """Radiance of a sphere of reflectance `_GREY` over that of the uniform sky around it."""
    import mitsuba as mi
    import numpy as np

    mi.set_variant(variant)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sky": {"type": "constant"},
            "ball": {
                "type": "sphere",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": _GREY}},
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
    # The sphere spans 23 of the 40 degrees: the middle 8x8 pixels see it, the corners do not.
    picture = np.asarray(mi.render(scene, seed=0))
    edge = np.r_[0:4, -4:0]
    corners = picture[np.ix_(edge, edge)]
    return float(picture[12:20, 12:20].mean() / corners.mean())


@dataclass(frozen=True)
class _Ending:
    """How a child process ended, and what it said.

    Attributes:
        code: exit status, negative for a signal; None when it was given up or could not start.
        found: the JSON objects on its standard output, merged.
        complaint: the last line of its standard error.
    """

    code: int | None
    found: Mapping[str, object]
    complaint: str


def _run(command: Sequence[str], limit_s: float) -> _Ending:
    """Run a child to its end or to the time limit."""
    try:
        done = subprocess.run(
            list(command), capture_output=True, text=True, errors="replace", timeout=limit_s
        )
    except subprocess.TimeoutExpired as late:
        said = late.stdout or b""
        return _Ending(None, _reported(said if isinstance(said, str) else said.decode(errors="replace")), "")
    except OSError as fault:
        return _Ending(None, {}, str(fault))
    complaint = done.stderr.strip().splitlines()
    return _Ending(done.returncode, _reported(done.stdout), complaint[-1][:300] if complaint else "")


def _reported(text: str) -> dict[str, object]:
    """The JSON objects among the lines of a child's output, merged; other lines are passed over."""
    found: dict[str, object] = {}
    for line in text.splitlines():
        try:
            item = json.loads(line)
        except ValueError:
            continue
        if isinstance(item, dict):
            found |= item
    return found


def _how(ending: _Ending) -> str:
    """A child's end in words."""
    if ending.code is None:
        return ending.complaint or "no answer within the time limit"
    if ending.code < 0:
        try:
            name = signal.Signals(-ending.code).name
        except ValueError:
            name = f"signal {-ending.code}"
        words = f"crashed ({name})"
    else:
        words = f"failed with exit code {ending.code}"
    return f"{words}: {ending.complaint}" if ending.complaint else words


def _rendering(ending: _Ending) -> list[Check]:
    """Variant, GPU and picture, as far as the smoke child came."""
    found = ending.found
    lines = []
    if "variant" in found:
        lines.append(Check("variant", str(found["variant"])))
    if "cuda" in found:
        lines.append(Check("GPU", "CUDA, usable" if found["cuda"] else "no usable CUDA GPU; the CPU renders"))

    ratio = found.get("furnace")
    if ending.code == 0 and isinstance(ratio, float):
        # 64 samples on 64 pixels leave well below 1 % of noise; 3 % tells a wrong picture from a right one.
        right = abs(ratio / _GREY - 1) < 0.03
        told = f"32x32, furnace ratio {ratio:.3f} (expected {_GREY})"
        advice = "" if right else f"the renderer computes wrongly here; {_llvm_advice()}"
        lines.append(Check("smoke render", told, right, advice))
    elif "setup" in found:
        lines.append(Check("variant", "none", good=False, advice=str(found["setup"])))
    elif "variant" not in found:
        lines.append(Check("variant", f"none: {_how(ending)}", good=False, advice=_llvm_advice()))
    else:
        lines.append(Check("smoke render", _how(ending), good=False, advice=_llvm_advice()))
    return lines


def _python() -> Check:
    good = sys.version_info >= OLDEST_PYTHON
    wanted = ".".join(map(str, OLDEST_PYTHON))
    return Check(
        "Python", platform.python_version(), good, "" if good else f"install Python {wanted} or newer"
    )


def _package(name: str) -> Check:
    try:
        return Check(name, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(name, "not installed", good=False, advice=_REINSTALL)


def _llvm() -> Check:
    """The library that would be used; found by name, or asked in a child process, never loaded here."""
    try:
        library = find_llvm()
    except SetupError as fault:
        return Check("LLVM", str(fault), good=False, advice=f"unset {LLVM_VARIABLE}, or {_llvm_advice()}")
    if library is None:
        # With a CUDA GPU this is no fault; the smoke child decides.
        return Check("LLVM", f"no library of version {OLDEST_LLVM} or newer")
    return Check("LLVM", f"{llvm_version(library)} ({library})")


def _llvm_advice() -> str:
    return (
        f"install LLVM {OLDEST_LLVM} or newer (`pip install karellen-llvm-core` on Linux x86-64), "
        f"or name another library in {LLVM_VARIABLE}"
    )


def _cores() -> Check:
    """The cores that this process may use, which can be fewer than the machine has."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return Check("cores", str(count))


def _denoiser() -> Check:
    version = _package("pyoidn")
    if not version.good:
        return Check("denoiser", "pyoidn is not installed", good=False, advice=_REINSTALL)
    ending = _run(_DENOISER, SMOKE_LIMIT_S)
    if ending.code != 0:
        return Check("denoiser", f"pyoidn {version.found} {_how(ending)}", good=False, advice=_REINSTALL)
    return Check("denoiser", f"Open Image Denoise, pyoidn {version.found}")

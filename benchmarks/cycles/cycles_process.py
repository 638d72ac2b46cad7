"""Render a scene with Blender Cycles: the same meshes, camera and light, through `bpy` in a child process.

The differences are listed in `cycles_scene` (three channels instead of spectra) and here:

- The flash's discs are one rectangle with the same variance of position; the beam profile is the same.
- Colours, with the patterns of veins, are taken at the vertices; relief is left out. Both save time.
- The cuticle is Cycles' Principled BSDF. Its diffuse part is constant with angle, while ours gets darker
  towards grazing angles (Kelemen & Szirmay-Kalos 2001): seen along the flash, glossy surfaces are a few
  per cent darker.
- The lens has no distortion; the sun's disc itself is not visible.

So the errors of Cycles are measured against its own converged image, never against ours.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from cycles_scene import CyclesScene, export_scene
from cycles_settings import CyclesSetting
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.errors import SetupError
from pepperscene.scene import Scene

PYTHON_VARIABLE: Final = "PEPPERSCENE_BPY_PYTHON"
"""Environment variable with a Python that has bpy: bpy 4.5 needs Python 3.11 and NumPy 1, we need NumPy 2."""

_CHILD: Final = Path(__file__).with_name("blender_main.py")


@dataclass(frozen=True, eq=False)
class CyclesRun:
    """Frames of one setting.

    Attributes:
        setting: of Cycles.
        seconds: of each frame in sequence, with the scene and its BVH in memory.
        fixed_seconds: additional time of the first frame of a scene.
        peak_mib: peak memory of the process while the setting was rendered.
        images: `(n, h, w, 3)` float32 expected electrons of the frames, each with a different seed.
        blender: version.
    """

    setting: CyclesSetting
    seconds: tuple[float, ...]
    fixed_seconds: float
    peak_mib: float
    images: NDArray[np.float32]
    blender: str


def bpy_python() -> str:
    """The Python to run bpy with: from the environment variable, or else this one."""
    return os.environ.get(PYTHON_VARIABLE) or sys.executable


def has_bpy() -> bool:
    """Whether that Python has bpy; it is not imported."""
    code = "import sys, importlib.util as u; sys.exit(0 if u.find_spec('bpy') else 1)"
    try:
        return subprocess.run([bpy_python(), "-P", "-c", code], capture_output=True).returncode == 0
    except OSError:
        return False


def render_cycles(
    scene: Scene,
    camera: Camera,
    settings: Sequence[CyclesSetting],
    folder: Path,
    frames: int = 1,
    threads: int = 0,
) -> list[CyclesRun]:
    """Render a view with each of the settings, in one process.

    Args:
        scene: with surfaces.
        camera: with a sensor of three channels; lens distortion is ignored.
        settings: in the order of rendering.
        folder: for the files exchanged with Blender; created if missing.
        frames: of each setting that does not have its own number.
        threads: of Cycles; 0 uses all cores.

    Raises:
        SetupError: bpy is missing, or Blender failed.
        ValueError: Cycles cannot render the scene or the sensor.
    """
    if not has_bpy():
        raise SetupError(
            f"Cycles needs bpy, which {bpy_python()} does not have: install bpy into an environment of its "
            f"own with Python 3.11, and set {PYTHON_VARIABLE} to its Python"
        )
    exported = export_scene(scene, camera)
    folder.mkdir(parents=True, exist_ok=True)
    _write(exported, settings, folder, frames, threads)
    command = [bpy_python(), "-P", str(_CHILD), str(folder)]
    with (folder / "blender.log").open("w") as log:
        done = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT)
    if done.returncode:
        lines = (folder / "blender.log").read_text(errors="replace").strip().splitlines()
        last = lines[-1] if lines else "no message"
        raise SetupError(f"Blender failed, see {folder / 'blender.log'}: {last}")
    return _read(exported, camera, settings, folder)


def _write(
    exported: CyclesScene, settings: Sequence[CyclesSetting], folder: Path, frames: int, threads: int
) -> None:
    np.savez(folder / "scene.npz", **exported.arrays)
    (folder / "scene.json").write_text(json.dumps(exported.facts))
    values = [{**dataclasses.asdict(setting), "frames": setting.frames or frames} for setting in settings]
    (folder / "settings.json").write_text(json.dumps({"settings": values, "threads": threads}))


def _read(
    exported: CyclesScene, camera: Camera, settings: Sequence[CyclesSetting], folder: Path
) -> list[CyclesRun]:
    results: dict[str, Any] = json.loads((folder / "results.json").read_text())
    runs = []
    for number, (setting, result) in enumerate(zip(settings, results["settings"], strict=True)):
        files = [folder / f"picture_{number}_{frame}.npy" for frame in range(len(result["seconds"]))]
        images = np.stack([exported.electrons(np.load(file), camera) for file in files]).astype(np.float32)
        runs.append(
            CyclesRun(
                setting,
                tuple(result["seconds"]),
                results["fixed_s"],
                result["peak_mib"],
                images,
                results["blender"],
            )
        )
    return runs

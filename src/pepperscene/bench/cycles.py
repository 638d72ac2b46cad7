"""Blender Cycles as a peer: the same meshes, camera and light, through `bpy` in a process of its own.

What differs, and by how much, is told in `pepperscene.bench.cycles_scene` (three channels instead of spectra)
and here:

- The flash's discs are one rectangle with the same variance of place; the beam's profile is the same.
- Colours, with the patterns of veins, are taken at the vertices; the relief is left out. Both save time.
- The cuticle is Cycles' Principled BSDF, whose diffuse part leaves evenly where ours is dimmed towards
  grazing (Kelemen & Szirmay-Kalos 2001): seen along the flash, glossy bodies are a few per cent darker.
- The lens has no distortion; the sun's disc itself is not seen.

So Cycles' errors are taken against Cycles' own converged picture, never against ours.
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
from numpy.typing import NDArray

from pepperscene.bench.cycles_scene import CyclesScene, exported
from pepperscene.bench.cycles_settings import CyclesSetting
from pepperscene.camera import Camera
from pepperscene.errors import SetupError
from pepperscene.scene import Scene

PYTHON_VARIABLE: Final = "PEPPERSCENE_BPY_PYTHON"
"""Environment variable with the Python that has bpy. It can hardly be this one: bpy 4.5 runs on Python 3.11
alone and asks for NumPy below 2."""

_CHILD: Final = Path(__file__).with_name("cycles_child.py")


@dataclass(frozen=True, eq=False)
class CyclesRun:
    """What a setting gave.

    Attributes:
        setting: which.
        seconds: of a frame in a sequence, the median: scene and tree of triangles are held in memory.
        fixed_seconds: what the first frame of a scene takes on top.
        peak_mib: most memory of the process while the setting was rendered, Blender's own included.
        images: `(n, h, w, 3)` float32 expected electrons of its frames, each with a seed of its own.
        blender: version.
    """

    setting: CyclesSetting
    seconds: float
    fixed_seconds: float
    peak_mib: float
    images: NDArray[np.float32]
    blender: str

    @property
    def image(self) -> NDArray[np.float32]:
        """`(h, w, 3)` of the first frame."""
        return np.asarray(self.images[0])

    @property
    def mean(self) -> NDArray[np.float32]:
        """`(h, w, 3)` over all frames: for a reference."""
        return np.asarray(self.images.mean(axis=0, dtype=float), np.float32)


def bpy_python() -> str:
    """The Python that is asked for bpy: the environment variable's, or else this one."""
    return os.environ.get(PYTHON_VARIABLE) or sys.executable


def available(python: str | None = None) -> bool:
    """Whether a Python (`bpy_python()` unless told) has bpy; it is looked for, not loaded."""
    look = "import sys, importlib.util as u; sys.exit(0 if u.find_spec('bpy') else 1)"
    try:
        return subprocess.run([python or bpy_python(), "-P", "-c", look], capture_output=True).returncode == 0
    except OSError:
        return False


def render_cycles(
    scene: Scene,
    camera: Camera,
    settings: Sequence[CyclesSetting],
    folder: Path,
    seeds: int = 1,
    *,
    python: str | None = None,
    threads: int = 0,
) -> list[CyclesRun]:
    """The view in Cycles with each of the settings, in one process.

    Args:
        scene: with surfaces.
        camera: with a sensor of three channels; its lens' distortion is left out.
        settings: in the order to render.
        folder: for what goes to Blender and comes back; made where it is not there.
        seeds: frames of each setting that does not say otherwise.
        python: that has bpy; `bpy_python()` unless told.
        threads: of Cycles; 0 are as many as there are.

    Raises:
        SetupError: there is no bpy, or Blender failed.
        ValueError: the scene or the sensor is nothing for Cycles.
    """
    python = python or bpy_python()
    if not available(python):
        raise SetupError(
            f"Cycles needs bpy, which {python} does not have: install bpy into an environment of its own "
            f"with Python 3.11 and name its Python in {PYTHON_VARIABLE}"
        )
    peer = exported(scene, camera)
    folder.mkdir(parents=True, exist_ok=True)
    _write(peer, settings, folder, seeds, threads)
    with (folder / "blender.log").open("w") as log:
        done = subprocess.run([python, "-P", str(_CHILD), str(folder)], stdout=log, stderr=subprocess.STDOUT)
    if done.returncode:
        raise SetupError(f"Blender failed; its last words in {folder / 'blender.log'}: {_last_words(folder)}")
    return _read(peer, camera, settings, folder)


def _write(
    peer: CyclesScene, settings: Sequence[CyclesSetting], folder: Path, seeds: int, threads: int
) -> None:
    np.savez(folder / "scene.npz", **peer.arrays)  # type: ignore[arg-type]
    (folder / "scene.json").write_text(json.dumps(peer.facts))
    asked = [{**dataclasses.asdict(one), "frames": one.frames or seeds} for one in settings]
    (folder / "settings.json").write_text(json.dumps({"settings": asked, "threads": threads}))


def _read(
    peer: CyclesScene, camera: Camera, settings: Sequence[CyclesSetting], folder: Path
) -> list[CyclesRun]:
    results: dict[str, Any] = json.loads((folder / "results.json").read_text())
    runs = []
    for number, (setting, found) in enumerate(zip(settings, results["settings"], strict=True)):
        pictures = [np.load(folder / f"picture_{number}_{frame}.npy") for frame in range(found["frames"])]
        images = np.stack([peer.electrons(picture, camera) for picture in pictures]).astype(np.float32)
        runs.append(
            CyclesRun(
                setting, found["seconds"], results["fixed_s"], found["peak_mib"], images, results["blender"]
            )
        )
    return runs


def _last_words(folder: Path) -> str:
    lines = (folder / "blender.log").read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else "none"

"""Runs inside Blender (`bpy`): builds the scene that lies in a folder, renders it, leaves pictures and times.

    python -P cycles_child.py FOLDER

A script of its own, which imports NumPy and `bpy` and nothing of the program: bpy is tied to one version of
Python and to an old NumPy, and lives in an environment of its own. The folder holds `scene.npz`,
`scene.json` and `settings.json`; pictures come back as `picture_<setting>_<frame>.npy`, the rest as
`results.json`.
"""

from __future__ import annotations

import gc
import importlib.util
import json
import os
import resource
import statistics
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

_WARM = {"name": "warm", "spp": 1, "denoise": False, "bounces": 8}
_SEEDS = 1000  # chosen: apart, so that no setting shares its samples with the reference


def main(folder: Path) -> None:
    """Builds, renders, and writes what `pepperscene.bench.cycles` reads."""
    bpy = importlib.import_module("bpy")
    facts = json.loads((folder / "scene.json").read_text())
    asked = json.loads((folder / "settings.json").read_text())
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _fixed_settings(bpy, facts["camera"], asked["threads"])
    with np.load(folder / "scene.npz") as arrays:
        _beside("cycles_build").build(bpy, arrays, facts)
    gc.collect()

    # The first frame carries over the scene and builds the tree of its triangles, the second does not.
    _set(bpy, _WARM)
    first, second = _rendered(bpy, 0), _rendered(bpy, 1)
    results: dict[str, Any] = {
        "blender": bpy.app.version_string,
        "first_s": first,
        "fixed_s": max(first - second, 0.0),
        "settings": [],
    }
    for number, setting in enumerate(asked["settings"]):
        _forget_peak()
        _set(bpy, {**setting, "spp": 1})
        _rendered(bpy, 0)  # loads the denoiser, takes over what has changed
        _set(bpy, setting)
        seconds: list[float] = []
        while not _enough(seconds, setting):
            seconds.append(_rendered(bpy, _SEEDS * (number + 1) + len(seconds)))
            np.save(folder / f"picture_{number}_{len(seconds) - 1}.npy", _picture(bpy, folder))
        results["settings"].append(
            {"seconds": statistics.median(seconds), "frames": len(seconds), "peak_mib": _peak_mib()}
        )
        (folder / "results.json").write_text(json.dumps(results))


def _beside(name: str) -> Any:
    """A module of this folder, which stays off the path: Blender's own add-on is called cycles too."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _enough(seconds: list[float], setting: dict[str, Any]) -> bool:
    """All frames, or as many as the time allows; two at least, for one alone tells nothing of its error."""
    late = 0.0 < setting["limit_s"] <= sum(seconds) and len(seconds) >= 2
    return late or len(seconds) == setting["frames"]


# --- settings -----------------------------------------------------------------------------------------------


def _fixed_settings(bpy: Any, camera: dict[str, Any], threads: int) -> None:
    """What all settings share: picture, filter, no colour management, the scene held from frame to frame."""
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = camera["width"], camera["height"]
    render.resolution_percentage = 100
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    render.threads_mode, render.threads = ("FIXED", threads) if threads else ("AUTO", render.threads)
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    cycles.device = "CPU"
    cycles.pixel_filter_type = "BOX"
    cycles.denoiser = "OPENIMAGEDENOISE"
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.sample_clamp_direct = 0.0


def _set(bpy: Any, setting: dict[str, Any]) -> None:
    cycles = bpy.context.scene.cycles
    cycles.samples = setting["spp"]
    cycles.use_denoising = setting["denoise"]
    for kind in ("max", "diffuse", "glossy", "transmission"):
        setattr(cycles, f"{kind}_bounces", setting["bounces"])
    cycles.sample_clamp_indirect = setting.get("clamp", 0.0)
    cycles.blur_glossy = setting.get("filter_glossy", 0.0)
    cycles.use_adaptive_sampling = setting.get("adaptive") is not None
    if cycles.use_adaptive_sampling:
        cycles.adaptive_threshold = setting["adaptive"]


def _rendered(bpy: Any, seed: int) -> float:
    """Renders a frame; the seconds that took."""
    bpy.context.scene.cycles.seed = seed
    start = time.perf_counter()
    bpy.ops.render.render()
    return time.perf_counter() - start


def _picture(bpy: Any, folder: Path) -> Any:
    """`(h, w, 3)` float32 of the last frame, first row on top."""
    path = folder / "last.exr"
    bpy.data.images["Render Result"].save_render(str(path), scene=bpy.context.scene)
    image = bpy.data.images.load(str(path))
    width, height = image.size
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    picture = pixels.reshape(height, width, -1)[::-1, :, :3].copy()
    bpy.data.images.remove(image)
    path.unlink()
    return picture


def _forget_peak() -> None:
    """Lets the kernel count peak memory anew, where it can (Linux)."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def _peak_mib() -> float:
    """Most memory since `_forget_peak`, or of all the process' life where that does nothing."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    # A plain exit after a Cycles render can hang for ever.
    code = 1
    try:
        main(Path(sys.argv[1]))
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)

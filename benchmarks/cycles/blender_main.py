"""Build and render an exported scene with Cycles, in a Python that has `bpy`.

    python -P blender_main.py FOLDER

The script imports NumPy and `bpy` only: bpy needs one version of Python and an old NumPy, and therefore an
environment of its own. It reads `scene.npz`, `scene.json` and `settings.json` from the folder, and writes
`picture_<setting>_<frame>.npy` and `results.json` into it.
"""

from __future__ import annotations

import gc
import importlib.util
import json
import os
import resource
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

_WARM = {"name": "warm", "spp": 1, "denoise": False, "bounces": 8}
_SEED_STEP = 1000  # chosen: so that no two settings share samples


def main(folder: Path) -> None:
    """Build, render and write what `cycles_process` reads."""
    bpy = importlib.import_module("bpy")
    facts = json.loads((folder / "scene.json").read_text())
    task = json.loads((folder / "settings.json").read_text())
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _apply_common(bpy, facts["camera"], task["threads"])
    with np.load(folder / "scene.npz") as arrays:
        _load_module("blender_scene").build(bpy, arrays, facts)
    gc.collect()

    # The first frame also transfers the scene and builds the BVH of its triangles.
    _apply_setting(bpy, _WARM)
    first, second = _render(bpy, 0), _render(bpy, 1)
    results: dict[str, Any] = {
        "blender": bpy.app.version_string,
        "first_s": first,
        "fixed_s": max(first - second, 0.0),
        "settings": [],
    }
    for number, setting in enumerate(task["settings"]):
        _reset_peak()
        _apply_setting(bpy, {**setting, "spp": 1})
        _render(bpy, 0)  # loads the denoiser and applies the changes
        _apply_setting(bpy, setting)
        seconds: list[float] = []
        while not _is_complete(seconds, setting):
            seconds.append(_render(bpy, _SEED_STEP * (number + 1) + len(seconds)))
            np.save(folder / f"picture_{number}_{len(seconds) - 1}.npy", _read_picture(bpy, folder))
        results["settings"].append({"seconds": seconds, "peak_mib": _peak_mib()})
        (folder / "results.json").write_text(json.dumps(results))


def _load_module(name: str) -> Any:
    """Import a module of this folder, which must stay off the path: Blender has a module `cycles` too."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _is_complete(seconds: list[float], setting: dict[str, Any]) -> bool:
    """Whether all frames are rendered, or time is up; two frames at least, to estimate their error."""
    late = 0.0 < setting["limit_s"] <= sum(seconds) and len(seconds) >= 2
    return late or len(seconds) == setting["frames"]


# --- settings -----------------------------------------------------------------------------------------------


def _apply_common(bpy: Any, camera: dict[str, Any], threads: int) -> None:
    """Apply what all settings share: picture, filter, no colour management, scene kept between frames."""
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


def _apply_setting(bpy: Any, setting: dict[str, Any]) -> None:
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


def _render(bpy: Any, seed: int) -> float:
    """Render a frame and return the seconds it took."""
    bpy.context.scene.cycles.seed = seed
    start = time.perf_counter()
    bpy.ops.render.render()
    return time.perf_counter() - start


def _read_picture(bpy: Any, folder: Path) -> Any:
    """`(h, w, 3)` float32 of the last frame, top row first."""
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


def _reset_peak() -> None:
    """Reset the peak memory of the process, where the system can (Linux)."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def _peak_mib() -> float:
    """Peak memory since `_reset_peak`, or since the start of the process where that is unsupported."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    # A normal exit after a Cycles render can hang.
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

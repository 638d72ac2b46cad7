"""A small greenhouse scene, and the digests of its frames; also imported by test processes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np

from pepperscene.camera import (
    Camera,
    DepthCamera,
    Developing,
    Distortion,
    ExposureControl,
    Partners,
    StereoMatching,
    arc_path,
    load_flash,
    load_lens,
    load_projector,
    load_sensor,
)
from pepperscene.cultivar import load_cultivar
from pepperscene.frame import Frame
from pepperscene.geometry import Mesh, mesh_plant
from pepperscene.grammar import Plant, grow
from pepperscene.materials import Surface, organ_surfaces, twine_surface
from pepperscene.outputs import DEFAULT_OUTPUTS, OUTPUTS
from pepperscene.render import Renderer
from pepperscene.scene import Scene, Sky, Twine, add_twine, assemble_scene, double_row, partly_cloudy_sky

NM = np.arange(360.0, 831.0, 10.0)
POSES = arc_path(3, 0.4, (-0.4, 0.4), (0.1, 0.4), np.radians(20.0))


def short_plant(parts: int, seed: int) -> Plant:
    cultivar = load_cultivar("kaite")
    short = cultivar.model_copy(update={"stem": cultivar.stem.model_copy(update={"parts": parts})})
    return grow(short, np.random.default_rng(seed))


def row_of_plants(parts: int = 6, seeds: Iterable[int] = (0, 1), detail: float = 0.4) -> Mesh:
    """Plants of few stem parts with twine, one of them in the back row."""
    meshes = []
    for seed in seeds:
        plant = short_plant(parts, seed)
        rng = np.random.default_rng(seed)
        meshes.append(add_twine(plant, mesh_plant(plant, detail), Twine(0.003, 4.0), rng))
    return double_row(meshes[:-1], meshes[-1:], spacing_m=0.2, gap_m=0.2, shift_m=0.1)


def cloudy_sky(seed: int = 7, azimuth_rad: float = -0.5) -> Sky:
    """A partly cloudy sky; the sun is not in view of `camera`."""
    return partly_cloudy_sky(
        np.random.default_rng(seed),
        illuminance_lx=5500.0,
        sun_azimuth_rad=azimuth_rad,
        sun_elevation_rad=0.7,
        sun_fraction=0.3,
        cloud_cover=0.5,
    )


def surfaces(nm: np.ndarray) -> dict[str, Surface]:
    twine = twine_surface(nm)
    return {**organ_surfaces(load_cultivar("kaite"), nm), twine.name: twine}


@cache
def greenhouse() -> Scene:
    """Two plants under a partly cloudy sky, grown once a process."""
    return assemble_scene(row_of_plants(), surfaces(NM), cloudy_sky())


@cache
def camera(
    step: int = 1, *, columns: int = 80, rows: int = 60, distorted: bool = False, flash: bool = True
) -> Camera:
    """The recipe's camera with its flash; binned to few large pixels, with the same field of view.

    Made once a process, as of a recipe: what is computed once for a sensor takes half of a small frame.
    """
    sensor = load_sensor("ueye_ui5250re")
    lens = load_lens("lensagon_cmfa0420nd")
    if distorted:
        lens = replace(lens, distortion=Distortion(k1=-0.1, k2=0.04, p1=1e-3, p2=-1e-3))
    sensor = replace(sensor, columns=columns, rows=rows, binning=sensor.binning * 10)
    return Camera(lens, sensor, POSES[step], 50e-6, load_flash("led_matrix_200klx") if flash else None)


def partners(step: int = 1) -> Partners:
    """Those of a step's frame: the camera at the last pose, one 60 mm to the right, and a depth camera."""
    pose = POSES[step].copy()
    pose[:3, 3] += 0.06 * pose[:3, 0]
    return Partners(camera(2), camera(step).at_pose(pose), depth_camera(step))


def depth_camera(step: int = 1) -> DepthCamera:
    """A small depth camera beside the camera, with a projector and automatic exposure."""
    left = Camera(
        load_lens("realsense_d435_infrared"),
        load_sensor("realsense_d435_infrared").with_size(106, 60),
        POSES[step],
        developing=Developing(white_balance="daylight"),
    )
    return DepthCamera(
        left, 0.05, load_projector("realsense_d435"), StereoMatching(disparities=32), ExposureControl()
    )


def digests(frame: Frame) -> dict[str, str]:
    """SHA-256 of the bytes of each image, or of the JSON text of other outputs."""
    return {
        name: hashlib.sha256(
            np.ascontiguousarray(image).tobytes()
            if OUTPUTS[name].is_image
            else json.dumps(image, sort_keys=True).encode()
        ).hexdigest()
        for name, image in frame.images.items()
    }


def fresh_digests() -> dict[str, str]:
    """Digests of the default outputs of one frame, with a new scene, renderer and camera."""
    scene, view = greenhouse.__wrapped__(), camera.__wrapped__()
    return digests(Renderer(scene).render(view, DEFAULT_OUTPUTS, "standard", 5))

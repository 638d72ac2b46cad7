"""Draws docs/images/close_range.jpg, and prints holes and errors of a D405 on a fruit and a leaf.

    python docs/figures/close_range.py

A fruit and a leaf of one plant, alone before a grey wall, by the daylight of a greenhouse.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Final

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image

import pepperscene as ps
from pepperscene.camera import Camera, DepthCamera, Partners, look_at
from pepperscene.geometry import Mesh, rectangle
from pepperscene.materials import Surface, lambertian_surface, load_skin, organ_surfaces
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.render import Renderer

IMAGES: Final = Path(__file__).parents[2] / "docs" / "images"
CULTIVAR, SEED = "kaite", 3
DISTANCES_M: Final = (0.15, 0.2, 0.4)
BEHIND_M: Final = 0.35  # of the wall
NM: Final = np.arange(380.0, 781.0, 5.0)
SIZE: Final = (420, 300)


def largest(mesh: Mesh, kind: str) -> Mesh:
    """The largest organ of a kind, alone."""
    numbers = [k for k, instance in enumerate(mesh.instances) if instance.kind == kind]
    extents = [np.ptp(mesh.vertices[mesh.faces[mesh.face_instance == k]], axis=(0, 1)).max() for k in numbers]
    keep = mesh.face_instance == numbers[int(np.argmax(extents))]
    names = ("faces", "face_instance", "face_surface", "face_appearance")
    return replace(mesh, **{name: getattr(mesh, name)[keep] for name in names})


def direction(organ: Mesh, kind: str) -> NDArray[np.float64]:
    """Where the camera is, as seen from an organ: before a fruit, above the upper side of a leaf."""
    if kind == "fruit":
        return np.array([0.0, -1.0, 0.0])
    a, b, c = (organ.vertices[organ.faces[:, corner]].astype(float) for corner in range(3))
    up = np.cross(b - a, c - a).sum(axis=0)
    tilted = up / np.linalg.norm(up) + np.array([0.25, 0.0, 0.0])  # chosen: the sun's reflection is aside
    return np.asarray(tilted / np.linalg.norm(tilted))


def scene(organ: Mesh, away: NDArray[np.float64], surfaces: dict[str, Surface]) -> ps.Scene:
    """An organ before a grey wall, by daylight below a diffuse cover."""
    across = np.cross(away, [0.0, 0.0, 1.0])
    centre = organ.vertices[organ.faces].mean(axis=(0, 1)) - BEHIND_M * away
    wall = rectangle(tuple(centre), tuple(3.0 * across), tuple(3.0 * np.cross(away, across)), "wall")
    sky = ps.partly_cloudy_sky(
        np.random.default_rng(1),
        illuminance_lx=15_000,
        sun_azimuth_rad=3.0,
        sun_elevation_rad=0.8,
        sun_fraction=0.3,
        cloud_cover=0.5,
        cover=ps.load_cover("diffuse_glass_4mm"),
    )
    materials = {**surfaces, "wall": lambertian_surface("wall", 0.1)}
    return ps.assemble_scene(ps.concatenate_meshes([organ, wall]), materials, sky)


def posed(camera: Camera, organ: Mesh, away: NDArray[np.float64], distance_m: float) -> Camera:
    """The camera at a distance from the nearest point of an organ, towards its middle."""
    points = organ.vertices[organ.faces].reshape(-1, 3).astype(float)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    nearest = ((points - centre) @ away).max()
    return camera.at_pose(look_at(centre + (nearest + distance_m) * away, centre))


def measure(
    renderer: Renderer, depth_camera: DepthCamera, distance_m: float, text: str
) -> tuple[NDArray[np.float32], float]:
    """Print holes and errors on the organ; its depth, and the exposure time."""
    outputs = ("depth_z", "depth_sensor")
    frame = renderer.render(depth_camera.left, outputs, "draft", 3, partners=Partners(depth=depth_camera))
    organ = frame["depth_z"] < distance_m + 0.12
    known = organ & np.isfinite(frame["depth_sensor"])
    error_mm = 1e3 * np.abs(frame["depth_sensor"] - frame["depth_z"])[known]
    holes, near = 1.0 - known.sum() / organ.sum(), (error_mm < 14.0 * distance_m).mean()
    sys.stdout.write(
        f"{text:14} {1e3 * distance_m:4.0f} mm: {holes:5.1%} holes, "
        f"median error {np.median(error_mm):5.2f} mm, {near:4.0%} within 1.4 %\n"
    )
    sys.stdout.flush()
    exposure_s = float(frame.metadata["depth_camera"]["exposure_s"])
    return np.where(organ, frame["depth_sensor"], np.nan), exposure_s


def panels(colour: NDArray[np.uint8], depth_m: NDArray[np.float32], nearest_m: float) -> list[Image.Image]:
    """The middle of a photograph, and of its depth in colours."""
    scaled = np.clip(1.0 - (depth_m - nearest_m) / 0.06, 0.0, 1.0)
    shown = matplotlib.colormaps["turbo"](np.nan_to_num(scaled))[..., :3]
    shown = np.rint(255.0 * np.where(np.isfinite(depth_m)[..., None], shown, 0.0)).astype(np.uint8)
    rows, columns = depth_m.shape
    left, top = (columns - SIZE[0]) // 2, (rows - SIZE[1]) // 2
    box = (left, top, left + SIZE[0], top + SIZE[1])
    return [Image.fromarray(image).crop(box) for image in (colour, shown)]


def main() -> None:
    """Measure both organs with and without fine texture, and draw the nearest view of the fruit."""
    depth_camera = resolve_recipe("realsense_close").depth_camera
    assert depth_camera is not None
    mesh, cultivar = ps.grow_plant(CULTIVAR, seed=SEED).mesh, ps.load_cultivar(CULTIVAR)
    pictures: list[Image.Image] = []
    for kind in ("fruit", "lamina"):
        organ = largest(mesh, kind)
        away = direction(organ, kind)
        for text, skin in (("smooth", None), ("pepper", load_skin("pepper"))):
            renderer = Renderer(scene(organ, away, organ_surfaces(cultivar, NM, skin)))
            for distance_m in DISTANCES_M:
                view = depth_camera.with_left(posed(depth_camera.left, organ, away, distance_m))
                depth_m, exposure_s = measure(renderer, view, distance_m, f"{kind} {text}")
                if distance_m == DISTANCES_M[0]:
                    exposed = replace(view.left, exposure_s=exposure_s)
                    photograph = renderer.render(exposed, ("colour",), "draft", 5)
                    pictures += panels(photograph["colour"], depth_m, distance_m)
    sheet = Image.new("RGB", (4 * SIZE[0], 2 * SIZE[1]))
    for number, picture in enumerate(pictures):
        sheet.paste(picture, (number % 4 * SIZE[0], number // 4 * SIZE[1]))
    sheet = sheet.resize((1400, 500), Image.Resampling.LANCZOS)
    sheet.save(IMAGES / "close_range.jpg", quality=82, optimize=True)


if __name__ == "__main__":
    main()

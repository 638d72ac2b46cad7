"""Render the figures of the README, the index and the page about optics into docs/images.

Run it after a change that affects them:

python docs/figures/overview.py [NAME ...]
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pepperscene import (
    Camera,
    FrameRenderer,
    Mesh,
    Scene,
    assemble_scene,
    concatenate_meshes,
    grow,
    load_cultivar,
    load_flash,
    load_lens,
    load_recipe,
    load_sensor,
    look_at,
    mesh_plant,
    organ_surfaces,
    partly_cloudy_sky,
    render_scene,
)
from pepperscene.camera import Developing
from pepperscene.review.report.colours import distance_colours

IMAGES: Final = Path(__file__).parents[1] / "images"
NM: Final = np.arange(360.0, 831.0, 5.0)
GAP: Final = 8
"""Width of the white gap between panels, in pixels."""

Picture = NDArray[np.uint8]


def single_organs(kind: str, seed: int = 3) -> list[Mesh]:
    """The organs of one kind of a plant of Kaite, as separate meshes."""
    mesh = mesh_plant(grow(load_cultivar("kaite"), np.random.default_rng(seed)), detail=3.0)
    return [mesh.select_instances([i]) for i, instance in enumerate(mesh.instances) if instance.kind == kind]


def upright(organ: Mesh) -> Mesh:
    """Move a leaf or a fruit to the origin, with its tip down and the upper side of a leaf towards -y."""
    centre = organ.vertices.mean(axis=0)
    tip, base = organ.uv[:, 1] > 0.9, organ.uv[:, 1] < 0.1
    axis = organ.vertices[tip].mean(axis=0) - organ.vertices[base].mean(axis=0)
    axis /= np.linalg.norm(axis)
    normal = organ.normals.mean(axis=0)
    normal = normal - (normal @ axis) * axis
    normal /= np.linalg.norm(normal)
    rotation = np.stack([np.cross(normal, axis), -normal, -axis])
    return organ.moved(rotation, -rotation @ centre)


def portrait_camera(width: int, height: int, distance_m: float, exposure_s: float, flash: bool) -> Camera:
    """A camera with a longer lens than the recipe's, which looks along +y at the origin."""
    sensor = dataclasses.replace(load_sensor("ueye_ui5250re"), columns=width, rows=height)
    lens = dataclasses.replace(load_lens("lensagon_cmfa0420nd"), focal_length_m=0.0125)
    lamp = load_flash("led_matrix_200klx") if flash else None
    pose = look_at((0.0, -distance_m, 0.0), (0.0, 0.0, 0.0))
    developing = Developing(white_balance="flash" if flash else "daylight")
    return Camera(lens, sensor, pose, exposure_s, lamp, developing)


def sunlit_scene(mesh: Mesh, sun_azimuth_rad: float) -> Scene:
    """The mesh in sunlight: from the camera's side at an azimuth of -pi/2, from behind at pi/2."""
    sky = partly_cloudy_sky(
        np.random.default_rng(5), illuminance_lx=5500.0, sun_azimuth_rad=sun_azimuth_rad,
        sun_elevation_rad=float(np.radians(32.0)), sun_fraction=0.85, cloud_cover=0.0,
    )  # fmt: skip
    return assemble_scene(mesh, organ_surfaces(load_cultivar("kaite"), NM), sky)


def leaf_glow() -> Picture:
    """One leaf with the sun in front of it, and with the sun behind it."""
    leaf = upright(max(single_organs("lamina"), key=lambda mesh: np.ptp(mesh.vertices, axis=0).max()))
    camera = portrait_camera(420, 520, 0.5, 1 / 1600, flash=False)
    scenes = [sunlit_scene(leaf, azimuth) for azimuth in (-np.pi / 2, np.pi / 2)]
    return side_by_side([render_scene(scene, camera, ["colour"])["colour"] for scene in scenes])


def ripening() -> Picture:
    """A fruit at six states from green to ripe, under the flash."""
    # Use the fruit with the fewest states at 0 or 1, so that its states can be shifted.
    fruit = upright(
        min(single_organs("fruit"), key=lambda mesh: np.mean((mesh.state <= 0) | (mesh.state >= 1)))
    )
    mean_state = float(fruit.state.mean())
    row = [
        dataclasses.replace(fruit, state=np.clip(fruit.state - mean_state + state, 0, 1)).moved(
            np.eye(3), np.array([0.105 * (column - 2.5), 0.0, 0.0])
        )
        for column, state in enumerate((0.0, 0.3, 0.5, 0.65, 0.8, 1.0))
    ]
    camera = portrait_camera(1000, 240, 0.9, 110e-6, flash=True)
    scene = assemble_scene(concatenate_meshes(row), organ_surfaces(load_cultivar("kaite"), NM))
    return render_scene(scene, camera, ["colour"])["colour"]


def cameras() -> Picture:
    """One view with four cameras: the paper's, the same with focus, a Nikon, a near-infrared one."""
    infrared = {
        "camera": {"sensor": "onsemi_mt9v024_mono", "flash": "led_nir_850nm", "filter": "bandpass_850nm"},
        "developing": {"white_balance": "daylight"},
    }
    changes_of_cameras: list[dict[str, Any]] = [
        {},
        {"camera": {"focus_mm": 400.0}},
        {"camera": {"sensor": "nikon_d5100", "lens": "nikkor_18_55mm_at_18mm", "gain": 4.0}},
        infrared,
    ]
    views = []
    for changes in changes_of_cameras:
        recipe = load_recipe("barth2018", changes)
        colour = FrameRenderer(recipe).render(recipe.plan.frame(2290), ["colour"])["colour"]
        views.append(np.asarray(Image.fromarray(colour).resize((480, 360), Image.Resampling.BOX)))
    white = np.full((GAP, 2 * 480 + GAP, 3), 255, np.uint8)
    return np.vstack([side_by_side(views[:2]), white, side_by_side(views[2:])])


def demo() -> Picture:
    """A frame, its class image and its distance image, as in a data set."""
    recipe = load_recipe("demo")
    frame = FrameRenderer(recipe).render(recipe.plan.frame(6137), ["colour", "class_colour", "distance"])
    panels = [
        (frame["colour"], Image.Resampling.BOX),
        (frame["class_colour"], Image.Resampling.NEAREST),
        (distance_colours(frame["distance"], 0.2, 1.0), Image.Resampling.NEAREST),
    ]
    return side_by_side(
        [np.asarray(Image.fromarray(panel).resize((520, 390), method)) for panel, method in panels]
    )


def side_by_side(pictures: list[Picture]) -> Picture:
    """Arrange pictures of equal height in a row, with white gaps."""
    white = np.full((pictures[0].shape[0], GAP, 3), 255, np.uint8)
    return np.hstack([part for picture in pictures for part in (white, picture)][1:])


FIGURES: Final[dict[str, Callable[[], Picture]]] = {
    figure.__name__: figure for figure in (demo, leaf_glow, ripening, cameras)
}


def main(names: list[str]) -> None:
    """Write the named figures; without names, all of them."""
    for name in names or FIGURES:
        Image.fromarray(FIGURES[name]()).save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:])

"""Render the figures of the pages about plants and about other crops into docs/images.

Run it after a change that affects them:

python docs/figures/plants.py [NAME ...]
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from overview import GAP, IMAGES, Picture, side_by_side
from PIL import Image

from pepperscene import (
    Camera,
    FrameRenderer,
    Renderer,
    grow_plant,
    interpolate_cultivars,
    load_cultivar,
    load_lens,
    load_recipe,
    load_sensor,
    look_at,
)
from pepperscene.building.scenes.plant_export import portrait
from pepperscene.camera import Developing

PHOTOS: Final = Path(__file__).parents[1] / "photos"
SIZE: Final = (613, 346)
"""Width and height of the photographs, in pixels."""
PHONE_DEG: Final = 62.0
"""Horizontal field of view of the smartphone that took them. Chosen: common for smartphones."""


Point = tuple[float, float, float]

PAIRS: Final[tuple[tuple[str, Point, Point], ...]] = (
    ("img4", (0.1, -0.72, 1.5), (0.1, 0.0, 1.65)),
    ("img6", (-0.3, -0.65, 1.9), (-0.3, 0.0, 2.0)),
    ("img3", (0.2, -1.0, 1.4), (0.2, 0.0, 1.7)),
)
"""Each photograph, with the camera position and the target of the corresponding rendering, in metres."""


def phone_camera(position: Point, target: Point) -> Camera:
    """A camera for daylight with a smartphone's field of view on the paper's sensor; all is in focus."""
    columns, rows = SIZE
    sensor = dataclasses.replace(load_sensor("ueye_ui5250re"), columns=columns, rows=rows)
    focal_length_m = 0.5 * columns * sensor.pixel_pitch_m / np.tan(np.radians(0.5 * PHONE_DEG))
    lens = dataclasses.replace(load_lens("lensagon_cmfa0420nd"), focal_length_m=float(focal_length_m))
    developing = Developing(white_balance="daylight", falloff=False)
    return Camera(lens, sensor, look_at(position, target), 2e-3, developing=developing)


def photographs() -> Picture:
    """Photographs on the left, renderings of the red cultivar at the same scale on the right."""
    recipe = load_recipe(
        "greenhouse",
        {
            "cultivar": "red_blocky",
            "daylight": {"sun_fraction": 0.1, "cloud_cover": 0.9},
        },
    )
    renderer = Renderer(FrameRenderer(recipe).scene(recipe.plan.frame(0)))
    rows = []
    for name, position, target in PAIRS:
        photo = np.asarray(Image.open(PHOTOS / f"{name}.png").convert("RGB").resize(SIZE))
        rendering = renderer.render(phone_camera(position, target), ["colour"])["colour"]
        rows.append(side_by_side([photo, rendering]))
    return stacked(rows)


def cultivars() -> Picture:
    """Four cultivars: whole, from 50 cm, and with a fruit 10 cm in front of the lens."""
    names = ("kaite", "red_blocky", "orange_pointed", "tomato")
    portraits = [portrait(grow_plant(name, seed=5).mesh, load_cultivar(name)) for name in names]
    return stacked([side_by_side(half_size(portraits[:2])), side_by_side(half_size(portraits[2:]))])


def crops() -> Picture:
    """Two crops other than those of `cultivars`, likewise."""
    names = ("cucumber", "eggplant")
    return side_by_side(
        half_size([portrait(grow_plant(name, seed=5).mesh, load_cultivar(name)) for name in names])
    )


def crop_flash() -> Picture:
    """Cucumbers by flash at night: the first recipe of the page about other crops."""
    changes = {
        "cultivar": "cucumber",
        "row.spacing_mm": 400,
        "row.plants_front": 5,
        "row.plants_back": 4,
        "views.height_mm": [900, 1200],
        "views.pitch_deg": 0,
    }
    renderer = FrameRenderer(load_recipe("demo", changes))
    return renderer.render(renderer.recipe.plan.frame(FLASH_FRAME), ("colour",)).colour


def crop_row() -> Picture:
    """A row of cucumbers in daylight: the second recipe of that page."""
    changes = {
        "cultivar": "cucumber",
        "views.distance_mm": 900,
        "views.height_mm": [1300, 1400],
        "camera.exposure_us": "auto",
        "camera.focus_mm": 900,
    }
    renderer = FrameRenderer(load_recipe("greenhouse", changes))
    return renderer.render(renderer.recipe.plan.frame(ROW_FRAME), ("colour",)).colour


def stages() -> Picture:
    """One seed at four dates: the three shipped stages, and one between the last two."""
    spring, autumn = load_cultivar("kaite"), load_cultivar("kaite_september")
    summer = interpolate_cultivars(spring, autumn, 0.5)
    portraits = [
        portrait(grow_plant("kaite_february", seed=7).mesh, load_cultivar("kaite_february")),
        portrait(grow_plant("kaite", seed=7).mesh, spring),
        portrait(grow_plant("kaite", seed=7, until="kaite_september", share=0.5).mesh, summer),
        portrait(grow_plant("kaite_september", seed=7).mesh, autumn),
    ]
    return stacked([side_by_side(half_size(portraits[:2])), side_by_side(half_size(portraits[2:]))])


def half_size(pictures: list[Picture]) -> list[Picture]:
    """Resize pictures to half their width and the same height."""
    return [
        np.asarray(Image.fromarray(picture).resize((picture.shape[1] // 2, 454), Image.Resampling.BOX))
        for picture in pictures
    ]


def stacked(rows: list[Picture]) -> Picture:
    """Arrange pictures in a column, with white gaps and margins."""
    width = max(row.shape[1] for row in rows)
    padded_rows: list[NDArray[np.uint8]] = []
    for row in rows:
        padded = np.full((row.shape[0] + GAP, width, 3), 255, np.uint8)
        padded[GAP:, : row.shape[1]] = row
        padded_rows.append(padded)
    return np.vstack(padded_rows)[GAP:]


FLASH_FRAME: Final = 6137
ROW_FRAME: Final = 4

FIGURES: Final[dict[str, Callable[[], Picture]]] = {
    "own_crop.jpg": crops,
    "own_crop_flash.jpg": crop_flash,
    "own_crop_row.jpg": crop_row,
    "plant_photographs.jpg": photographs,
    "plant_cultivars.png": cultivars,
    "plant_stages.png": stages,
}


def main(names: list[str]) -> None:
    """Write the named figures; without names, all of them."""
    for name in names or FIGURES:
        Image.fromarray(FIGURES[name]()).save(IMAGES / name, optimize=True, quality=90)


if __name__ == "__main__":
    main(sys.argv[1:])

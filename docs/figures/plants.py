"""Renders the pictures of the page on plants into docs/images; run it after a change that they show.

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
from overview import GAP, IMAGES, Picture, beside
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
from pepperscene.camera import Developing
from pepperscene.dataset.scenes.portrait import portrait

PHOTOS: Final = Path(__file__).parents[1] / "photos"
SIZE: Final = (613, 346)
"""Of the photographs, pixels."""
PHONE_DEG: Final = 62.0
"""Horizontal field of view of the telephone that took them: chosen, as most have."""


def phone(place: tuple[float, float, float], target: tuple[float, float, float]) -> Camera:
    """A telephone's field of view on the paper's sensor, all sharp, by daylight."""
    columns, rows = SIZE
    sensor = dataclasses.replace(load_sensor("ueye_ui5250re"), columns=columns, rows=rows)
    focal = 0.5 * columns * sensor.pixel_pitch_m / np.tan(np.radians(0.5 * PHONE_DEG))
    lens = dataclasses.replace(load_lens("lensagon_cmfa0420nd"), focal_length_m=float(focal))
    developing = Developing(white_balance="daylight", falloff=False)
    return Camera(lens, sensor, look_at(place, target), 2e-3, developing=developing)


def photographs() -> Picture:
    """Photographs on the left, renders of the red cultivar at the same scale on the right."""
    recipe = load_recipe(
        "greenhouse",
        {
            "cultivar": "red_blocky",
            "daylight": {"sun_fraction": 0.1, "cloud_cover": 0.9},
        },
    )
    renderer = Renderer(FrameRenderer(recipe).scene(recipe.plan.frame(0)))
    rows = []
    for name, place, target in PAIRS:
        photo = np.asarray(Image.open(PHOTOS / f"{name}.png").convert("RGB").resize(SIZE))
        shown = renderer.render(phone(place, target), ["colour"])["colour"]
        rows.append(beside([photo, shown]))
    return above(rows)


Point = tuple[float, float, float]
PAIRS: Final[tuple[tuple[str, Point, Point], ...]] = (
    ("img4", (0.1, -0.72, 1.5), (0.1, 0.0, 1.65)),
    ("img6", (-0.3, -0.65, 1.9), (-0.3, 0.0, 2.0)),
    ("img3", (0.2, -1.0, 1.4), (0.2, 0.0, 1.7)),
)
"""Each photograph, and where its twin is taken from and towards, metres."""


def cultivars() -> Picture:
    """Four cultivars and crops: whole, from 50 cm, and with a fruit 10 cm before the lens."""
    names = ("kaite", "red_blocky", "orange_pointed", "tomato")
    sheets = [portrait(grow_plant(name, seed=5).mesh, load_cultivar(name)) for name in names]
    return above([beside(even(sheets[:2])), beside(even(sheets[2:]))])


def stages() -> Picture:
    """One plant at four dates: the same seed, the shipped stages, and one between them."""
    spring, autumn = load_cultivar("kaite"), load_cultivar("kaite_september")
    summer = interpolate_cultivars(spring, autumn, 0.5)
    sheets = [
        portrait(grow_plant("kaite_february", seed=7).mesh, load_cultivar("kaite_february")),
        portrait(grow_plant("kaite", seed=7).mesh, spring),
        portrait(grow_plant("kaite", seed=7, until="kaite_september", share=0.5).mesh, summer),
        portrait(grow_plant("kaite_september", seed=7).mesh, autumn),
    ]
    return above([beside(even(sheets[:2])), beside(even(sheets[2:]))])


def even(sheets: list[Picture]) -> list[Picture]:
    """Sheets of one height, half as large."""
    return [
        np.asarray(Image.fromarray(one).resize((one.shape[1] // 2, 454), Image.Resampling.BOX))
        for one in sheets
    ]


def above(rows: list[Picture]) -> Picture:
    """Pictures one above the other on white, the narrower ones filled up."""
    width = max(row.shape[1] for row in rows)
    parts: list[NDArray[np.uint8]] = []
    for row in rows:
        full = np.full((row.shape[0] + GAP, width, 3), 255, np.uint8)
        full[GAP:, : row.shape[1]] = row
        parts.append(full)
    return np.vstack(parts)[GAP:]


FIGURES: Final[dict[str, Callable[[], Picture]]] = {
    "plant_photographs.jpg": photographs,
    "plant_cultivars.png": cultivars,
    "plant_stages.png": stages,
}


def main(names: list[str]) -> None:
    """Write the figures asked for, by default all."""
    for name in names or FIGURES:
        Image.fromarray(FIGURES[name]()).save(IMAGES / name, optimize=True, quality=90)


if __name__ == "__main__":
    main(sys.argv[1:])

"""Draws the pictures of docs/how-to/depth.md, and prints the share of holes and the errors of depth.

    python docs/figures/depth.py

Frames are cached in the folder `pepperscene_depth` of the system's folder for temporary files.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

import pepperscene as ps

IMAGES: Final = Path(__file__).parents[2] / "docs" / "images"
CACHE: Final = Path(tempfile.gettempdir()) / "pepperscene_depth"
OUTPUTS: Final = ["colour", "class", "depth_z", "depth_sensor", "depth_confidence", "imager_left"]
FRAME: Final = 5
SIZE: Final = (640, 360)
NEAR_M, FAR_M = 0.3, 1.5  # colours of depths
LARGEST_MM: Final = 30.0  # colours of differences
CONDITIONS: Final[dict[str, dict[str, Any]]] = {
    "daylight, 30,000 lx": {},
    "overcast, 5,000 lx": {"daylight.illuminance_lx": 5000, "daylight.sun_fraction": 0.0},
    "dusk, 300 lx": {"daylight.illuminance_lx": 300, "daylight.sun_fraction": 0.0},
}


def frame(name: str, projector: bool) -> ps.Dataset:
    """The data set of one frame under one condition, with the pattern or without it."""
    changes = {"camera.width": SIZE[0], "camera.height": SIZE[1], **CONDITIONS[name]}
    if not projector:
        changes["depth_camera.projector"] = "none"
    folder = CACHE / f"{list(CONDITIONS).index(name)}_{'on' if projector else 'off'}"
    recipe = ps.load_recipe("realsense_depth", changes)
    ps.build(recipe, folder, [FRAME], OUTPUTS, ps.BuildOptions("draft"))
    return ps.open_dataset(folder)


def depth_colours(depth_m: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Depths in colours, near ones bright; what has none is black."""
    return _colours((FAR_M - depth_m) / (FAR_M - NEAR_M), np.isfinite(depth_m), "turbo")


def difference_colours(difference_m: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Differences in colours: red too far, blue too near, white right; black in holes."""
    scaled = 0.5 + 500.0 * difference_m / LARGEST_MM
    return _colours(scaled, np.isfinite(difference_m), "coolwarm")


def _colours(scaled: NDArray[np.floating], known: NDArray[np.bool_], name: str) -> NDArray[np.uint8]:
    colour = matplotlib.colormaps[name](np.clip(np.nan_to_num(scaled), 0.0, 1.0))[..., :3]
    return np.rint(255.0 * np.where(known[..., None], colour, 0.0)).astype(np.uint8)


def panel(image: NDArray[np.uint8], text: str) -> Image.Image:
    """An image in the size of the others, with a caption."""
    picture = Image.fromarray(image).convert("RGB")
    height = round(SIZE[0] * picture.height / picture.width)
    picture = picture.resize((SIZE[0], height), Image.Resampling.LANCZOS)
    top = (height - SIZE[1]) // 2
    picture = picture.crop((0, top, SIZE[0], top + SIZE[1]))
    draw = ImageDraw.Draw(picture)
    draw.rectangle((0, 0, 10 + draw.textlength(text), 17), fill="black")
    draw.text((5, 3), text, fill="white")
    return picture


def sheet(panels: list[list[Image.Image]]) -> Image.Image:
    """Panels in rows and columns."""
    columns, rows = len(panels[0]), len(panels)
    image = Image.new("RGB", (columns * (SIZE[0] + 4) - 4, rows * (SIZE[1] + 4) - 4), "white")
    for row, line in enumerate(panels):
        for column, picture in enumerate(line):
            image.paste(picture, (column * (SIZE[0] + 4), row * (SIZE[1] + 4)))
    return image


def overview(dataset: ps.Dataset) -> Image.Image:
    """Photograph, infrared image, measured and exact depth, their difference, and the confidence."""
    images = {name: dataset.image(FRAME, name) for name in OUTPUTS}
    measured, exact = images["depth_sensor"], images["depth_z"]
    with np.errstate(invalid="ignore"):
        difference = measured - np.where(np.isfinite(exact), exact, np.nan)
    confidence = np.rint(255.0 * images["depth_confidence"]).astype(np.uint8)
    return sheet(
        [
            [
                panel(images["colour"], "colour"),
                panel(images["imager_left"], "imager_left, with the pattern"),
            ],
            [panel(depth_colours(measured), "depth_sensor"), panel(depth_colours(exact), "depth_z")],
            [
                panel(difference_colours(difference), f"difference, +-{LARGEST_MM:g} mm"),
                panel(confidence, "depth_confidence"),
            ],
        ]
    )


def detail(image: NDArray[np.uint8], text: str) -> Image.Image:
    """The middle of an infrared image, twice as large."""
    rows, columns = image.shape
    top, left = (rows - SIZE[1] // 2) // 2, (columns - SIZE[0] // 2) // 2
    part = image[top : top + SIZE[1] // 2, left : left + SIZE[0] // 2]
    return panel(np.asarray(Image.fromarray(part).resize(SIZE, Image.Resampling.NEAREST)), text)


def print_figures(dataset: ps.Dataset, text: str) -> None:
    """Holes and errors of the surfaces within 1.5 m, by class."""
    measured, exact, classes = (dataset.image(FRAME, n) for n in ("depth_sensor", "depth_z", "class"))
    lines = [f"{text:32} {'holes':>7} {'median error':>13} {'within 2 %':>11}"]
    for name, ids in (
        ("all", range(8)), ("leaf", [1]), ("pepper", [2]), ("peduncle", [3]), ("stem", [4]), ("shoot", [5]),
        ("wire", [6]),
    ):  # fmt: skip
        chosen = np.isin(classes, list(ids)) & (exact < FAR_M)
        known = chosen & np.isfinite(measured)
        if not chosen.any():
            continue
        error = np.abs(measured[known] - exact[known])
        good = (error < 0.02 * exact[known]).mean() if known.any() else 0.0
        median_mm = 1000 * np.median(error) if known.any() else np.nan
        holes = 1 - known.sum() / chosen.sum()
        lines.append(f"  {name:30} {holes:7.1%} {median_mm:10.1f} mm {good:11.1%}")
    sys.stdout.write("\n".join([*lines, ""]))


def main() -> None:
    """Build the frames, print the figures and draw the pictures."""
    sets = {(name, on): frame(name, on) for name in CONDITIONS for on in (True, False)}
    for (name, on), dataset in sets.items():
        print_figures(dataset, f"{name}, pattern {'on' if on else 'off'}")
    names = list(CONDITIONS)
    overview(sets[names[1], True]).save(IMAGES / "depth_camera.jpg", quality=85)
    details = [
        [
            detail(sets[name, True].image(FRAME, "imager_left"), f"{name}: left imager"),
            panel(depth_colours(sets[name, True].image(FRAME, "depth_sensor")), "depth_sensor, pattern on"),
            panel(depth_colours(sets[name, False].image(FRAME, "depth_sensor")), "depth_sensor, pattern off"),
        ]
        for name in names
    ]
    sheet(details).resize((1290, 728), Image.Resampling.LANCZOS).save(
        IMAGES / "depth_pattern.jpg", quality=85
    )


if __name__ == "__main__":
    main()

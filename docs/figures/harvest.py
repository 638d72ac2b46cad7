"""Renders the picture of the page on the harvest truth into docs/images; run it after a change that it shows.

python docs/figures/harvest.py
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from overview import IMAGES, Picture
from PIL import Image, ImageDraw
from skimage.measure import find_contours

from pepperscene import Camera, FrameRenderer, load_recipe
from pepperscene.truth.encodings import decode_rle

SEEN: Final = (255, 255, 255)
HIDDEN: Final = (190, 190, 190)
CUT: Final = (255, 0, 255)
WAY: Final = (0, 220, 255)
BOX: Final = (255, 200, 0)
LEAST: Final = 400
"""Pixels that a fruit shows if boxes and arrows are drawn for it: chosen, for a picture that can be read."""
TWICE: Final = 2  # lines are drawn on a picture so many times as large, and come out smooth


def drawn(colour: Picture, camera: Camera, harvest: Mapping[str, Any], scale: int = TWICE) -> Image.Image:
    """Outlines of whole fruit, their boxes, cut points and ways of approach over a photograph."""
    size = (colour.shape[1] * scale, colour.shape[0] * scale)
    sheet = Image.fromarray(colour).resize(size, Image.Resampling.LANCZOS)
    pen = ImageDraw.Draw(sheet)
    level = camera.at_pose(np.eye(4))

    def stroke(points: ArrayLike, fill: tuple[int, int, int], width: int = 1) -> None:
        places = np.asarray(points, float) * scale
        if np.isfinite(places).all():
            pen.line([tuple(place) for place in places], fill=fill, width=width * scale // 2 or 1)

    for fruit in harvest["fruit"]:
        well_seen = fruit["visible_pixels"] >= LEAST
        for line in outlines(fruit):
            stroke(line, SEEN if well_seen else HIDDEN, 2 if well_seen else 1)
        if not well_seen:
            continue
        for edge in edges(fruit["box_3d"]["corners_px"]):
            stroke(edge, BOX)
        if fruit["approach"] is not None:
            # The last 6 cm of the tool's way to the fruit's centre.
            centre = np.array(fruit["box_3d"]["centre"])
            start, end = level.project([centre - 0.06 * np.array(fruit["approach"]["camera"]), centre])
            stroke([start, end], WAY, 4)
            back, aside = (start - end) * 0.25, np.array([[0.0, -1.0], [1.0, 0.0]]) @ (start - end) * 0.12
            stroke([end + back + aside, end, end + back - aside], WAY, 4)
        stalk = fruit["peduncle"]
        if stalk is not None:
            stroke(level.project(stalk["curve_m"]), CUT, 2)
            if stalk["cut"]["px"] is not None:
                x, y = (scale * value for value in stalk["cut"]["px"])
                reach = 4 * scale
                place = (x - reach, y - reach, x + reach, y + reach)
                pen.ellipse(place, outline=CUT, width=scale, fill=CUT if stalk["cut"]["visible"] else None)
    return sheet


def outlines(fruit: Mapping[str, Any]) -> Iterable[np.ndarray]:
    """`(n, 2)` pixel coordinates of the amodal mask's outlines."""
    mask = np.pad(decode_rle(fruit["amodal"]), 1).astype(float)
    return [line[:, ::-1] - 0.5 for line in find_contours(mask, 0.5)]


def edges(corners: list[list[float] | None]) -> Iterable[list[list[float]]]:
    """The twelve edges of a box: corners whose numbers differ by one bit."""
    for one in range(8):
        for bit in (1, 2, 4):
            first, last = corners[one], corners[one | bit]
            if not one & bit and first is not None and last is not None:
                yield [first, last]


def shot(recipe: str, index: int, changes: Mapping[str, Any]) -> Image.Image:
    """A frame of a recipe with its harvest truth drawn over it."""
    told = load_recipe(recipe, dict(changes))
    stage, frame = FrameRenderer(told), told.plan.frame(index)
    made = stage.render(frame, ["colour", "harvest"])
    return drawn(made["colour"], stage.camera(frame), made["harvest"])


if __name__ == "__main__":
    size = (800, 600)
    sheet = shot("greenhouse", 4, {})
    sheet.resize(size, Image.Resampling.LANCZOS).save(IMAGES / "harvest.jpg", quality=90)

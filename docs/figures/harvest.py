"""Render the figure of the page about the harvest truth into docs/images.

Run it after a change that affects it:

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

Colour = tuple[int, int, int]

VISIBLE: Final = (255, 255, 255)
HIDDEN: Final = (190, 190, 190)
CUT: Final = (255, 0, 255)
APPROACH: Final = (0, 220, 255)
BOX: Final = (255, 200, 0)
MIN_PIXELS: Final = 400
"""Visible pixels above which a fruit gets a box and an arrow. Chosen: the picture remains readable."""
SCALE: Final = 2
"""Factor by which the picture is enlarged for drawing, so that lines are smooth."""


def draw_harvest(colour: Picture, camera: Camera, harvest: Mapping[str, Any]) -> Image.Image:
    """Draw outlines of whole fruit, their boxes, cut points and approach directions on a photograph."""
    size = (colour.shape[1] * SCALE, colour.shape[0] * SCALE)
    picture = Image.fromarray(colour).resize(size, Image.Resampling.LANCZOS)
    pen = ImageDraw.Draw(picture)
    camera_at_origin = camera.at_pose(np.eye(4))

    def draw_line(points: ArrayLike, fill: Colour, width: int = 1) -> None:
        pixels = np.asarray(points, float) * SCALE
        if np.isfinite(pixels).all():
            pen.line([tuple(pixel) for pixel in pixels], fill=fill, width=width * SCALE // 2 or 1)

    for fruit in harvest["fruit"]:
        well_visible = fruit["visible_pixels"] >= MIN_PIXELS
        for outline in amodal_outlines(fruit):
            draw_line(outline, VISIBLE if well_visible else HIDDEN, 2 if well_visible else 1)
        if not well_visible:
            continue
        for edge in box_edges(fruit["box_3d"]["corners_px"]):
            draw_line(edge, BOX)
        if fruit["approach"] is not None:
            # The last 6 cm of the tool's path to the centre of the fruit.
            centre = np.array(fruit["box_3d"]["centre"])
            path = [centre - 0.06 * np.array(fruit["approach"]["camera"]), centre]
            start, end = camera_at_origin.project(path)
            draw_line([start, end], APPROACH, 4)
            back = (start - end) * 0.25
            aside = np.array([[0.0, -1.0], [1.0, 0.0]]) @ (start - end) * 0.12
            draw_line([end + back + aside, end, end + back - aside], APPROACH, 4)
        peduncle = fruit["peduncle"]
        if peduncle is not None:
            draw_line(camera_at_origin.project(peduncle["curve_m"]), CUT, 2)
            cut = peduncle["cut"]
            if cut["px"] is not None:
                x, y = (SCALE * value for value in cut["px"])
                radius = 4 * SCALE
                circle = (x - radius, y - radius, x + radius, y + radius)
                pen.ellipse(circle, outline=CUT, width=SCALE, fill=CUT if cut["visible"] else None)
    return picture


def amodal_outlines(fruit: Mapping[str, Any]) -> Iterable[np.ndarray]:
    """`(n, 2)` pixel coordinates of the outlines of the amodal mask."""
    mask = np.pad(decode_rle(fruit["amodal"]), 1).astype(float)
    return [outline[:, ::-1] - 0.5 for outline in find_contours(mask, 0.5)]


def box_edges(corners: list[list[float] | None]) -> Iterable[list[list[float]]]:
    """Yield the edges of a box, between corners whose numbers differ by one bit, as far as they are known."""
    for number in range(8):
        for bit in (1, 2, 4):
            first, last = corners[number], corners[number | bit]
            if not number & bit and first is not None and last is not None:
                yield [first, last]


def render_harvest(recipe_name: str, index: int) -> Image.Image:
    """Render a frame of a recipe and draw its harvest truth."""
    recipe = load_recipe(recipe_name)
    renderer, spec = FrameRenderer(recipe), recipe.plan.frame(index)
    frame = renderer.render(spec, ["colour", "harvest"])
    return draw_harvest(frame["colour"], renderer.camera(spec), frame["harvest"])


if __name__ == "__main__":
    picture = render_harvest("greenhouse", 4)
    picture.resize((800, 600), Image.Resampling.LANCZOS).save(IMAGES / "harvest.jpg", quality=90)

"""Render the figures of the page about outputs into docs/images: amodal masks, and albedo.

Run it after a change that affects them:

python docs/figures/outputs.py
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from harvest import amodal_outlines
from overview import IMAGES, Picture
from PIL import Image, ImageDraw

from pepperscene import FrameRenderer, load_recipe
from pepperscene.camera import encode_tone
from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.truth import decode_rle

SCALE: Final = 2
"""Factor by which the picture is enlarged for drawing, so that lines are smooth."""
HIDDEN: Final = 0.4  # weight of the colour where a whole organ is hidden
LEAST_PIXELS, LEAST_VISIBLE = 1500, 0.3
"""Pixels of a whole organ, and visible fraction, from which it is drawn. Chosen: the picture is readable."""
LEAF_BLUE: Final = (110, 170, 255)
"""Of leaves: lighter than the colour of their class, which is dark on leaves."""


def draw_whole_organs(colour: Picture, instance: Picture, organs: list[Mapping[str, Any]]) -> Image.Image:
    """Tint the hidden parts of organs, and draw outlines of whole organs, in colours of classes."""
    tinted = colour.astype(float)
    colours = [*CLASS_COLOURS]
    colours[OrganClass.LEAF] = LEAF_BLUE
    drawn = [
        organ
        for organ in organs
        if organ["amodal_pixels"] >= LEAST_PIXELS and organ["visible_fraction"] >= LEAST_VISIBLE
    ]
    for organ in drawn:
        hidden = decode_rle(organ["amodal"]) & (instance != organ["instance"])
        tinted[hidden] += HIDDEN * (np.array(colours[organ["class"]]) - tinted[hidden])
    size = (colour.shape[1] * SCALE, colour.shape[0] * SCALE)
    picture = Image.fromarray(tinted.astype(np.uint8)).resize(size, Image.Resampling.LANCZOS)
    pen = ImageDraw.Draw(picture)
    for organ in drawn:
        for outline in amodal_outlines(organ):
            points = [tuple(point) for point in outline * SCALE]
            pen.line(points, fill=colours[organ["class"]], width=SCALE)
    return picture.resize((colour.shape[1], colour.shape[0]), Image.Resampling.LANCZOS)


def main(recipe_name: str = "greenhouse", index: int = 4) -> None:
    """Render a frame of a recipe, and write both figures."""
    renderer = FrameRenderer(load_recipe(recipe_name))
    spec = renderer.recipe.plan.frame(index)
    frame = renderer.render(spec, ["colour", "instance", "amodal", "albedo"])
    whole = draw_whole_organs(frame["colour"], frame["instance"], frame["amodal"]["organs"])
    whole.save(IMAGES / "amodal.jpg", quality=85)
    albedo = encode_tone(frame["albedo"].astype(np.float32), "srgb")
    both = np.concatenate([frame["colour"], albedo], axis=1)
    picture = Image.fromarray(both).resize((1200, 450), Image.Resampling.LANCZOS)
    picture.save(IMAGES / "albedo.jpg", quality=85)


if __name__ == "__main__":
    main()

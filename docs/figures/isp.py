"""Draw the picture of the how-to page on image signal processors, from a frame's electrons.

pepperscene build randomised --out out/isp --frames 0:1 --outputs electrons
python docs/figures/isp.py out/isp docs/images/isp.jpg
"""

from __future__ import annotations

import argparse
import io
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.font_manager import FontProperties, findfont
from PIL import Image, ImageDraw, ImageFont

import pepperscene as ps
from pepperscene.camera import Camera, develop, load_processor
from pepperscene.camera.image.photo import jpeg_bytes, photo_description
from pepperscene.recipe.resolve.frame_setups import FrameSetups
from pepperscene.recipe.resolve.load import resolve_recipe

RECIPE: Final = "randomised"
FRAME: Final = 0
CROP: Final = (160, 60, 770, 518)  # pixels of a photograph of 800 x 600
PRESETS: Final = {
    "no processor": None,
    "webcam": "webcam",
    "RealSense": "realsense_colour",
    "telephone": "telephone",
}
GAP: Final = 4


def camera_of(data: ps.Dataset) -> Camera:
    """The camera of the frame, with the exposure that was chosen for it."""
    recipe = resolve_recipe(RECIPE)
    camera = FrameSetups(recipe).at(recipe.recipe.plan.frame(FRAME)).camera
    taken = data.metadata(FRAME)["camera"]
    return replace(
        camera, exposure_s=taken["exposure_s"], sensor=camera.sensor.with_settings(gain=taken["gain"])
    )


def photograph(data: ps.Dataset, camera: Camera, preset: str | None) -> Image.Image:
    """The JPEG file of the frame by a preset."""
    isp = None if preset is None else load_processor(preset)
    camera = replace(camera, developing=replace(camera.developing, isp=isp))
    image = develop(data.image(FRAME, "electrons"), camera, np.random.default_rng(0))
    with Image.open(io.BytesIO(jpeg_bytes(image, photo_description(camera))), formats=["JPEG"]) as picture:
        return picture.crop(CROP)


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("set", "picture"):
        parser.add_argument(name, type=Path)
    options = parser.parse_args()
    data = ps.open_dataset(options.set)
    camera, font = camera_of(data), ImageFont.truetype(findfont(FontProperties()), 20)
    width, height = CROP[2] - CROP[0], CROP[3] - CROP[1]
    sheet = Image.new("RGB", (2 * width + GAP, 2 * height + GAP), "white")
    for number, (title, preset) in enumerate(PRESETS.items()):
        picture = photograph(data, camera, preset)
        draw = ImageDraw.Draw(picture)
        draw.rectangle((0, height - 32, draw.textlength(title, font) + 16, height), fill="black")
        draw.text((8, height - 29), title, "white", font)
        sheet.paste(picture, (number % 2 * (width + GAP), number // 2 * (height + GAP)))
    sheet.save(options.picture, quality=88, optimize=True, progressive=True)


if __name__ == "__main__":
    main()

"""Draws the picture of docs/how-to/own_spectrum.md: a plant with pigmented and with measured leaves.

    python docs/figures/own_spectrum.py [--cache FOLDER]

The curve and the recipe are those of the page.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import pepperscene as ps

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "own_spectrum.md"
PICTURE = ROOT / "docs" / "images" / "own_spectrum.jpg"
VIEW = {
    "views.distance_mm": 1100, "camera.focus_mm": 1100, "camera.width": 320, "camera.height": 284,
    "row.plants_front": 3, "row.plants_back": 0, "greenhouse.far_rows": 0,
}  # fmt: skip
PHOTOGRAPH = {"camera.sensor": "generic_rgb", "camera.hfov_deg": 41.2, "camera.exposure_us": 1100}


def main() -> None:
    """Build four frames, and put them side by side."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cache", type=Path, default=Path("out/own_spectrum"))
    cache = parser.parse_args().cache
    cache.mkdir(parents=True, exist_ok=True)
    text = PAGE.read_text(encoding="utf-8")
    rows = re.search(r'"""\\\n(.*?)"""', text, re.DOTALL)
    recipe = re.search(r"```toml\n(# own_leaf\.toml\n.*?)```", text, re.DOTALL)
    assert rows is not None
    assert recipe is not None
    (cache / "my_leaf.csv").write_text(rows[1], encoding="utf-8")
    (cache / "own_leaf.toml").write_text(recipe[1], encoding="utf-8")
    (cache / "pigments.toml").write_text(recipe[1].partition("[override")[0], encoding="utf-8")

    pictures = []
    for name in ("pigments", "own_leaf"):
        for kind, changes, outputs in (("rgb", PHOTOGRAPH, ["colour"]), ("bands", {}, ["reflectance"])):
            out = cache / f"{name}_{kind}"
            loaded = ps.load_recipe(cache / f"{name}.toml", {**VIEW, **changes})
            ps.build(loaded, out, [1], outputs, ps.BuildOptions("standard"))
            (image,) = ps.open_images(out)
            # The scale bar makes the index as much higher.
            picture = image.colour if kind == "rgb" else ps.index_picture(image, "ndvi", "red-green")
            pictures.append(Image.fromarray(np.asarray(picture)).resize((320, 284 if kind == "rgb" else 320)))
    sheet = Image.new("RGB", (4 * 324 - 4, 320), "white")
    draw = ImageDraw.Draw(sheet)
    captions = ("leaves of the cultivar's pigments", "", "leaves of a measured curve", "")
    for number, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        sheet.paste(picture, (324 * number, 0))
        draw.text((324 * number + 8, 292), caption, fill="black", font_size=18)
    sheet.save(PICTURE, quality=88)


if __name__ == "__main__":
    main()

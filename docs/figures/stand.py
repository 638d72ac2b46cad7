"""Draw the picture of the how-to page on stands, from the data sets that the page's commands build.

python docs/figures/stand.py out/turntable out/cabin docs/images/stand.jpg
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from PIL import Image

import pepperscene as ps

WIDTH: Final = 1224
GAP: Final = 4  # pixels between photographs


def row(data: ps.Dataset, indices: tuple[int, ...]) -> Image.Image:
    """Photographs of a data set side by side, over the whole width."""
    pictures = [Image.fromarray(data.image(index, "colour")).convert("RGB") for index in indices]
    width = (WIDTH - GAP * (len(pictures) - 1)) // len(pictures)
    height = round(width * pictures[0].height / pictures[0].width)
    image = Image.new("RGB", (WIDTH, height), "white")
    for number, picture in enumerate(pictures):
        image.paste(picture.resize((width, height), Image.Resampling.LANCZOS), (number * (width + GAP), 0))
    return image


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("turntable", "cabin", "picture"):
        parser.add_argument(name, type=Path)
    options = parser.parse_args()
    above = row(ps.open_dataset(options.turntable), (0, 10, 25))
    below = row(ps.open_dataset(options.cabin), (0, 1))
    sheet = Image.new("RGB", (WIDTH, above.height + GAP + below.height), "white")
    sheet.paste(above, (0, 0))
    sheet.paste(below, (0, above.height + GAP))
    sheet.save(options.picture, quality=85, optimize=True, progressive=True)


if __name__ == "__main__":
    main()

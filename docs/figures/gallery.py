"""Draw a contact sheet of a data set's photographs for the gallery page.

pepperscene build season --out out/season --frames 0:40 --outputs colour
python docs/figures/gallery.py out/season docs/images/gallery_season.jpg

The data set of `randomised` is that of the page's command: drafts of eight frames of each of sixteen sets.
The sheet of cucumbers is from the frames that the page's command builds.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image, ImageOps

import pepperscene as ps

COLUMNS: Final = 6
ROWS: Final = 4
GAP: Final = 4  # pixels between photographs
MOST_WIDTH: Final = 1600
MOST_BYTES: Final = 500_000
"""Chosen: so that the page with all sheets is below 2 MB."""


def contact_sheet(data: ps.Dataset) -> Image.Image:
    """Photographs of a data set, evenly spaced over its frames, in rows.

    All have the shape of the first; others are cropped in their middle.

    Raises:
        ValueError: the data set has too few frames.
    """
    indices, count = data.indices(), COLUMNS * ROWS
    if len(indices) < count:
        raise ValueError(f"a contact sheet needs {count} frames; the data set has {len(indices)}")
    shown = [indices[place] for place in np.linspace(0, len(indices) - 1, count).round().astype(int)]
    photographs = [Image.fromarray(data.image(index, "colour")).convert("RGB") for index in shown]

    width = (MOST_WIDTH - (COLUMNS - 1) * GAP) // COLUMNS
    height = round(width * photographs[0].height / photographs[0].width)
    size = (COLUMNS * (width + GAP) - GAP, ROWS * (height + GAP) - GAP)
    sheet = Image.new("RGB", size, "white")
    for number, photograph in enumerate(photographs):
        row, column = divmod(number, COLUMNS)
        cell = ImageOps.fit(photograph, (width, height), Image.Resampling.LANCZOS)
        sheet.paste(cell, (column * (width + GAP), row * (height + GAP)))
    return sheet


def jpeg(sheet: Image.Image) -> bytes:
    """A picture as JPEG, of the highest quality that is small enough."""
    for quality in range(90, 40, -5):
        buffer = io.BytesIO()
        sheet.save(buffer, "JPEG", quality=quality, optimize=True, progressive=True)
        if buffer.tell() < MOST_BYTES:
            break
    return buffer.getvalue()


def main() -> None:
    """Write the contact sheet of a data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the data set")
    parser.add_argument("picture", type=Path, help="JPEG file to write")
    arguments = parser.parse_args()
    arguments.picture.write_bytes(jpeg(contact_sheet(ps.open_dataset(arguments.data))))


if __name__ == "__main__":
    main()

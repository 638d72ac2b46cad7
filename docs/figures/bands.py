"""Draws the pictures of docs/how-to/bands.md and of the gallery: false colour, NDVI, and spectra of organs.

    python docs/figures/bands.py

Frames are cached in the folder `pepperscene_bands` of the system's folder for temporary files.
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

import pepperscene as ps

IMAGES: Final = Path(__file__).parents[2] / "docs" / "images"
CACHE: Final = Path(tempfile.gettempdir()) / "pepperscene_bands"
BLUE, GREEN, RED, RED_EDGE, NEAR_INFRARED = range(5)  # of the camera with five bands
WHITE: Final = 0.6  # reflectance that is shown as white
FRAME: Final = 1
LINE_FRAME: Final = 0
Picture = NDArray[np.uint8]


def data_set(recipe: str, outputs: list[str]) -> ps.Dataset:
    """All frames of a recipe."""
    ps.build(ps.load_recipe(recipe), CACHE / recipe, outputs=outputs, options=ps.BuildOptions("draft"))
    return ps.open_dataset(CACHE / recipe)


def as_picture(reflectance: NDArray[np.floating], bands: list[int]) -> Picture:
    """Three bands as red, green and blue, with the curve of sRGB."""
    linear = np.clip(reflectance[..., bands] / WHITE, 0.0, 1.0)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * curve).astype(np.uint8)


def ndvi(reflectance: NDArray[np.floating]) -> NDArray[np.floating]:
    """The normalised difference vegetation index `(h, w)`."""
    red, infrared = reflectance[..., RED], reflectance[..., NEAR_INFRARED]
    return (infrared - red) / np.maximum(infrared + red, 1e-6)


def ndvi_picture(reflectance: NDArray[np.floating]) -> Picture:
    """NDVI from 0, brown, to 1, green."""
    colours = matplotlib.colormaps["BrBG"](np.clip(ndvi(reflectance), 0.0, 1.0))[..., :3]
    return np.rint(255.0 * colours).astype(np.uint8)


def captioned(picture: Picture, text: str) -> Image.Image:
    """A picture with a caption."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 0, 10 + draw.textlength(text), 17), fill="black")
    draw.text((5, 3), text, fill="white")
    return image


def side_by_side(pictures: list[Image.Image], columns: int) -> Image.Image:
    """Pictures of one size in rows."""
    width, height = pictures[0].size
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (columns * (width + 4) - 4, rows * (height + 4) - 4), "white")
    for number, picture in enumerate(pictures):
        sheet.paste(picture, (number % columns * (width + 4), number // columns * (height + 4)))
    return sheet


def largest(data: ps.Dataset, index: int, kind: str) -> int:
    """The instance of a kind with most pixels."""
    instances = data.metadata(index)["instances"]
    sizes = {int(key): entry["pixels"] for key, entry in instances.items() if entry["kind"] == kind}
    return max(sizes, key=sizes.__getitem__)


def spectra(data: ps.Dataset) -> Image.Image:
    """Measured reflectance of a leaf and a fruit beside the spectra of their surfaces."""
    metadata = data.metadata(LINE_FRAME)
    nm = np.array([band["centre_nm"] for band in metadata["camera"]["bands"]])
    reflectance, instance = data.image(LINE_FRAME, "reflectance"), data.image(LINE_FRAME, "instance")
    surfaces = ps.organ_surfaces(ps.load_cultivar("kaite_dusty"), np.arange(400.0, 1001.0, 5.0))
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained", sharey=True)
    shown = (("lamina", "leaf", ("pale leaf", "dark leaf")), ("fruit", "fruit", ("unripe", "ripe")))
    for axis, (kind, surface, texts) in zip(axes, shown, strict=True):
        pixels = reflectance[instance == largest(data, LINE_FRAME, kind)]
        low, middle, high = np.percentile(pixels, (25, 50, 75), axis=0)
        axis.fill_between(nm, low, high, color="#9ab8d8", alpha=0.7, lw=0)
        axis.plot(nm, middle, color="#1f4e79", lw=1, label=f"in the image, {len(pixels)} pixels")
        tables, first = surfaces[surface].reflectance[:, 0], surfaces[surface].first_state
        states = np.linspace(first, 1.0, len(tables))
        for state, text, colour in zip((0.0, 1.0), texts, ("#7fb24d", "#c77d2e"), strict=True):
            spectrum = tables[int(np.argmin(np.abs(states - state)))]
            axis.plot(surfaces[surface].wavelength_nm, spectrum, "--", color=colour, lw=1, label=text)
        axis.set(title=kind, xlabel="wavelength (nm)", xlim=(400, 1000))
        axis.legend(frameon=False, fontsize=8)
    axes[0].set_ylabel("reflectance")
    axes[0].set_ylim(0, 1)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=140)
    return Image.open(buffer).convert("RGB")


def main() -> None:
    """Build the frames and draw the pictures."""
    data = data_set("multispectral", ["reflectance", "class", "instance"])
    images: dict[int, Any] = {index: data.image(index, "reflectance") for index in data.indices()}
    image = images[FRAME]
    panels = [
        captioned(as_picture(image, [RED, GREEN, BLUE]), "red, green, blue"),
        captioned(as_picture(image, [NEAR_INFRARED, RED, GREEN]), "near infrared, red, green"),
        captioned(as_picture(image, [RED_EDGE] * 3), "red edge, 717 nm"),
        captioned(ndvi_picture(image), "NDVI, 0 to 1"),
    ]
    side_by_side(panels, 2).save(IMAGES / "bands.jpg", quality=85, optimize=True)
    rows = [as_picture(each, [NEAR_INFRARED, RED, GREEN]) for each in images.values()]
    rows += [ndvi_picture(each) for each in images.values()]
    sheet = side_by_side([Image.fromarray(row) for row in rows], len(images))
    sheet.thumbnail((1600, 1600))
    sheet.save(IMAGES / "gallery_bands.jpg", quality=80, optimize=True, progressive=True)
    leaf = images[FRAME][data.image(FRAME, "class") == ps.OrganClass.LEAF]
    means, index = leaf.mean(axis=0).round(3).tolist(), float(ndvi(leaf).mean())
    sys.stdout.write(f"reflectance of leaf pixels by band: {means}; NDVI {index:.3f}\n")

    lines = data_set("line_scanner", ["reflectance", "class", "instance"])
    spectra(lines).save(IMAGES / "band_spectra.png", optimize=True)


if __name__ == "__main__":
    main()

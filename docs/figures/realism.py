"""Write the table and the pictures of the page about realism: renders beside photographs, and targets.

    python docs/figures/realism.py [--quality draft]

It renders six frames, and one in the infrared twice, which takes some minutes. Text between the markers of
the page is replaced.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from realism_targets import ROWS, Row

import pepperscene as ps
from pepperscene.classes import OrganClass
from pepperscene.colour import Comparison, compare
from pepperscene.render.quality import QUALITIES, Quality

DOCS: Final = Path(__file__).parents[1]
PAGE: Final = DOCS / "explanation" / "realism.md"
PHOTOS: Final = DOCS / "photos"
IMAGES: Final = DOCS / "images"
BEGIN, END = "<!-- realism table begins -->", "<!-- realism table ends -->"

FRUIT_MM: Final = 85.0
"""Width of a ripe fruit, from which the scale of the photographs follows. Chosen: blocky sweet peppers are
80 to 90 mm wide; the estimate is good to 15 %, because fruit and leaves are not equally far away."""

TEST_PHOTOS: Final = tuple(f"img{number}" for number in range(7, 13))
"""Photographs to which nothing was fitted."""

OUTLINES: Final = {
    "img7": ((236, 111), (255, 94), (261, 102), (279, 135), (282, 158), (277, 169), (238, 169), (234, 141)),
    "img8": ((481, 237), (488, 223), (508, 213), (528, 215), (537, 222), (528, 233), (505, 250), (485, 258)),
    "img9": ((240, 204), (274, 206), (290, 192), (315, 188), (328, 214), (315, 246), (283, 273), (245, 243)),
    "img10": ((206, 182), (226, 164), (256, 162), (287, 175), (288, 219), (274, 249), (243, 284), (212, 220)),
    "img11": ((403, 231), (415, 215), (446, 211), (468, 220), (468, 287), (457, 297), (428, 282), (405, 251)),
}
"""Columns and rows of polygons inside one leaf of some of them, drawn by hand."""

LEAST_LEAF_PX: Final = 2500
"""Pixels of a leaf in an image 600 pixels wide. Chosen: about as many as the outlined leaves have."""

CLOSE_MM: Final = 100.0
WIDE_MM: Final = 500.0
CELL: Final = (380, 285)
"""Width and height of a picture on the page, in pixels."""
GAP: Final = 6


@dataclasses.dataclass(frozen=True)
class Pair:
    """A frame of a recipe beside a photograph.

    Attributes:
        recipe: name of the recipe.
        frame: index.
        photo: name of the photograph.
        fruit_px: width of a whole fruit in it, measured by hand.
        leaf: column and row of a leaf at the distance of that fruit, likewise.
        others: further frames that the measures are taken of.
    """

    recipe: str
    frame: int
    photo: str
    fruit_px: float
    leaf: tuple[int, int]
    others: tuple[int, ...] = ()


PAIRS: Final = (
    Pair("demo", 6137, "img9", 67.0, (283, 216)),
    Pair("greenhouse", 0, "img8", 53.0, (497, 233), (4, 8, 10)),
    Pair("randomised", 0, "img7", 41.0, (258, 140)),
    Pair("season", 60, "img10", 49.0, (252, 207)),
)

Picture = NDArray[np.uint8]


# --- rendering ----------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Render:
    """A rendered frame and the scale of its leaves.

    Attributes:
        folder: of a data set that holds this frame and the others of the pair.
        colour: `(h, w, 3)` sRGB.
        leaf: column and row of the middle of its largest leaf.
        pixel_mm: size of a pixel at that leaf.
    """

    folder: Path
    colour: Picture
    leaf: tuple[int, int]
    pixel_mm: float


def render(pair: Pair, folder: Path, quality: str) -> Render:
    """Render the frames of a pair into a data set, and find the largest leaf of the first."""
    from scipy.ndimage import distance_transform_edt

    recipe = ps.load_recipe(pair.recipe)
    outputs = ["colour", "class", "instance", "distance"]
    options = ps.BuildOptions(quality)
    ps.build(recipe, folder, frames=[pair.frame, *pair.others], outputs=outputs, options=options)
    data = ps.open_dataset(folder)
    colour, classes, instances, distance = (data.image(pair.frame, name) for name in outputs)
    leaves = np.where(classes == OrganClass.LEAF, instances, 0)
    mask = leaves == np.argmax(np.bincount(leaves.ravel())[1:]) + 1
    row, column = np.unravel_index(np.argmax(distance_transform_edt(mask)), mask.shape)
    camera = ps.FrameRenderer(recipe).camera(recipe.plan.frame(pair.frame))
    pixel_mm = 1e3 * float(distance[row, column]) * camera.sensor.pixel_pitch_m / camera.lens.focal_length_m
    return Render(folder, colour[..., :3], (int(column), int(row)), pixel_mm)


# --- pictures -----------------------------------------------------------------------------------------------


def crop(picture: Picture, centre: tuple[int, int], width_mm: float, pixel_mm: float) -> Image.Image:
    """Part of a picture of this width on the plants, moved into the picture and at most as large as it."""
    width = min(width_mm / pixel_mm, picture.shape[1], picture.shape[0] * CELL[0] / CELL[1])
    height = width * CELL[1] / CELL[0]
    left = float(np.clip(centre[0] - width / 2, 0, picture.shape[1] - width))
    top = float(np.clip(centre[1] - height / 2, 0, picture.shape[0] - height))
    box = (left, top, left + width, top + height)
    return Image.fromarray(picture).resize(CELL, Image.Resampling.BICUBIC, box=box)


def panel(pair: Pair, rendered: Render) -> Image.Image:
    """Photograph above, render below: whole, 50 cm wide and 10 cm wide."""
    photo = np.asarray(Image.open(PHOTOS / f"{pair.photo}.png").convert("RGB"))
    sheet = Image.new("RGB", (3 * (CELL[0] + GAP) - GAP, 2 * (CELL[1] + GAP) - GAP), "white")
    rows = (
        (photo, pair.leaf, FRUIT_MM / pair.fruit_px, f"photograph {pair.photo}"),
        (rendered.colour, rendered.leaf, rendered.pixel_mm, f"render, {pair.recipe}"),
    )
    for row, (picture, leaf, pixel_mm, name) in enumerate(rows):
        centre = (picture.shape[1] // 2, picture.shape[0] // 2)
        cells = (
            (crop(picture, centre, np.inf, pixel_mm), name),
            (crop(picture, leaf, WIDE_MM, pixel_mm), "50 cm"),
            (crop(picture, leaf, CLOSE_MM, pixel_mm), "10 cm"),
        )
        for column, (cell, text) in enumerate(cells):
            draw = ImageDraw.Draw(cell)
            draw.rectangle((0, 0, 8 + 6.2 * len(text), 16), fill="white")
            draw.text((4, 2), text, fill="black")
            sheet.paste(cell, (column * (CELL[0] + GAP), row * (CELL[1] + GAP)))
    return sheet


# --- measures of renders ------------------------------------------------------------------------------------


def largest_ratio(first: tuple[Any, ...], second: tuple[Any, ...]) -> float:
    """Greatest factor between two lists of estimates."""
    ratios = [a.value / b.value for a, b in zip(first, second, strict=True)]
    return float(max(max(ratio, 1.0 / ratio) for ratio in ratios))


def lightness_sd(linear_width: int, picture: Picture, masks: NDArray[np.intp]) -> list[float]:
    """Standard deviation of L* of every region of at least `LEAST_LEAF_PX` pixels at a common scale.

    Args:
        linear_width: width in pixels to which picture and regions are reduced.
        picture: `(h, w, 3)` sRGB.
        masks: `(h, w)` number of the region of each pixel, 0 for none.
    """
    from skimage.color import rgb2lab

    size = linear_width, round(picture.shape[0] * linear_width / picture.shape[1])
    small = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))
    regions = np.asarray(Image.fromarray(masks.astype(np.int32)).resize(size, Image.Resampling.NEAREST))
    lightness = rgb2lab(small)[..., 0]
    areas = np.bincount(regions.ravel())
    return [
        float(lightness[regions == number].std())
        for number in np.flatnonzero(areas >= LEAST_LEAF_PX)
        if number
    ]


def photographed_leaves() -> list[float]:
    """`lightness_sd` of the outlined leaves of the photographs, whatever their size."""
    from skimage.color import rgb2lab
    from skimage.draw import polygon2mask

    values = []
    for name, outline in OUTLINES.items():
        photo = np.asarray(Image.open(PHOTOS / f"{name}.png").convert("RGB"))
        inside = polygon2mask(photo.shape[:2], np.array(outline)[:, ::-1])
        values.append(float(rgb2lab(photo)[..., 0][inside].std()))
    return values


def rendered_leaves(folder: Path) -> list[float]:
    """`lightness_sd` of the leaves of a data set."""
    data, values = ps.open_dataset(folder), []
    for frame in data.indices():
        colour, classes, instances = (data.image(frame, name) for name in ("colour", "class", "instance"))
        leaves = np.where(classes == OrganClass.LEAF, instances, 0)
        values += lightness_sd(600, np.ascontiguousarray(colour[..., :3]), leaves)
    return values


def infrared_loss(frame: int = 6137) -> float:
    """Light at 850 nm that `standard` lacks against 16 bounces, in percent of the mean signal."""
    changes = {
        "camera": {"sensor": "onsemi_mt9v024_mono", "flash": "led_nir_850nm", "filter": "bandpass_850nm"},
        "developing": {"white_balance": "daylight"},
    }
    recipe = ps.load_recipe("barth2018", changes)
    frames = ps.FrameRenderer(recipe)
    spec = recipe.plan.frame(frame)
    camera = frames.camera(spec)
    # The middle of the view suffices for a mean.
    columns, rows = camera.sensor.columns // 4, camera.sensor.rows // 4
    sensor = dataclasses.replace(camera.sensor, columns=columns, rows=rows)
    camera = dataclasses.replace(camera, sensor=sensor)
    renderer = ps.Renderer(frames.scene(spec))
    # The same samples, so that only the lengths of the paths differ.
    many = Quality(samples=64, soft=64, most=64, bounces=16, target=None, denoise=False)
    samples = {name: getattr(many, name) for name in ("samples", "soft", "most", "target", "denoise")}
    few = dataclasses.replace(QUALITIES["standard"], **samples)
    frames_of = [renderer.render(camera, ["electrons"], quality) for quality in (few, many)]
    means = [float(np.mean(frame["electrons"])) for frame in frames_of]
    return 100.0 * (1.0 - means[0] / means[1])


def rendered_rows(renders: dict[str, Render]) -> list[Row]:
    """Rows that need renders or photographs."""
    photos = ps.open_images(photo_folder(renders["demo"].folder.parent))
    day: Comparison = compare(photos, renders["greenhouse"].folder)
    flash: Comparison = compare(photos, renders["demo"].folder)
    leaf, lamp = day.appearance["leaf"].second, flash.appearance["leaf"].second
    dark = 100.0 * (leaf.blue_dark_share.value or 0.0)
    outlined = photographed_leaves()
    photo, image = day.appearance["image"].first, day.appearance["image"].second

    def row(name: str, target: str, low: float | None, high: float | None, digits: int, value: Any) -> Row:
        number = float(getattr(value, "value", value))
        return Row(name, target, low, high, digits, lambda: number)

    return [
        row("daylight leaf, S at 10 %", "at most 0.12", None, 0.12, 2, leaf.saturation[0]),
        row("daylight leaf, S at 50 %", "0.25 to 0.35", 0.25, 0.35, 2, leaf.saturation[1]),
        row("daylight leaf, pixels of dark blue, %", "below 2", None, 2.0, 1, dark),
        row("flash leaf, S at 50 %", "0.35 to 0.50", 0.35, 0.50, 2, lamp.saturation[1]),
        row("flash leaf, median hue, degrees", "120 to 127", 120.0, 127.0, 0, lamp.hue_median_deg),
        row("gradients of a daylight leaf, ratio", "at most 1.5", None, 1.5, 2, leaf.gradient_ratio),
        row("sd of L* in a daylight leaf", "about 15 (12 to 18)", 12.0, 18.0, 1, leaf.organ_lightness_sd),
        row(
            f"the same in large leaves only (outlined in photographs: {np.mean(outlined):.1f})",
            f"{min(outlined):.1f} to {max(outlined):.1f}", min(outlined), max(outlined), 1,
            float(np.mean(rendered_leaves(renders["greenhouse"].folder))),
        ),
        row(
            "whole images, S at 10, 50 and 90 %, greatest factor to the photographs",
            "at most 1.6", None, 1.6, 2, largest_ratio(photo.saturation, image.saturation),
        ),
        row(
            "slope of the power spectrum, difference from the photographs",
            "within ±0.15", -0.15, 0.15, 2, image.spectrum_slope.value - photo.spectrum_slope.value,
        ),
        row("light at 850 nm lost against 16 bounces, %", "at most 2", None, 2.0, 1, infrared_loss()),
    ]  # fmt: skip


def photo_folder(parent: Path) -> Path:
    """A folder with the photographs that the measures use, and nothing else."""
    folder = parent / "photographs"
    folder.mkdir(exist_ok=True)
    for name in TEST_PHOTOS:
        (folder / f"{name}.png").write_bytes((PHOTOS / f"{name}.png").read_bytes())
    return folder


# --- page ---------------------------------------------------------------------------------------------------


def table(rows: list[Row]) -> str:
    """The rows as a Markdown table."""
    lines = ["| measure | target | reached | within |", "|---|---|---|---|"]
    return "\n".join([*lines, *(row.cells(row.measure()) for row in rows)])


def write_table(text: str) -> None:
    """Replace the text between the markers of the page."""
    page = PAGE.read_text(encoding="utf-8")
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}", encoding="utf-8")


def main() -> None:
    """Render, measure, and write pictures and table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quality", default="standard", choices=sorted(QUALITIES))
    quality = parser.parse_args().quality
    with tempfile.TemporaryDirectory() as temporary:
        renders = {pair.recipe: render(pair, Path(temporary) / pair.recipe, quality) for pair in PAIRS}
        for pair in PAIRS:
            picture = IMAGES / f"realism_{pair.recipe}.jpg"
            panel(pair, renders[pair.recipe]).save(picture, quality=85, optimize=True, progressive=True)
        write_table(table([*ROWS, *rendered_rows(renders)]))


if __name__ == "__main__":
    main()

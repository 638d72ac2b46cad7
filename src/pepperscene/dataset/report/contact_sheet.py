"""One picture of a set as it is shown: its images in colours for people, and what is told of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.dataset.report.colours import class_colours, distance_colours, instance_colours

if TYPE_CHECKING:
    from PIL import Image, ImageDraw


TITLES: Final[Mapping[str, str]] = {
    "colour": "Colour",
    "class": "Class",
    "instance": "Organ instance",
    "distance": "Distance along the ray",
}
"""Images that are shown, in this order, and what they are called."""


@dataclass(frozen=True, eq=False)
class ShownImage:
    """One picture as it is shown.

    Attributes:
        name: of the picture in its set; a frame's index with six digits.
        facts: what its set tells of it, a frame's JSON; may be empty.
        pictures: `(h, w, 3)` uint8 by the keys of `TITLES`, in their order.
        pixels: number of pixels of each class by its id; empty when it has no labels.
        area: number of all its pixels, of those without a label as well.
    """

    name: str
    facts: Mapping[str, Any]
    pictures: Mapping[str, NDArray[np.uint8]]
    pixels: Mapping[int, int]
    area: int

    @property
    def rendered(self) -> bool:
        """Whether it is a frame of ours."""
        return "step" in self.facts

    @property
    def title(self) -> str:
        """What it is called."""
        return f"Frame {self.name}" if self.rendered else self.name

    @property
    def place(self) -> str:
        """Where in its data set it belongs, in one line; empty when nothing is known."""
        if not self.rendered:
            return ""
        place = "set {set} · rotation {rotation} · step {step}".format(**self.facts)
        height = self.height_m
        return place if height is None else f"{place} · camera at {height:.2f} m"

    @property
    def height_m(self) -> float | None:
        """Of the camera above the ground, metres."""
        pose = self.facts.get("camera", {}).get("pose")
        return None if pose is None else float(pose[2][3])


def view(picture: LabelledImage, near_m: float, far_m: float) -> ShownImage:
    """A picture's images as colours.

    Args:
        picture: with whatever images it has.
        near_m: distance shown brightest.
        far_m: distance shown darkest.
    """
    shown: dict[str, NDArray[np.uint8]] = {}
    pixels: dict[int, int] = {}
    if picture.colour is not None:
        shown["colour"] = picture.colour
    if picture.classes is not None:
        shown["class"] = class_colours(picture.classes)
        counts = np.bincount(picture.classes.ravel(), minlength=len(OrganClass))
        pixels = {int(one): int(counts[one]) for one in OrganClass}
    if picture.instances is not None:
        shown["instance"] = instance_colours(picture.instances)
    if picture.distance_m is not None:
        shown["distance"] = distance_colours(picture.distance_m, near_m, far_m)
    height, width = picture.size
    return ShownImage(picture.name, picture.facts, shown, pixels, height * width)


MOST_ROWS: Final = 24
"""Chosen: a sheet of more is taller than what viewers of pictures open."""

# Layout in pixels; chosen so that four pictures fill a wide screen.
_WIDTH: Final = 440
_GAP: Final = 10
_MARGIN: Final = 28
_CAPTION: Final = 34
_HEAD: Final = 44
_FOOT: Final = 70
_PAPER: Final = (22, 24, 29)
_INK: Final = (236, 238, 242)
_FAINT: Final = (150, 156, 168)


@dataclass(frozen=True, eq=False)
class SheetRow:
    """One frame's pictures in the size of the sheet, and the line below them."""

    pictures: dict[str, Image.Image]
    caption: str


def row(view: ShownImage) -> SheetRow:
    """A frame's row of the sheet."""
    from PIL import Image

    small = {}
    for name, picture in view.pictures.items():
        # Labels must not be blended: a mixed colour would be another class.
        way = Image.Resampling.LANCZOS if name == "colour" else Image.Resampling.NEAREST
        height = round(_WIDTH * picture.shape[0] / picture.shape[1])
        small[name] = Image.fromarray(np.ascontiguousarray(picture)).resize((_WIDTH, height), way)
    return SheetRow(small, " · ".join(part for part in (view.title, view.place) if part))


def contact_sheet(rows: Sequence[SheetRow], near_m: float, far_m: float) -> Image.Image:
    """All rows below each other; legends for class and distance at the foot."""
    from PIL import Image, ImageDraw

    columns = [name for name in TITLES if any(name in row.pictures for row in rows)]
    heights = [max((image.height for image in row.pictures.values()), default=0) for row in rows]
    across = max(2, len(columns))
    size = (
        2 * _MARGIN + across * _WIDTH + (across - 1) * _GAP,
        _HEAD + sum(heights) + len(rows) * _CAPTION + _FOOT,
    )
    sheet = Image.new("RGB", size, _PAPER)
    pen = ImageDraw.Draw(sheet)
    for column, name in enumerate(columns):
        pen.text((_left(column), _HEAD - 30), TITLES[name], fill=_INK, font=_font(19))
    top = _HEAD
    for row, height in zip(rows, heights, strict=True):
        for name, picture in row.pictures.items():
            sheet.paste(picture, (_left(columns.index(name)), top))
        pen.text((_MARGIN, top + height + 6), row.caption, fill=_FAINT, font=_font(15))
        top += height + _CAPTION
    _legends(sheet, pen, size[1] - _FOOT + 14, near_m, far_m, columns)
    return sheet


def _legends(
    sheet: Image.Image,
    pen: ImageDraw.ImageDraw,
    top: int,
    near_m: float,
    far_m: float,
    columns: Sequence[str],
) -> None:
    from PIL import Image

    left = float(_MARGIN)
    if "class" in columns:
        for organ_class, colour in zip(OrganClass, CLASS_COLOURS, strict=True):
            pen.rounded_rectangle((left, top + 4, left + 18, top + 22), 4, fill=colour, outline=_FAINT)
            name = organ_class.name.lower()
            pen.text((left + 25, top + 2), name, fill=_INK, font=_font(16))
            left += 25 + pen.textlength(name, font=_font(16)) + 22
    if "distance" in columns:
        ramp = np.linspace(near_m, far_m, 200)[None].repeat(18, axis=0)
        right = sheet.width - _MARGIN - 200 - 60
        sheet.paste(Image.fromarray(distance_colours(ramp, near_m, far_m)), (right, top + 4))
        pen.text((right - 8, top + 2), f"{near_m:.2f} m", fill=_INK, font=_font(16), anchor="ra")
        pen.text((right + 208, top + 2), f"{far_m:.2f} m", fill=_INK, font=_font(16))


def _left(column: int) -> int:
    return _MARGIN + column * (_WIDTH + _GAP)


def _font(size: int) -> Any:
    """Pillow's own font, so that the sheet looks the same everywhere."""
    from PIL import ImageFont

    return ImageFont.load_default(size)

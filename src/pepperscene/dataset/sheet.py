"""The contact sheet: a row of pictures for each frame, with what one needs to read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.display import View, distance_colours

if TYPE_CHECKING:
    from PIL import Image, ImageDraw


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

TITLES: Final = {
    "colour": "Colour", "class": "Class", "instance": "Organ instance", "distance": "Distance along the ray",
}  # fmt: skip


def contact_sheet(views: Sequence[View], near_m: float, far_m: float) -> Image.Image:
    """All views below each other, their pictures side by side; legends for class and distance at the foot."""
    from PIL import Image, ImageDraw

    columns = [name for name in TITLES if any(name in view.pictures for view in views)]
    first = next((image for view in views for image in view.pictures.values()), None)
    ratio = 0.75 if first is None else first.shape[0] / first.shape[1]
    height = round(_WIDTH * ratio)
    across = max(2, len(columns))
    size = (
        2 * _MARGIN + across * _WIDTH + (across - 1) * _GAP,
        _HEAD + len(views) * (height + _CAPTION) + _FOOT,
    )
    sheet = Image.new("RGB", size, _PAPER)
    pen = ImageDraw.Draw(sheet)
    for column, name in enumerate(columns):
        pen.text((_left(column), _HEAD - 30), TITLES[name], fill=_INK, font=_font(19))
    for row, view in enumerate(views):
        top = _HEAD + row * (height + _CAPTION)
        for name, picture in view.pictures.items():
            # Labels must not be blended: a mixed colour would be another class.
            way = Image.Resampling.LANCZOS if name == "colour" else Image.Resampling.NEAREST
            small = Image.fromarray(picture).resize((_WIDTH, height), way)
            sheet.paste(small, (_left(columns.index(name)), top))
        pen.text((_MARGIN, top + height + 6), caption(view.index, view.facts), fill=_FAINT, font=_font(15))
    _legends(sheet, pen, size[1] - _FOOT + 14, near_m, far_m, columns)
    return sheet


def caption(index: int, facts: dict[str, Any]) -> str:
    """What a frame is, in one line."""
    place = f"frame {index:06d} · set {facts['set']} · rotation {facts['rotation']} · step {facts['step']}"
    pose = facts.get("camera", {}).get("pose")
    return f"{place} · camera at {pose[2][3]:.2f} m" if pose else place


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

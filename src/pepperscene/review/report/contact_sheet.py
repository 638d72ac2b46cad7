"""The contact sheet of a report: the panels of its images below each other, as one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.camera.sensor.indices import INDICES
from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.review.report.colours import distance_colours
from pepperscene.review.report.image_view import TITLES, ImageView

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

MAX_ROWS: Final = 24
"""Chosen: image viewers do not open much taller sheets."""

# Layout of the contact sheet in pixels; chosen so that four panels fill a wide screen.
_PANEL_WIDTH: Final = 440
_GAP: Final = 10
_MARGIN: Final = 28
_CAPTION_HEIGHT: Final = 34
_HEADER_HEIGHT: Final = 44
_FOOTER_HEIGHT: Final = 70
_PAPER: Final = (22, 24, 29)
_INK: Final = (236, 238, 242)
_FAINT: Final = (150, 156, 168)


@dataclass(frozen=True, eq=False)
class SheetRow:
    """Panels of an image in the size of the contact sheet, and the caption below them."""

    panels: dict[str, Image.Image]
    caption: str


def sheet_row(view: ImageView) -> SheetRow:
    """The row of an image in the contact sheet."""
    from PIL import Image

    panels = {}
    for key, panel in view.panels.items():
        # Labels must not be blended: a mixed colour would be another class.
        resampling = Image.Resampling.LANCZOS if key in ("colour", *INDICES) else Image.Resampling.NEAREST
        size = (_PANEL_WIDTH, round(_PANEL_WIDTH * panel.shape[0] / panel.shape[1]))
        panels[key] = Image.fromarray(np.ascontiguousarray(panel)).resize(size, resampling)
    return SheetRow(panels, " · ".join(part for part in (view.title, view.location) if part))


def contact_sheet(rows: Sequence[SheetRow], near_m: float, far_m: float) -> Image.Image:
    """All rows below each other, with legends for class and distance in the footer."""
    from PIL import Image, ImageDraw

    columns = [key for key in TITLES if any(key in row.panels for row in rows)]
    heights = [max((panel.height for panel in row.panels.values()), default=0) for row in rows]
    width = 2 * _MARGIN + max(2, len(columns)) * (_PANEL_WIDTH + _GAP) - _GAP
    height = _HEADER_HEIGHT + sum(heights) + len(rows) * _CAPTION_HEIGHT + _FOOTER_HEIGHT
    sheet = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    lefts = {key: _MARGIN + number * (_PANEL_WIDTH + _GAP) for number, key in enumerate(columns)}
    for key, left in lefts.items():
        draw.text((left, _HEADER_HEIGHT - 30), TITLES[key], fill=_INK, font=_font(19))
    top = _HEADER_HEIGHT
    for row, row_height in zip(rows, heights, strict=True):
        for key, panel in row.panels.items():
            sheet.paste(panel, (lefts[key], top))
        draw.text((_MARGIN, top + row_height + 6), row.caption, fill=_FAINT, font=_font(15))
        top += row_height + _CAPTION_HEIGHT
    _draw_legends(sheet, draw, columns, near_m, far_m)
    return sheet


def _draw_legends(
    sheet: Image.Image, draw: ImageDraw.ImageDraw, columns: Sequence[str], near_m: float, far_m: float
) -> None:
    from PIL import Image

    top, left, font = sheet.height - _FOOTER_HEIGHT + 14, float(_MARGIN), _font(16)
    if "class" in columns:
        for organ_class, colour in zip(OrganClass, CLASS_COLOURS, strict=True):
            draw.rounded_rectangle((left, top + 4, left + 18, top + 22), 4, fill=colour, outline=_FAINT)
            name = organ_class.name.lower()
            draw.text((left + 25, top + 2), name, fill=_INK, font=font)
            left += 25 + draw.textlength(name, font=font) + 22
    if "distance" in columns:
        ramp = np.linspace(near_m, far_m, 200)[None].repeat(18, axis=0)
        right = sheet.width - _MARGIN - 200 - 60
        sheet.paste(Image.fromarray(distance_colours(ramp, near_m, far_m)), (right, top + 4))
        draw.text((right - 8, top + 2), f"{near_m:.2f} m", fill=_INK, font=font, anchor="ra")
        draw.text((right + 208, top + 2), f"{far_m:.2f} m", fill=_INK, font=font)


def _font(size: int) -> Any:
    """Pillow's default font, so that the sheet is the same on every machine."""
    from PIL import ImageFont

    return ImageFont.load_default(size)

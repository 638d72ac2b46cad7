"""Colours, layout and titles that the charts of a comparison share."""

from __future__ import annotations

from collections.abc import Sized
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.figure import SubFigure

COLOURS: Final = ("#00796b", "#d1500f")  # of the first and the second set
DASHES: Final = ("-", (0, (4, 2)))
COLUMNS: Final = 4  # chosen: charts in a row


def add_title(part: SubFigure, title: str) -> float:
    """Add a section's title; return the height of the section in inches."""
    height = float(part.bbox.height / part.figure.dpi)
    part.text(0.04, 1.0 - 0.1 / height, title, va="top", fontsize=12, fontweight="bold")
    return height


def count_rows(kinds: Sized) -> int:
    """Rows of charts, one chart for each kind."""
    return -(-len(kinds) // COLUMNS)


def shorten_name(name: str, limit: int = 12) -> str:
    """A name of at most `limit` letters."""
    return name if len(name) <= limit else name[: limit - 1] + "…"

"""A drawing of a plant from the side, for notebooks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import OrganForm

_HEIGHT_PX: Final = 480  # chosen: a plant of four metres is then legible in a notebook
_MARGIN_M: Final = 0.1  # chosen: half of a large leaf
_BLADE: Final = 0.4  # chosen: drawn part of a blade's width, because most blades are seen at an angle
_STROKES: Final[dict[OrganForm, tuple[str, float]]] = {
    "internode": ("#6b8e4e", 8.0),
    "node": ("#6b8e4e", 10.0),
    "stalk": ("#86ab5f", 4.0),
    "blade": ("#2e7d32", 0.0),
    "peduncle": ("#4f7d3a", 6.0),
    "calyx": ("#4f7d3a", 8.0),
    "fruit": ("#c62828", 0.0),
    "flower": ("#dddddd", 12.0),
}
"""Chosen: colour and width in millimetres of the strokes of each form; 0 for the organ's own width."""


_RIPE: Final = 0.5  # chosen: ripeness from which fruit is drawn in its ripe colour
_UNRIPE: Final = "#33691e"


DrawnOrgan = tuple[OrganForm, NDArray[np.float64], Mapping[str, float]]
"""Form, centreline `(k, 3)` in metres, and measures of an organ."""


def plant_svg(organs: Sequence[DrawnOrgan]) -> str:
    """SVG of the centrelines of all organs, seen along y: blades and fruit about as wide as they are."""
    points = np.concatenate([np.zeros((1, 3)), *(curve for _, curve, _ in organs)])
    left, bottom = points[:, 0].min() - _MARGIN_M, points[:, 2].min() - _MARGIN_M
    width, height = np.ptp(points[:, 0]) + 2 * _MARGIN_M, np.ptp(points[:, 2]) + 2 * _MARGIN_M
    # Millimetres, y downwards.
    lines = "".join(_organ_line(*organ, left, bottom + height) for organ in organs)
    return (
        f'<svg height="{_HEIGHT_PX}" viewBox="0 0 {1e3 * width:.0f} {1e3 * height:.0f}" '
        f'xmlns="http://www.w3.org/2000/svg" fill="none" stroke-linecap="round">{lines}</svg>'
    )


def _organ_line(
    form: OrganForm, curve: NDArray[np.float64], measures: Mapping[str, float], left: float, top: float
) -> str:
    colour, width_mm = _STROKES.get(form, ("#888888", 4.0))
    if width_mm == 0.0:
        width_mm = 1e3 * measures.get("diameter_m", _BLADE * measures.get("width_m", 0.01))
    if measures.get("ripeness", 1.0) < _RIPE:
        colour = _UNRIPE
    x, y = 1e3 * (curve[:, 0] - left), 1e3 * (top - curve[:, 2])
    path = " ".join(f"{a:.0f},{b:.0f}" for a, b in zip(x, y, strict=True))
    return f'<polyline points="{path}" stroke="{colour}" stroke-width="{width_mm:.0f}" stroke-opacity="0.7"/>'

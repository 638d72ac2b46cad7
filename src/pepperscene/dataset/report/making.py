"""How the frames were made: timings and errors, as the build and the frames tell them."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from pepperscene.dataset.report.charts import value_chart
from pepperscene.dataset.report.records import Records
from pepperscene.dataset.report.sections import name_of, plural
from pepperscene.dataset.report.side import Side

_CHARTS = (
    ("render_s", "Time to render a frame", "seconds", 1.0),
    ("write_s", "Time to write a frame", "seconds", 1.0),
    ("error_codes", "Error of the traced light, estimated", "8-bit codes, root mean square", 1.0),
    ("samples_per_pixel", "Samples of light in a pixel", "mean over the frame", 1.0),
    ("bytes", "Size of a frame's files", "MB", 1e-6),
)
"""Column of the manifest, what it is called, its unit, and how many of that unit one is."""


def making(sides: Sequence[Side]) -> str:
    """Distributions of timings, errors and sizes over all frames."""
    told = [(side, side.records) for side in sides if side.records is not None]
    panels = [panel for chart in _CHARTS if (panel := _panel(told, *chart))]
    totals = "".join(f'<p class="note">{name_of(side)} {_totals(records)}</p>' for side, records in told)
    return f'{totals}<div class="grid">{"".join(panels)}</div>'


def _panel(told: Sequence[tuple[Side, Records]], column: str, title: str, unit: str, scale: float) -> str:
    values = [
        (side, records.indices[known], scale * records.numbers[column][known])
        for side, records in told
        if (known := records.known(column)).any()
    ]
    if not values:
        return ""
    chart = value_chart(
        f"made-{column}", title, [(side.key, side.name, some) for side, _, some in values], unit
    )
    lines = []
    for side, indices, some in values:
        low, middle, high = np.percentile(some, (5, 50, 95))
        worst = int(np.argmax(some))
        lines.append(
            f"{name_of(side)} median <b>{middle:.3g}</b>, nine of ten from {low:.3g} to {high:.3g}, "
            f"most {some[worst]:.3g} in frame {indices[worst]:06d}"
        )
    return f'<section class="panel"><h3>{escape(title)}</h3>{chart}<p>{"<br>".join(lines)}</p></section>'


def _totals(records: Records) -> str:
    size = np.nansum(records.numbers["bytes"])
    parts = [f"{plural(len(records.indices), 'frame')}, {_size(float(size))} of files"]
    if records.known("render_s").any():
        seconds = float(np.nansum(records.numbers["render_s"]))
        by = f" by {plural(len(records.workers), 'worker')}" if records.workers else ""
        parts.append(f"{_duration(seconds)} of rendering{by}")
    if records.known("error_codes").any() and records.known("noise_codes").any():
        share = np.nanmedian(records.numbers["error_codes"] / records.numbers["noise_codes"])
        parts.append(f"the light's error is {100 * share:.0f} % of the sensor's noise (median)")
    return "; ".join(parts) + "."


def _size(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count / 1e3:.3g} kB"


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"

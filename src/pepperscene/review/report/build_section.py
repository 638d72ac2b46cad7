"""The section of a report on a build: distributions of times, errors and sizes of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pepperscene.durations import format_duration
from pepperscene.review.report.charts import value_chart
from pepperscene.review.report.data import FrameRecords, SetSummary
from pepperscene.review.report.markup import Html, element, fragment, joined
from pepperscene.review.report.sections import panel, plural, set_label

_BUILD_CHARTS: Final = (
    ("render_s", "Render time of a frame", "seconds", 1.0),
    ("write_s", "Write time of a frame", "seconds", 1.0),
    ("error_codes", "Estimated error of the traced light", "8-bit codes, root mean square", 1.0),
    ("samples_per_pixel", "Samples per pixel", "mean over the frame", 1.0),
    ("bytes", "File size of a frame", "MB", 1e-6),
)
"""Column of the manifest, title, unit, and factor to that unit."""


def build_html(sets: Sequence[SetSummary]) -> Html:
    """Distributions of timings, errors and sizes of all frames."""
    known = [(item, item.records) for item in sets if item.records is not None]
    panels = [_build_panel(known, *chart) for chart in _BUILD_CHARTS]
    totals = (element("p", set_label(item), " ", _totals(records), class_="note") for item, records in known)
    return fragment(*totals, element("div", *panels, class_="grid"))


def _build_panel(
    sets: Sequence[tuple[SetSummary, FrameRecords]], column: str, title: str, unit: str, factor: float
) -> Html:
    values = [
        (item, records.indices[known], factor * records.numbers[column][known])
        for item, records in sets
        if (known := records.known(column)).any()
    ]
    if not values:
        return fragment()
    chart = value_chart(
        f"build-{column}", title, [(item.key, item.name, numbers) for item, _, numbers in values], unit
    )
    lines = []
    for item, indices, numbers in values:
        low, middle, high = np.percentile(numbers, (5, 50, 95))
        highest = int(np.argmax(numbers))
        lines.append(
            fragment(
                set_label(item), " median ", element("b", f"{middle:.3g}"),
                f", 90 % from {low:.3g} to {high:.3g}, "
                f"maximum {numbers[highest]:.3g} in frame {indices[highest]:06d}",
            )
        )  # fmt: skip
    return panel(title, chart, element("p", joined(lines, element("br"))))


def _totals(records: FrameRecords) -> str:
    size = float(np.nansum(records.numbers["bytes"]))
    parts = [f"{plural(len(records.indices), 'frame')}, {_format_size(size)} of files"]
    if records.known("render_s").any():
        seconds = float(np.nansum(records.numbers["render_s"]))
        by = f" by {plural(len(records.workers), 'worker')}" if records.workers else ""
        parts.append(f"{format_duration(seconds)} of rendering{by}")
    if records.known("error_codes").any() and records.known("noise_codes").any():
        ratio = np.nanmedian(records.numbers["error_codes"] / records.numbers["noise_codes"])
        parts.append(f"the light's error is {100 * ratio:.0f} % of the sensor's noise (median)")
    return "; ".join(parts) + "."


def _format_size(count: float) -> str:
    unit, size = next((pair for pair in (("GB", 1e9), ("MB", 1e6)) if count >= pair[1]), ("kB", 1e3))
    return f"{count / size:.3g} {unit}"

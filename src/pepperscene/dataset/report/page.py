"""The report's web page: one file with its style, its script and its pictures inside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from string import Template
from typing import Any

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.dataset.report.charts import value_chart
from pepperscene.dataset.report.colours import VIRIDIS
from pepperscene.dataset.report.data import FrameRecords, Side
from pepperscene.dataset.report.sections import (
    class_places,
    class_shares,
    hue_spectra,
    light,
    name_of,
    plural,
    swatch,
)

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


def _panel(
    told: Sequence[tuple[Side, FrameRecords]], column: str, title: str, unit: str, scale: float
) -> str:
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


def _totals(records: FrameRecords) -> str:
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


def page(about: Mapping[str, Any], sides: Sequence[Side], near_m: float | None, far_m: float | None) -> str:
    """The page as HTML.

    Args:
        about: the data set's `dataset.json`.
        sides: the data set, and the one beside it if there is one.
        near_m: distance shown brightest, None where no picture has distances.
        far_m: distance shown darkest.
    """
    recipe = about["recipe"]
    return Template(_part("page.html")).substitute(
        style=Template(_part("page.css")).substitute(ramp=", ".join(VIRIDIS)),
        script=_part("page.js"),
        name=escape(str(recipe["name"])),
        cultivar=escape(str(recipe["cultivar"])),
        summary=_summary(recipe, sides),
        facts=_facts(about),
        classes=" ".join(f"<span>{swatch(one)}{one.name.lower()}</span>" for one in OrganClass),
        distances=_distances(near_m, far_m),
        frames="".join(_frames(side, alone=len(sides) == 1) for side in sides),
        shares=class_shares(sides),
        measured=_measured(sides),
        places=class_places(sides),
        hues=hue_spectra(sides),
        light=light(sides),
        making=making(sides),
    )


def _part(name: str) -> str:
    return resources.files("pepperscene.dataset.report").joinpath(name).read_text(encoding="utf-8")


def _summary(recipe: Mapping[str, Any], sides: Sequence[Side]) -> str:
    total = recipe["plan"]["sets"] * recipe["plan"]["rotations"] * recipe["plan"]["frames"]
    parts = [f"{sides[0].frames:,} of {total:,} planned frames are built."]
    parts += [f"Beside it: {name_of(side)}, {plural(side.frames, 'picture')}." for side in sides[1:]]
    return " ".join(parts)


def _facts(about: Mapping[str, Any]) -> str:
    recipe = about["recipe"]
    daylight = recipe["daylight"] or {"illuminance_lx": 0}
    items = {
        "Quality": about["quality"],
        "Seed": recipe["seed"],
        "Plan": "{sets} sets × {rotations} rotations × {frames} steps".format(**recipe["plan"]),
        "Rows": "{plants_front} + {plants_back} plants, {spacing_mm:g} mm apart".format(**recipe["row"]),
        "Exposure": f"{recipe['camera']['exposure_us']:g} µs",
        "Daylight": f"{daylight['illuminance_lx']:,.0f} lx",
        "Version": about["version"],
        "Recipe SHA-256": about["recipe_sha256"][:12] + "…",
    }
    return "".join(f"<div><dt>{k}</dt><dd>{escape(str(v))}</dd></div>" for k, v in items.items())


def _distances(near_m: float | None, far_m: float | None) -> str:
    if near_m is None or far_m is None:
        return ""
    return f'<p class="ramp"><span>{near_m:.2f} m</span><i class="back"></i><span>{far_m:.2f} m</span></p>'


def _frames(side: Side, alone: bool) -> str:
    """The pictures shown of a set, and the same as a table."""
    several = (
        f"{len(side.cards):,} of {side.frames:,}" if len(side.cards) < side.frames else f"{side.frames:,}"
    )
    head = "" if alone else f"<h3>{name_of(side)}</h3>"
    columns = ["", "set", "rotation", "step", "height, m", "error, codes"]
    columns += [f"{one.name.lower()}, %" for one in OrganClass]
    heads = "".join(f'<th scope="col">{name}</th>' for name in columns)
    return (
        f'{head}<p>{several} shown.</p><div class="cards">{"".join(side.cards)}</div>'
        f"<details><summary>As a table{'' if alone else f': {escape(side.name)}'}</summary>"
        f'<div class="scroll" tabindex="0" role="region" aria-label="Pictures of {escape(side.name)}">'
        f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(side.lines)}</tbody></table></div></details>"
    )


def _measured(sides: Sequence[Side]) -> str:
    """Of how many pictures the measures of their images are."""
    parts = []
    for side in sides:
        some, every = side.statistics.pictures, side.frames
        parts.append(f"all {every:,} of {name_of(side)}" if some == every else
                     f"{some:,} of {every:,} of {name_of(side)}, evenly spread")  # fmt: skip
    return f"Measured in {' and '.join(parts)}."

"""Figs. 10 to 13 of Barth et al. 2018, saturation and power spectra of two sets in one figure."""

from __future__ import annotations

import io
import textwrap
from typing import TYPE_CHECKING, Final

import numpy as np

from pepperscene.colour.comparison import similarity
from pepperscene.colour.comparison.chart_style import (
    COLOURS,
    COLUMNS,
    DASHES,
    add_title,
    count_rows,
    shorten_name,
)
from pepperscene.colour.comparison.class_charts import draw_fractions, draw_masks
from pepperscene.colour.comparison.image_charts import draw_appearance, draw_light
from pepperscene.colour.comparison.missing import missing_parts
from pepperscene.colour.comparison.result import Comparison, KindComparison
from pepperscene.colour.comparison.scale_text import describe_scale
from pepperscene.colour.comparison.tables import format_estimate
from pepperscene.colour.statistics import bin_angles
from pepperscene.truth import HUE_BINS

if TYPE_CHECKING:
    from matplotlib.figure import SubFigure

_LINE_IN: Final = 0.17  # chosen: height of a line of notes
_NOTE_LETTERS: Final = 190  # chosen: as many as fit into the width
_WIDTH_IN: Final = 13.0
_DPI: Final = 150  # of PNG files, and of the images in an SVG
_STYLE: Final = {
    "svg.fonttype": "none",  # text stays text
    "text.parse_math": False,  # names of sets and kinds may hold dollar signs
    "svg.hashsalt": "pepperscene",  # the same comparison gives the same bytes
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xaxis.labellocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dde1d6",
}


def comparison_figure(comparison: Comparison, file_format: str = "svg") -> bytes:
    """Draw the comparison as one figure, with the parts for which there is data.

    Args:
        comparison: of two sets.
        file_format: "svg" or "png".

    Returns:
        The content of the file; the same comparison gives the same bytes.
    """
    import matplotlib
    from matplotlib.figure import Figure

    classes, kinds = comparison.labelled_classes, comparison.coloured_kinds
    notes = _heading_notes(comparison)
    # Height in inches and drawing function of each section.
    sections = [(0.75 + _LINE_IN * len(notes), lambda part: _draw_heading(part, comparison, notes))]
    if classes:
        sections.append((1.1 + 0.38 * len(classes), lambda part: draw_fractions(part, comparison, classes)))
        sections.append((0.8 + 1.6 * count_rows(classes), lambda part: draw_masks(part, comparison, classes)))
    if kinds:
        sections.append((0.5 + 2.2 * count_rows(kinds), lambda part: _draw_hues(part, comparison, kinds)))
    if comparison.light.first.value is not None and comparison.light.second.value is not None:
        sections.append((3.2, lambda part: draw_light(part, comparison)))
        sections.append((3.0, lambda part: draw_appearance(part, comparison)))

    with matplotlib.rc_context(_STYLE):
        heights = [height for height, _ in sections]
        figure = Figure(figsize=(_WIDTH_IN, sum(heights)))
        parts = figure.subfigures(len(sections), squeeze=False, height_ratios=heights, hspace=0.0)
        for part, (_, draw) in zip(parts[:, 0], sections, strict=True):
            draw(part)
        file = io.BytesIO()
        metadata = {"Date": None} if file_format == "svg" else {"Software": None}
        figure.savefig(file, format=file_format, dpi=_DPI, metadata=metadata)
    return file.getvalue()


def _heading_notes(comparison: Comparison) -> list[str]:
    """Lines on the size of the images, the scale of the comparison, and what is missing."""
    notes = []
    for side in (comparison.first, comparison.second):
        if side.has_images:
            size, centre, texture = describe_scale(side)
            name = shorten_name(side.name, 45)
            notes.append(f"{name}: {size} pixels; hues and CIELAB: {centre}; saturation, texture: {texture}")
    for sentence in missing_parts(comparison.first, comparison.second):
        notes += textwrap.wrap(f"{sentence}.", _NOTE_LETTERS)
    return notes


def _draw_heading(part: SubFigure, comparison: Comparison, notes: list[str]) -> None:
    from matplotlib.lines import Line2D

    height = float(part.bbox.height / part.figure.dpi)
    sides = (comparison.first, comparison.second)
    title = " and ".join(shorten_name(side.name, 45) for side in sides)
    part.text(0.04, 1.0 - 0.2 / height, title, fontsize=15, fontweight="bold", va="center")
    handles = []
    for side, colour, dashes in zip(sides, COLOURS, DASHES, strict=True):
        noun = "images" if side.has_images else "images and spectra of the patches"
        label = f"{shorten_name(side.name, 45)}: {side.units:,} of {side.available:,} {noun}"
        handles.append(Line2D([], [], color=colour, linestyle=dashes, linewidth=2.5, label=label))
    anchor = (0.03, 1.0 - 0.35 / height)
    part.legend(handles=handles, loc="upper left", bbox_to_anchor=anchor, ncols=2, frameon=False)
    for line, note in enumerate(notes):
        part.text(0.04, 1.0 - (0.78 + _LINE_IN * line) / height, note, va="center")


def _draw_hues(part: SubFigure, comparison: Comparison, kinds: list[KindComparison]) -> None:
    """Fig. 12: both hue spectra of each kind, with their similarity below."""
    mean = comparison.hue_correlation
    note = "" if mean.value is None else f" (mean correlation over plant parts: r = {format_estimate(mean)})"
    height = add_title(part, f"Fig. 12: hues of each kind, in the centre of the images{note}")
    edges = {"left": 0.06, "right": 0.97, "top": 1 - 0.65 / height, "bottom": 0.85 / height}
    grid = part.add_gridspec(count_rows(kinds), COLUMNS, **edges, hspace=0.95, wspace=0.28)
    for position, kind in enumerate(kinds):
        axes = part.add_subplot(grid[divmod(position, COLUMNS)])
        for side, colour, dashes in zip((comparison.first, comparison.second), COLOURS, DASHES, strict=True):
            if (sums := side.totals(kind.kind)) is not None:
                spectrum = similarity.hue_spectra(sums[:1])[0]
                axes.plot(bin_angles(HUE_BINS), spectrum, color=colour, linestyle=dashes, linewidth=1.3)
        axes.set(title=kind.kind, ylabel="% of its pixels", xlim=(0.0, 360.0), xticks=range(0, 361, 60))
        axes.set_ylim(bottom=0.0)
        axes.grid(axis="y")
        axes.tick_params(axis="x", length=0, pad=9)
        strip = axes.inset_axes((0.0, -0.08, 1.0, 0.05))
        strip.imshow(np.linspace(0.0, 1.0, 361)[None], cmap="hsv", aspect="auto")
        strip.set_axis_off()
        axes.set_xlabel(f"hue, degrees\n{_describe_hues(kind)}")


def _describe_hues(kind: KindComparison) -> str:
    if kind.hue_correlation.value is None:
        return textwrap.fill(f"not compared: {kind.hue_correlation.why}", 50)
    correlation, emd = format_estimate(kind.hue_correlation), format_estimate(kind.hue_emd_deg, 0)
    colours = f"CIEDE2000 of the mean colours {format_estimate(kind.delta_e_2000, 1)}"
    return f"r = {correlation}, EMD {emd}°\n{colours}"

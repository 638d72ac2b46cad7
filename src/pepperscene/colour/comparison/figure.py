"""Figs. 10 to 13 of Barth et al. 2018, saturation and power spectra of two sets in one figure."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence, Sized
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.colour.appearance import spectrum_frequencies
from pepperscene.colour.comparison import similarity
from pepperscene.colour.comparison.appearance import (
    SATURATION_BINS,
    SATURATION_WIDTH,
    SATURATIONS,
    WHOLE,
    mean_power_spectrum,
)
from pepperscene.colour.comparison.bootstrap import Estimate
from pepperscene.colour.comparison.measure import CELLS
from pepperscene.colour.comparison.result import Comparison, KindComparison
from pepperscene.colour.comparison.tables import describe_scale, format_estimate, missing_parts
from pepperscene.colour.statistics import bin_angles
from pepperscene.truth import HUE_BINS, centre_falloff

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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
_RINGS: Final = 40  # chosen: each 12 pixels wide in an image of 800 x 600
_CYCLES: Final = (0.02, 0.05, 0.1)  # ticks, of wavelengths from 64 to 6 pixels
_BY_INTEREST: Final = (WHOLE, *(organ.name.lower() for organ in OrganClass if organ), "background")
"""Kinds in the order in which their saturation is shown: whole images and leaves, if both sets show them."""
COLOURS: Final = ("#00796b", "#d1500f")  # of the first and the second set
DASHES: Final = ("-", (0, (4, 2)))
COLUMNS: Final = 4  # chosen: charts in a row


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
    for side in comparison.sides:
        if side.has_images:
            size, centre, texture = describe_scale(side)
            name = shorten_name(side.name, 45)
            notes.append(f"{name}: {size} pixels; hues and CIELAB: {centre}; saturation, texture: {texture}")
    for sentence in missing_parts(*comparison.sides):
        notes += textwrap.wrap(f"{sentence}.", _NOTE_LETTERS)
    return notes


def _draw_heading(part: SubFigure, comparison: Comparison, notes: list[str]) -> None:
    from matplotlib.lines import Line2D

    height, sides = _height_in(part), comparison.sides
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
        for side, colour, dashes in zip(comparison.sides, COLOURS, DASHES, strict=True):
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


def draw_fractions(part: SubFigure, comparison: Comparison, kinds: list[KindComparison]) -> None:
    """Fig. 10: bars with their intervals and numbers."""
    height = add_title(part, "Fig. 10: fraction of each class that both sets label, in whole images")
    axes = part.add_axes((0.11, 0.55 / height, 0.74, 1 - 1.0 / height))
    for row, kind in enumerate(kinds):
        _draw_bar(axes, row - 0.19, kind.first.share, COLOURS[0])
        _draw_bar(axes, row + 0.19, kind.second.share, COLOURS[1])
    axes.set_yticks(range(len(kinds)), [kind.kind for kind in kinds])
    axes.set_ylim(len(kinds) - 0.5, -0.5)
    axes.set_xlim(left=0.0)
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(length=0)
    axes.set_xticks([])
    correlation = comparison.share_correlation
    text = f"r = {format_estimate(correlation, 3)}" if correlation.value is not None else correlation.why
    axes.set_xlabel(f"correlation of the class fractions: {text}")


def _draw_bar(axes: Axes, y: float, fraction: Estimate, colour: str) -> None:
    if fraction.value is None:
        return
    end, text = 100.0 * fraction.value, f"{format_estimate(fraction, 2, 100.0)} %"
    axes.barh(y, end, height=0.36, color=colour)
    if fraction.low is not None and fraction.high is not None:
        end = 100.0 * fraction.high
        axes.plot([100.0 * fraction.low, end], [y, y], color="black", linewidth=1.0)
    axes.annotate(text, (end, y), (5, 0), textcoords="offset points", va="center")


def draw_masks(part: SubFigure, comparison: Comparison, kinds: list[KindComparison]) -> None:
    """Fig. 11: a pair of mean masks for each class, and their maxima below."""
    height = add_title(part, "Fig. 11: mean masks in whole images, over their maxima, drawn in one shape")
    edges = {"left": 0.04, "right": 0.97, "top": 1 - 0.6 / height, "bottom": 0.75 / height}
    grid = part.add_gridspec(count_rows(kinds), 2 * COLUMNS, **edges, hspace=0.65, wspace=0.12)
    sides = comparison.sides
    all_masks = [side.statistics.mean_masks() for side in sides]
    for position, kind in enumerate(kinds):
        for index, masks in enumerate(all_masks):
            axes = part.add_subplot(grid[divmod(2 * position + index, 2 * COLUMNS)])
            # Positions are compared in one grid, whatever the shape of the images.
            axes.set(xticks=[], yticks=[], box_aspect=CELLS[0] / CELLS[1])
            axes.spines[:].set_visible(False)
            mask = None if masks is None else masks[OrganClass[kind.kind.upper()]]
            if mask is None or mask.max() == 0.0:
                axes.set(facecolor="#f1f3ee")
                axes.text(0.5, 0.5, "not seen", ha="center", va="center")
            else:
                axes.imshow(mask / mask.max(), cmap="viridis", vmin=0.0, vmax=1.0, aspect="auto")
                maximum = f"{shorten_name(sides[index].name)}: up to {100 * mask.max():.0f} %"
                axes.set_xlabel(maximum, labelpad=2)
            if index == 0:
                axes.set_title(kind.kind)
                text = (
                    f"r = {format_estimate(kind.place_correlation)}, SSIM {format_estimate(kind.place_ssim)}"
                )
                if kind.place_correlation.value is not None:
                    axes.annotate(text, (0, 0), (0, -17), "axes fraction", "offset points", va="top")
    scale = part.add_axes((0.08, 0.18 / height, 0.14, 0.12 / height))
    scale.imshow(np.linspace(0.0, 1.0, 256)[None], cmap="viridis", aspect="auto")
    scale.set_axis_off()
    scale.annotate("never", (0, 0.5), (-5, 0), "axes fraction", "offset points", ha="right", va="center")
    scale.annotate("most often", (1, 0.5), (5, 0), "axes fraction", "offset points", va="center")


def draw_light(part: SubFigure, comparison: Comparison) -> None:
    """Fig. 13: the mean images, and their radial falloff."""
    sides = comparison.sides
    means = [mean for side in sides if (mean := side.statistics.mean_intensity()) is not None]
    # As in the paper, both are brightened by one factor, as far as nothing saturates.
    brightest = max(float(np.percentile(mean, 99.5)) for mean in means)
    factor = max(1.0, float(np.floor(10.0 * 255.0 / max(1.0, brightest)) / 10.0))
    note = f", shown {factor:g} times as bright" if factor > 1.0 else ""
    add_title(part, f"Fig. 13: mean intensity of whole images{note}")
    grid = part.add_gridspec(1, 3, left=0.04, right=0.97, top=0.82, bottom=0.22, wspace=0.12)
    light, falloff = comparison.light, part.add_subplot(grid[2])
    for index, mean in enumerate(means):
        axes = part.add_subplot(grid[index])
        axes.imshow(factor * mean, cmap="gray", vmin=0.0, vmax=255.0)
        axes.set(title=shorten_name(sides[index].name, 45), xticks=[], yticks=[])
        axes.set_xlabel(f"mean {format_estimate((light.first, light.second)[index], 1)} of 255")
        falloff.plot(*_falloff(mean), color=COLOURS[index], linestyle=DASHES[index])
    falloff.set(title="falloff towards the corners", ylabel="grey value", xlim=(0.0, 1.0))
    falloff.set_ylim(bottom=0.0)
    falloff.grid(axis="y")
    text = "distance from the centre (0) to the corners (1)"
    if light.correlation.value is not None:
        text += (
            f"\ncorrelation of the falloff r = {format_estimate(light.falloff_correlation)}\n"
            f"of the mean images r = {format_estimate(light.correlation)}, "
            f"SSIM {format_estimate(light.ssim)}"
        )
    falloff.set_xlabel(text)


def draw_appearance(part: SubFigure, comparison: Comparison) -> None:
    """Saturation of whole images and of a class that both sets show, and the radial power spectrum."""
    add_title(part, "Saturation and power spectrum")
    grid = part.add_gridspec(1, 3, left=0.06, right=0.97, top=0.8, bottom=0.25, wspace=0.28)
    shown = [kind for kind in _BY_INTEREST if all(kind in side.appearance for side in comparison.sides)]
    for column, kind in enumerate(shown[:2]):
        _draw_saturation(part.add_subplot(grid[column]), comparison, kind)
    spectra = [mean_power_spectrum(side.appearance[WHOLE]) for side in comparison.sides]
    if all(spectrum is not None for spectrum in spectra):
        _draw_spectra(part.add_subplot(grid[len(shown[:2])]), comparison, spectra)


def _draw_saturation(axes: Axes, comparison: Comparison, kind: str) -> None:
    """Histograms of saturation of a kind."""
    saturations = (np.arange(SATURATION_BINS) + 0.5) * SATURATION_WIDTH
    for side, colour, dashes in zip(comparison.sides, COLOURS, DASHES, strict=True):
        counts = side.appearance[kind].totals()[0, SATURATIONS]
        axes.plot(saturations, 100.0 * counts / counts.sum(), color=colour, linestyle=dashes)
    axes.set(title=kind, ylabel="% of pixels", xlim=(0.0, 1.5), xlabel="saturation C*/(L*+16)")
    axes.set_ylim(bottom=0.0)
    axes.grid(axis="y")


def _draw_spectra(axes: Axes, comparison: Comparison, spectra: Sequence[NDArray[np.float64] | None]) -> None:
    """Mean power spectra of whole images on logarithmic axes."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    for spectrum, colour, dashes in zip(spectra, COLOURS, DASHES, strict=True):
        axes.loglog(spectrum_frequencies(), spectrum, color=colour, linestyle=dashes)
    # Matplotlib writes powers of ten as formulas, which the style switches off.
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    axes.xaxis.set(major_locator=FixedLocator(_CYCLES), minor_locator=NullLocator(), major_formatter=plain)
    axes.yaxis.set(minor_locator=NullLocator(), major_formatter=plain)
    pair = comparison.appearance[WHOLE]
    slopes = [format_estimate(measures.spectrum_slope) for measures in (pair.first, pair.second)]
    axes.set(title="mean power spectrum of images", ylabel="power")
    axes.set_xlabel(f"cycles per pixel\nslope {' and '.join(slopes)}")


def _falloff(mean: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radii of the rings that contain pixels, and the mean intensity in them."""
    radii = np.linspace(0.0, 1.0, _RINGS + 1)
    rings = centre_falloff(mean, radii)
    filled = np.isfinite(rings)
    return ((radii[1:] + radii[:-1]) / 2.0)[filled], rings[filled]


def add_title(part: SubFigure, title: str) -> float:
    """Add a section's title; return the height of the section in inches."""
    height = _height_in(part)
    part.text(0.04, 1.0 - 0.1 / height, title, va="top", fontsize=12, fontweight="bold")
    return height


def _height_in(part: SubFigure) -> float:
    return float(part.bbox.height / part.figure.dpi)


def count_rows(kinds: Sized) -> int:
    """Rows of charts, one chart for each kind."""
    return -(-len(kinds) // COLUMNS)


def shorten_name(name: str, limit: int = 12) -> str:
    """A name of at most `limit` letters."""
    return name if len(name) <= limit else name[: limit - 1] + "…"

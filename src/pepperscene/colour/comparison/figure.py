"""Figs. 10 to 13 of Barth et al. 2018, saturation and power spectra of two sets in one figure."""

from __future__ import annotations

import io
import textwrap
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
from pepperscene.colour.comparison.result import Comparison, KindComparison
from pepperscene.colour.comparison.tables import format_estimate
from pepperscene.colour.statistics import bin_angles
from pepperscene.truth import HUE_BINS, centre_falloff

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

_COLOURS: Final = ("#00796b", "#d1500f")  # of the first and the second set
_DASHES: Final = ("-", (0, (4, 2)))
_COLUMNS: Final = 4  # chosen: charts in a row
_WIDTH_IN: Final = 13.0
_DPI: Final = 150  # of PNG files, and of the images in an SVG
_RINGS: Final = 40  # chosen: each 12 pixels wide in an image of 800 x 600
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

    kinds = list(comparison.kinds.values())
    classes = [kind for kind in kinds if "." not in kind.kind]
    sides = (comparison.first, comparison.second)
    # Height in inches and drawing function of each section.
    sections = [(0.7, lambda part: _draw_heading(part, comparison))]
    if any(side.share.value is not None for kind in classes for side in (kind.first, kind.second)):
        sections.append((1.1 + 0.38 * len(classes), lambda part: _draw_fractions(part, comparison, classes)))
        sections.append((0.8 + 1.6 * _rows(classes), lambda part: _draw_masks(part, comparison, classes)))
    if kinds:
        sections.append((0.5 + 2.2 * _rows(kinds), lambda part: _draw_hues(part, comparison, kinds)))
    if any(side.statistics.mean_intensity() is not None for side in sides):
        sections.append((3.2, lambda part: _draw_light(part, comparison)))

    if comparison.appearance:
        sections.append((3.0, lambda part: _draw_appearance(part, comparison)))

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


def _draw_heading(part: SubFigure, comparison: Comparison) -> None:
    from matplotlib.lines import Line2D

    sides = (comparison.first, comparison.second)
    title = " and ".join(_shorten(side.name, 45) for side in sides)
    part.text(0.04, 0.7, title, fontsize=15, fontweight="bold", va="center")
    handles = []
    for side, colour, dashes in zip(sides, _COLOURS, _DASHES, strict=True):
        noun = "images" if side.has_images else "images and spectra of the patches"
        label = f"{_shorten(side.name, 45)}: {side.units:,} of {side.available:,} {noun}"
        handles.append(Line2D([], [], color=colour, linestyle=dashes, linewidth=2.5, label=label))
    part.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.03, 0.0), ncols=2, frameon=False)


def _draw_fractions(part: SubFigure, comparison: Comparison, kinds: list[KindComparison]) -> None:
    """Fig. 10: bars with their intervals and numbers."""
    height = _add_title(part, "Fig. 10: fraction of each class in all pixels")
    axes = part.add_axes((0.11, 0.55 / height, 0.74, 1 - 1.0 / height))
    for row, kind in enumerate(kinds):
        _draw_bar(axes, row - 0.19, kind.first.share, _COLOURS[0])
        _draw_bar(axes, row + 0.19, kind.second.share, _COLOURS[1])
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
    end, text = 0.0, fraction.why
    if fraction.value is not None:
        end, text = 100.0 * fraction.value, f"{format_estimate(fraction, 2, 100.0)} %"
        axes.barh(y, end, height=0.36, color=colour)
    if fraction.low is not None and fraction.high is not None:
        end = 100.0 * fraction.high
        axes.plot([100.0 * fraction.low, end], [y, y], color="black", linewidth=1.0)
    axes.annotate(text, (end, y), (5, 0), textcoords="offset points", va="center")


def _draw_masks(part: SubFigure, comparison: Comparison, kinds: list[KindComparison]) -> None:
    """Fig. 11: a pair of mean masks for each class; below, their maximum or the reason why one is missing."""
    height = _add_title(part, "Fig. 11: mean mask of each class, over its maximum")
    edges = {"left": 0.04, "right": 0.97, "top": 1 - 0.6 / height, "bottom": 0.75 / height}
    grid = part.add_gridspec(_rows(kinds), 2 * _COLUMNS, **edges, hspace=0.65, wspace=0.12)
    sides = (comparison.first, comparison.second)
    all_masks = [side.statistics.mean_masks() for side in sides]
    for position, kind in enumerate(kinds):
        for index, side in enumerate((kind.first, kind.second)):
            axes = part.add_subplot(grid[divmod(2 * position + index, 2 * _COLUMNS)])
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
            masks = all_masks[index]
            mask = None if masks is None else masks[OrganClass[kind.kind.upper()]]
            if mask is None or mask.max() == 0.0:
                axes.set(facecolor="#f1f3ee", box_aspect=0.75)
                axes.text(0.5, 0.5, textwrap.fill(side.share.why or "not seen", 22), ha="center", va="center")
            else:
                axes.imshow(mask / mask.max(), cmap="viridis", vmin=0.0, vmax=1.0)
                maximum = f"{_shorten(sides[index].name)}: up to {100 * mask.max():.0f} %"
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


def _draw_hues(part: SubFigure, comparison: Comparison, kinds: list[KindComparison]) -> None:
    """Fig. 12: both hue spectra of each kind, with their similarity below."""
    mean = f"mean correlation over plant parts: r = {format_estimate(comparison.hue_correlation)}"
    height = _add_title(part, f"Fig. 12: hues of each kind, in the centre of the images ({mean})")
    edges = {"left": 0.06, "right": 0.97, "top": 1 - 0.65 / height, "bottom": 0.85 / height}
    grid = part.add_gridspec(_rows(kinds), _COLUMNS, **edges, hspace=0.95, wspace=0.28)
    for position, kind in enumerate(kinds):
        axes = part.add_subplot(grid[divmod(position, _COLUMNS)])
        for side, colour, dashes in zip(
            (comparison.first, comparison.second), _COLOURS, _DASHES, strict=True
        ):
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


def _draw_light(part: SubFigure, comparison: Comparison) -> None:
    """Fig. 13: the mean images, and their radial falloff."""
    sides = (comparison.first, comparison.second)
    means = [side.statistics.mean_intensity() for side in sides]
    # As in the paper, both are brightened by one factor, as far as nothing saturates.
    brightest = max(float(np.percentile(mean, 99.5)) for mean in means if mean is not None)
    factor = max(1.0, float(np.floor(10.0 * 255.0 / max(1.0, brightest)) / 10.0))
    note = f", shown {factor:g} times as bright" if factor > 1.0 else ""
    _add_title(part, f"Fig. 13: mean intensity over all images{note}")
    grid = part.add_gridspec(1, 3, left=0.04, right=0.97, top=0.82, bottom=0.22, wspace=0.12)
    light, falloff = comparison.light, part.add_subplot(grid[2])
    for index, mean in enumerate(means):
        if mean is None:
            continue
        axes = part.add_subplot(grid[index])
        axes.imshow(factor * mean, cmap="gray", vmin=0.0, vmax=255.0)
        axes.set(title=_shorten(sides[index].name, 45), xticks=[], yticks=[])
        axes.set_xlabel(f"mean {format_estimate((light.first, light.second)[index], 1)} of 255")
        falloff.plot(*_falloff(mean), color=_COLOURS[index], linestyle=_DASHES[index])
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


def _draw_appearance(part: SubFigure, comparison: Comparison) -> None:
    """Saturation of whole images and of leaves, and the radial power spectrum."""
    _add_title(part, "Saturation and power spectrum")
    grid = part.add_gridspec(1, 3, left=0.06, right=0.97, top=0.8, bottom=0.25, wspace=0.28)
    saturations = (np.arange(SATURATION_BINS) + 0.5) * SATURATION_WIDTH
    sides = (comparison.first, comparison.second)
    for column, kind in enumerate((WHOLE, OrganClass.LEAF.name.lower())):
        if kind not in comparison.appearance:
            continue
        axes = part.add_subplot(grid[column])
        for side, colour, dashes in zip(sides, _COLOURS, _DASHES, strict=True):
            if kind in side.appearance:
                counts = side.appearance[kind].totals()[0, SATURATIONS]
                axes.plot(saturations, 100.0 * counts / counts.sum(), color=colour, linestyle=dashes)
        axes.set(title=kind, ylabel="% of pixels", xlim=(0.0, 1.5), xlabel="saturation C*/(L*+16)")
        axes.set_ylim(bottom=0.0)
        axes.grid(axis="y")
    axes = part.add_subplot(grid[2])
    slopes = []
    for side, colour, dashes in zip(sides, _COLOURS, _DASHES, strict=True):
        spectrum = mean_power_spectrum(side.appearance[WHOLE]) if WHOLE in side.appearance else None
        if spectrum is not None:
            axes.loglog(spectrum_frequencies(), spectrum, color=colour, linestyle=dashes)
    if WHOLE in comparison.appearance:
        pair = comparison.appearance[WHOLE]
        slopes = [format_estimate(measures.spectrum_slope) for measures in (pair.first, pair.second)]
    axes.set(title="mean power spectrum", ylabel="power")
    axes.set_xlabel(f"cycles per pixel\nslope {' and '.join(slopes)}")


def _falloff(mean: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radii of the rings that contain pixels, and the mean intensity in them."""
    radii = np.linspace(0.0, 1.0, _RINGS + 1)
    rings = centre_falloff(mean, radii)
    filled = np.isfinite(rings)
    return ((radii[1:] + radii[:-1]) / 2.0)[filled], rings[filled]


def _add_title(part: SubFigure, title: str) -> float:
    """Add a section's title; return the height of the section in inches."""
    height = float(part.bbox.height / part.figure.dpi)
    part.text(0.04, 1.0 - 0.1 / height, title, va="top", fontsize=12, fontweight="bold")
    return height


def _rows(kinds: list[KindComparison]) -> int:
    return -(-len(kinds) // _COLUMNS)


def _shorten(name: str, limit: int = 12) -> str:
    return name if len(name) <= limit else name[: limit - 1] + "…"

"""Figs. 10 and 11 of Barth et al. 2018: class fractions and mean masks of two sets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.colour.comparison.bootstrap import Estimate
from pepperscene.colour.comparison.chart_style import COLOURS, COLUMNS, add_title, count_rows, shorten_name
from pepperscene.colour.comparison.measure import CELLS
from pepperscene.colour.comparison.result import Comparison, KindComparison
from pepperscene.colour.comparison.tables import format_estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure


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
    sides = (comparison.first, comparison.second)
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

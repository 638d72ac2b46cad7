"""Fig. 13 of Barth et al. 2018, saturation and power spectra: charts of whole images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.colour.appearance import spectrum_frequencies
from pepperscene.colour.comparison.appearance import (
    SATURATION_BINS,
    SATURATION_WIDTH,
    SATURATIONS,
    WHOLE,
    mean_power_spectrum,
)
from pepperscene.colour.comparison.chart_style import COLOURS, DASHES, add_title, shorten_name
from pepperscene.colour.comparison.measure import SetMeasures
from pepperscene.colour.comparison.result import Comparison
from pepperscene.colour.comparison.tables import format_estimate
from pepperscene.truth import centre_falloff

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

_RINGS: Final = 40  # chosen: each 12 pixels wide in an image of 800 x 600
_CYCLES: Final = (0.02, 0.05, 0.1)  # ticks, of wavelengths from 64 to 6 pixels
_BY_INTEREST: Final = (WHOLE, *(organ.name.lower() for organ in OrganClass if organ), "background")
"""Kinds in the order in which their saturation is shown: whole images and leaves, if both sets show them."""


def draw_light(part: SubFigure, comparison: Comparison) -> None:
    """Fig. 13: the mean images, and their radial falloff."""
    sides = (comparison.first, comparison.second)
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
    shown = [kind for kind in _BY_INTEREST if all(kind in side.appearance for side in _sides(comparison))]
    for column, kind in enumerate(shown[:2]):
        _draw_saturation(part.add_subplot(grid[column]), comparison, kind)
    spectra = [mean_power_spectrum(side.appearance[WHOLE]) for side in _sides(comparison)]
    if all(spectrum is not None for spectrum in spectra):
        _draw_spectra(part.add_subplot(grid[len(shown[:2])]), comparison, spectra)


def _sides(comparison: Comparison) -> tuple[SetMeasures, SetMeasures]:
    return comparison.first, comparison.second


def _draw_saturation(axes: Axes, comparison: Comparison, kind: str) -> None:
    """Histograms of saturation of a kind."""
    saturations = (np.arange(SATURATION_BINS) + 0.5) * SATURATION_WIDTH
    for side, colour, dashes in zip(_sides(comparison), COLOURS, DASHES, strict=True):
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

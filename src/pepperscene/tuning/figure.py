"""Figure of a fit: measured colours, the model's before and after, spectra, scene, and fitted values."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import encode_tone
from pepperscene.camera.image.colorimetry import D65_WHITE, XYZ_TO_SRGB
from pepperscene.colour import ColourStatistics, linear_srgb_to_lab
from pepperscene.spectra import colour_science
from pepperscene.tuning.least_squares import FitResult, KindFit, SpectrumFit
from pepperscene.tuning.report import fitted_entries, format_value, format_with_sd

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

WIDTH_IN: Final = 11.5  # chosen, as all of the layout below: 1380 pixels
DPI: Final = 120
_LEFT, _RIGHT = 0.03, 0.97  # fractions of the width
_MEASURED, _BEFORE, _AFTER = "#222421", "#c4762c", "#267a54"
_STYLE: Final = {
    "text.parse_math": False, "font.size": 9, "axes.titlesize": 9, "axes.titlelocation": "left",
    "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.6, "lines.linewidth": 1.3,
    "legend.frameon": False, "legend.fontsize": 8, "xtick.labelsize": 8, "ytick.labelsize": 8,
}  # fmt: skip
_VISIBILITY: Final = (
    (1.0, "not visible"), (2.0, "barely visible"), (5.0, "slightly different"),
    (10.0, "clearly different"), (np.inf, "another colour"),
)  # fmt: skip
"""CIEDE2000 in words. Chosen: 1 is just visible side by side, and each step is about twice as large."""
_SWATCH: Final = (18, 72)  # rows and columns of a mean colour
_STRIP_ROWS: Final = 8  # of pixels below it
Row = tuple[float, Callable[["SubFigure"], None]]  # height in inches, and function that draws it


@dataclass(frozen=True, eq=False)
class BeforeAfter:
    """The same frame of the whole scene before and after tuning, `(h, w, 3)` sRGB."""

    before: NDArray[np.uint8]
    after: NDArray[np.uint8]


def before_after_png(fit: FitResult, name: str, frames: BeforeAfter | None = None) -> bytes:
    """Return the figure as PNG; the same fit gives the same bytes."""
    import matplotlib.style

    buffer = BytesIO()
    with matplotlib.style.context(["default", _STYLE]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        before_after_figure(fit, name, frames).savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def before_after_figure(fit: FitResult, name: str, frames: BeforeAfter | None = None) -> Figure:
    """Draw the fit of the recipe of this name, with frames of the whole scene or without."""
    from matplotlib.figure import Figure

    spectra = list(fit.spectra.items())
    sentences = dict.fromkeys((*fit.diagnostics, *fit.undetermined))
    lines = [line for sentence in sentences for line in textwrap.wrap(sentence, 150)]
    rows: list[Row] = [(0.7, partial(_draw_title, name=name, kinds=bool(fit.kinds)))]
    rows += [(1.75, partial(_draw_kind, kind=kind, colours=kind_fit)) for kind, kind_fit in fit.kinds.items()]
    rows += [(2.4, partial(_draw_spectra, spectra=spectra[i : i + 2])) for i in range(0, len(spectra), 2)]
    if frames is not None:
        height, width, _ = frames.before.shape
        rows.append((0.4 + 0.47 * WIDTH_IN * height / width, partial(_draw_frames, frames=frames)))
    entries = sum(len(parameter.labels) for parameter in fit.parameters)
    rows.append((0.5 + 0.22 * entries, partial(_draw_values, fit=fit)))
    rows.append((0.3 + 0.19 * len(lines), partial(_draw_text, text="\n".join(lines))))

    heights = [height for height, _ in rows]
    figure = Figure(figsize=(WIDTH_IN, sum(heights)), dpi=DPI)
    parts = figure.subfigures(len(rows), 1, squeeze=False, height_ratios=heights, hspace=0.0)
    for (_, draw), part in zip(rows, parts[:, 0], strict=True):
        draw(part)
    return figure


def _draw_title(part: SubFigure, name: str, kinds: bool) -> None:
    part.text(_LEFT, 0.75, textwrap.shorten(f"{name}: before and after tuning", 90), size=15, va="top")
    if kinds:
        explanation = (
            "Mean colours, with the measured one in the middle; below them pixels from dark to bright. "
            "Hues: measured dashed, before orange, after green."
        )
        part.text(_LEFT, 0.2, explanation, color="0.4", va="top")


def _draw_kind(part: SubFigure, kind: str, colours: KindFit) -> None:
    """Swatches of mean colour and pixels, measured, before and after, and their hue spectra."""
    organ, _, stage = kind.partition(".")
    part.text(_LEFT, 0.84, f"{organ}\n{stage}", size=11, va="top")
    axes = part.subplots(1, 4, gridspec_kw={"width_ratios": (1, 1, 1, 0.9)})
    part.subplots_adjust(left=0.1, right=_RIGHT, bottom=0.24, top=0.84, wspace=0.08)
    columns = (
        ("measured", _MEASURED, colours.target, colours.pixels_target, None),
        ("before", _BEFORE, colours.before, colours.pixels_before, colours.delta_e_before),
        ("after", _AFTER, colours.after, colours.pixels_after, colours.delta_e_after),
    )
    for axis, (title, colour, (mean, sd), pixels, delta_e) in zip(axes, columns, strict=False):
        axis.imshow(_swatch(mean, colours.target[0], pixels), interpolation="nearest", aspect="auto")
        hues, style = ColourStatistics.from_pixels(pixels).hue_spectrum, "--" if delta_e is None else "-"
        axes[3].plot(np.arange(-60, 300, 2), np.roll(hues, 30), color=colour, lw=1.0, ls=style)
        if delta_e is not None:
            words = next(text for limit, text in _VISIBILITY if delta_e <= limit or limit == np.inf)
            title = f"{title}: dE2000 {delta_e:.1f}, {words}"
        axis.set_title(title, color=colour)
        lab = "  ".join(f"{label}* {value:.0f}" for label, value in zip("Lab", mean, strict=True))
        axis.set_xlabel(f"{lab}   sd {' / '.join(f'{number:.0f}' for number in sd)}", loc="left", color="0.4")
        axis.set(xticks=[], yticks=[])
        axis.spines[:].set_visible(False)
    # Reds are on both sides of 0 degrees.
    axes[3].set(xlim=(-60, 180), ylim=(0, None), xticks=range(-60, 181, 60), yticks=[])
    axes[3].set_title("% of pixels by hue, degrees")


def _swatch(mean: ArrayLike, measured: ArrayLike, pixels: ArrayLike) -> NDArray[np.uint8]:
    """`(h, w, 3)` sRGB of a mean colour with the measured one in its middle, above pixels by lightness."""
    rows, columns = _SWATCH
    field = np.tile(_srgb(mean), (rows, columns, 1))
    field[rows // 3 : -(rows // 3), columns // 3 : -(columns // 3)] = _srgb(measured)
    linear = np.asarray(pixels, float)
    ascending = linear[np.argsort(linear_srgb_to_lab(linear)[:, 0], kind="stable")]
    # Evenly sampled; few pixels are repeated.
    cells = _STRIP_ROWS * columns
    sampled = ascending[np.arange(cells) * len(ascending) // cells]
    codes = encode_tone(sampled.astype(np.float32)).reshape(columns, _STRIP_ROWS, 3)
    return np.concatenate([field, codes.transpose(1, 0, 2)])


def _srgb(lab: ArrayLike) -> NDArray[np.uint8]:
    """`(3,)` 8-bit sRGB of a CIELAB colour, clipped to the gamut."""
    colour = colour_science()
    xyz = colour.Lab_to_XYZ(np.asarray(lab, float), colour.XYZ_to_xy(D65_WHITE))
    return encode_tone((XYZ_TO_SRGB @ xyz).astype(np.float32))


def _draw_spectra(part: SubFigure, spectra: Sequence[tuple[str, SpectrumFit]]) -> None:
    """Measured reflectances and those of the model."""
    axes = part.subplots(1, 2)
    part.subplots_adjust(left=0.06, right=_RIGHT, bottom=0.17, top=0.88, wspace=0.12)
    for axis, (name, spectrum) in zip(axes, spectra, strict=False):
        nm = spectrum.wavelength_nm
        before, after = f"before, RMSE {spectrum.rmse_before:.4f}", f"after, RMSE {spectrum.rmse_after:.4f}"
        axis.plot(nm, spectrum.before, color=_BEFORE, label=before)
        axis.plot(nm, spectrum.after, color=_AFTER, label=after)
        axis.plot(nm, spectrum.target, color=_MEASURED, ls="--", label="measured")
        axis.set(xlim=(nm[0], nm[-1]), ylim=(0, None), xlabel="wavelength, nm")
        axis.set_title(f"Reflectance: {textwrap.shorten(name, 70)}")
        axis.legend(loc="upper left")
    for axis in axes[len(spectra) :]:
        axis.remove()


def _draw_frames(part: SubFigure, frames: BeforeAfter) -> None:
    axes = part.subplots(1, 2)
    part.subplots_adjust(left=_LEFT, right=_RIGHT, bottom=0.02, top=0.92, wspace=0.03)
    images = {"whole scene before": frames.before, "whole scene after": frames.after}
    for axis, (title, image) in zip(axes, images.items(), strict=True):
        axis.imshow(image)
        axis.set_title(title)
        axis.set_axis_off()


def _draw_values(part: SubFigure, fit: FitResult) -> None:
    """Table of the fitted values, with a bar for the reduction of the prior variance by the data."""
    axis = part.add_axes((_LEFT, 0.02, _RIGHT - _LEFT, 0.96))
    columns, full, row = (0.0, 0.42, 0.54, 0.74, 0.95), 0.2, 0

    def write(*texts: str, weight: str = "normal") -> None:
        for x, text in zip(columns, texts, strict=False):
            axis.text(x, row, text, va="center", weight=weight)

    write("fitted parameter", "before", "after", "reduction of the prior variance", weight="bold")
    for parameter in fit.parameters:
        unit = f", {parameter.unit}" if parameter.unit and parameter.unit != "1" else ""
        reductions = np.nan_to_num(np.atleast_1d(fit.variance_reduction[parameter.name])).clip(0.0, 1.0)
        for (label, value, sd, before), reduction in zip(
            fitted_entries(fit, parameter), reductions, strict=True
        ):
            row -= 1
            numbers = format_value(before, sd), format_with_sd(value, sd)
            write(f"{label}{unit}", *numbers, "", f"{100 * reduction:.0f} %")
            axis.barh(row, [full, full * reduction], 0.55, columns[3], color=["0.88", _AFTER])
    axis.set(xlim=(0.0, 1.0), ylim=(row - 0.6, 1.0))
    axis.set_axis_off()


def _draw_text(part: SubFigure, text: str) -> None:
    part.text(_LEFT, 0.9, text, va="top", linespacing=1.4)

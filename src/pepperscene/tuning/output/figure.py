"""A sheet that shows a fit to people: measured colours, the model's before and after, what was changed."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import encode_tone
from pepperscene.camera.colorimetry import D65_WHITE, SRGB_TO_XYZ, XYZ_TO_SRGB, xyz_to_lab
from pepperscene.spectra import colour_science
from pepperscene.tuning.output.provenance import entries, plain, with_spread

if TYPE_CHECKING:
    from PIL import Image

    from pepperscene.tuning.fit.result import FitResult, KindFit, SpectrumFit


WIDTH: Final = 1400  # chosen: a page at 120 pixels an inch, as all of the layout below
_MARGIN, _LABEL, _GAP = 44, 176, 18
_FIELD, _STRIP, _CELL = 116, 48, 6
_ACROSS: Final = (WIDTH - 2 * _MARGIN - _LABEL - 2 * _GAP) // 3
_PAPER, _INK, _FAINT, _LINE = (250, 249, 246), (34, 36, 33), (112, 114, 108), (214, 212, 204)
_BEFORE, _AFTER = (196, 118, 44), (38, 122, 84)
_SAID: Final = (
    (1.0, "no difference to the eye"), (2.0, "hardly a difference"), (5.0, "a small difference"),
    (10.0, "a clear difference"), (np.inf, "another colour"),
)  # fmt: skip
"""CIEDE2000 in words. Chosen: 1 is about what can just be told side by side, and each step doubles it."""
_FINE: Final = 3  # chosen: curves are drawn so many times as large, for smooth edges


@dataclass(frozen=True, eq=False)
class BeforeAfter:
    """The same frame of the whole scene twice, `(h, w, 3)` sRGB: before and after tuning."""

    before: NDArray[np.uint8]
    after: NDArray[np.uint8]


def sheet(fit: FitResult, name: str, frames: BeforeAfter | None = None) -> Image.Image:
    """The whole sheet, `WIDTH` pixels wide.

    Args:
        fit: what was found.
        name: of the recipe.
        frames: of the whole scene, or None.
    """
    from PIL import Image

    blocks = [_head(name)]
    if fit.kinds:
        blocks += [_titles(), *(_kind_row(kind, one) for kind, one in fit.kinds.items())]
    blocks += _spectra(fit.spectra)
    if frames is not None:
        blocks.append(_scene(frames))
    blocks += [_changes(fit), _words(fit), _blank(20)[0]]
    whole = Image.new("RGB", (WIDTH, sum(block.height for block in blocks)), _PAPER)
    top = 0
    for block in blocks:
        whole.paste(block, (0, top))
        top += block.height
    return whole


def _head(name: str) -> Image.Image:
    block, pen = _blank(96)
    pen.text(
        (_MARGIN, 34), _plain_text(f"{name}: colours before and after tuning"), fill=_INK, font=_font(30)
    )
    return block


def _titles() -> Image.Image:
    block, pen = _blank(68)
    titles = ("measured", "model before", "model after")
    below = ("mean colour; below it pixels, from dark to bright", *["in its middle: the measured colour"] * 2)
    for i, (title, more) in enumerate(zip(titles, below, strict=True)):
        pen.text((_left(i), 4), title, fill=_INK, font=_font(22))
        pen.text((_left(i), 36), more, fill=_FAINT, font=_font(15))
    return block


def _kind_row(kind: str, one: KindFit) -> Image.Image:
    """Three fields of mean colour over strips of pixels."""
    from PIL import Image

    block, pen = _blank(_FIELD + _STRIP + 74)
    organ, _, stage = kind.partition(".")
    pen.text((_MARGIN, 4), organ, fill=_INK, font=_font(24))
    pen.text((_MARGIN, 36), stage, fill=_FAINT, font=_font(18))
    measured = _colour(one.target[0])
    columns = (
        (one.target, one.pixels_target, None),
        (one.before, one.pixels_before, one.delta_e_before),
        (one.after, one.pixels_after, one.delta_e_after),
    )
    for i, (moments, pixels, difference) in enumerate(columns):
        left, low = _left(i), _FIELD + _STRIP
        pen.rectangle((left, 0, left + _ACROSS - 1, _FIELD - 1), fill=_colour(moments[0]))
        if difference is not None:
            # Colours are compared best where they touch.
            middle = left + _ACROSS // 2
            pen.rectangle((middle - 70, 32, middle + 69, _FIELD - 33), fill=measured)
        block.paste(Image.fromarray(_strip(pixels)), (left, _FIELD))
        light, red, yellow = moments[0]
        spread = " / ".join(f"{one:.0f}" for one in moments[1])
        told = f"L* {light:.0f}   a* {red:.0f}   b* {yellow:.0f}   spread {spread}"
        if difference is None:
            pen.text((left, low + 8), told, fill=_FAINT, font=_font(16))
            continue
        word = next(text for most, text in _SAID if difference <= most or most == np.inf)
        pen.text((left, low + 6), f"dE2000 {difference:.1f}", fill=_INK, font=_font(19))
        pen.text((left + 130, low + 9), word, fill=_FAINT, font=_font(16))
        pen.text((left, low + 34), told, fill=_FAINT, font=_font(16))
    return block


def _strip(pixels: ArrayLike) -> NDArray[np.uint8]:
    """`(_STRIP, _ACROSS, 3)` sRGB of pixels `(n, 3)`: cells column by column, from dark to bright."""
    linear = np.asarray(pixels, float).reshape(-1, 3)
    columns, rows = -(-_ACROSS // _CELL), _STRIP // _CELL
    if not len(linear):
        return np.full((_STRIP, _ACROSS, 3), _PAPER, np.uint8)
    # A strip of few pixels shows each of them several times.
    ascending = linear[np.argsort(xyz_to_lab(linear @ SRGB_TO_XYZ.T)[:, 0], kind="stable")]
    picked = ascending[np.arange(columns * rows) * len(ascending) // (columns * rows)]
    cells = encode_tone(picked.astype(np.float32)).reshape(columns, rows, 3).transpose(1, 0, 2)
    return cells.repeat(_CELL, axis=0).repeat(_CELL, axis=1)[:, :_ACROSS]


def _spectra(spectra: Mapping[str, SpectrumFit]) -> list[Image.Image]:
    """Curves of measured reflectances, two beside each other."""
    blocks, width = [], (WIDTH - 2 * _MARGIN - _GAP) // 2
    items = list(spectra.items())
    for i in range(0, len(items), 2):
        block, pen = _blank(330)
        for k, (name, one) in enumerate(items[i : i + 2]):
            left = _MARGIN + k * (width + _GAP)
            pen.text((left, 6), f"{_plain_text(name)}: reflectance by nm", fill=_INK, font=_font(19))
            block.paste(_curves(one, width, 236), (left, 36))
            at = float(left)
            for text, colour in (
                ("measured", _INK),
                (f"before, RMSE {one.rmse_before:.4f}", _BEFORE),
                (f"after, RMSE {one.rmse_after:.4f}", _AFTER),
            ):
                pen.text((at, 286), text, fill=colour, font=_font(16))
                at += pen.textlength(text, font=_font(16)) + 24
        blocks.append(block)
    return blocks


def _curves(one: SpectrumFit, width: int, height: int) -> Image.Image:
    """Reflectance against wavelength."""
    from PIL import Image, ImageDraw

    big = Image.new("RGB", (width * _FINE, height * _FINE), _PAPER)
    pen = ImageDraw.Draw(big)
    most = 0.1 * np.ceil(
        10.0 * max(float(np.max(curve)) for curve in (one.target, one.before, one.after)) + 1e-9
    )
    first, last = float(one.wavelength_nm[0]), float(one.wavelength_nm[-1])
    left, right, top, bottom = (_FINE * edge for edge in (44, width - 16, 8, height - 26))

    def x(nm: float) -> float:
        return left + (nm - first) / (last - first) * (right - left)

    def y(value: float) -> float:
        return bottom - value / most * (bottom - top)

    for value in np.linspace(0.0, most, 3):
        pen.line((left, y(value), right, y(value)), fill=_LINE, width=_FINE)
        pen.text(
            (left - 6 * _FINE, y(value)), f"{value:.2f}", fill=_FAINT, font=_font(14 * _FINE), anchor="rm"
        )
    for nm in np.arange(100.0 * np.ceil(first / 100.0), last + 1.0, 100.0):
        pen.line((x(nm), bottom, x(nm), bottom + 4 * _FINE), fill=_FAINT, width=_FINE)
        pen.text((x(nm), bottom + 6 * _FINE), f"{nm:.0f}", fill=_FAINT, font=_font(14 * _FINE), anchor="ma")
    for curve, colour, thick in ((one.before, _BEFORE, 2), (one.target, _INK, 3), (one.after, _AFTER, 2)):
        points = [(x(nm), y(value)) for nm, value in zip(one.wavelength_nm, curve, strict=True)]
        pen.line(points, fill=colour, width=thick * _FINE, joint="curve")
    return big.resize((width, height), Image.Resampling.LANCZOS)


def _scene(frames: BeforeAfter) -> Image.Image:
    """The whole scene, before and after side by side."""
    from PIL import Image

    width = (WIDTH - 2 * _MARGIN - _GAP) // 2
    pictures = []
    for codes in (frames.before, frames.after):
        picture = Image.fromarray(np.ascontiguousarray(codes)).convert("RGB")
        size = (width, max(1, round(width * picture.height / picture.width)))
        pictures.append(picture.resize(size, Image.Resampling.LANCZOS))
    block, pen = _blank(40 + max(picture.height for picture in pictures) + 36)
    for i, (picture, title) in enumerate(zip(pictures, ("whole scene before", "after"), strict=True)):
        left = _MARGIN + i * (width + _GAP)
        pen.text((left, 6), title, fill=_INK, font=_font(20))
        block.paste(picture, (left, 40))
    return block


def _changes(fit: FitResult) -> Image.Image:
    """Each number before and after, and how much of it the patches tell."""
    columns, step = (_MARGIN, 480, 680, 960), 30
    rows = [
        (label, parameter.unit, value, sd, before, gained)
        for parameter in fit.parameters
        for (label, value, sd, before), gained in zip(
            entries(fit, parameter), np.atleast_1d(fit.gained[parameter.name]), strict=True
        )
    ]  # fmt: skip
    block, pen = _blank(66 + step * len(rows) + 24)
    for left, title in zip(
        columns, ("what was fitted", "before", "after", "how much the patches tell"), strict=True
    ):
        pen.text((left, 16), title, fill=_INK, font=_font(20))
    pen.line((_MARGIN, 50, WIDTH - _MARGIN, 50), fill=_LINE, width=2)
    for i, (label, unit, value, sd, before, gained) in enumerate(rows):
        top, share = 60 + step * i, float(np.clip(np.nan_to_num(gained), 0.0, 1.0))
        name = f"{label}, {unit}" if unit and unit != "1" else label
        texts = (
            _shortened(pen, _plain_text(name), columns[1] - columns[0] - 12),
            plain(before, sd),
            with_spread(value, sd),
        )
        for left, text in zip(columns, texts, strict=False):
            pen.text((left, top), text, fill=_INK, font=_font(17))
        left, full = columns[3], 300
        pen.rectangle((left, top + 3, left + full, top + 17), fill=_LINE)
        if share > 0.0:
            pen.rectangle((left, top + 3, left + round(full * share), top + 17), fill=_AFTER)
        pen.text((left + full + 14, top), f"{100 * share:.0f} %", fill=_INK, font=_font(17))
    return block


def _words(fit: FitResult) -> Image.Image:
    """What was found, in sentences."""
    lines = [
        line
        for text in dict.fromkeys((*fit.diagnostics, *fit.undetermined))
        for line in (*_wrapped(text), "")
    ]
    block, pen = _blank(26 * len(lines) + 12)
    for i, line in enumerate(lines):
        pen.text((_MARGIN, 26 * i), line, fill=_INK, font=_font(18))
    return block


# --- means ------------------------------------------------------------------------------------------------


def _blank(height: int) -> tuple[Image.Image, Any]:
    """A piece of the sheet, and its pen."""
    from PIL import Image, ImageDraw

    block = Image.new("RGB", (WIDTH, height), _PAPER)
    return block, ImageDraw.Draw(block)


def _left(column: int) -> int:
    return _MARGIN + _LABEL + column * (_ACROSS + _GAP)


def _colour(of_lab: ArrayLike) -> tuple[int, int, int]:
    """8-bit sRGB of a colour in CIELAB, the nearest there is."""
    colour = colour_science()
    xyz = colour.Lab_to_XYZ(np.asarray(of_lab, float), colour.XYZ_to_xy(D65_WHITE))
    red, green, blue = encode_tone((XYZ_TO_SRGB @ xyz).astype(np.float32)).tolist()
    return red, green, blue


def _wrapped(text: str) -> Sequence[str]:
    return textwrap.wrap(_plain_text(text), 140)


def _shortened(pen: Any, text: str, width: int) -> str:
    """The text, cut where it would run into its neighbour."""
    while len(text) > 1 and pen.textlength(text, font=_font(17)) > width:
        text = f"{text.removesuffix('…')[:-1]}…"
    return text


def _plain_text(text: str) -> str:
    """The text with what Pillow's own font has no letters for written otherwise."""
    for sign, word in {"µ": "u", "²": "2", "→": "to", "−": "-", "Δ": "d", "×": "x", "–": "-"}.items():
        text = text.replace(sign, word)
    return "".join(sign if sign.isascii() or sign in "±°…·" else "?" for sign in text)


def _font(size: int) -> Any:
    """Pillow's own font, so that the sheet looks the same everywhere."""
    from PIL import ImageFont

    return ImageFont.load_default(size)

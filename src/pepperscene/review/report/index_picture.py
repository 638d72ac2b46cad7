"""Pictures of spectral indices in colours, with a scale bar."""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.indices import INDICES, has_index, spectral_index
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.dataset.store.images import recorded_bands
from pepperscene.errors import ArgumentError, InputError
from pepperscene.review.report.colours import BACKGROUND

Palette = Literal["viridis", "red-green"]
_MAPS: Final = {"viridis": "viridis", "red-green": "RdYlGn"}
_RANGES: Final = {"ndvi": (0.0, 1.0), "ndre": (0.0, 0.6), "pri": (-0.1, 0.1)}
"""Of the colours. Chosen: from soil, and stressed leaves, to the greenest leaves."""
_WIDTH_PX: Final = 320  # least width, at which the scale can be read: chosen
_MARGIN_PX, _BAR_PX, _SCALE_PX = 40, 10, 36
_INK, _PAPER = (236, 238, 242), (22, 24, 29)


def available_indices(image: LabelledImage) -> tuple[str, ...]:
    """Names of the indices that can be computed from the reflectance of a frame."""
    bands = [band.centre_nm for band in recorded_bands(image.metadata)]
    reflectance = image.reflectance
    if reflectance is None or reflectance.shape[2] != len(bands):
        return ()
    return tuple(name for name in INDICES if has_index(name, bands))


def index_picture(
    image: LabelledImage, name: str = "ndvi", palette: Palette = "viridis"
) -> NDArray[np.uint8]:
    """A frame's spectral index in colours, with a scale bar below; nearly black where it is not a number.

    Small images are enlarged by a whole number, so that the scale can be read.

    Args:
        image: of a sensor with bands, with its reflectance and metadata.
        name: "ndvi", "ndre" or "pri".
        palette: colours from low to high: "viridis", or "red-green" over yellow, as agronomists use it.

    Returns:
        `(h, w, 3)` uint8, sRGB.

    Raises:
        ArgumentError: there is no such index or palette.
        InputError: the image has no reflectance, or not the bands of the index.
    """
    bands = [band.centre_nm for band in recorded_bands(image.metadata)]
    if image.reflectance is None or not bands:
        raise InputError(image.name, "has no reflectance in bands")
    if palette not in _MAPS:
        raise ArgumentError("palette", f"must be one of {', '.join(_MAPS)}", value=palette)
    values, (low, high) = spectral_index(name, image.reflectance, bands), _RANGES[name]
    rgb = _colours((values - low) / (high - low), palette)
    factor = -(-_WIDTH_PX // rgb.shape[1])
    rgb = rgb.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.concatenate([rgb, _scale(name, low, high, rgb.shape[1], palette)])


def _colours(fraction: NDArray[np.floating[Any]], palette: Palette) -> NDArray[np.uint8]:
    from matplotlib import colormaps

    known = np.nan_to_num(np.clip(fraction, 0.0, 1.0))
    rgb = np.rint(255.0 * colormaps[_MAPS[palette]](known)[..., :3]).astype(np.uint8)
    rgb[np.isnan(fraction)] = BACKGROUND
    return rgb


def _scale(name: str, low: float, high: float, width: int, palette: Palette) -> NDArray[np.uint8]:
    """A scale bar `(_SCALE_PX, width, 3)`, with the index's name."""
    from PIL import Image, ImageDraw, ImageFont

    left, right = 2 * _MARGIN_PX, width - _MARGIN_PX // 2
    sheet = Image.new("RGB", (width, _SCALE_PX), _PAPER)
    bar = _colours(np.linspace(0.0, 1.0, right - left)[None].repeat(_BAR_PX, axis=0), palette)
    sheet.paste(Image.fromarray(bar), (left, 4))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    draw.text((8, 9), name.upper(), fill=_INK, font=font)
    for fraction in (0.0, 0.25, 0.5, 0.75, 1.0):
        text, x = f"{low + fraction * (high - low):g}", left + fraction * (right - left)
        draw.text((x, 5 + _BAR_PX), text, fill=_INK, font=font, anchor="ma")
    return np.asarray(sheet)

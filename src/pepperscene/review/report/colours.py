"""Labels and distances in colours for display, and images as data URIs."""

from __future__ import annotations

import base64
import colorsys
import io
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, IGNORE_COLOUR

VIRIDIS: Final = (
    "#440154", "#472D7B", "#3B528B", "#2C728E", "#21908C", "#27AD81", "#5DC863", "#AADC32", "#FDE725",
)  # fmt: skip
"""Nine even steps of viridis (S. van der Walt and N. Smith 2015, CC0), as R's viridisLite prints them."""

BACKGROUND: Final = (13, 15, 20)  # chosen: nearly black, distinct from viridis' dark violet
_GOLDEN_RATIO: Final = 0.6180339887498949
_STEPS_BETWEEN: Final = 30
"""Chosen: colours from one of viridis' steps to the next. With the background they are 242, which fit into a
palette of 256; an image with a palette is a third as large."""

_STEPS: Final = np.array([[int(code[k : k + 2], 16) for k in (1, 3, 5)] for code in VIRIDIS])
_POSITIONS: Final = np.arange((len(VIRIDIS) - 1) * _STEPS_BETWEEN + 1) / _STEPS_BETWEEN
_CHANNELS: Final = [np.interp(_POSITIONS, range(len(VIRIDIS)), channel) for channel in _STEPS.T]
_VIRIDIS_TABLE: Final = np.stack(_CHANNELS, axis=-1).round().astype(np.uint8)


def viridis_colours(fraction: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Values in [0, 1] `(h, w)` as viridis' colours `(h, w, 3)`, from dark violet to yellow."""
    position = np.rint(np.clip(fraction, 0.0, 1.0) * (len(_VIRIDIS_TABLE) - 1)).astype(np.intp)
    return np.take(_VIRIDIS_TABLE, position, axis=0)


def distance_colours(distance_m: NDArray[np.floating[Any]], near_m: float, far_m: float) -> NDArray[np.uint8]:
    """Distances `(h, w)` as colours `(h, w, 3)`: near is yellow, far dark violet, background nearly black."""
    finite = np.isfinite(distance_m)
    distance = np.where(finite, distance_m, far_m)
    rgb = viridis_colours((far_m - distance) / max(far_m - near_m, 1e-9))
    rgb[~finite] = BACKGROUND
    return rgb


def class_colours(class_id: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Class ids `(h, w)` as the published colours `(h, w, 3)`; grey for other ids."""
    # Ids that are no class are ignored, whatever their number.
    palette = np.full((256, 3), IGNORE_COLOUR, np.uint8)
    palette[: len(CLASS_COLOURS)] = CLASS_COLOURS
    return np.take(palette, class_id, axis=0)


def instance_colours(instance: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Instances `(h, w)` as colours `(h, w, 3)`; neighbouring numbers have very different hues."""
    numbers, inverse = np.unique(instance, return_inverse=True)
    palette = np.array([instance_colour(int(number)) for number in numbers], dtype=np.uint8)
    return palette[inverse.reshape(instance.shape)]


def instance_colour(number: int) -> tuple[int, int, int]:
    """The 8-bit RGB of an instance: a hue by the golden ratio, never near the last few; two values and two
    saturations.
    """
    if number == 0:
        return BACKGROUND
    value = 1.0 if number % 2 else 0.78
    saturation = 0.62 if number // 2 % 2 else 0.85
    red, green, blue = colorsys.hsv_to_rgb(number * _GOLDEN_RATIO % 1.0, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)


_MAX_SIZE_PX: Final = 1600
"""Chosen: no screen shows more of an image; a 4k frame would take 15 MB."""
_JPEG_STEPS: Final = (
    (90, 1.0),
    (80, 1.0),
    (70, 1.0),
    (80, 0.75),
    (70, 0.75),
    (75, 0.5),
    (75, 0.35),
    (70, 0.25),
)
"""JPEG quality and scale of a photograph, tried in turn. Chosen: the first keeps the sensor's noise visible;
a smaller image looks better than one below quality 70."""
_MIN_SIZE_PX: Final = 64  # chosen: no image of labels is reduced further


def jpeg_data_uri(rgb: NDArray[np.uint8], max_length: int | None = None) -> str:
    """A photograph `(h, w, 3)` uint8 as the data URI of a JPEG.

    With `max_length`, its quality and then its size are reduced until the URI has at most so many characters.
    """
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(rgb))
    if max(image.size) > _MAX_SIZE_PX:
        image.thumbnail((_MAX_SIZE_PX, _MAX_SIZE_PX), Image.Resampling.LANCZOS)
    uri = ""
    for quality, scale in _JPEG_STEPS:
        size = (max(1, round(scale * image.width)), max(1, round(scale * image.height)))
        scaled = image if scale == 1.0 else image.resize(size, Image.Resampling.LANCZOS)
        buffer = io.BytesIO()
        scaled.save(buffer, format="JPEG", quality=quality, optimize=True)
        uri = _data_uri("jpeg", buffer.getvalue())
        if max_length is None or len(uri) <= max_length:
            break
    return uri


def png_data_uri(
    rgb: NDArray[np.uint8], max_size_px: int = _MAX_SIZE_PX, max_length: int | None = None
) -> str:
    """Labels or a map in colours `(h, w, 3)` uint8 as the data URI of a PNG with the same colours.

    With `max_length`, pixels are left out until the URI has at most so many characters.
    """
    # Colours of labels must not be blended: a mixture would be another class.
    return shortened(lambda step: _png_data_uri(rgb[::step, ::step]), rgb.shape, max_length, max_size_px)


def shortened(
    text_of: Callable[[int], str], shape: Sequence[int], max_length: int | None, max_px: int = _MAX_SIZE_PX
) -> str:
    """The text `text_of(n)` of every n-th row and column of labels with this shape `(h, w, ...)`.

    n is the least with which the longer side has at most `max_px` pixels, and the text at most `max_length`
    characters; but no side is reduced below 64 pixels for the latter.
    """
    longest = max(shape[:2])
    step = -(-longest // max_px)
    text = text_of(step)
    while max_length is not None and len(text) > max_length and longest > _MIN_SIZE_PX * (step + 1):
        step += 1
        text = text_of(step)
    return text


def _png_data_uri(rgb: NDArray[np.uint8]) -> str:
    from PIL import Image

    codes = (rgb.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(axis=-1, dtype=np.uint32)
    distinct, inverse = np.unique(codes, return_inverse=True)
    if len(distinct) <= 256:
        image = Image.fromarray(inverse.reshape(codes.shape).astype(np.uint8), mode="P")
        image.putpalette(b"".join(int(code).to_bytes(3, "big") for code in distinct))
    else:
        image = Image.fromarray(np.ascontiguousarray(rgb))
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return _data_uri("png", buffer.getvalue())


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"

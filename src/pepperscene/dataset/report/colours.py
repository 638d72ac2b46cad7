"""Labels and distances as colours that a person can read; for looking at, never for measuring."""

from __future__ import annotations

import base64
import colorsys
import io
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS

VIRIDIS: Final = (
    "#440154", "#472D7B", "#3B528B", "#2C728E", "#21908C", "#27AD81", "#5DC863", "#AADC32", "#FDE725",
)  # fmt: skip
"""Nine even steps of viridis (S. van der Walt and N. Smith 2015, CC0), as R's viridisLite prints them."""

_NOTHING: Final = (13, 15, 20)  # chosen: nearly black, apart from viridis' dark violet
_VOID: Final = (120, 120, 120)  # chosen: a grey that no class has
_GOLDEN: Final = 0.6180339887498949
_STEPS_BETWEEN: Final = 30
"""Chosen: colours from one of viridis' steps to the next. With the colour for nothing they are 242, which a
palette of 256 holds, and a picture with a palette takes a third of the room."""


def _ramp() -> NDArray[np.uint8]:
    steps = np.array([[int(code[k : k + 2], 16) for k in (1, 3, 5)] for code in VIRIDIS], dtype=float)
    places = np.arange((len(VIRIDIS) - 1) * _STEPS_BETWEEN + 1) / _STEPS_BETWEEN
    channels = [np.interp(places, np.arange(len(VIRIDIS)), steps[:, channel]) for channel in range(3)]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


_RAMP: Final = _ramp()


def share_colours(share: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Values in [0, 1] `(h, w)` as viridis' colours `(h, w, 3)`, from dark violet to yellow."""
    place = np.rint(np.clip(share, 0.0, 1.0) * (len(_RAMP) - 1)).astype(np.intp)
    return np.take(_RAMP, place, axis=0)


def distance_colours(distance_m: NDArray[np.floating[Any]], near_m: float, far_m: float) -> NDArray[np.uint8]:
    """Distances `(h, w)` as colours `(h, w, 3)`: near is yellow, far dark violet, nothing almost black."""
    found = np.isfinite(distance_m)
    depth = np.where(found, distance_m, far_m)
    rgb = share_colours((far_m - depth) / max(far_m - near_m, 1e-9))
    rgb[~found] = _NOTHING
    return rgb


def class_colours(class_id: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Class ids `(h, w)` as the published colours `(h, w, 3)`; grey where the id is no class's."""
    palette = np.full((256, 3), _VOID, np.uint8)
    palette[: len(CLASS_COLOURS)] = CLASS_COLOURS
    return np.take(palette, class_id, axis=0)


def instance_colours(instance: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Instance numbers `(h, w)` as colours `(h, w, 3)`: neighbouring numbers get hues far apart."""
    numbers, place = np.unique(instance, return_inverse=True)
    palette = np.array([_hue(int(number)) for number in numbers], dtype=np.uint8)
    return palette[place.reshape(instance.shape)]


def _hue(number: int) -> tuple[int, int, int]:
    """Hues by the golden ratio, never close to the last few; two lightnesses and two saturations."""
    if number == 0:
        return _NOTHING
    value = 1.0 if number % 2 else 0.78
    saturation = 0.62 if number // 2 % 2 else 0.85
    red, green, blue = colorsys.hsv_to_rgb(number * _GOLDEN % 1.0, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)


_LONGEST_PX: Final = 1600
"""Chosen: no screen shows more of a picture than this; a frame of 4k would take 15 MB."""
_JPEG_QUALITY: Final = 90  # chosen: the sensor's noise stays to be seen


def photograph(picture: NDArray[np.uint8]) -> str:
    """A photograph `(h, w, 3)` uint8 as the address of a JPEG."""
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(picture))
    if max(image.size) > _LONGEST_PX:
        image.thumbnail((_LONGEST_PX, _LONGEST_PX), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.save(buffer, format="JPEG", quality=_JPEG_QUALITY, optimize=True)
    return _address("jpeg", buffer.getvalue())


def drawing(picture: NDArray[np.uint8], longest_px: int = _LONGEST_PX) -> str:
    """Labels or a map as colours `(h, w, 3)` uint8, as the address of a PNG that holds just these colours."""
    from PIL import Image

    # Colours of labels must not be blended: a mixture would be another class.
    stride = -(-max(picture.shape[:2]) // longest_px)
    picture = np.ascontiguousarray(picture[::stride, ::stride])
    codes = (picture.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(axis=-1, dtype=np.uint32)
    found, place = np.unique(codes, return_inverse=True)
    if len(found) <= 256:
        image = Image.fromarray(place.reshape(codes.shape).astype(np.uint8), mode="P")
        image.putpalette(b"".join(int(code).to_bytes(3, "big") for code in found))
    else:
        image = Image.fromarray(picture)
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return _address("png", buffer.getvalue())


def _address(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"

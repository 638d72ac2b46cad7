"""Pictures as text inside the page: each is there once, small enough to be mailed."""

from __future__ import annotations

import base64
import io
from typing import Final

import numpy as np
from numpy.typing import NDArray

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

"""Foreign picture files: photographs as 8-bit sRGB, masks as the values or colours that they hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError

_ORIENTATION: Final = 0x0112
"""EXIF tag that says how a camera was held."""

_VALUE_MODES: Final = frozenset({"1", "L", "I", "I;16", "I;16B", "I;16L"})
_COLOUR_MODES: Final = frozenset({"RGB", "RGBA"})


@dataclass(frozen=True, eq=False)
class MaskPicture:
    """What a mask file holds.

    Attributes:
        values: `(h, w)` whole numbers, or None where the file has colours only.
        rgb: `(h, w, 3)` uint8, or None where it has values only; a palette image has both, and so has one
            whose colours are all grey.
        seen: `(h, w)` bool, False where the file is fully transparent; None where it has no transparency.
    """

    values: NDArray[np.integer[Any]] | None
    rgb: NDArray[np.uint8] | None
    seen: NDArray[np.bool_] | None

    @property
    def grey(self) -> bool:
        """Whether it has no colour that tells more than a value."""
        return self.rgb is None or bool((self.rgb[..., :1] == self.rgb[..., 1:]).all())

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        image = self.rgb if self.values is None else self.values
        assert image is not None
        return int(image.shape[0]), int(image.shape[1])


def read_photo(path: Path) -> NDArray[np.uint8]:
    """A photograph `(h, w, 3)` as it is to be looked at: turned as its EXIF says, transparency over black.

    Raises:
        InputError: the file is missing, no image, or has no 8-bit colours.
    """
    from PIL import Image, ImageOps

    with _opened(path) as picture:
        if picture.mode.startswith(("I", "F")):
            raise InputError(path, "must be a photograph of 8 bits a channel")
        upright = ImageOps.exif_transpose(picture)
        if "A" in upright.mode or "transparency" in upright.info:
            with_alpha = upright.convert("RGBA")
            upright = Image.alpha_composite(Image.new("RGBA", with_alpha.size, (0, 0, 0, 255)), with_alpha)
        return np.array(upright.convert("RGB"))


def photo_shape(path: Path) -> tuple[int, int]:
    """Height and width of a photograph as `read_photo` gives it, from its header alone.

    Raises:
        InputError: the file is missing or no image.
    """
    with _opened(path) as picture:
        width, height = picture.size
        # Orientations 5 to 8 lie on their side.
        return (width, height) if picture.getexif().get(_ORIENTATION, 1) >= 5 else (height, width)


def read_mask(path: Path) -> MaskPicture:
    """A mask, unchanged: no value is scaled, no palette replaced, no pixel moved.

    Raises:
        InputError: the file is missing, no image, compressed with loss, or of real numbers.
    """
    with _opened(path) as picture:
        if picture.format == "JPEG":
            raise InputError(path, "is a JPEG, which changes the values of a mask; save it as PNG")
        if picture.mode == "P":
            rgba = np.array(picture.convert("RGBA"))
            return MaskPicture(np.array(picture), rgba[..., :3].copy(), _seen(rgba[..., 3]))
        if picture.mode in _VALUE_MODES:
            return MaskPicture(np.array(picture).astype(np.int32), None, None)
        if picture.mode == "LA":
            values, alpha = np.moveaxis(np.array(picture), -1, 0)
            return MaskPicture(values, None, _seen(alpha))
        if picture.mode in _COLOUR_MODES:
            rgba = np.array(picture.convert("RGBA"))
            mask = MaskPicture(None, rgba[..., :3].copy(), _seen(rgba[..., 3]))
            return replace(mask, values=rgba[..., 0].copy()) if mask.grey else mask
        raise InputError(path, f"must hold whole numbers or RGB colours, not mode {picture.mode}")


def _seen(alpha: NDArray[np.uint8]) -> NDArray[np.bool_] | None:
    seen = alpha > 0
    return None if seen.all() else seen


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The file opened by Pillow; whatever it cannot read is one sentence."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            yield picture
    except InputError:
        raise
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as fault:
        raise InputError(path, f"cannot be read as an image ({fault})") from None

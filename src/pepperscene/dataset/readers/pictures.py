"""Image files of other programs: photographs as 8-bit sRGB, masks as the values or colours that they hold."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.user_files import open_file

_ORIENTATION: Final = 0x0112
"""EXIF tag of the camera's orientation."""

_FORMATS: Final = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")
"""Pillow's names of the formats that are read, whatever a file's suffix says. Pillow would otherwise choose
any format by the content, and it starts another program, Ghostscript, for EPS."""

MOST_PIXELS: Final = 120_000_000
"""Chosen: of an image file; the largest common cameras have 102 million."""
_LARGE_PHOTO: Final = 25_000_000
"""Chosen: pixels above which a photograph's file must have a plausible size."""
_PIXELS_PER_BYTE: Final = 50
"""Chosen: most pixels of a large photograph for a byte of its file; cameras write 2 to 8, and a file that
unpacks into one colour has hundreds."""

_JPEG_FORMATS: Final = frozenset({"JPEG", "MPO"})  # Pillow reads a JPEG file of several images as MPO

_VALUE_MODES: Final = frozenset({"1", "L", "I", "I;16", "I;16B", "I;16L"})
_COLOUR_MODES: Final = frozenset({"RGB", "RGBA"})


@dataclass(frozen=True, eq=False)
class MaskImage:
    """Content of a mask file.

    Palette images have both values and colours, and so have colour images whose colours are all grey.
    """

    values: NDArray[np.integer[Any]] | None  # (h, w)
    rgb: NDArray[np.uint8] | None  # (h, w, 3)
    opaque: NDArray[np.bool_] | None  # (h, w), False where fully transparent; None without transparency

    @property
    def is_grey(self) -> bool:
        """Whether all colours are grey."""
        return self.rgb is None or bool((self.rgb[..., :1] == self.rgb[..., 1:]).all())

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        image = self.rgb if self.values is None else self.values
        assert image is not None
        return int(image.shape[0]), int(image.shape[1])


def read_photo(path: Path) -> NDArray[np.uint8]:
    """Read a photograph `(h, w, 3)` for display: rotated as its EXIF says, transparent parts black.

    Raises:
        InputError: the file is missing, not an image, or has no 8-bit colours.
    """
    from PIL import Image, ImageOps

    with _open_image(path) as image:
        _check_plausible(path, image.size)
        if image.mode.startswith(("I", "F")):
            raise InputError(path, "must be a photograph with 8 bits per channel")
        upright = ImageOps.exif_transpose(image)
        if "A" in upright.mode or "transparency" in upright.info:
            rgba = upright.convert("RGBA")
            upright = Image.alpha_composite(Image.new("RGBA", rgba.size, (0, 0, 0, 255)), rgba)
        return np.array(upright.convert("RGB"))


def photo_shape(path: Path) -> tuple[int, int]:
    """Height and width of a photograph as `read_photo` returns it, from the file header alone."""
    with _open_image(path) as image:
        width, height = image.size
        # Orientations 5 to 8 swap rows and columns.
        return (width, height) if image.getexif().get(_ORIENTATION, 1) >= 5 else (height, width)


def mask_shape(path: Path) -> tuple[int, int]:
    """Height and width of a mask as `read_mask` returns it, from the file header alone."""
    with _open_image(path) as image:
        width, height = image.size
        return height, width


def read_mask(path: Path) -> MaskImage:
    """Read a mask unchanged: without scaling values, replacing palette indices or moving pixels.

    Raises:
        InputError: the file is missing, not an image, lossy, or holds real numbers.
    """
    with _open_image(path) as image:
        if image.format in _JPEG_FORMATS:
            raise InputError(path, "is a JPEG, which changes the values of a mask; save it as PNG")
        if image.mode == "P":
            rgba = np.array(image.convert("RGBA"))
            return MaskImage(np.array(image), rgba[..., :3].copy(), _opaque_mask(rgba[..., 3]))
        if image.mode in _VALUE_MODES:
            return MaskImage(np.array(image).astype(np.int32), None, None)
        if image.mode == "LA":
            values, alpha = np.moveaxis(np.array(image), -1, 0)
            return MaskImage(values, None, _opaque_mask(alpha))
        if image.mode in _COLOUR_MODES:
            rgba = np.array(image.convert("RGBA"))
            mask = MaskImage(None, rgba[..., :3].copy(), _opaque_mask(rgba[..., 3]))
            return replace(mask, values=rgba[..., 0].copy()) if mask.is_grey else mask
        raise InputError(path, f"must hold integers or RGB colours, not mode {image.mode}")


def _opaque_mask(alpha: NDArray[np.uint8]) -> NDArray[np.bool_] | None:
    opaque = alpha > 0
    return None if opaque.all() else opaque


def _check_plausible(path: Path, size: tuple[int, int]) -> None:
    """Raise `InputError` for a large photograph whose file is too small to be one, before it is decoded."""
    pixels, written = size[0] * size[1], path.stat().st_size
    if pixels > max(_LARGE_PHOTO, _PIXELS_PER_BYTE * written):
        raise InputError(
            path,
            f"has {size[0]} x {size[1]} pixels in {written:,} bytes, which no photograph has; above "
            f"{_LARGE_PHOTO // 10**6} million pixels, at most {_PIXELS_PER_BYTE} may be in a byte",
        )


def _too_large(path: Path, found: str) -> InputError:
    allowed = f"at most {MOST_PIXELS // 10**6} million are read: scale it down, or cut it into parts"
    return InputError(path, f"has {found}; {allowed}")


@contextmanager
def _open_image(path: Path) -> Iterator[Any]:
    """The file opened by Pillow, whose errors become `InputError`; nothing is decoded yet."""
    from PIL import Image

    try:
        with open_file(path, "image") as file:
            with warnings.catch_warnings():
                # Its limit of pixels is replaced by that of this module.
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                opened = Image.open(file, formats=_FORMATS)
            with opened as image:
                width, height = image.size
                if width * height > MOST_PIXELS:
                    raise _too_large(path, f"{width} x {height} pixels")
                yield image
    except Image.DecompressionBombError:
        raise _too_large(path, "more pixels") from None
    except Image.UnidentifiedImageError:
        problem = f"cannot be read as an image (cannot identify image file {str(path)!r})"
        raise InputError(path, problem) from None
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(path, f"cannot be read as an image ({error})") from None

"""Image files of other programs: photographs as 8-bit sRGB, masks as the values or colours that they hold."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.user_files import open_file

_ORIENTATION: Final = 0x0112
"""EXIF tag of the camera's orientation."""

Exif = Literal["displayed", "stored"]
"""Which pixels of a photograph a mask marks: as displayed, turned by the EXIF orientation, or as stored."""

_UPRIGHT: Final = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x01\0\0\0\0\0\0"
"""EXIF content, big-endian: one directory with the orientation 1."""

_PNG_START: Final = 33  # bytes of the signature and of the first chunk, the image header

EXIF_KEY: Final = "exif"
"""Key of a table of labels that gives it."""

_TURNED: Final[Mapping[int, Callable[[NDArray[Any]], NDArray[Any]]]] = {
    1: lambda image: image,
    2: lambda image: image[:, ::-1],
    3: lambda image: image[::-1, ::-1],
    4: lambda image: image[::-1],
    5: lambda image: image.swapaxes(0, 1),
    6: lambda image: image[::-1].swapaxes(0, 1),
    7: lambda image: image[::-1, ::-1].swapaxes(0, 1),
    8: lambda image: image[:, ::-1].swapaxes(0, 1),
}
"""How an image `(h, w, ...)` is turned for display by its orientation, as Pillow's `exif_transpose` does."""

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

    def turned(self, orientation: int) -> MaskImage:
        """The mask turned for display, as a photograph with an EXIF orientation of 1 to 8."""
        parts = (self.values, self.rgb, self.opaque)
        return MaskImage(*(None if part is None else _TURNED[orientation](part) for part in parts))


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
    return _displayed(*_header(path))


def mark_orientation(
    shape: tuple[int, int], photo: Path, exif: Exif | None, where: Path, *, by_size: bool = True
) -> int | None:
    """EXIF orientation by which the marks on a photograph must be turned, so that they are on its objects.

    1 for marks of the displayed photograph, as `read_photo` returns it; the photograph's orientation for
    marks of the stored one.

    Args:
        shape: height and width of the image that was marked.
        photo: its file.
        exif: which of the two it was; None if only the sizes can tell.
        where: the file of the marks, for messages.
        by_size: whether the stored size shows that the stored pixels were marked.

    Returns:
        None if the photograph has another size.

    Raises:
        InputError: `exif` is None, and the size does not show which it was.
    """
    stored, orientation = _header(photo)
    sizes: dict[Exif, tuple[int, int]] = {"displayed": _displayed(stored, orientation), "stored": stored}
    fitting = [name for name in sizes if exif in (None, name) and sizes[name] == shape]
    if not fitting:
        return None
    if orientation != 1 and exif is None and (len(fitting) == 2 or (fitting == ["stored"] and not by_size)):
        problem = (
            f"may mark {photo.name} as displayed or as stored, before its EXIF orientation {orientation}"
        )
        raise InputError(where, f'{problem}; say which with {EXIF_KEY} = "displayed" or "stored"')
    return orientation if fitting[0] == "stored" else 1


def read_mask_of(photo: Path, path: Path, exif: Exif | None = None) -> MaskImage | None:
    """Read the mask of a photograph, turned as `read_photo` turns the photograph; None for another size.

    A mask that has an EXIF orientation itself is displayed by it. `exif` is as of `mark_orientation`.

    Raises:
        InputError: as `read_mask` and `mark_orientation`.
    """
    # From the headers alone, before the mask is decoded.
    with _open_image(path) as image:
        width, height = image.size
        shape, own = (height, width), image.getexif().get(_ORIENTATION)
    turns: tuple[int, ...] = ()
    if own in _TURNED and exif != "stored":
        turns, shape, exif = (own,), _displayed(shape, own), "displayed"
    orientation = mark_orientation(shape, photo, exif, path)
    if orientation is None:
        return None
    mask = read_mask(path)
    for turn in (*turns, orientation):
        mask = mask.turned(turn)
    return mask


def turn_image(image: NDArray[Any], orientation: int) -> NDArray[Any]:
    """An image `(h, w, ...)` turned for display, by an EXIF orientation of 1 to 8; a view."""
    return _TURNED[orientation](image)


def is_turned(photo: Path) -> bool:
    """Whether `read_photo` turns a photograph by its EXIF orientation."""
    return _header(photo)[1] != 1


def with_upright_exif(png: bytes) -> bytes:
    """A PNG file with the EXIF orientation 1: a mask of a turned photograph as displayed."""
    chunk = b"eXIf" + _UPRIGHT
    chunk = struct.pack(">I", len(_UPRIGHT)) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return png[:_PNG_START] + chunk + png[_PNG_START:]


def parse_exif(value: Any, source: str | Path) -> Exif:
    """The value of `EXIF_KEY` in a table; raises `InputError` for another one."""
    if value not in ("displayed", "stored"):
        raise InputError(source, 'must be "displayed" or "stored"', key=EXIF_KEY, value=value)
    return "displayed" if value == "displayed" else "stored"


def _header(path: Path) -> tuple[tuple[int, int], int]:
    """Stored height and width, and the EXIF orientation, 1 to 8; 1 if there is none, or another number."""
    with _open_image(path) as image:
        width, height = image.size
        orientation = image.getexif().get(_ORIENTATION)
    return (height, width), int(orientation) if orientation in _TURNED else 1


def _displayed(shape: tuple[int, int], orientation: int) -> tuple[int, int]:
    """Height and width of a displayed picture; orientations 5 to 8 swap rows and columns."""
    return shape if orientation < 5 else shape[::-1]


def mask_shape(path: Path) -> tuple[int, int]:
    """Height and width of a mask as `read_mask` returns it, from the file header alone."""
    return _header(path)[0]


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
    allowed = f"at most {MOST_PIXELS // 10**6} million are read; scale it down, or cut it into parts"
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
        raise _too_large(path, f"more than {MOST_PIXELS // 10**6} million pixels") from None
    except Image.UnidentifiedImageError:
        problem = f"cannot be read as an image (cannot identify image file {str(path)!r})"
        raise InputError(path, problem) from None
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(path, f"cannot be read as an image ({error})") from None

"""Image files: PNG for integers, OpenEXR for measured values, JPEG for photographs, JSON for other outputs.

An EXR file has one channel named as its output, or `Output.channel_names`, or `Y` of a monochrome sensor.
Those of a sensor with bands have their number and centre, `B01.475nm`; header attributes list the centres and
widths. The header attribute `unit` holds their unit. Class images are palette PNGs: the pixel values are the
class ids, and a viewer shows the class colours.

PNG files have an encoder here: Pillow takes 1.9 to 3.7 times as long (colour of 800x600: 41 ms against 11;
class, instance and distance code together 13 against 6, of a label frame's 47), for files of the same size,
and cannot write these bytes.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import canonical_json
from pepperscene.camera.image.photo import jpeg_bytes
from pepperscene.camera.optics.white_reference import UNLIT_BANDS
from pepperscene.camera.sensor.bands import Band
from pepperscene.classes import OrganClass
from pepperscene.document import parse_json
from pepperscene.errors import InputError
from pepperscene.outputs import BAND_OUTPUTS, OUTPUTS
from pepperscene.truth.encodings import class_palette
from pepperscene.user_files import check_file, open_file, read_file

NO_PHOTO: Final[Mapping[str, Any]] = MappingProxyType({})
_LUMINANCE: Final = ("Y",)  # channel of electrons and albedo behind no colour filter

_CHANNEL: Final = re.compile(r"B(\d+)(\.\d+nm)?")
_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_GREY, _RGB, _PALETTE, _RGBA = 0, 2, 3, 6  # PNG colour types
_UP: Final = 2  # PNG filter: each row holds its difference from the row above
_DEFLATE_LEVEL, _DEFLATE_MEMORY = 1, 9
_PNG_PART: Final = 1 << 24  # bytes of an image that are filtered at a time; chosen: more than most images


def write_image(
    path: Path, image: Any, output: str, bands: Sequence[Band] = (), photo: Mapping[str, Any] = NO_PHOTO
) -> None:
    """Write one image of a frame in the format of its output, the same bytes for the same values.

    Args:
        path: the file; its suffix is not used.
        image: of the shape and dtype of `OUTPUTS[output]`; a JSON-ready object if the output is no array.
        output: name of the output.
        bands: of the sensor, if it has bands.
        photo: settings and EXIF of a JPEG, `photo` of the frame's metadata.

    Raises:
        ValueError: the image does not fit the output, or holds a value that JSON cannot represent.
    """
    path.write_bytes(encode_image(image, output, bands, photo))


def encode_image(
    image: Any, output: str, bands: Sequence[Band] = (), photo: Mapping[str, Any] = NO_PHOTO
) -> bytes:
    """The content of the file that `write_image` writes; same arguments and `ValueError`."""
    expected = OUTPUTS[output]
    if not expected.fits(image):
        actual = f"{image.shape} {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f"{output} must be {f'{expected.shape} {expected.dtype}'.strip()}, not {actual}")
    if not expected.is_image:
        return canonical_json(image)
    if expected.suffix == ".exr":
        return _exr_bytes(image, output, bands)
    if expected.suffix == ".jpg":
        return jpeg_bytes(image, photo)
    if output == "class":
        return png_bytes(image, class_palette(ignored=int(image.max(initial=0)) >= len(OrganClass)))
    return png_bytes(image)


def read_image(path: str | Path, *, within: Path | None = None) -> Any:
    """Read a file that `write_image` wrote, as `Frame` holds it (class ids of a palette PNG).

    Args:
        path: of the file.
        within: folder of the data set, which no link may leave; None for a file that a user named.

    Raises:
        InputError: the file is missing, not such an image, or outside `within`.
    """
    path = Path(path)
    try:
        if path.suffix == ".json":
            return _read_object(path, within)
        return _read_exr(path, within) if path.suffix == ".exr" else _read_picture(path, within)
    except (OSError, RuntimeError, ValueError, SyntaxError, MemoryError) as error:
        raise InputError(path, f"cannot be read as an image ({str(error) or type(error).__name__})") from None


def png_bytes(image: NDArray[Any], palette: Sequence[tuple[int, int, int]] | None = None) -> bytes:
    """Encode an image as PNG, the same bytes for the same values.

    Args:
        image: `(h, w)` uint8 or uint16 grey values, or `(h, w, 3)` or `(h, w, 4)` uint8 RGB or RGBA.
        palette: colours of the values of an `(h, w)` uint8 image.

    Raises:
        ValueError: the image has another shape or dtype, or is empty.
    """
    colour_types = {(): _GREY if palette is None else _PALETTE, (3,): _RGB, (4,): _RGBA}
    colour_type = colour_types.get(image.shape[2:])
    dtypes = ("uint8", "uint16") if colour_type == _GREY else ("uint8",)
    fits = colour_type is not None and image.dtype in dtypes and (palette is None or image.ndim == 2)
    if not fits or image.ndim < 2 or image.size == 0:
        raise ValueError(f"an image of shape {image.shape} and type {image.dtype} does not fit this PNG type")

    # Each row: the filter, then its big-endian bytes minus those of the row above.
    # A part of the rows at a time, which takes little memory, and gives the same bytes as all at once.
    coder = zlib.compressobj(_DEFLATE_LEVEL, zlib.DEFLATED, zlib.MAX_WBITS, _DEFLATE_MEMORY, zlib.Z_RLE)
    step, data = max(_PNG_PART // image[0].nbytes, 1), []
    for top in range(0, len(image), step):
        rows = image[max(top - 1, 0) : top + step]
        big_endian = rows.astype(image.dtype.newbyteorder(">"), order="C", copy=False)
        values = big_endian.reshape(len(rows), -1).view(np.uint8)
        filtered = np.empty((len(rows), 1 + values.shape[1]), np.uint8)
        filtered[:, 0] = _UP
        filtered[0, 1:] = values[0]
        np.subtract(values[1:], values[:-1], out=filtered[1:, 1:])
        data.append(coder.compress(filtered[top > 0 :].data))
    data.append(coder.flush())

    # Width, height, bits per value, colour type; deflate, filters by row, not interlaced.
    height, width = image.shape[:2]
    header = struct.pack(">IIBBBBB", width, height, 8 * image.itemsize, colour_type, 0, 0, 0)
    colours = [] if palette is None else _chunk(b"PLTE", bytes(value for rgb in palette for value in rgb))
    return b"".join(
        [_PNG_SIGNATURE, *_chunk(b"IHDR", header), *colours, *_chunk(b"IDAT", *data), *_chunk(b"IEND", b"")]
    )


def _chunk(name: bytes, *content: bytes) -> list[bytes]:
    """The parts of a PNG chunk: length, name, content, checksum."""
    checksum = zlib.crc32(name)
    for part in content:
        checksum = zlib.crc32(part, checksum)
    return [struct.pack(">I", sum(map(len, content))), name, *content, struct.pack(">I", checksum)]


def _exr_bytes(image: NDArray[Any], output: str, bands: Sequence[Band]) -> bytes:
    import OpenEXR

    planes = np.atleast_3d(image)
    names = (output,) if image.ndim == 2 else _channel_names(planes.shape[2], output, bands)
    # The low bits of measured values do not compress: ZIP takes 14 % off distances and 4 % off electrons for
    # six times the time (800x600: 16 and 55 ms against 3 and 6). Of normals it takes 58 %, but for 43 ms
    # against 6, most of what a frame's ground truth takes; of positions 18 % and of flow 35 %, for six times
    # the time. Coverage consists of runs of 0 and 1: 195 KiB instead of 7.3 MiB, for 16 ms against 8.
    compression = OpenEXR.ZIP_COMPRESSION if OUTPUTS[output].in_runs else OpenEXR.NO_COMPRESSION
    header = {"compression": compression, "type": OpenEXR.scanlineimage, "unit": OUTPUTS[output].unit}
    if bands and OUTPUTS[output].has_channels:
        header |= _band_attributes(bands)
    channels = {name: np.ascontiguousarray(planes[..., axis]) for axis, name in enumerate(names)}
    # Into memory: to a file the library writes every line with a system call (4.0 ms against 2.3).
    stream = BytesIO()
    OpenEXR.File(header, channels).write(stream)
    return stream.getvalue()


def _channel_names(count: int, output: str, bands: Sequence[Band]) -> Sequence[str]:
    """Names of the channels of an image with a third axis."""
    if OUTPUTS[output].has_channels:
        if bands or output in BAND_OUTPUTS:
            return _band_channels(count, bands)
        if count not in (1, 3):
            raise ValueError(f"{output} with {count} channels needs the bands of the sensor")
        return _LUMINANCE if count == 1 else OUTPUTS[output].channel_names
    return OUTPUTS[output].channel_names


def _read_object(path: Path, within: Path | None) -> dict[str, Any]:
    content = parse_json(read_file(path, "json", within=within))
    if not isinstance(content, dict):
        raise ValueError("it holds no JSON object")
    return content


def _read_picture(path: Path, within: Path | None) -> NDArray[Any]:
    from PIL import Image

    formats = ["JPEG" if path.suffix == ".jpg" else "PNG"]
    try:
        with open_file(path, "image", within=within) as file, Image.open(file, formats=formats) as picture:
            return np.array(picture)
    except Image.UnidentifiedImageError:
        raise ValueError(f"cannot identify image file {str(path)!r}") from None
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from None


def _is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _read_exr(path: Path, within: Path | None) -> NDArray[Any]:
    import OpenEXR

    # By its name: the library reads an open file in four times the time.
    source: Any = str(check_file(path, "values", within=within))
    if not _is_utf8(source):
        # The library takes no such name.
        source = BytesIO(read_file(path, "values", within=within))
    with OpenEXR.File(source, separate_channels=True) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    if names := _sorted_bands(channels):
        return np.stack([channels[name] for name in names], axis=-1)
    for names in (*(output.channel_names for output in OUTPUTS.values()), _LUMINANCE):
        if set(channels) == set(names):
            return np.stack([channels[name] for name in names], axis=-1)
    if len(channels) == 1:
        return next(iter(channels.values()))
    raise ValueError(f"channels {', '.join(sorted(channels))} belong to no output of this package")


def _band_channels(count: int, bands: Sequence[Band] = ()) -> tuple[str, ...]:
    """Names of `count` channels: `B01.475nm`, with the centre to a nanometre; `B01` without bands.

    Raises:
        ValueError: there is another number of bands.
    """
    if bands and len(bands) != count:
        raise ValueError(f"{count} channels cannot be those of {len(bands)} bands")
    digits = max(2, len(str(count)))
    centres = [f".{band.centre_nm:.0f}nm" for band in bands] or [""] * count
    return tuple(f"B{number:0{digits}d}{centre}" for number, centre in enumerate(centres, start=1))


def _sorted_bands(channels: Iterable[str]) -> tuple[str, ...]:
    """The channels in the order of their bands; empty if they are not those of bands."""
    matches = {name: _CHANNEL.fullmatch(name) for name in channels}
    numbers = {name: int(match[1]) for name, match in matches.items() if match is not None}
    return tuple(sorted(numbers, key=numbers.__getitem__)) if len(numbers) == len(matches) else ()


def _band_attributes(bands: Sequence[Band]) -> dict[str, str]:
    """Attributes of an EXR header: centres and full widths at half maximum, and names if there are some."""
    attributes = {
        "wavelength_nm": ", ".join(f"{band.centre_nm:g}" for band in bands),
        "fwhm_nm": ", ".join(f"{band.width_nm:g}" for band in bands),
    }
    if any(band.name for band in bands):
        attributes["band_names"] = ", ".join(band.name for band in bands)
    return attributes


def recorded_bands(metadata: Mapping[str, Any]) -> tuple[Band, ...]:
    """The bands in the JSON of a frame, whose types are valid; empty for a sensor without bands."""
    return tuple(
        Band(entry["name"], entry["centre_nm"], entry["width_nm"])
        for entry in metadata.get("camera", {}).get("bands", ())
    )


def unlit_bands(metadata: Mapping[str, Any]) -> tuple[int, ...]:
    """Bands, from 0, whose reflectance is nan somewhere in a frame, by its JSON, which may be damaged."""
    reference = metadata.get("white_reference")
    listed = reference.get(UNLIT_BANDS, ()) if isinstance(reference, Mapping) else ()
    known = listed if isinstance(listed, list | tuple) else ()
    return tuple(band for band in known if isinstance(band, int) and not isinstance(band, bool))

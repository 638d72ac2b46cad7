"""Images on disk: PNG for what is whole numbers, OpenEXR for what is measured, JSON for what is no image.

An EXR file has channels of 32-bit floats named by what they hold: `distance`; `depth_z`; `R`, `G`, `B` for
electrons, or `Y` for those of a monochrome sensor; `X`, `Y`, `Z` for normals and positions; `U`, `V`;
`flow.x`, `flow.y`, `visible`; and of 16-bit floats named by the classes (`background`, `leaf`, ...) for their
coverage. Their unit stands in the header attribute `unit`. Class images are palette PNGs: the pixel values
are the class ids, and a viewer shows the class colours.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.store.atomic import canonical_json
from pepperscene.dataset.store.codecs import exr_bytes, png_bytes
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS

_CHANNELS: Final[Mapping[str, tuple[str, ...]]] = {
    "electrons": ("R", "G", "B"),
    "normal": ("X", "Y", "Z"),
    "position": ("X", "Y", "Z"),
    "coverage": tuple(one.name.lower() for one in OrganClass),
    "uv": ("U", "V"),
    "flow": ("flow.x", "flow.y", "visible"),
    "stereo": ("stereo.x", "stereo.y", "visible"),
}
"""Names of the channels along a third axis."""

_LUMINANCE: Final = ("Y",)
"""Of electrons behind no colour filter."""

_UNITS: Final = {
    "electrons": "photo-electrons per photosite",
    "distance": "metres along the ray from the projection centre",
    "depth_z": "metres along the optical axis",
    "normal": "unit vector in world coordinates",
    "coverage": "share of the pixel's area",
    "position": "metres in world coordinates",
    "uv": "surface coordinates from 0 to 1",
    "flow": "pixels right and down to the next frame; 1 where visible there",
    "stereo": "pixels right and down in the partner's picture; 1 where visible there",
}


def write_image(path: Path, image: Any, output: str) -> None:
    """Write one image of a frame in the format of its output, the same bytes for the same values.

    Args:
        path: the file, whatever its suffix.
        image: of the shape and dtype that `OUTPUTS[output]` tells; a JSON-ready object where it is no array.
        output: name of the output.

    Raises:
        ValueError: shape or dtype are not the output's, or the object holds what JSON does not know.
        OSError: the file cannot be written.
    """
    wanted = OUTPUTS[output]
    if not wanted.fits(image):
        found = f"{image.shape} {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f"{output} must be {f'{wanted.shape} {wanted.dtype}'.strip()}, not {found}")
    if not wanted.is_image:
        path.write_bytes(canonical_json(image))
    elif wanted.suffix == ".exr":
        _write_exr(path, image, output)
    else:
        _write_png(path, image, output)


def read_image(path: str | Path) -> Any:
    """Read a PNG or EXR image as `Frame` holds it; of a palette PNG the indices, which are class ids.

    Of a JSON file the object that it holds.

    Raises:
        InputError: the file is missing or no such image.
    """
    path = Path(path)
    try:
        if path.suffix == ".json":
            return _read_object(path)
        return _read_exr(path) if path.suffix == ".exr" else _read_png(path)
    except (OSError, RuntimeError, ValueError, SyntaxError, MemoryError) as fault:
        raise InputError(path, f"cannot be read as an image ({fault})") from None


def _read_object(path: Path) -> dict[str, Any]:
    found = json.loads(path.read_bytes())
    if not isinstance(found, dict):
        raise ValueError("it holds no JSON object")
    return found


def _write_png(path: Path, image: NDArray[Any], output: str) -> None:
    path.write_bytes(png_bytes(image, CLASS_COLOURS if output == "class" else None))


def _read_png(path: Path) -> NDArray[Any]:
    from PIL import Image

    try:
        with Image.open(path, formats=["PNG"]) as picture:
            return np.array(picture)
    except Image.DecompressionBombError as fault:
        raise ValueError(str(fault)) from None


def _write_exr(path: Path, image: NDArray[Any], output: str) -> None:
    planes = image[..., None] if image.ndim == 2 else image
    names = _LUMINANCE if planes.shape[2] == 1 else _CHANNELS[output]
    if image.ndim == 2:
        names = (output,)
    channels = {name: planes[..., axis] for axis, name in enumerate(names)}
    # The low bits of what is measured are noise to a compressor: ZIP takes 14 % off distances and 4 % off
    # electrons for six times the time (800x600: 16 and 55 ms against 3 and 6). Of normals it takes 58 %, but
    # for 43 ms against 6, most of what a frame's ground truth takes; of positions 18 % and of flow 35 %, for
    # six times the time. Coverage is runs of 0 and 1: 195 KiB instead of 7.3 MiB, for 16 ms against 8.
    if output == "coverage":
        _write_compressed(path, channels, _UNITS[output])
    else:
        path.write_bytes(exr_bytes(channels, {"unit": _UNITS[output]}))


def _write_compressed(path: Path, channels: Mapping[str, NDArray[Any]], unit: str) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "unit": unit}
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    try:
        OpenEXR.File(header, planes).write(str(path))
    except RuntimeError as fault:
        raise OSError(str(fault)) from None


def _read_exr(path: Path) -> NDArray[Any]:
    import OpenEXR

    if not path.is_file():
        raise FileNotFoundError("no such file")
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    for names in (*_CHANNELS.values(), _LUMINANCE):
        if set(channels) == set(names):
            return np.stack([channels[name] for name in names], axis=-1)
    if len(channels) == 1:
        return next(iter(channels.values()))
    raise ValueError(f"channels {', '.join(sorted(channels))} are none of this package's")

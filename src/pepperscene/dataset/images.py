"""Images on disk: PNG for what is whole numbers, OpenEXR for what is measured.

An EXR file has 32-bit float channels named by what they hold (`distance`; `depth_z`; `R`, `G`, `B` for
electrons, or `Y` for those of a monochrome sensor; `X`, `Y`, `Z` for normals), without compression, and their
unit in the header attribute `unit`. Class images are palette PNGs: the pixel values are the class ids, and a
viewer shows the class colours.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS
from pepperscene.dataset.png import png_bytes
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS

_CHANNELS: Final = (("R", "G", "B"), ("Y",), ("X", "Y", "Z"))
"""Names of the channels along a third axis: colours, luminance alone, directions."""

_UNITS: Final = {
    "electrons": "photo-electrons per photosite",
    "distance": "metres along the ray from the projection centre",
    "depth_z": "metres along the optical axis",
    "normal": "unit vector in world coordinates",
}


def write_image(path: Path, image: NDArray[Any], output: str) -> None:
    """Write one image of a frame in the format of its output, the same bytes for the same values.

    Args:
        path: the file, whatever its suffix.
        image: of the shape and dtype that `OUTPUTS[output]` tells.
        output: name of the output.

    Raises:
        ValueError: shape or dtype are not the output's.
        OSError: the file cannot be written.
    """
    wanted = OUTPUTS[output]
    if not wanted.fits(image):
        raise ValueError(f"{output} must be {wanted.shape} {wanted.dtype}, not {image.shape} {image.dtype}")
    if wanted.suffix == ".exr":
        _write_exr(path, image, output)
    else:
        _write_png(path, image, output)


def read_image(path: str | Path) -> NDArray[Any]:
    """Read a PNG or EXR image as `Frame` holds it; of a palette PNG the indices, which are class ids.

    Raises:
        InputError: the file is missing or no such image.
    """
    path = Path(path)
    try:
        return _read_exr(path) if path.suffix == ".exr" else _read_png(path)
    except (OSError, RuntimeError, ValueError, SyntaxError) as fault:
        raise InputError(path, "", None, f"cannot be read as an image ({fault})") from None


def _write_png(path: Path, image: NDArray[Any], output: str) -> None:
    path.write_bytes(png_bytes(image, CLASS_COLOURS if output == "class" else None))


def _read_png(path: Path) -> NDArray[Any]:
    from PIL import Image

    with Image.open(path, formats=["PNG"]) as picture:
        return np.array(picture)


def _write_exr(path: Path, image: NDArray[Any], output: str) -> None:
    import OpenEXR

    planes = image[..., None] if image.ndim == 2 else image
    names = (output,) if image.ndim == 2 else _channels(output, image.shape[2])
    channels = {name: np.ascontiguousarray(planes[..., axis]) for axis, name in enumerate(names)}
    header = {
        # The low bits of what is measured are noise to a compressor: ZIP takes 14 % off distances and 4 % off
        # electrons for six times the time (800x600: 16 and 55 ms against 3 and 6). Of normals it takes 58 %,
        # but for 43 ms against 6, most of what a frame's ground truth takes in all.
        "compression": OpenEXR.NO_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "unit": _UNITS[output],
    }
    try:
        OpenEXR.File(header, channels).write(str(path))
    except RuntimeError as fault:
        raise OSError(str(fault)) from None


def _channels(output: str, count: int) -> tuple[str, ...]:
    """Names of the channels of an image with a third axis."""
    colour, luminance, direction = _CHANNELS
    if count == 1:
        return luminance
    return direction if output == "normal" else colour


def _read_exr(path: Path) -> NDArray[Any]:
    import OpenEXR

    if not path.is_file():
        raise FileNotFoundError("no such file")
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    for names in _CHANNELS:
        if set(channels) == set(names):
            return np.stack([channels[name] for name in names], axis=-1)
    if len(channels) == 1:
        return next(iter(channels.values()))
    raise ValueError(f"channels {', '.join(sorted(channels))} are none of this package's")

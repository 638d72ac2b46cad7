"""Photographs of a ColorChecker or a grey card, and the pixels that they give for a calibration."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.image.photo import jpeg_bytes
from pepperscene.colour.patches.chart import check_corners, orient_corners
from pepperscene.colour.patches.chart_detection import find_chart, grid_corners, map_points
from pepperscene.dataset.readers.pictures import read_photo
from pepperscene.errors import ArgumentError, InputError
from pepperscene.user_files import open_file

Floats = NDArray[np.float64]

FIELDS: Final = 24
_MIDDLE: Final = 0.4  # chosen: side of a field's middle, in steps of the grid; turned by 45 degrees it fits
_MIN_SIDE_PX: Final = 6  # chosen: a deviation of 36 pixels is known to 12 %
_MAX_CLIPPED: Final = 0.01  # chosen: fraction of a field's codes at 0 or 255 that noise explains
_MIN_WHITE: Final = 0.2  # chosen: mean code of the white field, of full scale; darker charts have no tones
_MIN_USED: Final = 12  # chosen: half of the chart
_CARD_PARTS: Final = 4  # chosen: a grey card is divided into 4 x 4 parts


_SAMPLINGS: Final = {0: "4:4:4", 1: "4:2:2", 2: "4:2:0"}  # as Pillow numbers them
_LUMA_TABLE: Final = (
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56,
    14, 17, 22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92,
    49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
)  # fmt: skip
"""Quantisation of luma of ITU-T T.81, table K.1."""


@dataclass(frozen=True)
class JpegSettings:
    """How a JPEG file was compressed: quality as of the Independent JPEG Group, and subsampling of chroma."""

    quality: int
    subsampling: str

    def compressed(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The picture `(h, w, 3)` after compression."""
        from PIL import Image

        settings = {"jpeg_quality": self.quality, "jpeg_subsampling": self.subsampling}
        compressed = io.BytesIO(jpeg_bytes(picture, settings))
        return np.array(Image.open(compressed, formats=("JPEG",)).convert("RGB"))


@dataclass(frozen=True, eq=False)
class ChartPhotograph:
    """A photograph and its measured fields, n = 24 of a ColorChecker, fewer of a grey card.

    Attributes:
        name: of the file.
        picture: `(h, w, 3)` uint8, as displayed.
        corners: `(4, 2)` of the chart in pixels, from dark skin; of a card, of its rectangle.
        fields: `(n,)` numbers of the chart's fields; -1 for a grey card.
        codes: `(n, 3)` mean codes of the middles of the fields, 1 for 255.
        usable: `(n, 3)` whether a channel is neither clipped at 0 nor at 255.
        place: `(n, 2)` of the fields from the middle of the picture, right and down, in half diagonals.
        middles: codes `(k, k, 3)` of a square in the middle of each field.
    """

    name: str
    picture: NDArray[np.uint8]
    corners: Floats
    fields: NDArray[np.intp]
    codes: Floats
    usable: NDArray[np.bool_]
    place: Floats
    middles: tuple[Floats, ...]


def read_chart(path: Path, corners: ArrayLike | None = None) -> ChartPhotograph:
    """Read a photograph of a ColorChecker, turned as its EXIF orientation says.

    Args:
        path: JPEG, PNG, TIFF, BMP or WebP with 8 bits per channel.
        corners: `(4, 2)` pixel coordinates x, y of the outer corners of the fields at the chart's corners, in
            order around it, beginning at any; None detects the chart.

    Raises:
        InputError: the file is no image, no chart is found, or it is too small, too dark or overexposed.
    """
    picture = read_photo(path)
    found = find_chart(picture, path) if corners is None else check_corners(corners, picture.shape, path)
    return measure_chart(picture, orient_corners(picture, found, path), path)


def measure_chart(picture: NDArray[np.uint8], corners: Floats, where: str | Path) -> ChartPhotograph:
    """Measure the fields of a chart whose corners begin at dark skin; errors as `read_chart`."""
    columns, rows = np.meshgrid(np.arange(6) + 0.5, np.arange(4) + 0.5)
    centres_of = np.stack([columns, rows], axis=-1).reshape(-1, 2)
    centres = map_points(centres_of, grid_corners(), corners)
    # The shorter side of each field, from the centres of its neighbours' edges.
    steps = [map_points(centres_of + half, grid_corners(), corners) for half in ([0.5, 0.0], [0.0, 0.5])]
    pitch = 2.0 * np.min([np.linalg.norm(step - centres, axis=1) for step in steps], axis=0)
    sides = np.floor(_MIDDLE * pitch).astype(int)
    if sides.min() < _MIN_SIDE_PX:
        least = round(_MIN_SIDE_PX / _MIDDLE)
        problem = f"shows fields of {pitch.min():.0f} pixels; they must have at least {least}"
        raise InputError(where, problem, key="chart")
    starts = np.rint(centres - sides[:, None] / 2.0).astype(int)
    middles = tuple(
        picture[y : y + side, x : x + side] / 255.0 for (x, y), side in zip(starts, sides, strict=True)
    )
    photograph = _measured(picture, corners, np.arange(FIELDS), middles, centres, where)
    if (white := float(photograph.codes[18].max())) < _MIN_WHITE:
        code = f"its white field has the code {255.0 * white:.0f}, minimum {255 * _MIN_WHITE:g}"
        raise InputError(where, f"is too dark: {code}", key="chart")
    if (used := int(photograph.usable.all(axis=1).sum())) < _MIN_USED:
        problem = f"has {FIELDS - used} of {FIELDS} fields with codes at 0 or 255: change the exposure"
        raise InputError(where, problem, key="chart")
    return photograph


def read_card(path: Path, box: tuple[float, ...]) -> ChartPhotograph:
    """Read a photograph of a grey card.

    Args:
        path: as for `read_chart`.
        box: left, top, width and height of a rectangle on the card, in pixels.

    Raises:
        InputError: the file is no image, or the card is overexposed or black.
        ArgumentError: the rectangle is not in the photograph, or too small.
    """
    picture = read_photo(path)
    left, top, width, height = (round(length) for length in box)
    if left < 0 or top < 0 or left + width > picture.shape[1] or top + height > picture.shape[0]:
        size = f"{picture.shape[1]}x{picture.shape[0]} pixels"
        raise ArgumentError("grey_card", f"must be inside {path}, {size}, not {left},{top},{width},{height}")
    if min(width, height) < _CARD_PARTS * _MIN_SIDE_PX:
        least = f"must be at least {_CARD_PARTS * _MIN_SIDE_PX} pixels wide and high"
        raise ArgumentError("grey_card", f"{least}, not {width}x{height}")
    # Parts of equal size; what remains at the right and the bottom is left out.
    step_x, step_y = width // _CARD_PARTS, height // _CARD_PARTS
    side = min(step_x, step_y)
    starts = [(left + i * step_x, top + j * step_y) for j in range(_CARD_PARTS) for i in range(_CARD_PARTS)]
    middles = tuple(picture[y : y + side, x : x + side] / 255.0 for x, y in starts)
    centres = np.array(starts) + side / 2.0
    corners = np.array([[left, top], [left + width, top], [left + width, top + height], [left, top + height]])
    numbers = np.full(len(starts), -1)
    card = _measured(picture, corners.astype(float), numbers, middles, centres, path)
    if not card.usable.all(axis=1).any():
        raise InputError(path, "has codes at 0 or 255 everywhere on the card: change the exposure")
    return card


def jpeg_settings(path: Path) -> JpegSettings | None:
    """How a photograph was compressed, by its table of quantisation; None if it is no JPEG of colours.

    The quality is that of the Independent JPEG Group whose table of luma is nearest.
    """
    from PIL import Image, JpegImagePlugin, UnidentifiedImageError

    try:
        with open_file(path, "image") as file, Image.open(file, formats=("JPEG",)) as image:
            tables, sampling = getattr(image, "quantization", None), JpegImagePlugin.get_sampling(image)
    except UnidentifiedImageError:
        return None
    if not tables or sampling not in _SAMPLINGS:
        return None
    found, standard = sum(tables[0]), np.array(_LUMA_TABLE)
    qualities = np.arange(1, 101)
    scales = np.where(qualities < 50, 5000 // qualities, 200 - 2 * qualities)
    sums = np.clip((standard * scales[:, None] + 50) // 100, 1, 255).sum(axis=1)
    return JpegSettings(int(qualities[np.abs(sums - found).argmin()]), _SAMPLINGS[sampling])


def _measured(
    picture: NDArray[np.uint8],
    corners: Floats,
    fields: NDArray[np.intp],
    middles: tuple[Floats, ...],
    centres: Floats,
    where: str | Path,
) -> ChartPhotograph:
    size = np.array([picture.shape[1], picture.shape[0]], float)
    clipped = np.stack([((codes == 0.0) | (codes == 1.0)).mean(axis=(0, 1)) for codes in middles])
    return ChartPhotograph(
        name=Path(where).name,
        picture=picture,
        corners=corners,
        fields=fields,
        codes=np.stack([codes.mean(axis=(0, 1)) for codes in middles]),
        usable=clipped <= _MAX_CLIPPED,
        place=(centres - size / 2.0) / (np.linalg.norm(size) / 2.0),
        middles=middles,
    )

"""Calibration of a picture's colours by a ColorChecker Classic in it.

The 24 fields' mean linear colours, taken in the middle of each field, are brought to what the chart's
measured reflectances (ISO 17321-1) show under D65, by a matrix: Cheung et al. 2004, "A comparative study of
the characterisation of colour cameras by means of neural networks and polynomial transforms", Coloration
Technology 120:19, with three terms, which is least squares. A matrix alone, so that a colour in shade keeps
its chromaticity.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import decode_tone
from pepperscene.camera.colorimetry import (
    CHART,
    XYZ_TO_SRGB,
    adapted_xyz,
    colour_checker_reflectances,
    d65_spectrum,
)
from pepperscene.colour.patches.chart_detection import COLUMNS, ROWS, field_numbers, orientations
from pepperscene.colour.statistics.colours import delta_e_2000, linear_srgb_to_lab
from pepperscene.errors import InputError
from pepperscene.spectra import colour_science, read_spectra

Floats = NDArray[np.float64]

_LEAST_PIXELS: Final = 9  # chosen: in the middle half of a field; a mean of fewer shows the noise
_SATURATED: Final = 0.01  # chosen: share of a field's pixels with a channel at 255, below which noise did it
_LEAST_FIELDS: Final = 12  # chosen: half of the chart, for the nine numbers of a matrix
_DARKEST_WHITE: Final = 0.05  # chosen: linear; the black field, 28 times as dark, is then half a code
_NO_CHART: Final = 10.0  # chosen: mean CIEDE2000; a chart through a camera's own tone curve has half of it
_NM: Final = np.arange(300.0, 1101.0)  # the grid of `adapted_xyz`


@dataclass(frozen=True, eq=False)
class Calibration:
    """What brings a camera's linear colours to linear sRGB.

    Attributes:
        matrix: `(3, 3)` linear colour of the picture to linear sRGB under D65.
        corners: `(4, 2)` of the chart in the picture: at dark skin, bluish green, black and white.
        before: `(24,)` CIEDE2000 of the fields as they are in the picture.
        after: `(24,)` once calibrated.
        left_out: names of fields that the matrix was not fitted to: a channel of theirs is cut off at 0.
    """

    matrix: Floats
    corners: Floats
    before: Floats = field(repr=False)
    after: Floats = field(repr=False)
    left_out: tuple[str, ...] = ()

    def apply(self, linear: ArrayLike) -> Floats:
        """`(..., 3)` linear sRGB of the picture's linear colours; may leave [0, 1]."""
        return np.asarray(linear, float) @ self.matrix.T

    def report(self) -> str:
        """The differences before and after, in one line."""
        told = f"{self.before.mean():.2f} (at most {self.before.max():.2f})"
        found = f"{self.after.mean():.2f} (at most {self.after.max():.2f})"
        return f"mean delta E 2000 of the chart's fields: {told} as photographed, {found} calibrated"


def calibrate(
    picture: NDArray[np.uint8],
    corners: ArrayLike | None = None,
    *,
    tone: Literal["srgb", "linear"] = "srgb",
    where: str | Path = "chart",
) -> Calibration:
    """The calibration by the chart in a picture.

    Args:
        picture: `(h, w, 3)` uint8.
        corners: `(4, 2)` pixel coordinates x, y of the outer corners of the fields at dark skin, bluish
            green, black and white (with dark skin at the upper left: clockwise); None looks for the chart,
            whichever way it is held.
        tone: of the picture's codes.
        where: the file, for messages.

    Raises:
        InputError: no chart is found there, it is told in another order, a field is saturated or too small,
            or it is too dark.
    """
    if corners is None:
        from pepperscene.colour.patches.chart_detection import find_chart

        told = find_chart(picture, where)
    else:
        told = _checked(corners, picture.shape, where)
    turned, means, saturated = _best_orientation(picture, told, tone, where)
    found = _fitted(means, saturated, turned, where)
    if corners is not None and turned.tolist() != told.tolist():
        first, second = (1 + int(np.flatnonzero((told == turned[k]).all(axis=1))[0]) for k in range(2))
        allowed = f"must go from dark skin to bluish green, here from corner {first} to corner {second}"
        raise InputError(where, allowed, key="corners", value=told.tolist())
    return found


@lru_cache(maxsize=1)
def chart_linear() -> Floats:
    """`(24, 3)` linear sRGB of the chart's fields under D65; cyan lies outside of sRGB."""
    return adapted_xyz(d65_spectrum(), colour_checker_reflectances().at(_NM)) @ XYZ_TO_SRGB.T


@lru_cache(maxsize=1)
def chart_names() -> tuple[str, ...]:
    """Names of the 24 fields, row by row from dark skin."""
    return tuple(read_spectra(CHART))


def _checked(corners: ArrayLike, shape: tuple[int, ...], where: str | Path) -> Floats:
    found = np.asarray(corners, float)
    if found.shape != (4, 2) or not np.isfinite(found).all():
        raise InputError(
            where, "must be four pairs of pixel coordinates x, y", key="corners", value=found.tolist()
        )
    height, width = shape[:2]
    if (found < 0).any() or (found > [width, height]).any():
        raise InputError(
            where, f"must lie in the picture, {width}x{height} pixels", key="corners", value=found.tolist()
        )
    # A quadrangle whose corners follow each other turns the same way at all of them.
    sides = np.roll(found, -1, axis=0) - found
    turns = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
    if not ((turns > 0).all() or (turns < 0).all()):
        raise InputError(
            where, "must go around the chart, one after the other", key="corners", value=found.tolist()
        )
    return found


def _best_orientation(
    picture: NDArray[np.uint8], corners: Floats, tone: Literal["srgb", "linear"], where: str | Path
) -> tuple[Floats, Floats, Floats]:
    """Corners in the order in which the fields fit the chart best, and the fields' means and saturation."""
    aim = chart_linear()
    found = []
    for turned in orientations(corners):
        means, saturated = _fields(picture, turned, tone, where)
        matrix, *_ = np.linalg.lstsq(means, aim, rcond=None)
        misfit = float(
            np.linalg.norm(linear_srgb_to_lab(means @ matrix) - linear_srgb_to_lab(aim), axis=1).mean()
        )
        found.append((misfit, turned, means, saturated))
    _, turned, means, saturated = min(found, key=lambda one: one[0])
    return turned, means, saturated


def _fields(
    picture: NDArray[np.uint8], corners: Floats, tone: Literal["srgb", "linear"], where: str | Path
) -> tuple[Floats, Floats]:
    """Mean linear colour `(24, 3)` of the fields' middle halves, and the share of their pixels at 255."""
    part, numbers = field_numbers(picture.shape[:2], corners)
    codes, inside = picture[part][numbers >= 0], numbers[numbers >= 0]
    counts = np.bincount(inside, minlength=ROWS * COLUMNS)
    if counts.min() < _LEAST_PIXELS:
        found = f"shows fields of {counts.min()} pixels; the middle of each must have {_LEAST_PIXELS}"
        raise InputError(where, found, key="chart")
    linear = decode_tone(codes, tone)
    sums = [np.bincount(inside, linear[:, channel], ROWS * COLUMNS) for channel in range(3)]
    full = np.bincount(inside, (codes == 255).any(axis=1), ROWS * COLUMNS)
    return np.stack(sums, axis=1) / counts[:, None], full / counts


def _fitted(means: Floats, saturated: Floats, corners: Floats, where: str | Path) -> Calibration:
    """The matrix, once the chart is exposed as it must be."""
    names = np.array(chart_names())
    if (full := saturated > _SATURATED).any():
        found = f"is saturated in the fields {', '.join(names[full])}: expose less, or calibrate another way"
        raise InputError(where, found, key="chart")
    white = float(means[list(names).index("white_9_5_05_d")].max())
    if white < _DARKEST_WHITE:
        found = f"is too dark: its white has {white:.3f} of full scale and must have {_DARKEST_WHITE:g}"
        raise InputError(where, found, key="chart")

    # What is cut off at 0 lies outside of the picture's colours, and tells a wrong ratio.
    cut = (means <= 0.0).any(axis=1)
    if np.count_nonzero(~cut) < _LEAST_FIELDS:
        raise InputError(where, f"has {np.count_nonzero(cut)} fields with a channel at 0", key="chart")
    characterise = colour_science().characterisation.matrix_colour_correction
    matrix = np.asarray(characterise(means[~cut], chart_linear()[~cut], method="Cheung 2004", terms=3))

    aim = linear_srgb_to_lab(chart_linear())
    before, after = (
        delta_e_2000(linear_srgb_to_lab(means), aim),
        delta_e_2000(linear_srgb_to_lab(means @ matrix.T), aim),
    )
    if after.mean() > _NO_CHART:
        found = f"shows no ColorChecker there: calibrated, its mean delta E 2000 is {after.mean():.1f}"
        raise InputError(where, found, key="chart")
    return Calibration(matrix, corners, before, after, tuple(str(name) for name in names[cut]))

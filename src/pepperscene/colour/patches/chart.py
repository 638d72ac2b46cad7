"""Colour calibration of a picture by a ColorChecker Classic in it.

The mean linear colours of the 24 fields, taken in the centre of each field, are mapped to the colours of the
chart's measured reflectances (ISO 17321-1) under D65 by a 3x3 matrix: least squares, which is the method of
Cheung et al. 2004 with three terms ("A comparative study of the characterisation of colour cameras by means
of neural networks and polynomial transforms", Coloration Technology 120:19). A matrix alone keeps the
chromaticity of colours in shade.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import decode_tone
from pepperscene.camera.image.colorimetry import (
    COLOUR_CHECKER_FILE,
    NM,
    XYZ_TO_SRGB,
    adapted_xyz,
    colour_checker_reflectances,
    d65_spectrum,
)
from pepperscene.colour.patches.chart_detection import COLUMNS, ROWS, field_numbers, find_chart, orientations
from pepperscene.colour.statistics import delta_e_2000, linear_srgb_to_lab
from pepperscene.errors import InputError
from pepperscene.spectra import colour_science, read_spectra

Floats = NDArray[np.float64]
Tone = Literal["srgb", "linear"]

_MIN_FIELD_PX: Final = 9  # chosen: in the centre of a field; a mean of fewer pixels shows the noise
_MAX_SATURATED: Final = 0.01  # chosen: fraction of a field's pixels with a channel at 255 that noise explains
_MIN_FIELDS: Final = 12  # chosen: half of the chart, for the nine numbers of a matrix
_MIN_WHITE: Final = 0.05  # chosen: linear; the black field, 28 times as dark, is then half a code
_MAX_DELTA_E: Final = 10.0  # chosen: mean CIEDE2000; a chart through a camera's own tone curve has half of it


@dataclass(frozen=True, eq=False)
class Calibration:
    """A matrix that maps a camera's linear colours to linear sRGB.

    Attributes:
        matrix: `(3, 3)` linear colour of the picture to linear sRGB under D65.
        corners: `(4, 2)` of the chart in the picture: at dark skin, bluish green, black and white.
        before: `(24,)` CIEDE2000 of the fields as photographed.
        after: `(24,)` CIEDE2000 after calibration.
        left_out: names of the fields that the fit leaves out, because a channel is clipped at 0.
    """

    matrix: Floats
    corners: Floats
    before: Floats = field(repr=False)
    after: Floats = field(repr=False)
    left_out: tuple[str, ...] = ()

    def apply(self, linear: ArrayLike) -> Floats:
        """`(..., 3)` linear sRGB of linear colours of the picture; values may be outside [0, 1]."""
        return np.asarray(linear, float) @ self.matrix.T

    def report(self) -> str:
        """Colour differences before and after, in one line."""
        before, after = (f"{d.mean():.2f} (maximum {d.max():.2f})" for d in (self.before, self.after))
        return f"mean CIEDE2000 of the chart's fields: {before} before, {after} after calibration"


def calibrate(
    picture: NDArray[np.uint8],
    corners: ArrayLike | None = None,
    *,
    tone: Tone = "srgb",
    where: str | Path = "chart",
) -> Calibration:
    """Calibrate the colours of a picture by the chart in it.

    Args:
        picture: `(h, w, 3)` uint8.
        corners: `(4, 2)` pixel coordinates x, y of the outer corners of the fields dark skin, bluish green,
            black and white (clockwise if dark skin is at the upper left); None detects the chart.
        tone: of the picture's codes.
        where: file name for messages.

    Raises:
        InputError: no chart is found, the corners are in another order, a field is saturated or too small, or
            the chart is too dark.
    """
    given = find_chart(picture, where) if corners is None else check_corners(corners, picture.shape, where)
    oriented, means, saturated = _best_orientation(picture, given, tone, where)
    calibration = _fit_matrix(means, saturated, oriented, where)
    if corners is not None and oriented.tolist() != given.tolist():
        first, second = (1 + int(np.flatnonzero((given == oriented[k]).all(axis=1))[0]) for k in range(2))
        problem = f"must begin at dark skin, then bluish green, which are here corner {first} and {second}"
        raise InputError(where, problem, key="corners", value=given.tolist())
    return calibration


@lru_cache(maxsize=1)
def chart_linear() -> Floats:
    """`(24, 3)` linear sRGB of the chart's fields under D65; cyan is outside the sRGB gamut."""
    return adapted_xyz(d65_spectrum(), colour_checker_reflectances().at(NM)) @ XYZ_TO_SRGB.T


@lru_cache(maxsize=1)
def chart_names() -> tuple[str, ...]:
    """Names of the 24 fields, row by row from dark skin."""
    return tuple(read_spectra(COLOUR_CHECKER_FILE))


def check_corners(corners: ArrayLike, shape: tuple[int, ...], where: str | Path) -> Floats:
    """The corners `(4, 2)` if they are four points in order around an area inside the picture."""
    points, (height, width, *_) = np.asarray(corners, float), shape
    if points.shape != (4, 2) or not np.isfinite(points).all():
        problem = "must be four pairs of pixel coordinates x, y"
    elif (points < 0).any() or (points > [width, height]).any():
        problem = f"must be inside the picture, {width}x{height} pixels"
    else:
        # A convex quadrangle turns the same way at every corner.
        edges = np.roll(points, -1, axis=0) - points
        turns = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
        if (turns > 0).all() or (turns < 0).all():
            return points
        problem = "must be in order around the chart"
    raise InputError(where, problem, key="corners", value=points.tolist())


def orient_corners(picture: NDArray[np.uint8], corners: Floats, where: str | Path) -> Floats:
    """The corners `(4, 2)` in the order in which the fields of an sRGB picture fit the chart best."""
    return _best_orientation(picture, corners, "srgb", where)[0]


def _best_orientation(
    picture: NDArray[np.uint8], corners: Floats, tone: Tone, where: str | Path
) -> tuple[Floats, Floats, Floats]:
    """Corners in the order in which the fields fit the chart best, and the fields' means and saturation."""
    aim = chart_linear()

    def misfit(candidate: tuple[Floats, Floats, Floats]) -> float:
        _, means, _ = candidate
        matrix, *_ = np.linalg.lstsq(means, aim, rcond=None)
        difference = linear_srgb_to_lab(means @ matrix) - linear_srgb_to_lab(aim)
        return float(np.linalg.norm(difference, axis=1).mean())

    candidates = [(way, *_field_means(picture, way, tone, where)) for way in orientations(corners)]
    return min(candidates, key=misfit)


def _field_means(
    picture: NDArray[np.uint8], corners: Floats, tone: Tone, where: str | Path
) -> tuple[Floats, Floats]:
    """Mean linear colour `(24, 3)` of the fields' central halves, and the fraction of pixels at 255."""
    part, numbers = field_numbers(picture.shape[:2], corners)
    codes, inside = picture[part][numbers >= 0], numbers[numbers >= 0]
    counts = np.bincount(inside, minlength=ROWS * COLUMNS)
    if counts.min() < _MIN_FIELD_PX:
        problem = (
            f"shows fields of {counts.min()} pixels; the centre of each must have at least {_MIN_FIELD_PX}"
        )
        raise InputError(where, problem, key="chart")
    linear = decode_tone(codes, tone)
    sums = [np.bincount(inside, linear[:, channel], ROWS * COLUMNS) for channel in range(3)]
    saturated = np.bincount(inside, (codes == 255).any(axis=1), ROWS * COLUMNS)
    return np.stack(sums, axis=1) / counts[:, None], saturated / counts


def _fit_matrix(means: Floats, saturated: Floats, corners: Floats, where: str | Path) -> Calibration:
    """Fit the matrix; refuse a chart that is over- or underexposed."""
    names = np.array(chart_names())
    if (too_bright := saturated > _MAX_SATURATED).any():
        problem = f"is saturated in the fields {', '.join(names[too_bright])}: reduce the exposure"
        raise InputError(where, problem, key="chart")
    white = float(means[list(names).index("white_9_5_05_d")].max())
    if white < _MIN_WHITE:
        problem = f"is too dark: its white field is at {white:.3f} of full scale, minimum {_MIN_WHITE:g}"
        raise InputError(where, problem, key="chart")

    # A channel clipped at 0 is outside the picture's gamut and gives a wrong ratio.
    clipped = (means <= 0.0).any(axis=1)
    if np.count_nonzero(~clipped) < _MIN_FIELDS:
        raise InputError(where, f"has {np.count_nonzero(clipped)} fields with a channel at 0", key="chart")
    fit = colour_science().characterisation.matrix_colour_correction
    matrix = np.asarray(fit(means[~clipped], chart_linear()[~clipped], method="Cheung 2004", terms=3))

    aim = linear_srgb_to_lab(chart_linear())
    before = delta_e_2000(linear_srgb_to_lab(means), aim)
    after = delta_e_2000(linear_srgb_to_lab(means @ matrix.T), aim)
    if after.mean() > _MAX_DELTA_E:
        problem = f"shows no ColorChecker there: its mean CIEDE2000 after calibration is {after.mean():.1f}"
        raise InputError(where, problem, key="chart")
    return Calibration(matrix, corners, before, after, tuple(str(name) for name in names[clipped]))

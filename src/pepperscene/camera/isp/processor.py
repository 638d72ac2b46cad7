"""The steps of an image signal processor (ISP), each off unless it has a value, and files of these.

Presets are TOML files, as of `materials/isps`; tone curves are CSV files.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field

from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra.files import SourcedDocument, find_material, read_table
from pepperscene.units import Fraction, Name, Table, single_message, within

ToneCurveName = Literal["srgb", "linear", "gamma", "filmic"]
TONE_CURVES: Final[tuple[ToneCurveName, ...]] = ("srgb", "linear", "gamma", "filmic")
MOST_POINTS: Final = 1_025  # of a tone curve; chosen: four for each 8-bit code

# Bounds of all steps are chosen: beyond what cameras show, and far from where single precision ends.
RedBlue = tuple[Annotated[float, within(-0.9, 1)], Annotated[float, within(-0.9, 1)]]
Pixels = Annotated[float, within(-50, 50)]
Quality = Annotated[int, Field(strict=True, ge=1, le=100)]
Subsampling = Literal["4:4:4", "4:2:2", "4:2:0"]
Points = tuple[tuple[float, float], ...]
Rows = Annotated[tuple[tuple[Fraction, Fraction], ...], Field(min_length=2, max_length=MOST_POINTS)]

_CURVE: Final = single_message(
    f"must be {', '.join(TONE_CURVES)}, the path of a .csv file, or pairs of light and code, each 0 to 1"
)


def _check_curve_name(name: str) -> str:
    if name not in TONE_CURVES and not name.lower().endswith(".csv"):
        raise ValueError("no such curve")
    return name


CurveName = Annotated[Name, AfterValidator(_check_curve_name)]


@dataclass(frozen=True)
class ImageProcessor(Table):
    """An image signal processor: steps in this order, from the colours of the sensor to an 8-bit image.

    A value that is not given is the preset's; without one, its step is left out. Rows of a tone curve that do
    not rise are a ValueError; see `tone_points`.

    Attributes:
        preset: shipped name or path of a file with the values that are not given here.
        black_level_error: what remains of the black level, a fraction of full scale; negative values crush
            dark colours.
        shading_correction: share of the lens' fall-off towards the corners that is corrected; 1 makes an even
            surface even.
        shading: residual of that correction, added to a factor of 1 at the image's corners; it falls to 0 at
            the centre with the square of the distance.
        shading_cast: the same for red and blue alone.
        chromatic_aberration_px: of the lens: how far red and blue are displaced outwards, against green, at
            the corners. Green, and so the labels, stay where they are.
        chromatic_correction: share of the aberration that is corrected.
        saturation: factor on the difference from grey, in linear light; 0 is grey.
        tone_curve: from linear light to code, instead of `developing.tone`: a name, a CSV file with the
            columns `light` and `code`, or its rows.
        gamma: of the tone curve `gamma`: code is light to the power of 1/gamma; 2.2 without a value.
        contrast: how far codes follow the S-curve 3x² − 2x³; negative values flatten.
        luma_noise_reduction: smooths where codes of luma differ by less than about this fraction of white.
        chroma_noise_reduction: the same for chroma, over twice the distance.
        local_tone_mapping: how far the brightness of large areas is moved to the mean; black and white stay.
        local_contrast: by what share details of these areas are amplified.
        sharpening: amount of an unsharp mask of luma; negative values soften.
        sharpening_radius_px: standard deviation of its Gaussian; 1 without a value.
        sharpening_threshold: smaller differences, as fractions of white, are not sharpened.
        jpeg_quality: of the output `photo`, on the scale of the Independent JPEG Group; 90 without a value.
        jpeg_subsampling: of its chroma; `4:2:0` without a value.
    """

    preset: Name | None = None
    black_level_error: Annotated[float, within(-0.2, 0.2)] | None = None
    shading_correction: Fraction | None = None
    shading: Annotated[float, within(-0.9, 1)] | None = None
    shading_cast: RedBlue | None = None
    chromatic_aberration_px: tuple[Pixels, Pixels] | None = None
    chromatic_correction: Fraction | None = None
    saturation: Annotated[float, within(0, 4)] | None = None
    tone_curve: Annotated[CurveName | Rows | None, _CURVE] = None
    gamma: Annotated[float, within(0.5, 5)] | None = None
    contrast: Annotated[float, within(-1, 1)] | None = None
    luma_noise_reduction: Annotated[float, within(0, 0.5)] | None = None
    chroma_noise_reduction: Annotated[float, within(0, 0.5)] | None = None
    local_tone_mapping: Fraction | None = None
    local_contrast: Annotated[float, within(0, 4)] | None = None
    sharpening: Annotated[float, within(-1, 10)] | None = None
    sharpening_radius_px: Annotated[float, within(0.3, 10)] | None = None
    sharpening_threshold: Fraction | None = None
    jpeg_quality: Quality | None = None
    jpeg_subsampling: Subsampling | None = None

    def __post_init__(self) -> None:
        if self.tone_curve is not None and not isinstance(self.tone_curve, str):
            object.__setattr__(self, "tone_curve", tone_points(self.tone_curve))

    @property
    def changes_images(self) -> bool:
        """Whether any step before the JPEG has a value."""
        return not _given(self).keys() <= {"preset", "jpeg_quality", "jpeg_subsampling"}

    def completed(self, preset: ImageProcessor) -> ImageProcessor:
        """The same with the values of a preset where there is none."""
        missing = {name: value for name, value in _given(preset).items() if getattr(self, name) is None}
        return dataclasses.replace(self, **missing)

    def to_metadata(self) -> dict[str, Any]:
        """JSON-ready values that are given; of a tone curve, its points."""
        return _given(self)


def tone_points(points: Any) -> Points:
    """Rows of light and code of a tone curve as a tuple.

    Raises:
        ValueError: not such rows, light does not rise from 0 to 1, code falls, or a value is outside [0, 1].
    """
    rows = np.asarray(points, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != 2 or not 2 <= len(rows) <= MOST_POINTS:
        raise ValueError(f"a tone curve must be 2 to {MOST_POINTS:,} pairs of light and code")
    # Written so that nan fails too.
    if not ((rows >= 0) & (rows <= 1)).all():
        raise ValueError("light and code of a tone curve must be 0 to 1")
    light, code = rows.T
    if light[0] != 0 or light[-1] != 1 or not (np.diff(light) > 0).all():
        raise ValueError("light of a tone curve must rise from 0 in the first row to 1 in the last")
    if not (np.diff(code) >= 0).all() or code[0] == code[-1]:
        raise ValueError("code of a tone curve must rise with light, or stay the same")
    return tuple((float(x), float(y)) for x, y in rows)


def _given(processor: ImageProcessor) -> dict[str, Any]:
    fields = (field.name for field in dataclasses.fields(processor))
    return {name: value for name in fields if (value := getattr(processor, name)) is not None}


class ProcessorDocument(SourcedDocument):
    """A file of `materials/isps`: a name, the keys of `[developing.isp]` but for `preset`, and sources."""

    model_config = ConfigDict(extra="allow")


def load_processor(name_or_path: str | Path) -> ImageProcessor:
    """Load a preset from its TOML file, or a shipped one by its name; its tone curve is read, too.

    Raises:
        InputError: a file is missing or not valid; the message names file, key and value.
    """
    path = find_material("isps", name_or_path)
    values = validate(ProcessorDocument, read_toml(path), path).model_extra or {}
    if "preset" in values:
        raise InputError(path, "is not a known key", key="preset")
    processor = validate(ImageProcessor, values, path)
    curve = processor.tone_curve
    if isinstance(curve, str) and curve not in TONE_CURVES:
        # Relative to the preset's folder.
        return dataclasses.replace(processor, tone_curve=read_tone_curve(path.parent / curve))
    return processor


def read_tone_curve(path: str | Path) -> Points:
    """Read a tone curve: a CSV file with the columns `light` and `code`, each 0 to 1.

    Raises:
        InputError: the file is missing, is no such table, or its curve does not rise; see `tone_points`.
    """
    header, rows = read_table(Path(path), ("light",))
    if header[1:] != ["code"]:
        raise InputError(path, "must be light,code", key="header", value=",".join(header))
    try:
        return tone_points(rows)
    except ValueError as error:
        raise InputError(path, str(error)) from None

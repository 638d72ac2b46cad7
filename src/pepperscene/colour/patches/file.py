"""The file that says which pixels of which pictures show what: regions, charts and measured reflectances."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from pepperscene.colour.patches.chart import Calibration, calibrate
from pepperscene.colour.patches.extraction import Extraction, measured_spectrum
from pepperscene.colour.patches.patch import MeasuredSpectrum, Patch, PatchSet, is_organ_kind
from pepperscene.dataset.readers.folder import natural_sort_key
from pepperscene.dataset.readers.pictures import read_mask, read_photo
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.truth.statistics import centre_crop

Text = Annotated[str, Field(min_length=1)]
Point = tuple[float, float]
Corners = tuple[Point, Point, Point, Point]


class _OfKind(Document):
    """Something that shows a kind of organ."""

    kind: Text

    @field_validator("kind")
    @classmethod
    def _is_kind(cls, kind: str) -> str:
        if not is_organ_kind(kind):
            raise ValueError('must be a class in lower case, and maybe a stage ("leaf", "pepper.ripe")')
        return kind


class MaskRegion(Document):
    """Pixels that have one of these values, or this colour, in a mask."""

    file: Text
    value: int | tuple[int, ...] | Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]


class PatchRegion(_OfKind):
    """One `[[patch]]`: a region of a picture, as a box, a polygon, or a part of a mask."""

    picture: Text
    name: Text | None = None
    box: tuple[int, int, int, int] | None = None
    polygon: Annotated[tuple[Point, ...], Field(min_length=3)] | None = None
    mask: MaskRegion | None = None

    @model_validator(mode="after")
    def _one_region(self) -> PatchRegion:
        told = [name for name in ("box", "polygon", "mask") if getattr(self, name) is not None]
        if len(told) != 1:
            raise ValueError(f"must have one of box, polygon and mask, not {' and '.join(told) or 'none'}")
        return self


class SpectrumColumn(_OfKind):
    """One `[[spectrum]]`: a column of a CSV file of reflectances with its provenance beside it."""

    file: Text
    column: Text
    name: Text | None = None


class ChartPlace(Document):
    """One `[chart]`: where a ColorChecker is, and which pictures it calibrates.

    Attributes:
        picture: that shows it; None where every picture shows its own.
        corners: of its fields at dark skin, bluish green, black and white.
        detect: instead of `corners`.
        pictures: that it calibrates; None means all that no other chart names.
    """

    picture: Text | None = None
    corners: Corners | None = None
    detect: bool = False
    pictures: tuple[Text, ...] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> ChartPlace:
        if (self.corners is None) != self.detect:
            raise ValueError("must have either corners or detect = true")
        return self


class PatchesFile(Document):
    """A patches file.

    Attributes:
        folder: that pictures and masks lie in, from the file's own.
        tone: of the pictures' codes.
        clipped: whether pixels with a channel at 0 or 255 are kept.
        erode_px: border of every region that is left out.
        centre_px: side of the middle part of the pictures that counts; None for all of them.
    """

    folder: Text = "."
    tone: Literal["srgb", "linear"] = "srgb"
    clipped: Literal["keep", "leave_out"] = "keep"
    erode_px: Annotated[int, Field(ge=0, le=1000)] = 0
    centre_px: Annotated[int, Field(ge=1)] | None = None
    patch: tuple[PatchRegion, ...] = ()
    spectrum: tuple[SpectrumColumn, ...] = ()
    chart: tuple[ChartPlace, ...] = ()

    @field_validator("chart", mode="before")
    @classmethod
    def _one_or_many(cls, chart: Any) -> Any:
        return (chart,) if isinstance(chart, dict) else chart

    @model_validator(mode="after")
    def _names_something(self) -> PatchesFile:
        if not self.patch and not self.spectrum:
            raise ValueError("must hold at least one [[patch]] or [[spectrum]]")
        if sum(chart.pictures is None for chart in self.chart) > 1:
            raise ValueError("each of several [[chart]] but one must tell its pictures")
        return self


def read_patches_file(
    path: Path,
    *,
    pictures: Path | None = None,
    erode_px: int | None = None,
    clipped: Literal["keep", "leave_out"] | None = None,
    most_px: int = Extraction.most_px,
) -> PatchSet:
    """The patches and spectra of a file.

    Args:
        path: of the TOML file.
        pictures: folder to look for pictures and masks in, instead of the file's.
        erode_px: instead of the file's.
        clipped: instead of the file's.
        most_px: pixels kept of one patch.

    Raises:
        InputError: a key, a picture, a mask, a chart or a spectrum is not what it must be.
    """
    told = validate(PatchesFile, read_toml(path), path)
    folder = path.parent / told.folder if pictures is None else pictures
    how = Extraction(
        told.tone,
        told.clipped if clipped is None else clipped,
        told.erode_px if erode_px is None else erode_px,
        most_px,
    )
    # Picture by picture, so that each is read once and none is kept.
    patches: list[Patch] = []
    calibrations = _Calibrations(told, folder)
    for picture in sorted(dict.fromkeys(one.picture for one in told.patch), key=natural_sort_key):
        image = read_photo(folder / picture)
        calibration = calibrations.of(picture, image)
        for place, one in enumerate(told.patch):
            if one.picture == picture:
                patches.append(_cut(one, place, image, told, folder, how, calibration, path))
    spectra = tuple(_spectrum(one, path) for one in told.spectrum)
    _distinct([one.name for one in patches] + [one.name for one in spectra], path)
    return PatchSet(path.stem, tuple(patches), spectra)


class _Calibrations:
    """The calibration of each picture; a chart that serves many is measured once."""

    def __init__(self, told: PatchesFile, folder: Path) -> None:
        self._told, self._folder = told, folder
        self._found: dict[int, Calibration] = {}

    def of(self, picture: str, image: NDArray[np.uint8]) -> Calibration | None:
        named = [k for k, chart in enumerate(self._told.chart) if picture in (chart.pictures or ())]
        general = [k for k, chart in enumerate(self._told.chart) if chart.pictures is None]
        if not named + general:
            return None
        place = (named + general)[0]
        chart = self._told.chart[place]
        if chart.picture is None:
            return calibrate(image, chart.corners, tone=self._told.tone, where=self._folder / picture)
        if place not in self._found:
            file = self._folder / chart.picture
            self._found[place] = calibrate(read_photo(file), chart.corners, tone=self._told.tone, where=file)
        return self._found[place]


def _cut(
    one: PatchRegion,
    place: int,
    image: NDArray[np.uint8],
    told: PatchesFile,
    folder: Path,
    how: Extraction,
    calibration: Calibration | None,
    where: Path,
) -> Patch:
    key = f"patch.{place}"
    region = _region(one, image.shape[:2], folder, where, key)
    if told.centre_px is not None:
        middle = np.zeros_like(region)
        centre_crop(middle, told.centre_px)[:] = True
        region &= middle
    name = one.name or f"{_stem(one.picture)} {one.kind} {place}"
    patch = how.patch(image, region, name=name, kind=one.kind, of=_stem(one.picture), calibration=calibration)
    if patch is None:
        raise InputError(where, f"leaves no pixel of {one.picture}", key=key)
    return patch


def _region(
    one: PatchRegion, shape: tuple[int, ...], folder: Path, where: Path, key: str
) -> NDArray[np.bool_]:
    """`(h, w)` the pixels of a region."""
    if one.mask is not None:
        return _masked(one.mask, shape, folder)
    region = np.zeros(shape, bool)
    height, width = shape
    if one.box is not None:
        left, top, right, bottom = one.box
        if not (0 <= left < right <= width and 0 <= top < bottom <= height):
            allowed = f"must be x0, y0, x1, y1 with x0 < x1 <= {width} and y0 < y1 <= {height}"
            raise InputError(where, allowed, key=f"{key}.box", value=list(one.box))
        region[top:bottom, left:right] = True
        return region
    from skimage.draw import polygon

    points = np.array(one.polygon)
    if (points < 0).any() or (points > [width, height]).any():
        allowed = f"must lie within the {width}x{height} pixels of {one.picture}"
        raise InputError(where, allowed, key=f"{key}.polygon", value=points.tolist())
    # The centre of the first pixel is at 0.5.
    region[polygon(points[:, 1] - 0.5, points[:, 0] - 0.5, shape)] = True
    return region


def _masked(wanted: MaskRegion, shape: tuple[int, ...], folder: Path) -> NDArray[np.bool_]:
    file = folder / wanted.file
    mask = read_mask(file)
    if mask.shape != shape:
        found = "x".join(str(length) for length in mask.shape[::-1])
        raise InputError(file, f"is {found} pixels large, but its picture {shape[1]}x{shape[0]}")
    if isinstance(wanted.value, str):
        if mask.rgb is None:
            raise InputError(file, "has values, not colours")
        colour = [int(wanted.value[k : k + 2], 16) for k in (1, 3, 5)]
        return np.asarray((mask.rgb == colour).all(axis=-1))
    if mask.values is None:
        raise InputError(file, "has colours, not values")
    return np.isin(mask.values, wanted.value)


def _spectrum(one: SpectrumColumn, where: Path) -> MeasuredSpectrum:
    beside = where.parent / one.file
    found = any(Path(f"{beside}{ending}").is_file() for ending in ("", ".csv"))
    return measured_spectrum(beside if found else one.file, one.column, one.kind, one.name)


def _stem(picture: str) -> str:
    """A picture's name: its path as the file tells it, without the ending."""
    return Path(picture).with_suffix("").as_posix()


def _distinct(names: list[str], where: Path) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(where, "must be that of one patch or spectrum only", key="name", value=twice)

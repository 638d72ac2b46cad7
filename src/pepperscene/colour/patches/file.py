"""Patches files: TOML that names regions of pictures, colour charts and measured reflectances."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from pepperscene.colour.patches.chart import Calibration, Tone, calibrate
from pepperscene.colour.patches.extraction import Clipped, Extraction, read_reflectance
from pepperscene.colour.patches.patch import (
    KIND_RULE,
    MeasuredSpectrum,
    Patch,
    PatchSet,
    duplicate_name,
    is_organ_kind,
)
from pepperscene.dataset.readers.folder import natural_sort_key
from pepperscene.dataset.readers.pictures import Exif, read_mask, read_mask_of, read_photo
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.truth.statistics import centre_crop

Text = Annotated[str, Field(min_length=1)]
Point = tuple[float, float]
Corners = tuple[Point, Point, Point, Point]


class _WithKind(Document):
    """A table with the key `kind`."""

    kind: Text

    @field_validator("kind")
    @classmethod
    def _check_kind(cls, kind: str) -> str:
        if not is_organ_kind(kind):
            raise ValueError(KIND_RULE)
        return kind


class MaskRegion(Document):
    """The pixels of a mask that have one of these values, or this colour."""

    file: Text
    value: int | tuple[int, ...] | Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
    exif: Exif | None = None


class PatchRegion(_WithKind):
    """One `[[patch]]`: a region of a picture, given as a box, a polygon or part of a mask."""

    picture: Text
    name: Text | None = None
    box: tuple[int, int, int, int] | None = None
    polygon: Annotated[tuple[Point, ...], Field(min_length=3)] | None = None
    mask: MaskRegion | None = None

    @model_validator(mode="after")
    def _check_one_region(self) -> PatchRegion:
        given = [name for name in ("box", "polygon", "mask") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"must have one of box, polygon and mask, not {' and '.join(given) or 'none'}")
        return self


class SpectrumColumn(_WithKind):
    """One `[[spectrum]]`: a column of a CSV file of reflectances with provenance."""

    file: Text
    column: Text
    name: Text | None = None


class ChartPlace(Document):
    """One `[chart]`: the position of a ColorChecker, and the pictures that it calibrates.

    Attributes:
        picture: file that shows the chart; None if every picture shows its own.
        corners: of its fields dark skin, bluish green, black and white.
        detect: find the corners automatically.
        pictures: files that it calibrates; None means all that no other chart lists.
    """

    picture: Text | None = None
    corners: Corners | None = None
    detect: bool = False
    pictures: tuple[Text, ...] | None = None

    @model_validator(mode="after")
    def _check_one_way(self) -> ChartPlace:
        if (self.corners is None) != self.detect:
            raise ValueError("must have either corners or detect = true")
        return self


class PatchesFile(Document):
    """A patches file.

    Attributes:
        folder: of pictures and masks, relative to the file.
        tone: of the pictures' codes.
        clipped: whether pixels with a channel at 0 or 255 are kept.
        erode_px: width of the border of every region that is left out.
        centre_px: side of the central square of the pictures that is used; None uses all of it.
    """

    folder: Text = "."
    tone: Tone = "srgb"
    clipped: Clipped = "keep"
    erode_px: Annotated[int, Field(ge=0, le=1000)] = 0
    centre_px: Annotated[int, Field(ge=1)] | None = None
    patch: tuple[PatchRegion, ...] = ()
    spectrum: tuple[SpectrumColumn, ...] = ()
    chart: tuple[ChartPlace, ...] = ()

    @field_validator("chart", mode="before")
    @classmethod
    def _allow_single_table(cls, chart: Any) -> Any:
        return (chart,) if isinstance(chart, dict) else chart

    @model_validator(mode="after")
    def _check_not_empty(self) -> PatchesFile:
        if not self.patch and not self.spectrum:
            raise ValueError("must hold at least one [[patch]] or [[spectrum]]")
        if sum(chart.pictures is None for chart in self.chart) > 1:
            raise ValueError("at most one [[chart]] may omit pictures")
        return self


def read_patches_file(
    path: Path,
    *,
    pictures: Path | None = None,
    erode_px: int | None = None,
    clipped: Clipped | None = None,
) -> PatchSet:
    """Read the patches and spectra of a patches file; other arguments than the path override its own.

    Raises:
        InputError: a key, a picture, a mask, a chart or a spectrum is invalid.
    """
    file = validate(PatchesFile, read_toml(path), path)
    folder = path.parent / file.folder if pictures is None else pictures
    extraction = Extraction(
        file.tone,
        file.clipped if clipped is None else clipped,
        file.erode_px if erode_px is None else erode_px,
    )

    @functools.cache
    def calibrate_by(chart: ChartPlace) -> Calibration:
        """A chart in a separate picture is measured once."""
        photo = folder / str(chart.picture)
        return calibrate(read_photo(photo), chart.corners, tone=file.tone, where=photo)

    # Picture by picture, so that each is read once and only one is in memory.
    patches: list[Patch] = []
    for picture in sorted(dict.fromkeys(region.picture for region in file.patch), key=natural_sort_key):
        image = read_photo(folder / picture)
        chart = _chart_of(picture, file.chart)
        calibration = None
        if chart is not None and chart.picture is not None:
            calibration = calibrate_by(chart)
        elif chart is not None:
            calibration = calibrate(image, chart.corners, tone=file.tone, where=folder / picture)
        for index, region in enumerate(file.patch):
            if region.picture == picture:
                mask = _region_mask(region, image.shape[:2], folder, path, f"patch.{index}")
                if file.centre_px is not None:
                    central = np.zeros_like(mask)
                    centre_crop(central, file.centre_px)[:] = True
                    mask &= central
                stem = Path(picture).with_suffix("").as_posix()
                patch = extraction.patch(
                    image,
                    mask,
                    name=region.name or f"{stem} {region.kind} {index}",
                    kind=region.kind,
                    picture=stem,
                    calibration=calibration,
                )
                if patch is None:
                    raise InputError(path, f"leaves no pixel of {picture}", key=f"patch.{index}")
                patches.append(patch)
    spectra = tuple(_read_spectrum(column, path) for column in file.spectrum)
    if (name := duplicate_name((*patches, *spectra))) is not None:
        raise InputError(path, "must be the name of one patch or spectrum only", key="name", value=name)
    return PatchSet(path.stem, tuple(patches), spectra)


def _chart_of(picture: str, charts: Sequence[ChartPlace]) -> ChartPlace | None:
    """The chart that lists a picture, else the one for all other pictures, else None."""
    charts_of_picture = [chart for chart in charts if picture in (chart.pictures or ())]
    general = [chart for chart in charts if chart.pictures is None]
    return next(iter(charts_of_picture + general), None)


def _region_mask(
    region: PatchRegion, shape: tuple[int, ...], folder: Path, where: Path, key: str
) -> NDArray[np.bool_]:
    """`(h, w)` mask of the pixels of a region."""
    if region.mask is not None:
        return _read_mask_region(region.mask, shape, folder, region.picture)
    mask = np.zeros(shape, bool)
    height, width = shape
    if region.box is not None:
        left, top, right, bottom = region.box
        if not (0 <= left < right <= width and 0 <= top < bottom <= height):
            allowed = f"must be x0, y0, x1, y1 with x0 < x1 <= {width} and y0 < y1 <= {height}"
            raise InputError(where, allowed, key=f"{key}.box", value=list(region.box))
        mask[top:bottom, left:right] = True
        return mask
    from skimage.draw import polygon

    points = np.array(region.polygon)
    if (points < 0).any() or (points > [width, height]).any():
        allowed = f"must be within the {width}x{height} pixels of {region.picture}"
        raise InputError(where, allowed, key=f"{key}.polygon", value=points.tolist())
    # The centre of the first pixel is at 0.5.
    mask[polygon(points[:, 1] - 0.5, points[:, 0] - 0.5, shape)] = True
    return mask


def _read_mask_region(
    region: MaskRegion, shape: tuple[int, ...], folder: Path, picture: str
) -> NDArray[np.bool_]:
    file = folder / region.file
    mask = read_mask_of(folder / picture, file, region.exif)
    if mask is None:
        size = "x".join(str(length) for length in read_mask(file).shape[::-1])
        raise InputError(file, f"has {size} pixels, but its picture {shape[1]}x{shape[0]}")
    if isinstance(region.value, str):
        if mask.rgb is None:
            raise InputError(file, "has values, not colours")
        colour = [int(region.value[k : k + 2], 16) for k in (1, 3, 5)]
        return np.asarray((mask.rgb == colour).all(axis=-1))
    if mask.values is None:
        raise InputError(file, "has colours, not values")
    return np.isin(mask.values, region.value)


def _read_spectrum(column: SpectrumColumn, where: Path) -> MeasuredSpectrum:
    """Read a column of a CSV file next to the patches file, or of a shipped one."""
    local = where.parent / column.file
    exists = any(Path(f"{local}{ending}").is_file() for ending in ("", ".csv"))
    return read_reflectance(local if exists else column.file, column.column, column.kind, column.name)

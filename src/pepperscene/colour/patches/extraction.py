"""Extraction of patches from regions of pictures, and of measured reflectances from CSV files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import decode_tone
from pepperscene.colour.patches.chart import Calibration, Tone
from pepperscene.colour.patches.patch import (
    KIND_RULE,
    MeasuredSpectrum,
    Patch,
    PatchSet,
    even_indices,
    is_organ_kind,
)
from pepperscene.colour.statistics import hue_histogram, srgb_codes
from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shipped_folder
from pepperscene.spectra import Provenance, read_spectra, spectra_file
from pepperscene.truth.statistics import centre_crop

Clipped = Literal["keep", "leave_out"]

_KINDS: Final = "kinds"
"""Table of a CSV's TOML that gives the kind of each column."""


# --- measured reflectances ----------------------------------------------------------------------------------


def reflectance_file(path_or_name: str | Path) -> Path:
    """Find a CSV file by its path, or a shipped one by its name, with or without its folder.

    Raises:
        InputError: no such file; the message lists the shipped ones.
    """
    name = Path(path_or_name)
    stem = name.with_suffix("") if name.suffix == ".csv" else name
    if not is_file(stem.with_name(f"{stem.name}.csv")) and name.parent == Path("."):
        for path in sorted(shipped_folder("materials").glob(f"*/{stem.name}.csv")):
            return path
    return spectra_file(path_or_name)


def read_reflectance(file: str | Path, column: str, kind: str, name: str | None = None) -> MeasuredSpectrum:
    """Read one column of a CSV file of reflectances of a kind of organ; its name is the column's by default.

    Raises:
        InputError: there is no such file or column, it has no provenance, or it holds no reflectances.
    """
    path = reflectance_file(file)
    _read_kinds(path)  # checks the provenance as well
    return _read_column(path, column, kind, name)


def open_reflectances(file: str | Path) -> PatchSet:
    """Read the columns of a CSV file whose kinds are given in its TOML, under `[kinds]`.

    Raises:
        InputError: as `read_reflectance`, or no kinds are given.
    """
    path = reflectance_file(file)
    kinds = _read_kinds(path)
    if not kinds:
        allowed = 'is missing: add column = "kind" entries, or name the columns in a patches file'
        raise InputError(path.with_suffix(".toml"), allowed, key=f"[{_KINDS}]")
    spectra = [_read_column(path, column, kind, None) for column, kind in kinds.items()]
    return PatchSet(path.stem, (), tuple(spectra))


def _read_kinds(path: Path) -> dict[str, str]:
    """Kinds of the columns in a CSV's TOML; the rest of the TOML must be valid provenance."""
    toml = path.with_suffix(".toml")
    tables = read_toml(toml) if is_file(toml) else {}
    kinds = tables.pop(_KINDS, {})
    validate(Provenance, tables, toml)
    if not isinstance(kinds, dict):
        raise InputError(toml, "must be a table of column = kind", key=_KINDS, value=kinds)
    for column, kind in kinds.items():
        if not isinstance(kind, str) or not is_organ_kind(kind):
            raise InputError(toml, KIND_RULE, key=f"{_KINDS}.{column}", value=kind)
    return kinds


def _read_column(path: Path, column: str, kind: str, name: str | None) -> MeasuredSpectrum:
    # Constant beyond its ends, as for other reflectances: there is no data there, and little sensitivity.
    spectra = read_spectra(path, outside="hold")
    if column not in spectra:
        raise InputError(path, f"must be one of {', '.join(spectra)}", key="column", value=column)
    values = spectra[column].values
    if values.min() < 0.0 or values.max() > 1.0:
        extremes = f"{values.min():g} to {values.max():g}"
        raise InputError(path, f"must be reflectances in [0, 1], not {extremes}", key=f"column {column}")
    return MeasuredSpectrum(name or column, kind, spectra[column])


# --- pixels -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Extraction:
    """Settings by which pixels become patches.

    Attributes:
        tone: of the codes: "srgb", or "linear" if they are proportional to light.
        clipped: whether pixels with a channel at 0 or 255 are kept. Their true colour is unknown; leaving
            them out darkens and desaturates glossy organs, keeping them does so less.
        erode_px: pixels closer than this to another region are left out: hand-drawn borders are coarse, and
            every lens mixes the colours at an edge.
        limit_px: at most so many pixels are kept of a patch, evenly spaced; enough for a mean and a
            covariance (chosen).
    """

    tone: Tone = "srgb"
    clipped: Clipped = "keep"
    erode_px: int = 0
    limit_px: int = 20_000

    def patch(
        self,
        image: NDArray[np.uint8],
        region: NDArray[np.bool_],
        *,
        name: str,
        kind: str,
        picture: str,
        centre_px: int | None = None,
        calibration: Calibration | None = None,
    ) -> Patch | None:
        """Extract the patch of a region; None if no pixel is left.

        With a calibration, the patch's codes are those of the calibrated colours.

        Args:
            image: `(h, w, 3)` uint8.
            region: `(h, w)` mask of the pixels.
            name: of the patch.
            kind: of organ.
            picture: name of the picture.
            centre_px: side of the central square that is used, or None for all of the image.
            calibration: of this picture's colours, or None.
        """
        inner = erode(region, self.erode_px)
        if centre_px is not None:
            image, region, inner = (centre_crop(part, centre_px) for part in (image, region, inner))
        codes = image[inner]
        if not len(codes):
            return None
        clipped = ((codes == 0) | (codes == 255)).any(axis=1)
        as_srgb = codes if self.tone == "srgb" and calibration is None else self._srgb(codes, calibration)

        # Hues are counted in all pixels; everything else uses an evenly spaced subset.
        kept = np.flatnonzero(~clipped) if self.clipped == "leave_out" else np.arange(len(codes))
        kept = kept[even_indices(len(kept), self.limit_px)]
        if not len(kept):
            return None
        return Patch(
            name,
            kind,
            picture,
            self._linear(codes[kept], calibration),
            as_srgb[kept],
            hues=hue_histogram(as_srgb),
            pixels=len(codes),
            clipped=int(clipped.sum()),
            border=int(region.sum()) - len(codes),
        )

    def _linear(self, codes: NDArray[np.uint8], calibration: Calibration | None) -> NDArray[np.float64]:
        linear = decode_tone(codes, self.tone)
        return linear if calibration is None else calibration.apply(linear)

    def _srgb(self, codes: NDArray[np.uint8], calibration: Calibration | None) -> NDArray[np.uint8]:
        """8-bit sRGB of pixels, in chunks of a million to bound memory."""
        chunks = np.array_split(codes, max(1, len(codes) // 1_000_000))
        return np.concatenate([srgb_codes(self._linear(chunk, calibration)) for chunk in chunks])


def erode(region: NDArray[np.bool_], distance_px: int) -> NDArray[np.bool_]:
    """Remove the pixels of a region that have other pixels within so many rows and columns.

    Pixels beyond the border of the image count as part of the region.
    """
    if distance_px == 0:
        return region
    from scipy.ndimage import binary_erosion

    square = np.ones((3, 3), bool)
    return np.asarray(binary_erosion(region, square, iterations=distance_px, border_value=1))

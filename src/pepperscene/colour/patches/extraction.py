"""From the pixels of a region in a picture to a patch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import decode_tone
from pepperscene.colour.patches.chart import Calibration
from pepperscene.colour.patches.patch import MeasuredSpectrum, Patch, PatchSet, evenly, is_organ_kind
from pepperscene.colour.statistics.colours import encoded, hue_counts_of
from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shipped_folder
from pepperscene.spectra import Provenance, read_spectra, spectra_file

_KINDS: Final = "kinds"
"""The table of a CSV's TOML that tells the kind of each column."""


def reflectance_file(wanted: str | Path) -> Path:
    """A CSV file by its path, or a shipped one by its name, with or without its folder.

    Raises:
        InputError: there is none; the message lists what is shipped.
    """
    name = Path(wanted)
    stem = name.with_suffix("") if name.suffix == ".csv" else name
    if not is_file(stem.with_name(f"{stem.name}.csv")) and name.parent == Path("."):
        for found in sorted(shipped_folder("materials").glob(f"*/{stem.name}.csv")):
            return found
    return spectra_file(wanted)


def measured_spectrum(file: str | Path, column: str, kind: str, name: str | None = None) -> MeasuredSpectrum:
    """One column of a CSV file of reflectances.

    Args:
        file: its path, or the name of a shipped one ("vrhel_fruit_vegetable_reflectance").
        column: in it.
        kind: of what it shows.
        name: of the patch; None takes the column's.

    Raises:
        InputError: there is no such file or column, it has no provenance, or it holds no reflectances.
    """
    path = reflectance_file(file)
    _kinds(path)
    return _spectrum(path, column, kind, name)


def open_reflectances(file: str | Path) -> PatchSet:
    """The columns of a CSV file whose kinds its TOML tells, under `[kinds]`.

    Raises:
        InputError: as `measured_spectrum`, or no kinds are told.
    """
    path = reflectance_file(file)
    kinds = _kinds(path)
    if not kinds:
        allowed = 'is missing: tell column = "kind" there, or name the columns in a patches file'
        raise InputError(path.with_suffix(".toml"), allowed, key=f"[{_KINDS}]")
    spectra = [_spectrum(path, column, kind, None) for column, kind in kinds.items()]
    return PatchSet(path.stem, (), tuple(spectra))


def _kinds(path: Path) -> dict[str, str]:
    """The kinds that the TOML beside a CSV tells; the rest of it must say where the numbers come from."""
    beside = path.with_suffix(".toml")
    told = read_toml(beside)
    kinds = told.pop(_KINDS, {})
    validate(Provenance, told, beside)
    if not isinstance(kinds, dict):
        raise InputError(beside, "must be a table of column = kind", key=_KINDS, value=kinds)
    for column, kind in kinds.items():
        if not isinstance(kind, str) or not is_organ_kind(kind):
            allowed = 'must be a class in lower case, and maybe a stage ("leaf", "pepper.ripe")'
            raise InputError(beside, allowed, key=f"{_KINDS}.{column}", value=kind)
    return kinds


def _spectrum(path: Path, column: str, kind: str, name: str | None) -> MeasuredSpectrum:
    # Held beyond its ends, as other reflectances are: nobody measured it there, and nothing sees it much.
    spectra = read_spectra(path, outside="hold")
    if column not in spectra:
        raise InputError(path, f"is not one of {', '.join(spectra)}", key="column", value=column)
    values = spectra[column].values
    if values.min() < 0.0 or values.max() > 1.0:
        found = f"{values.min():g} to {values.max():g}"
        raise InputError(path, f"must be reflectances in [0, 1], not {found}", key=f"column {column}")
    return MeasuredSpectrum(name or column, kind, spectra[column])


Clipped = Literal["keep", "leave_out"]
PatchTone = Literal["srgb", "linear"]


@dataclass(frozen=True)
class Extraction:
    """How pixels become patches.

    Attributes:
        tone: of the codes: "srgb", or "linear" where they are proportional to light.
        clipped: whether pixels with a channel at 0 or 255 are kept. What a clipped pixel's colour was nobody
            knows; leaving it out darkens and dulls what shines, keeping it does so less.
        erode_px: pixels nearer than this to what is not of the region are left out: hand-drawn borders are
            coarse, and every lens mixes what meets there.
        most_px: of one patch that are kept, evenly spread; enough for a mean and a covariance (chosen).
    """

    tone: PatchTone = "srgb"
    clipped: Clipped = "keep"
    erode_px: int = 0
    most_px: int = 20_000

    def patch(
        self,
        picture: NDArray[np.uint8],
        region: NDArray[np.bool_],
        *,
        name: str,
        kind: str,
        of: str,
        within: tuple[slice, slice] = (slice(None), slice(None)),
        calibration: Calibration | None = None,
    ) -> Patch | None:
        """The patch of a region, or None where no pixel is left.

        Where there is a calibration, the patch's codes are those of the calibrated colours.

        Args:
            picture: `(h, w, 3)` uint8.
            region: `(h, w)`, which pixels it has.
            name: of the patch.
            kind: of what it shows.
            of: name of the picture.
            within: part of the picture that counts.
            calibration: of this picture's colours, or None.
        """
        inner = eroded(region, self.erode_px)[within]
        codes = picture[within][inner]
        if not len(codes):
            return None
        clipped = ((codes == 0) | (codes == 255)).any(axis=1)
        counted = codes if self.tone == "srgb" and calibration is None else self._codes(codes, calibration)

        # All that count in the hues; fewer, evenly spread over the region, for everything else.
        kept = np.flatnonzero(~clipped) if self.clipped == "leave_out" else np.arange(len(codes))
        kept = kept[evenly(len(kept), self.most_px)]
        if not len(kept):
            return None
        return Patch(
            name,
            kind,
            of,
            self._linear(codes[kept], calibration),
            counted[kept],
            hues=hue_counts_of(counted),
            pixels=len(codes),
            clipped=int(clipped.sum()),
            border=int(region[within].sum()) - len(codes),
        )

    def _linear(self, codes: NDArray[np.uint8], calibration: Calibration | None) -> NDArray[np.float64]:
        linear = decode_tone(codes, self.tone)
        return linear if calibration is None else calibration.apply(linear)

    def _codes(self, codes: NDArray[np.uint8], calibration: Calibration | None) -> NDArray[np.uint8]:
        """What a picture in sRGB would have; pieces of a million pixels at a time."""
        pieces = np.array_split(codes, max(1, len(codes) // 1_000_000))
        return np.concatenate([encoded(self._linear(piece, calibration)) for piece in pieces])


def eroded(region: NDArray[np.bool_], by_px: int) -> NDArray[np.bool_]:
    """A region without the pixels that have others than its own within so many rows and columns.

    What lies beyond the picture's border counts as of the region.
    """
    if by_px == 0:
        return region
    from scipy.ndimage import binary_erosion

    square = np.ones((3, 3), bool)
    return np.asarray(binary_erosion(region, square, iterations=by_px, border_value=1))

"""Measured reflectances as patches: columns of CSV files with their provenance beside them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pepperscene.colour.patch import MeasuredSpectrum, PatchSet, is_kind
from pepperscene.document import read_toml, validated
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shelf
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
        for found in sorted(shelf("materials").glob(f"*/{stem.name}.csv")):
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
        raise InputError(path.with_suffix(".toml"), f"[{_KINDS}]", None, allowed)
    spectra = [_spectrum(path, column, kind, None) for column, kind in kinds.items()]
    return PatchSet(path.stem, (), tuple(spectra))


def _kinds(path: Path) -> dict[str, str]:
    """The kinds that the TOML beside a CSV tells; the rest of it must say where the numbers come from."""
    beside = path.with_suffix(".toml")
    told = read_toml(beside)
    kinds = told.pop(_KINDS, {})
    validated(Provenance, told, beside)
    if not isinstance(kinds, dict):
        raise InputError(beside, _KINDS, kinds, "must be a table of column = kind")
    for column, kind in kinds.items():
        if not isinstance(kind, str) or not is_kind(kind):
            allowed = 'must be a class in lower case, and maybe a stage ("leaf", "pepper.ripe")'
            raise InputError(beside, f"{_KINDS}.{column}", kind, allowed)
    return kinds


def _spectrum(path: Path, column: str, kind: str, name: str | None) -> MeasuredSpectrum:
    # Held beyond its ends, as other reflectances are: nobody measured it there, and nothing sees it much.
    spectra = read_spectra(path, outside="hold")
    if column not in spectra:
        raise InputError(path, "column", column, f"is not one of {', '.join(spectra)}")
    values = spectra[column].values
    if values.min() < 0.0 or values.max() > 1.0:
        found = f"{values.min():g} to {values.max():g}"
        raise InputError(path, f"column {column}", None, f"must be reflectances in [0, 1], not {found}")
    return MeasuredSpectrum(name or column, kind, spectra[column])

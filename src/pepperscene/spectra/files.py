"""Reading spectra from CSV files, and their provenance from the TOML file beside them."""

from __future__ import annotations

import contextlib
import csv
import itertools
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shipped_folder
from pepperscene.spectra.spectrum import Outside, Spectrum

WAVELENGTH_KEY: Final = "wavelength_nm"
WAVELENGTH_RANGE_NM: Final = (100.0, 20_000.0)
"""Anything beyond is not in nanometres: chosen, far ultraviolet to thermal infrared."""


class Provenance(Document):
    """Where a file of spectra comes from: the TOML of the same stem beside it.

    Attributes:
        title: what the spectra are.
        source: publication and file that they were taken from.
        licence: under which they may be handed on, with its holder.
        kind: "measured"; "standard" for agreed or retrieved reference tables; "MODEL" for made ones.
        unit: of the values; "1" for reflectance and the like.
        instrument: that measured them, where known.
        note: what was done to the numbers.
    """

    title: str
    source: str
    licence: str
    kind: Literal["measured", "standard", "MODEL"]
    unit: str = "1"
    instrument: str = ""
    note: str = ""


def spectra_file(path: str | Path) -> Path:
    """The CSV file at `path`, or that shipped under this name ("light/astm_g173_300_1100").

    Raises:
        InputError: there is neither; the message lists what is shipped.
    """
    wanted = Path(path) if str(path).endswith(".csv") else Path(f"{path}.csv")
    for candidate in (wanted, shipped_folder("materials") / wanted):
        if is_file(candidate):
            return candidate
    root = shipped_folder("materials")
    names = ", ".join(sorted(p.relative_to(root).with_suffix("").as_posix() for p in root.rglob("*.csv")))
    raise InputError(str(path), f"no such file, nor one of the shipped spectra: {names}")


def read_provenance(path: str | Path) -> Provenance:
    """Where the spectra of `path` come from.

    Raises:
        InputError: the TOML beside the CSV is missing or wrong.
    """
    beside = spectra_file(path).with_suffix(".toml")
    return validate(Provenance, read_toml(beside), beside)


def read_spectra(path: str | Path, *, outside: Outside = "zero") -> dict[str, Spectrum]:
    """All columns of a CSV file whose first column is `wavelength_nm`, by name.

    Args:
        path: of the file, or the name of a shipped one ("leaf/vrhel_leaf_reflectance"), with or without .csv.
        outside: what the spectra give beyond their range: zero suits lights and sensors, "hold" reflectances.

    Raises:
        InputError: no such file, or one that is not such a table; row and column are named.
    """
    file = spectra_file(path)
    header, rows = _table(file)
    wavelength_nm = rows[:, 0]
    low, high = WAVELENGTH_RANGE_NM
    for row, nm in enumerate(wavelength_nm):
        if not low <= nm <= high:
            raise _cell_error(file, row, WAVELENGTH_KEY, nm, f"must be in nanometres, {low:g} to {high:g}")
        if row and nm <= wavelength_nm[row - 1]:
            raise _cell_error(file, row, WAVELENGTH_KEY, nm, "must be larger than in the row before")
    return {name: Spectrum(wavelength_nm, rows[:, i], outside) for i, name in enumerate(header) if i}


def read_spectrum(path: str | Path, column: str, *, outside: Outside = "zero") -> Spectrum:
    """One column of a CSV file of spectra.

    Raises:
        InputError: as `read_spectra`, or there is no such column.
    """
    spectra = read_spectra(path, outside=outside)
    if column not in spectra:
        raise InputError(
            spectra_file(path), f"is not one of {', '.join(spectra)}", key="column", value=column
        )
    return spectra[column]


def _table(file: Path) -> tuple[list[str], NDArray[np.float64]]:
    """Header and numbers `(rows, columns)` of a CSV file."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            lines = [line for line in csv.reader(stream) if line]
    except OSError as fault:
        raise InputError(file, f"cannot be read ({fault.strerror})") from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError(file, "must be a comma-separated text file in UTF-8") from None

    header = [name.strip() for name in lines[0]] if lines else []
    if not header or header[0] != WAVELENGTH_KEY:
        found = header[0] if header else None
        raise InputError(file, f"must be named {WAVELENGTH_KEY}", key="first column", value=found)
    if len(header) < 2 or len(set(header)) < len(header) or not all(header):
        raise InputError(
            file, "must name at least one spectrum, each once", key="header", value=",".join(header)
        )
    if len(lines) < 3:
        raise InputError(file, "must be at least two below the header", key="rows", value=len(lines) - 1)

    # All at once; where that fails, one by one to say where.
    if all(len(line) == len(header) for line in lines[1:]):
        with contextlib.suppress(ValueError):
            read = np.fromiter(map(float, itertools.chain.from_iterable(lines[1:])), float)
            if np.isfinite(read).all():
                return header, read.reshape(-1, len(header))
    numbers = np.empty((len(lines) - 1, len(header)))
    for row, line in enumerate(lines[1:]):
        if len(line) != len(header):
            raise InputError(
                file, f"must have {len(header)} columns as the header", key=f"row {row + 2}", value=len(line)
            )
        for i, cell in enumerate(line):
            numbers[row, i] = _number(file, row, header[i], cell)
    return header, numbers


def _number(file: Path, row: int, column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise _cell_error(file, row, column, cell, "must be a finite number")
    return value


def _cell_error(file: Path, row: int, column: str, value: object, allowed: str) -> InputError:
    """An error that names the row as a text editor counts it: the header is row 1."""
    shown = float(value) if isinstance(value, float) else value
    return InputError(file, allowed, key=f"row {row + 2}, column {column}", value=shown)


# Bounds beyond what can be built; they keep slips of units and of the pen out.
NotNegative = Annotated[float, Field(ge=0, le=1e6)]
Millimetres = Annotated[float, Field(ge=-1e6, le=1e6)]
Coefficient = Annotated[float, Field(ge=-100, le=100)]
Text = Annotated[str, Field(min_length=1)]


class SourcedDocument(Document):
    """A file in which every number has its source."""

    name: Text
    licence: Text
    sources: dict[str, Text]

    @model_validator(mode="after")
    def _every_number_has_a_source(self) -> SourcedDocument:
        owed = self.model_fields_set - {"name", "licence", "sources", "kind"}
        if missing := sorted(owed - self.sources.keys()):
            raise ValueError(f"[sources] must tell where {', '.join(missing)} comes from")
        if idle := sorted(self.sources.keys() - owed):
            raise ValueError(f"[sources] names {', '.join(idle)}, which the file does not hold")
        return self


class CurveTable(Document):
    """One column of a CSV file beside the TOML file."""

    file: Text
    column: Text


def find_material(folder: str, wanted: str | Path) -> Path:
    """A path as it is, a bare name in the shipped folder."""
    path, shipped = Path(wanted), shipped_folder("materials") / folder
    if is_file(path):
        return path
    if path.parent == Path(".") and is_file(shipped / f"{path}.toml"):
        return shipped / f"{path}.toml"
    names = ", ".join(sorted(file.stem for file in shipped.glob("*.toml")))
    raise InputError(str(wanted), f"no such file, nor one of the shipped {folder}: {names}")


def read_curve(path: Path, table: str, file: str, column: str) -> Spectrum:
    """One column of the CSV file beside `path`: a curve that is nowhere negative, 0 beyond its range."""
    beside = path.parent / file
    if not is_file(beside):
        raise InputError(path, "is not a file beside this one", key=f"{table}.file", value=file)
    found = read_spectrum(beside, column)
    negative = found.values < 0
    if negative.any():
        row = int(np.argmax(negative))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        raise InputError(beside, "must be at least 0", key=key, value=float(found.values[row]))
    return found

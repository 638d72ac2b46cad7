"""Read spectra from CSV files, and their provenance from the TOML file of the same stem."""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.document import Document, read_text, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shipped_folder
from pepperscene.spectra.spectrum import FloatArray, Outside, Spectrum

WAVELENGTH_KEY: Final = "wavelength_nm"
WAVELENGTH_RANGE_NM: Final = (100.0, 20_000.0)
"""Chosen, far ultraviolet to thermal infrared: values outside are not in nanometres."""
LEAST_STEP_NM: Final = 1e-6
"""Between two rows. Chosen: the sharpest lines of lasers in tables are a thousand times wider."""
LARGEST_VALUE: Final = 1e30
"""Of spectra in any unit. Chosen: photons per second have 1e21, and squares of such values are finite."""
LEAST_PEAK: Final = 1e-30
"""Of a light that is not dark, in any unit. Chosen as `LARGEST_VALUE`, so that ratios do not overflow."""


class Provenance(Document):
    """Origin of a file of spectra. The shipped files have all keys; a user's own file may leave out any."""

    title: str = ""  # short description of the spectra
    source: str = ""  # publication and file that they were taken from
    licence: str = ""  # licence and its holder
    # "standard" for agreed or retrieved reference tables, "MODEL" for modelled spectra.
    kind: Literal["measured", "standard", "MODEL"] = "measured"
    unit: str = "1"  # of the values; "1" for reflectance and other ratios
    instrument: str = ""  # the measuring instrument, if known
    note: str = ""  # how the numbers were processed


def spectra_file(path: str | Path) -> Path:
    """Find a CSV file by its path, or by the name of a shipped one ("light/astm_g173_300_1100").

    Raises:
        InputError: neither exists; the message lists the shipped files.
    """
    file_name = Path(path) if str(path).endswith(".csv") else Path(f"{path}.csv")
    root = shipped_folder("materials")
    for candidate in (file_name, root / file_name):
        if is_file(candidate):
            return candidate
    names = ", ".join(sorted(p.relative_to(root).with_suffix("").as_posix() for p in root.rglob("*.csv")))
    raise InputError(str(path), f"no such file, nor one of the shipped spectra: {names}")


def read_provenance(path: str | Path) -> Provenance:
    """Read the provenance of the spectra of `path`.

    Raises:
        InputError: the TOML file is missing or invalid.
    """
    toml = spectra_file(path).with_suffix(".toml")
    return validate(Provenance, read_toml(toml), toml)


def read_spectra(path: str | Path, *, outside: Outside = "zero") -> dict[str, Spectrum]:
    """Read all columns of a CSV file whose first column is `wavelength_nm`, by name.

    Args:
        path: the file, or the name of a shipped one ("leaf/vrhel_leaf_reflectance"), with or without .csv.
        outside: behaviour outside the range: "zero" suits lights and sensors, "hold" reflectances.

    Raises:
        InputError: the file does not exist or is not such a table; row and column are named.
    """
    file = spectra_file(path)
    header, rows = read_table(file)
    wavelength_nm = rows[:, 0]
    check_wavelengths(file, wavelength_nm)
    too_large = np.abs(rows) > LARGEST_VALUE
    if too_large.any():
        row, column = divmod(int(np.argmax(too_large)), len(header))
        allowed = f"must be between {-LARGEST_VALUE:g} and {LARGEST_VALUE:g}"
        raise cell_error(file, row, header[column], rows[row, column], allowed)
    return {name: Spectrum(wavelength_nm, rows[:, i], outside) for i, name in enumerate(header) if i}


def read_spectrum(path: str | Path, column: str, *, outside: Outside = "zero") -> Spectrum:
    """Read one column of a CSV file of spectra.

    Raises:
        InputError: as `read_spectra`, or there is no such column.
    """
    spectra = read_spectra(path, outside=outside)
    if column not in spectra:
        problem = f"is not one of {', '.join(spectra)}"
        raise InputError(spectra_file(path), problem, key="column", value=column)
    return spectra[column]


def check_wavelengths(file: Path, wavelength_nm: FloatArray) -> None:
    """Raise `InputError` if the wavelengths of a file are not in nanometres, or do not ascend."""
    low, high = WAVELENGTH_RANGE_NM
    for row, nm in enumerate(wavelength_nm):
        if not low <= nm <= high:
            raise cell_error(file, row, WAVELENGTH_KEY, nm, f"must be in nanometres, {low:g} to {high:g}")
        if row and nm < wavelength_nm[row - 1] + LEAST_STEP_NM:
            allowed = f"must be greater than in the row above, by {LEAST_STEP_NM:g} at least"
            raise cell_error(file, row, WAVELENGTH_KEY, nm, allowed)


def read_table(
    file: Path, first: Sequence[str] = (WAVELENGTH_KEY,), plain: Callable[[str], str] = str.strip
) -> tuple[list[str], FloatArray]:
    """Header and numbers `(rows, columns)` of a CSV file; raises `InputError` if a cell is not a number.

    `first` are the allowed names of the first column; `plain` makes names from the texts in the header.
    """
    text = read_text(file, "spectra")
    try:
        lines = [line for line in csv.reader(io.StringIO(text)) if line]
    except csv.Error as error:
        raise InputError(file, f"is not a table of comma-separated values: {error}") from None

    header = [plain(name) for name in lines[0]] if lines else []
    if not header or header[0] not in first:
        found = lines[0][0] if header else None
        raise InputError(file, f"must be named {' or '.join(first)}", key="first column", value=found)
    if len(header) < 2 or len(set(header)) < len(header) or not all(header):
        allowed = "must have at least one spectrum, and each name once"
        raise InputError(file, allowed, key="header", value=",".join(header))
    if len(lines) < 3:
        raise InputError(file, "must be at least two below the header", key="rows", value=len(lines) - 1)

    for row, line in enumerate(lines[1:]):
        if len(line) != len(header):
            allowed = f"must have {len(header)} columns like the header"
            raise InputError(file, allowed, key=f"row {row + 2}", value=len(line))
    cells = list(itertools.chain.from_iterable(lines[1:]))
    try:
        numbers = np.fromiter(map(float, cells), float, len(cells))
    except ValueError:
        numbers = np.array([_float_or_nan(cell) for cell in cells])
    if not np.isfinite(numbers).all():
        bad = int(np.argmin(np.isfinite(numbers)))
        row, column = divmod(bad, len(header))
        raise cell_error(file, row, header[column], cells[bad], "must be a finite number")
    return header, numbers.reshape(-1, len(header))


def _float_or_nan(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def cell_error(file: Path, row: int, column: str, value: object, allowed: str) -> InputError:
    """Error that counts rows like a text editor: the header is row 1."""
    value = float(value) if isinstance(value, float) else value  # not a NumPy scalar in the message
    return InputError(file, allowed, key=f"row {row + 2}, column {column}", value=value)


# Bounds of device and cover files, wider than any device; they catch wrong units and typing errors.
NonNegative = Annotated[float, Field(ge=0, le=1e6)]
Coefficient = Annotated[float, Field(ge=-100, le=100)]
NonEmptyText = Annotated[str, Field(min_length=1)]


class SourcedDocument(Document):
    """A file whose numbers can have sources.

    The shipped files have the licence and the source of every number (a test checks them). A user's own file
    may leave out both; if it has `[sources]`, they must be complete, so that a forgotten one is found.
    """

    name: NonEmptyText
    licence: NonEmptyText | None = None
    sources: dict[str, NonEmptyText] | None = None

    @model_validator(mode="after")
    def _check_sources(self) -> SourcedDocument:
        if self.sources is None:
            return self
        needed = self.model_fields_set - {"name", "licence", "sources", "kind"}
        if missing := sorted(needed - self.sources.keys()):
            raise ValueError(f"[sources] must give the source of {', '.join(missing)}")
        if unused := sorted(self.sources.keys() - needed):
            raise ValueError(f"[sources] names {', '.join(unused)}, which the file does not have")
        return self


class CurveTable(Document):
    """One column of a CSV file in the folder of the TOML file."""

    file: NonEmptyText
    column: NonEmptyText


def find_material(folder: str, name_or_path: str | Path) -> Path:
    """Find a TOML file by its path, or by the bare name of a shipped one in `folder` of the materials.

    Raises:
        InputError: neither exists; the message lists the shipped files.
    """
    path, shipped = Path(name_or_path), shipped_folder("materials") / folder
    if is_file(path):
        return path
    if path.parent == Path(".") and is_file(shipped / f"{path}.toml"):
        return shipped / f"{path}.toml"
    names = ", ".join(sorted(file.stem for file in shipped.glob("*.toml")))
    raise InputError(str(name_or_path), f"no such file, nor one of the shipped {folder}: {names}")


def curve_file(path: Path, file: str) -> Path:
    """The CSV file that the TOML file `path` names: beside it, or else a shipped one ("light/led_b1")."""
    beside = path.parent / file
    shipped = shipped_folder("materials") / f"{file.removesuffix('.csv')}.csv"
    return shipped if not is_file(beside) and is_file(shipped) else beside


def read_light(path: Path, table: CurveTable) -> Spectrum:
    """The spectrum of a lamp that the TOML file `path` names: as `read_curve`, or of a shipped file."""
    found = curve_file(path, table.file)
    # A missing file is reported under the name in the file.
    return read_curve(path, "spectrum", str(found) if is_file(found) else table.file, table.column)


def read_curve(path: Path, table: str, file: str, column: str) -> Spectrum:
    """Read one column of the CSV file that a `table` of the TOML file `path` names; 0 outside its range.

    Raises:
        InputError: the CSV file does not exist in the same folder, is invalid, or has a negative value.
    """
    csv_file = path.parent / file
    if not is_file(csv_file):
        raise InputError(path, "is not a file in the same folder", key=f"{table}.file", value=file)
    curve = read_spectrum(csv_file, column)
    if (curve.values < 0).any():
        row = int(np.argmax(curve.values < 0))
        raise cell_error(csv_file, row, column, float(curve.values[row]), "must be at least 0")
    return curve

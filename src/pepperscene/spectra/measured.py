"""Measured curves of users: reflectance and transmittance from a CSV file, in fractions or percent."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.shipped import is_file
from pepperscene.spectra.files import Provenance, cell_error, check_wavelengths, read_table
from pepperscene.spectra.spectrum import FloatArray, Spectrum

_FIRST: Final = ("wavelength_nm", "wavelength_um", "wavelength")
_PERCENT: Final = "_percent"
_IS_PERCENT: Final = {"1": False, "fraction": False, "%": True, "percent": True}  # by unit
_GAP_STEPS, _GAP_NM = 10.0, 20.0
"""A gap is longer than both: so many of the usual steps, and so many nanometres. Both are chosen: narrower
than the slope of a leaf's red edge, and wider than the steps of any table of a continuous curve."""
_ROUNDING: Final = 1e-9  # of sums of decimal fractions
_OWN_KEYS: Final = {"name", "extends"}  # of recipes and cultivars, which no description of spectra has


def read_measured(
    file: Path,
    columns: Sequence[str] | None = None,
    *,
    unit: str | None = None,
    wavelength_unit: str | None = None,
) -> Spectrum:
    """Read columns of a user's CSV file as fractions `(k, n)`; the end values hold outside of its range.

    The first column is `wavelength_nm`, `wavelength_um` or `wavelength`; a name that ends with `_percent`, or
    `(%)`, says that its column is in percent. "Wavelength (nm)" is the same as `wavelength_nm`, and a column
    is found with or without its unit.

    Args:
        file: path of the file.
        columns: names of k columns; None for the first one after the wavelengths.
        unit: of columns without one in their name, "fraction" or "percent"; None for that of the TOML file of
            the same stem (see `Provenance`), or fractions.
        wavelength_unit: likewise, "nm" or "um"; None for nanometres.

    Raises:
        InputError: a column is missing, a unit is contradicted, a cell is not a number, wavelengths do not
            ascend or have a gap, or a value is outside of 0 to 1 or 0 to 100 %.
    """
    header, rows = read_table(file, _FIRST, _plain_name)
    in_header = header[0].removeprefix("wavelength").strip("_")
    if in_header and wavelength_unit not in (None, in_header):
        problem = f"must be that of the header, {in_header}"
        raise InputError(file, problem, key="wavelength_unit", value=wavelength_unit)
    # Rounded, because a decimal fraction of a micrometre is none in binary.
    nm = np.round(1e3 * rows[:, 0], 9) if (in_header or wavelength_unit) == "um" else rows[:, 0]
    check_wavelengths(file, nm)
    _check_gaps(file, nm)
    default = unit or _described_unit(file)
    found = [1] if columns is None else [_column(file, header, name) for name in columns]
    values = [_fractions(file, header[number], rows[:, number], default) for number in found]
    return Spectrum(nm, np.stack(values), "hold")


def check_energy(file: Path, reflectance: Spectrum, transmittance: Spectrum, columns: Sequence[str]) -> None:
    """Raise `InputError` if reflectances and transmittances `(k, n)` of a file sum to more than 1.

    `columns` are the k names of the transmittances.
    """
    excess = reflectance.values + transmittance.values - 1.0
    if excess.max() > _ROUNDING:
        number, row = divmod(int(excess.argmax()), excess.shape[1])
        most = 1.0 - float(reflectance.values[number, row])
        problem = f"must be at most {most:.4g}, which the reflectance of that row leaves of 1"
        raise cell_error(file, row, columns[number], float(transmittance.values[number, row]), problem)


def _plain_name(text: str) -> str:
    """A column's name in lower case, with _ for spaces and brackets, and units in letters."""
    text = re.sub("[µμ]", "u", text.lower().replace("%", "percent"))
    return re.sub(r"[\s\[\]()_]+", "_", text).strip("_")


def _check_gaps(file: Path, wavelength_nm: FloatArray) -> None:
    steps = np.diff(wavelength_nm)
    limit = max(_GAP_STEPS * float(np.median(steps)), _GAP_NM)
    if steps.max() > limit:
        row = int(steps.argmax())
        problem = f"must follow {wavelength_nm[row]:g} nm by at most {limit:g} nm: a gap is not filled"
        raise cell_error(file, row + 1, "wavelength", float(wavelength_nm[row + 1]), problem)


def _described_unit(file: Path) -> str:
    """The unit in the TOML file of the same stem; fractions if there is none, or it describes no spectra."""
    toml = file.with_suffix(".toml")
    if not is_file(toml) or _OWN_KEYS & (tables := read_toml(toml)).keys():
        return "fraction"
    unit = validate(Provenance, tables, toml).unit
    if unit not in _IS_PERCENT:
        raise InputError(toml, 'must be "fraction" or "percent"', key="unit", value=unit)
    return unit


def _column(file: Path, header: Sequence[str], name: str) -> int:
    for number, column in enumerate(header):
        if number and _plain_name(name) in (column, column.removesuffix(_PERCENT)):
            return number
    raise InputError(file, f"is not one of {', '.join(header[1:])}", key="column", value=name)


def _fractions(file: Path, name: str, values: FloatArray, unit: str) -> FloatArray:
    """Values of one column in [0, 1]."""
    is_percent = name.endswith(_PERCENT) or _IS_PERCENT[unit]
    most = 100.0 if is_percent else 1.0
    outside = (values < 0.0) | (values > most)
    if outside.any():
        row = int(outside.argmax())
        allowed = f"must be {'in percent, 0 to 100' if is_percent else 'a fraction, 0 to 1'}"
        if values[row] > 1.0 and not is_percent:
            allowed += (
                f'; name the column {name}{_PERCENT} or set unit = "percent" if all of it is in percent'
            )
        raise cell_error(file, row, name, float(values[row]), allowed)
    if is_percent and values.max() <= 1.0:
        problem = "has no value above 1, so that it looks like fractions; give it in fractions, 0 to 1"
        raise InputError(file, problem, key=f"column {name}", value="percent")
    return values / most

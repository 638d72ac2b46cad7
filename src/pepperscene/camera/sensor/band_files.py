"""The bands in a sensor file: one by one, at regular steps, or as curves in a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.sensor.bands import band_curves
from pepperscene.document import Document
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum
from pepperscene.spectra.files import NonEmptyText, read_spectra

MOST_BANDS: Final = 1000
"""Chosen: line scanners have up to 950 (Headwall Hyperspec VNIR E series)."""
_CENTRE_NM: Final = (200.0, 2500.0)
"""Chosen from the deep ultraviolet; the optics of plants are known up to 2500 nm."""
_WIDTH_NM: Final = (1.0, 1000.0)
"""Full width at half maximum. Chosen: light is traced on a grid of half nanometres, and the widest filters
pass all that silicon detects."""
DEFAULT_PEAK: Final = 0.5
"""Electrons per photon. Chosen: silicon behind a filter has 0.3 to 0.7 in its best range."""

Centre = Annotated[float, Field(ge=_CENTRE_NM[0], le=_CENTRE_NM[1])]
Width = Annotated[float, Field(ge=_WIDTH_NM[0], le=_WIDTH_NM[1])]
Peak = Annotated[float, Field(ge=1e-6, le=1)]
Shape = Literal["gaussian", "box"]


class BandTable(Document):
    """One band: `[[bands]]`."""

    centre_nm: Centre
    width_nm: Width
    name: NonEmptyText | None = None
    peak: Peak = DEFAULT_PEAK
    shape: Shape = "gaussian"


class RegularBandsTable(Document):
    """Bands of equal width at equal steps: `[regular_bands]`."""

    first_nm: Centre
    last_nm: Centre
    count: Annotated[int, Field(ge=2, le=MOST_BANDS)]
    width_nm: Width
    peak: Peak = DEFAULT_PEAK
    shape: Shape = "gaussian"

    @model_validator(mode="after")
    def _check_order(self) -> RegularBandsTable:
        if not self.first_nm < self.last_nm:
            raise ValueError(f"first_nm = {self.first_nm:g} must be below last_nm = {self.last_nm:g}")
        return self


class BandCurvesTable(Document):
    """Curves of a CSV file beside the TOML file: `[band_curves]`; all columns, or some by name."""

    file: NonEmptyText
    columns: Annotated[list[NonEmptyText], Field(min_length=1, max_length=MOST_BANDS)] | None = None


BandTables = tuple[BandTable, ...] | RegularBandsTable | BandCurvesTable


def read_bands(path: Path, tables: BandTables) -> tuple[Spectrum, tuple[str, ...]]:
    """The responses `(c, n)` of the bands of a sensor file, and their names; "" for a band without one.

    Raises:
        InputError: a name occurs twice, or the CSV file is missing or invalid.
    """
    if isinstance(tables, BandCurvesTable):
        return _read_curves(path, tables)
    if isinstance(tables, RegularBandsTable):
        centres = np.linspace(tables.first_nm, tables.last_nm, tables.count).tolist()
        widths, peaks = [tables.width_nm] * tables.count, [tables.peak] * tables.count
        return band_curves(centres, widths, peaks, [tables.shape] * tables.count), ()
    names = tuple(band.name or "" for band in tables)
    for number, name in enumerate(names):
        if name and name in names[:number]:
            raise InputError(path, "must be different for each band", key=f"bands.{number}.name", value=name)
    curves = band_curves(
        [band.centre_nm for band in tables],
        [band.width_nm for band in tables],
        [band.peak for band in tables],
        [band.shape for band in tables],
    )
    return curves, names if any(names) else ()


def _read_curves(path: Path, table: BandCurvesTable) -> tuple[Spectrum, tuple[str, ...]]:
    """The columns of a CSV file, which are named by its header."""
    file = path.parent / table.file
    if not file.is_file():
        raise InputError(path, "is not a file in the same folder", key="band_curves.file", value=table.file)
    found = read_spectra(file)
    names = tuple(table.columns or found)
    if len(names) > MOST_BANDS:
        raise InputError(file, f"must be at most {MOST_BANDS}", key="number of curves", value=len(names))
    for number, name in enumerate(names):
        if name not in found or name in names[:number]:
            problem = f"must be different columns of {table.file}: {', '.join(found)}"
            raise InputError(path, problem, key="band_curves.columns", value=name)
    nm = found[names[0]].wavelength_nm
    for name in names:
        values = found[name].values
        if not (values.min() >= 0 and values.max() <= 1):
            row = int(np.argmax((values < 0) | (values > 1)))
            key = f"row {row + 2}, column {name}"
            raise InputError(file, "must be from 0 to 1", key=key, value=float(values[row]))
    return Spectrum(nm, np.stack([found[name].values for name in names])), names

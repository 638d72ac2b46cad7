"""The files of sensors and filters: their models, and loading them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.sensor.bands import (
    MOST_BANDS,
    BandCurvesTable,
    BandTable,
    BandTables,
    RegularBandsTable,
    read_bands,
)
from pepperscene.camera.sensor.sensor import MAX_BITS, Filter, Pattern, Sensor, binning_error
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum
from pepperscene.spectra.files import (
    CurveTable,
    NonEmptyText,
    NonNegative,
    SourcedDocument,
    cell_error,
    find_material,
    read_curve,
)

MAX_PHOTOSITES: Final = 500_000_000
"""Chosen: the sensors with the most have 410 million (Canon 2025), and an image needs 4 bytes for each."""
_LONGEST_LINE_US: Final = 10_000.0  # chosen: a second for a hundred rows
_LONGEST_SCAN_US: Final = 10_000_000.0  # chosen: ten seconds for a line, as in dim light or by hand
_HIGHEST_BLACK: Final = 0.9  # of full scale; chosen: cameras use a sixteenth, thermal ones up to a half
_LOWEST_EFFICIENCY: Final = 1e-6
"""At the peak of a curve. Chosen: a photosite that misses all but a millionth of the photons sees nothing."""


class EfficiencyTable(Document):
    """Columns of a CSV file next to the TOML file: red, green and blue, or the only one."""

    file: NonEmptyText
    columns: Annotated[list[NonEmptyText], Field(min_length=1, max_length=3)]


class SensorDocument(SourcedDocument):
    """A file of `materials/sensors`."""

    kind: Literal["measured", "standard", "MODEL"]
    columns: Annotated[int, Field(ge=1, le=20_000)]
    rows: Annotated[int, Field(ge=1, le=20_000)]
    pattern: Pattern
    binning: Annotated[int, Field(ge=1, le=16)]
    # Chosen: two photosites within a quarter of a wavelength of light see the same (the smallest that are
    # made have 0.5 um), and the largest pixels of X-ray detectors have 0.2 mm.
    pitch_um: Annotated[float, Field(ge=0.1, le=1000)]
    full_well_e: Annotated[float, Field(ge=1, le=1e9)]
    read_noise_e: Annotated[float, Field(ge=0, le=1e9)]
    bits: Annotated[int, Field(ge=1, le=MAX_BITS)]
    black_level_dn: NonNegative
    line_time_us: Annotated[float, Field(ge=0, le=_LONGEST_SCAN_US)] = 0.0
    line_scan: Annotated[bool, Field(strict=True)] = False
    quantum_efficiency: EfficiencyTable | None = None
    bands: Annotated[tuple[BandTable, ...], Field(min_length=1, max_length=MOST_BANDS)] | None = None
    regular_bands: RegularBandsTable | None = None
    band_curves: BandCurvesTable | None = None
    infrared_cut: CurveTable | None = None

    @model_validator(mode="after")
    def _check_consistency(self) -> SensorDocument:
        full_scale = 2**self.bits - 1
        if self.black_level_dn > _HIGHEST_BLACK * full_scale:
            allowed = f"below the full scale of {full_scale}, at most {_HIGHEST_BLACK:g} of it"
            raise ValueError(f"black_level_dn must be {allowed}")
        if self.read_noise_e > self.full_well_e:
            raise ValueError(f"read_noise_e must be at most full_well_e, {self.full_well_e:g}")
        if error := binning_error(self.pattern, self.binning, self.columns, self.rows):
            raise ValueError(error)
        photosites = self.columns * self.rows * self.binning**2
        if photosites > MAX_PHOTOSITES:
            size = f"columns x rows x binning^2 = {photosites}"
            raise ValueError(f"{size} photosites must be at most {MAX_PHOTOSITES}")
        self._check_times()
        self._check_response()
        return self

    def _check_times(self) -> None:
        if self.line_scan and self.pattern not in ("mono", "bands"):
            raise ValueError(f'line_scan needs the pattern "mono" or "bands", not {self.pattern!r}')
        if self.line_scan and not self.line_time_us > 0:
            raise ValueError("line_scan needs a line_time_us above 0")
        if not self.line_scan and self.line_time_us > _LONGEST_LINE_US:
            raise ValueError(
                f"line_time_us must be at most {_LONGEST_LINE_US:g}, or {_LONGEST_SCAN_US:g} with line_scan"
            )

    def _check_response(self) -> None:
        given = [name for name in _BAND_KEYS if getattr(self, name) is not None]
        if self.pattern == "bands" and len(given) != 1:
            found = f"not {' and '.join(given)}" if given else "which are missing"
            raise ValueError(f'the pattern "bands" needs one of {", ".join(_BAND_KEYS)}, {found}')
        if self.pattern != "bands" and given:
            raise ValueError(f'{given[0]} needs the pattern "bands", not {self.pattern!r}')
        colours = {"mono": 1, "bands": 1}.get(self.pattern, 3)
        if self.quantum_efficiency is None:
            if self.pattern != "bands":
                raise ValueError("quantum_efficiency is required but missing")
        elif len(self.quantum_efficiency.columns) != colours:
            raise ValueError(f"quantum_efficiency.columns must name {colours} for the pattern {self.pattern}")

    @property
    def band_tables(self) -> BandTables | None:
        """The bands as the file defines them; None for a sensor with another pattern."""
        return self.bands or self.regular_bands or self.band_curves


_BAND_KEYS: Final = ("bands", "regular_bands", "band_curves")


class FilterDocument(SourcedDocument):
    """A file of `materials/filters`."""

    kind: Literal["measured", "standard", "MODEL"]
    transmittance: CurveTable


def load_sensor(name_or_path: str | Path) -> Sensor:
    """Load a sensor from its file, or a shipped one by its name.

    Raises:
        InputError: the file or its curves are missing or invalid; the message names file, key and value.
    """
    path = find_material("sensors", name_or_path)
    document = validate(SensorDocument, read_toml(path), path)
    efficiency, names = _read_response(path, document)
    sensor = Sensor(
        name=document.name,
        columns=document.columns,
        rows=document.rows,
        pitch_m=document.pitch_um * 1e-6,
        quantum_efficiency=efficiency,
        full_well_e=document.full_well_e,
        read_noise_e=document.read_noise_e,
        bits=document.bits,
        black_level_dn=document.black_level_dn,
        binning=document.binning,
        pattern=document.pattern,
        line_time_s=document.line_time_us * 1e-6,
        band_names=names,
        line_scan=document.line_scan,
    )
    if (cut := document.infrared_cut) is None:
        return sensor
    return sensor.with_filter(read_fraction(path, "infrared_cut", cut.file, cut.column))


def _read_response(path: Path, document: SensorDocument) -> tuple[Spectrum, tuple[str, ...]]:
    """The quantum efficiency `(c, n)` of a sensor file's channels, and the names of its bands."""
    table, tables = document.quantum_efficiency, document.band_tables
    bands, names = (None, ()) if tables is None else read_bands(path, tables)
    curves: dict[str, Spectrum] = {}
    if table is not None:
        for column in table.columns:
            curves[column] = read_fraction(path, "quantum_efficiency", table.file, column)
            if not (peak := float(curves[column].values.max())) >= _LOWEST_EFFICIENCY:
                allowed = f"must reach at least {_LOWEST_EFFICIENCY:g} at some wavelength"
                key = f"maximum of the column {column}"
                raise InputError(path.parent / table.file, allowed, key=key, value=peak)
    if bands is None:
        first, *_ = curves.values()
        return Spectrum(first.wavelength_nm, np.stack([curve.values for curve in curves.values()])), names
    # The efficiency of the photosites behind the filters.
    efficiency = Spectrum(bands.wavelength_nm, bands.values)
    for curve in curves.values():
        efficiency = Spectrum(bands.wavelength_nm, bands.values * curve.at(bands.wavelength_nm))
    for number, peak in enumerate(efficiency.values.max(axis=1).tolist()):
        if not peak >= _LOWEST_EFFICIENCY:
            allowed = f"must reach at least {_LOWEST_EFFICIENCY:g} electrons per photon"
            label = repr(names[number]) if names and names[number] else str(number + 1)
            raise InputError(path, allowed, key=f"maximum of the band {label}", value=peak)
    return efficiency, names


def load_filter(name_or_path: str | Path) -> Filter:
    """Load a filter from its file, or a shipped one by its name.

    Raises:
        InputError: the file or its curve is missing or invalid; the message names file, key and value.
    """
    path = find_material("filters", name_or_path)
    document = validate(FilterDocument, read_toml(path), path)
    table = document.transmittance
    return Filter(document.name, read_fraction(path, "transmittance", table.file, table.column))


def read_fraction(path: Path, table: str, file: str, column: str) -> Spectrum:
    """As `read_curve`; raises `InputError` if a value is above 1, too."""
    spectrum = read_curve(path, table, file, column)
    above = spectrum.values > 1.0
    if above.any():
        row = int(np.argmax(above))
        raise cell_error(path.parent / file, row, column, spectrum.values[row], "must be at most 1")
    return spectrum

"""The files of sensors and filters: their models, and loading them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.sensor import MAX_BITS, Filter, Pattern, Sensor, binning_error
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum
from pepperscene.spectra.files import (
    CurveTable,
    NonEmptyText,
    NonNegative,
    SourcedDocument,
    find_material,
    read_curve,
)

# Bounds of sensor files.
_PITCH_UM: Final = (0.1, 1000.0)
"""Chosen: two photosites within a quarter of a wavelength of light see the same (the smallest that are made
have 0.5 um), and the largest pixels of X-ray detectors have 0.2 mm."""
MAX_PHOTOSITES: Final = 500_000_000
"""Chosen: the sensors with the most have 410 million (Canon 2025), and an image needs 4 bytes for each."""
_LONGEST_LINE_US: Final = 10_000.0  # chosen: a second for a hundred rows
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
    pitch_um: Annotated[float, Field(ge=_PITCH_UM[0], le=_PITCH_UM[1])]
    full_well_e: Annotated[float, Field(ge=1, le=1e9)]
    read_noise_e: Annotated[float, Field(ge=0, le=1e9)]
    bits: Annotated[int, Field(ge=1, le=MAX_BITS)]
    black_level_dn: NonNegative
    line_time_us: Annotated[float, Field(ge=0, le=_LONGEST_LINE_US)] = 0.0
    quantum_efficiency: EfficiencyTable
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
        if len(self.quantum_efficiency.columns) != (colours := 1 if self.pattern == "mono" else 3):
            raise ValueError(f"quantum_efficiency.columns must name {colours} for the pattern {self.pattern}")
        return self


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
    table = document.quantum_efficiency
    curves = [read_fraction(path, "quantum_efficiency", table.file, column) for column in table.columns]
    for column, curve in zip(table.columns, curves, strict=True):
        if not (peak := float(curve.values.max())) >= _LOWEST_EFFICIENCY:
            allowed = f"must reach at least {_LOWEST_EFFICIENCY:g} at some wavelength"
            raise InputError(
                path.parent / table.file, allowed, key=f"maximum of the column {column}", value=peak
            )
    sensor = Sensor(
        name=document.name,
        columns=document.columns,
        rows=document.rows,
        pitch_m=document.pitch_um * 1e-6,
        quantum_efficiency=Spectrum(curves[0].wavelength_nm, np.stack([curve.values for curve in curves])),
        full_well_e=document.full_well_e,
        read_noise_e=document.read_noise_e,
        bits=document.bits,
        black_level_dn=document.black_level_dn,
        binning=document.binning,
        pattern=document.pattern,
        line_time_s=document.line_time_us * 1e-6,
    )
    cut = document.infrared_cut
    return (
        sensor
        if cut is None
        else sensor.with_filter(read_fraction(path, "infrared_cut", cut.file, cut.column))
    )


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
    """Read a curve within [0, 1] from a column of the CSV file next to `path`; it is 0 beyond its range.

    Raises:
        InputError: the file or the column is missing, or a value is out of range.
    """
    spectrum = read_curve(path, table, file, column)
    above = spectrum.values > 1.0
    if above.any():
        row = int(np.argmax(above))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        raise InputError(path.parent / file, "must be at most 1", key=key, value=float(spectrum.values[row]))
    return spectrum

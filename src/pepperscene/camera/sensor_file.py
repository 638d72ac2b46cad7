"""Sensor files (TOML) and the sensors that they become."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.sensor import MOST_BITS, Pattern, Sensor, fault_of_binning
from pepperscene.document import Document, read_toml, validated
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum
from pepperscene.spectra.sourced_file import (
    CurveTable,
    NotNegative,
    SourcedDocument,
    Text,
    curve,
    locate,
)


class EfficiencyTable(Document):
    """Columns of a CSV file beside the TOML file: red, green and blue, or the only one."""

    file: Text
    columns: Annotated[list[Text], Field(min_length=1, max_length=3)]


class SensorDocument(SourcedDocument):
    """A file of `materials/sensors`."""

    kind: Literal["measured", "standard", "MODEL"]
    columns: Annotated[int, Field(ge=1, le=20_000)]
    rows: Annotated[int, Field(ge=1, le=20_000)]
    pattern: Pattern
    binning: Annotated[int, Field(ge=1, le=16)]
    pitch_um: Annotated[float, Field(gt=0, le=1000)]
    full_well_e: Annotated[float, Field(ge=1, le=1e9)]
    read_noise_e: Annotated[float, Field(ge=0, le=1e9)]
    bits: Annotated[int, Field(ge=1, le=MOST_BITS)]
    black_level_dn: NotNegative
    quantum_efficiency: EfficiencyTable
    infrared_cut: CurveTable | None = None

    @model_validator(mode="after")
    def _black_within_the_range(self) -> SensorDocument:
        if self.black_level_dn >= 2**self.bits - 1:
            raise ValueError(f"black_level_dn must be below the full scale of {2**self.bits - 1}")
        return self

    @model_validator(mode="after")
    def _pixels_on_the_pattern(self) -> SensorDocument:
        if fault := fault_of_binning(self.pattern, self.binning, self.columns, self.rows):
            raise ValueError(fault)
        if len(self.quantum_efficiency.columns) != (colours := 1 if self.pattern == "mono" else 3):
            raise ValueError(f"quantum_efficiency.columns must name {colours} for the pattern {self.pattern}")
        return self


def load_sensor(wanted: str | Path) -> Sensor:
    """The sensor of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file or its curves are missing or wrong; the message names file, key and value.
    """
    path = locate("sensors", wanted)
    told = validated(SensorDocument, read_toml(path), path)
    table = told.quantum_efficiency
    curves = [curve(path, "quantum_efficiency", table.file, column) for column in table.columns]
    efficiency = Spectrum(curves[0].wavelength_nm, np.stack([one.values for one in curves]))
    if efficiency.values.max() > 1:
        highest = float(efficiency.values.max())
        raise InputError(path, "quantum_efficiency", highest, "must be a share of the photons, at most 1")
    sensor = Sensor(
        name=told.name,
        columns=told.columns,
        rows=told.rows,
        pitch_m=told.pitch_um * 1e-6,
        quantum_efficiency=efficiency,
        full_well_e=told.full_well_e,
        read_noise_e=told.read_noise_e,
        bits=told.bits,
        black_level_dn=told.black_level_dn,
        binning=told.binning,
        pattern=told.pattern,
    )
    return sensor if told.infrared_cut is None else sensor.behind(_cut(path, told.infrared_cut))


def _cut(path: Path, table: CurveTable) -> Spectrum:
    """The transmittance of the filter that belongs to the sensor."""
    found = curve(path, "infrared_cut", table.file, table.column)
    if found.values.max() > 1:
        highest = float(found.values.max())
        raise InputError(path, "infrared_cut", highest, "must be a share of the light, at most 1")
    return found

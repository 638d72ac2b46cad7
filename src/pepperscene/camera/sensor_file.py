"""Sensor files (TOML) and the sensors that they become."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.sensor import Sensor
from pepperscene.document import read_toml, validated
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum
from pepperscene.spectra.sourced_file import (
    CurvesTable,
    CurveTable,
    NotNegative,
    SourcedDocument,
    curve,
    locate,
)


class SensorDocument(SourcedDocument):
    """A file of `materials/sensors`."""

    kind: Literal["measured", "standard", "MODEL"]
    columns: Annotated[int, Field(ge=1, le=20_000)]
    rows: Annotated[int, Field(ge=1, le=20_000)]
    binning: Annotated[int, Field(ge=2, le=16, multiple_of=2)]
    pitch_um: Annotated[float, Field(gt=0, le=1000)]
    full_well_e: Annotated[float, Field(ge=1, le=1e9)]
    read_noise_e: Annotated[float, Field(ge=0, le=1e9)]
    bits: Annotated[int, Field(ge=1, le=24)]
    black_level_dn: NotNegative
    quantum_efficiency: CurvesTable
    infrared_cut: CurveTable | None = None

    @model_validator(mode="after")
    def _black_within_the_range(self) -> SensorDocument:
        if self.black_level_dn >= 2**self.bits - 1:
            raise ValueError(f"black_level_dn must be below the full scale of {2**self.bits - 1}")
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
    if (cut := told.infrared_cut) is not None:
        efficiency = _behind(efficiency, curve(path, "infrared_cut", cut.file, cut.column))
    if efficiency.values.max() > 1:
        highest = float(efficiency.values.max())
        raise InputError(path, "quantum_efficiency", highest, "must be a share of the photons, at most 1")
    return Sensor(
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
    )


def _behind(efficiency: Spectrum, filter_: Spectrum) -> Spectrum:
    """Efficiencies times a filter's transmittance, at the wavelengths of both."""
    nm = np.union1d(efficiency.wavelength_nm, filter_.wavelength_nm)
    return Spectrum(nm, efficiency.at(nm) * filter_.at(nm))

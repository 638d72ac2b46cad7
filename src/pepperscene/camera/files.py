"""Sensor, lens and flash files (TOML) and the objects that they become."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.flash import AngularProfile, Flash, is_visible
from pepperscene.camera.lens import Distortion, Lens
from pepperscene.camera.sensor import Sensor
from pepperscene.document import Document, read_toml, validated
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shelf
from pepperscene.spectra import Spectrum, read_spectrum

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


class CurvesTable(Document):
    """Three columns of a CSV file beside the TOML file, for red, green and blue."""

    file: Text
    columns: tuple[Text, Text, Text]


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


class DistortionTable(Document):
    """The plumb bob's coefficients, on slopes."""

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0
    k3: Coefficient = 0.0


class LensDocument(SourcedDocument):
    """A file of `materials/lenses`."""

    focal_length_mm: Annotated[float, Field(gt=0, le=10_000)]
    f_number: Annotated[float, Field(ge=0.5, le=1000)]
    transmittance: Annotated[float, Field(gt=0, le=1)]
    distortion: DistortionTable


class ProfileTable(Document):
    """Relative intensity against the angle to the axis."""

    angle_deg: Annotated[tuple[Annotated[float, Field(ge=0, le=90)], ...], Field(min_length=2)]
    relative_intensity: tuple[NotNegative, ...]

    @model_validator(mode="after")
    def _a_curve_from_the_axis(self) -> ProfileTable:
        if len(self.angle_deg) != len(self.relative_intensity):
            raise ValueError("angle_deg and relative_intensity must be equally long")
        if self.angle_deg[0] != 0 or any(np.diff(self.angle_deg) <= 0):
            raise ValueError("angle_deg must increase from 0")
        if self.relative_intensity[0] != 1:
            raise ValueError("relative_intensity must be 1 at angle 0")
        return self


class FlashDocument(SourcedDocument):
    """A file of `materials/flashes`."""

    illuminance_lx: Annotated[float, Field(gt=0, le=1e9)]
    at_mm: Annotated[float, Field(ge=1, le=1e6)]
    pulse_us: Annotated[float, Field(gt=0, le=1e9)]
    radius_mm: Annotated[float, Field(ge=0, le=1e6)]
    offset_mm: tuple[Millimetres, Millimetres, Millimetres]
    spectrum: CurveTable
    profile: ProfileTable


def load_sensor(wanted: str | Path) -> Sensor:
    """The sensor of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file or its curves are missing or wrong; the message names file, key and value.
    """
    path = _locate("sensors", wanted)
    told = validated(SensorDocument, read_toml(path), path)
    table = told.quantum_efficiency
    curves = [_curve(path, "quantum_efficiency", table.file, column) for column in table.columns]
    efficiency = Spectrum(curves[0].wavelength_nm, np.stack([curve.values for curve in curves]))
    if (cut := told.infrared_cut) is not None:
        efficiency = _behind(efficiency, _curve(path, "infrared_cut", cut.file, cut.column))
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


def load_lens(wanted: str | Path) -> Lens:
    """The lens of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file is missing or wrong; the message names file, key and value.
    """
    path = _locate("lenses", wanted)
    told = validated(LensDocument, read_toml(path), path)
    distortion = Distortion(**told.distortion.model_dump())
    return Lens(told.name, told.focal_length_mm * 1e-3, told.f_number, told.transmittance, distortion)


def load_flash(wanted: str | Path) -> Flash:
    """The flash of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file or its spectrum is missing or wrong; the message names file, key and value.
    """
    path = _locate("flashes", wanted)
    told = validated(FlashDocument, read_toml(path), path)
    spectrum = _curve(path, "spectrum", told.spectrum.file, told.spectrum.column)
    if not is_visible(spectrum):
        raise InputError(path, "spectrum.column", told.spectrum.column, "must hold light in 400 to 700 nm")
    right, down, forwards = (length * 1e-3 for length in told.offset_mm)
    return Flash(
        name=told.name,
        spectrum=spectrum,
        illuminance_lx=told.illuminance_lx,
        at_m=told.at_mm * 1e-3,
        profile=AngularProfile(np.deg2rad(told.profile.angle_deg), np.array(told.profile.relative_intensity)),
        radius_m=told.radius_mm * 1e-3,
        offset_m=(right, down, forwards),
        pulse_s=told.pulse_us * 1e-6,
    )


def _locate(folder: str, wanted: str | Path) -> Path:
    """A path as it is, a bare name in the shipped folder."""
    path, shipped = Path(wanted), shelf("materials") / folder
    if is_file(path):
        return path
    if path.parent == Path(".") and is_file(shipped / f"{path}.toml"):
        return shipped / f"{path}.toml"
    names = ", ".join(sorted(file.stem for file in shipped.glob("*.toml")))
    raise InputError(str(wanted), "", None, f"no such file, nor one of the shipped {folder}: {names}")


def _curve(path: Path, table: str, file: str, column: str) -> Spectrum:
    """One column of the CSV file beside `path`: a curve that is nowhere negative, 0 beyond its range."""
    beside = path.parent / file
    if not is_file(beside):
        raise InputError(path, f"{table}.file", file, "is not a file beside this one")
    curve = read_spectrum(beside, column)
    negative = curve.values < 0
    if negative.any():
        row = int(np.argmax(negative))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        raise InputError(beside, key, float(curve.values[row]), "must be at least 0")
    return curve


def _behind(efficiency: Spectrum, filter_: Spectrum) -> Spectrum:
    """Efficiencies times a filter's transmittance, at the wavelengths of both."""
    nm = np.union1d(efficiency.wavelength_nm, filter_.wavelength_nm)
    return Spectrum(nm, efficiency.at(nm) * filter_.at(nm))

"""Flash files (TOML) and the flashes that they become."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.flash import Flash, is_visible, square_matrix
from pepperscene.camera.profile import AngularProfile
from pepperscene.document import Document, read_toml, validated
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shelf
from pepperscene.spectra import Spectrum
from pepperscene.spectra.sourced_file import (
    CurveTable,
    Millimetres,
    NotNegative,
    SourcedDocument,
    curve,
    locate,
)

Degrees = Annotated[float, Field(ge=0, le=90)]
Strength = Annotated[float, Field(gt=0, le=1e9)]


class ProfileTable(Document):
    """Relative intensity against the angle to the axis."""

    angle_deg: Annotated[tuple[Degrees, ...], Field(min_length=2)]
    relative_intensity: tuple[NotNegative, ...]

    @model_validator(mode="after")
    def _is_a_profile(self) -> ProfileTable:
        self.profile()
        return self

    def profile(self) -> AngularProfile:
        """The beam; it ends at the last angle."""
        return AngularProfile(np.deg2rad(self.angle_deg), np.array(self.relative_intensity))


class MatrixTable(Document):
    """Emitters in rows and columns around the flash's centre."""

    columns: Annotated[int, Field(ge=1, le=100)]
    rows: Annotated[int, Field(ge=1, le=100)]
    pitch_mm: Annotated[float, Field(gt=0, le=1e4)]


class FlashDocument(SourcedDocument):
    """A file of `materials/flashes`."""

    illuminance_lx: Strength | None = None
    irradiance_W_m2: Strength | None = None  # noqa: N815 (the unit is written so)
    at_mm: Annotated[float, Field(ge=1, le=1e6)]
    pulse_us: Annotated[float, Field(gt=0, le=1e9)]
    radius_mm: Annotated[float, Field(ge=0, le=1e6)]
    offset_mm: tuple[Millimetres, Millimetres, Millimetres]
    matrix: MatrixTable | None = None
    spectrum: CurveTable
    profile: ProfileTable

    @model_validator(mode="after")
    def _one_strength(self) -> FlashDocument:
        if (self.illuminance_lx is None) == (self.irradiance_W_m2 is None):
            raise ValueError("exactly one of illuminance_lx and irradiance_W_m2 must be given")
        return self

    @model_validator(mode="after")
    def _emitters_apart(self) -> FlashDocument:
        matrix = self.matrix
        if (
            matrix
            and max(matrix.columns, matrix.rows) > 1
            and self.radius_mm > matrix.pitch_mm / 2 * (1 + 1e-9)
        ):
            raise ValueError("radius_mm must be at most half of matrix.pitch_mm, or emitters overlap")
        return self


def load_flash(wanted: str | Path) -> Flash:
    """The flash of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file or its spectrum is missing or wrong; the message names file, key and value.
    """
    path = locate("flashes", wanted)
    told = validated(FlashDocument, read_toml(path), path)
    spectrum = _spectrum(path, told)
    right, down, forwards = (length * 1e-3 for length in told.offset_mm)
    matrix = told.matrix or MatrixTable(columns=1, rows=1, pitch_mm=1.0)
    try:
        return Flash(
            name=told.name,
            spectrum=spectrum,
            at_m=told.at_mm * 1e-3,
            profile=told.profile.profile(),
            illuminance_lx=told.illuminance_lx,
            irradiance_W_m2=told.irradiance_W_m2,
            radius_m=told.radius_mm * 1e-3,
            emitters_m=square_matrix(matrix.columns, matrix.rows, matrix.pitch_mm * 1e-3),
            offset_m=(right, down, forwards),
            pulse_s=told.pulse_us * 1e-6,
        )
    except ValueError as fault:
        # What remains: a beam so narrow that none of the matrix shines on the point where it was measured.
        raise InputError(path, "profile", None, f"does not fit the other values: {fault}") from None


def _spectrum(path: Path, told: FlashDocument) -> Spectrum:
    """The curve of a CSV file beside this one, or of a shipped one ("light/houser2013_cool_white_led")."""
    file, column = told.spectrum.file, told.spectrum.column
    shipped = shelf("materials") / f"{file.removesuffix('.csv')}.csv"
    if not is_file(path.parent / file) and is_file(shipped):
        file = str(shipped)
    found = curve(path, "spectrum", file, column)
    if told.illuminance_lx is not None and not is_visible(found):
        allowed = "must hold light in 400 to 700 nm, or the strength be told as irradiance_W_m2"
        raise InputError(path, "spectrum.column", column, allowed)
    if not found.integral() > 0:
        raise InputError(path, "spectrum.column", column, "must hold some light")
    return found

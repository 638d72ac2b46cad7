"""Flash files (TOML) and the flashes that they become."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.flash import AngularProfile, Flash, is_visible
from pepperscene.document import Document, read_toml, validated
from pepperscene.errors import InputError
from pepperscene.spectra.sourced_file import (
    CurveTable,
    Millimetres,
    NotNegative,
    SourcedDocument,
    curve,
    locate,
)


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


def load_flash(wanted: str | Path) -> Flash:
    """The flash of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file or its spectrum is missing or wrong; the message names file, key and value.
    """
    path = locate("flashes", wanted)
    told = validated(FlashDocument, read_toml(path), path)
    spectrum = curve(path, "spectrum", told.spectrum.file, told.spectrum.column)
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

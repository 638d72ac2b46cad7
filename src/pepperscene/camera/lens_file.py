"""Lens files (TOML) and the lenses that they become."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.lens import Distortion, Lens
from pepperscene.camera.profile import AngularProfile
from pepperscene.document import Document, read_toml, validated
from pepperscene.spectra.sourced_file import Coefficient, SourcedDocument, locate


class DistortionTable(Document):
    """The plumb bob's coefficients, on slopes."""

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0
    k3: Coefficient = 0.0


class VignettingTable(Document):
    """What the rims leave of oblique light, against the field angle."""

    angle_deg: Annotated[tuple[Annotated[float, Field(ge=0, le=90)], ...], Field(min_length=2)]
    # Above 1 for lenses whose pupil grows with the angle; twice is beyond what is built.
    relative: tuple[Annotated[float, Field(ge=0, le=2)], ...]

    @model_validator(mode="after")
    def _is_a_profile(self) -> VignettingTable:
        self.profile()
        return self

    def profile(self) -> AngularProfile:
        """The table as a curve, held beyond its last angle."""
        return AngularProfile(np.deg2rad(self.angle_deg), np.array(self.relative), beyond="hold")


SensorMillimetres = Annotated[float, Field(ge=-100, le=100)]


class LensDocument(SourcedDocument):
    """A file of `materials/lenses`."""

    focal_length_mm: Annotated[float, Field(gt=0, le=10_000)]
    f_number: Annotated[float, Field(ge=0.5, le=1000)]
    transmittance: Annotated[float, Field(gt=0, le=1)]
    principal_offset_mm: tuple[SensorMillimetres, SensorMillimetres] = (0.0, 0.0)
    distortion: DistortionTable
    vignetting: VignettingTable | None = None


def load_lens(wanted: str | Path) -> Lens:
    """The lens of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file is missing or wrong; the message names file, key and value.
    """
    path = locate("lenses", wanted)
    told = validated(LensDocument, read_toml(path), path)
    right, down = told.principal_offset_mm
    return Lens(
        name=told.name,
        focal_length_m=told.focal_length_mm * 1e-3,
        f_number=told.f_number,
        transmittance=told.transmittance,
        distortion=Distortion(**told.distortion.model_dump()),
        principal_offset_m=(right * 1e-3, down * 1e-3),
        vignetting=told.vignetting.profile() if told.vignetting else None,
    )

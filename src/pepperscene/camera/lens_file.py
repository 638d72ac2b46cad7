"""Lens files (TOML) and the lenses that they become."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from pepperscene.camera.lens import Distortion, Lens
from pepperscene.document import Document, read_toml, validated
from pepperscene.spectra.sourced_file import Coefficient, SourcedDocument, locate


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


def load_lens(wanted: str | Path) -> Lens:
    """The lens of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file is missing or wrong; the message names file, key and value.
    """
    path = locate("lenses", wanted)
    told = validated(LensDocument, read_toml(path), path)
    distortion = Distortion(**told.distortion.model_dump())
    return Lens(told.name, told.focal_length_mm * 1e-3, told.f_number, told.transmittance, distortion)

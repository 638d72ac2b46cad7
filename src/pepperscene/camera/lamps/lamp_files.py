"""Files of lamps: TOML files of `materials/lamps`, and photometric files of luminaires."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.camera.lamps.beam import Beam, diffuse_tube_beam, even_beam, lambertian_beam, profile_beam
from pepperscene.camera.lamps.lamp import POINT, EmitterShape, Lamp, ring
from pepperscene.camera.lamps.photometric_files import ENDINGS, read_beam
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra import read_spectrum
from pepperscene.spectra.files import CurveTable, SourcedDocument, find_material, read_light

_SIZE_MM: Final = 1e4  # chosen: as of a flash
_WHITE: Final = ("light/cie_illuminants_colour_science", "led_b3")
"""Spectrum of lamps of photometric files, which have none: the CIE's white LED of 4103 K."""

Size = Annotated[float, Field(gt=0, le=_SIZE_MM)]
Strength = Annotated[float, Field(ge=1e-6, le=1e9)]
BeamAngle = Annotated[float, Field(ge=0, le=180)]
Elements = Annotated[int, Field(ge=1, le=100)]


class LampBeamTable(Document):
    """The beam of a lamp: a word, a photometric file, or relative intensities at angles to the axis."""

    kind: Literal["lambertian", "even"] | None = None
    file: Annotated[str, Field(min_length=1, max_length=400)] | None = None
    angle_deg: Annotated[tuple[BeamAngle, ...], Field(max_length=1000)] | None = None
    relative_intensity: tuple[Annotated[float, Field(ge=0, le=1e6)], ...] | None = None

    @model_validator(mode="after")
    def _check_consistency(self) -> LampBeamTable:
        if (self.angle_deg is None) != (self.relative_intensity is None):
            raise ValueError("angle_deg and relative_intensity must be given together")
        if sum(part is not None for part in (self.kind, self.file, self.angle_deg)) != 1:
            raise ValueError("exactly one of kind, file, and angle_deg with relative_intensity must be given")
        if self.angle_deg is not None:
            profile_beam(np.radians(self.angle_deg), self.relative_intensity or ())
        return self


class PanelTable(Document):
    """Equal rectangles or discs in columns (along the lamp's x axis) and rows."""

    columns: Elements = 1
    rows: Elements = 1
    pitch_mm: tuple[Size, Size] | None = None
    size_mm: tuple[Size, Size] | None = None
    radius_mm: Size | None = None

    @model_validator(mode="after")
    def _check_consistency(self) -> PanelTable:
        if (self.size_mm is None) == (self.radius_mm is None):
            raise ValueError("exactly one of size_mm and radius_mm must be given")
        pitch, size = self.pitch_mm or (0.0, 0.0), self.size_mm or (2.0 * (self.radius_mm or 0.0),) * 2
        for count, step, width in zip((self.columns, self.rows), pitch, size, strict=True):
            if count > 1 and width > step * (1 + 1e-9):
                raise ValueError("several columns or rows need a pitch_mm of at least the size of an element")
        return self

    def shape(self) -> EmitterShape:
        """The same in metres."""
        (right, down), (width, height) = self.pitch_mm or (0, 0), self.size_mm or (0, self.radius_mm or 0)
        pitch_m, size_m = (1e-3 * right, 1e-3 * down), (1e-3 * width, 1e-3 * height)
        return EmitterShape(self.columns, self.rows, pitch_m, size_m, is_round=self.size_mm is None)


class LampDocument(SourcedDocument):
    """A file of `materials/lamps`.

    The strength is in lumens, in umol s-1 of photons of 400 to 700 nm, in watts of light, or in lux straight
    ahead at `at_mm`; a photometric file of the beam has its own.
    """

    shape: Literal["point", "disc", "ring", "panel", "tube"]
    radius_mm: Size | None = None
    inner_radius_mm: Size | None = None
    length_mm: Size | None = None
    panel: PanelTable | None = None
    flux_lm: Strength | None = None
    ppf_umol_s: Strength | None = None
    flux_W: Strength | None = None  # noqa: N815 (the unit is written so)
    illuminance_lx: Strength | None = None
    at_mm: Annotated[float, Field(ge=1, le=1e5)] | None = None
    pulse_us: Annotated[float, Field(ge=1e-3, le=1e9)] | None = None
    spectrum: CurveTable
    beam: LampBeamTable

    @model_validator(mode="after")
    def _check_consistency(self) -> LampDocument:
        needed = {"disc": ("radius_mm",), "ring": ("radius_mm", "inner_radius_mm"), "panel": ("panel",)}
        of_shape = (needed | {"tube": ("length_mm",)}).get(self.shape, ())
        for key in ("radius_mm", "inner_radius_mm", "length_mm", "panel"):
            if (getattr(self, key) is not None) != (key in of_shape):
                verb = "needs" if key in of_shape else "must not have"
                raise ValueError(f"a lamp of the shape {self.shape} {verb} {key}")
        if self.shape == "ring" and not (self.inner_radius_mm or 0) < (self.radius_mm or 0):
            raise ValueError("inner_radius_mm must be less than radius_mm")
        strengths = [self.flux_lm, self.ppf_umol_s, self.flux_W, self.illuminance_lx]
        count = sum(strength is not None for strength in strengths)
        if count > 1 or (count == 0 and self.beam.file is None):
            raise ValueError("exactly one of flux_lm, ppf_umol_s, flux_W and illuminance_lx must be given")
        if (self.illuminance_lx is None) != (self.at_mm is None):
            raise ValueError("illuminance_lx and at_mm must be given together")
        return self

    def emitter(self) -> EmitterShape:
        """The shape in metres."""
        if self.panel is not None:
            return self.panel.shape()
        if self.length_mm is not None:
            return EmitterShape(size_m=(1e-3 * self.length_mm, 0.0))
        if self.radius_mm is not None:
            return ring(1e-3 * self.radius_mm, 1e-3 * (self.inner_radius_mm or 0.0))
        return POINT


def load_lamp(name_or_path: str | Path) -> Lamp:
    """Load a lamp from its TOML file or a photometric file (.ies, .ldt), or a shipped one by its name.

    It is at the origin, with its axis along z. A lamp of a photometric file is a point with the spectrum of
    the CIE's white LED B3.

    Raises:
        InputError: a file is missing or not valid; the message names file, key and value.
    """
    path = Path(name_or_path)
    if path.suffix.lower() in ENDINGS:
        beam, spectrum = read_beam(path), read_spectrum(*_WHITE)
        return Lamp(path.stem, spectrum, 1.0, beam).with_strength(flux_lm=beam.flux)
    path = find_material("lamps", name_or_path)
    document = validate(LampDocument, read_toml(path), path)
    spectrum, beam = read_light(path, document.spectrum), _beam(path, document)
    pulse_s = None if document.pulse_us is None else 1e-6 * document.pulse_us
    try:
        lamp = Lamp(
            document.name, spectrum, document.flux_W or 1.0, beam, document.emitter(), pulse_s=pulse_s
        )
    except ValueError as error:
        key, column = "spectrum.column", document.spectrum.column
        raise InputError(path, f"does not fit: {error}", key=key, value=column) from None
    if document.flux_W is not None:
        return lamp
    given = {key: getattr(document, key) for key in ("flux_lm", "ppf_umol_s", "illuminance_lx")}
    if all(value is None for value in given.values()):
        given["flux_lm"] = beam.flux
    try:
        return lamp.with_strength(**given, at_m=1e-3 * (document.at_mm or 1000.0))
    except ValueError as error:
        raise InputError(path, f"does not fit the spectrum and the beam: {error}") from None


def _beam(path: Path, document: LampDocument) -> Beam:
    table = document.beam
    if table.file is not None:
        file = path.parent / table.file
        if file.suffix.lower() not in ENDINGS:
            raise InputError(path, "must be an .ies or .ldt file", key="beam.file", value=table.file)
        return read_beam(file)
    if table.angle_deg is not None and table.relative_intensity is not None:
        return profile_beam(np.radians(table.angle_deg), np.array(table.relative_intensity))
    if table.kind == "even":
        return even_beam()
    return diffuse_tube_beam() if document.shape == "tube" else lambertian_beam()

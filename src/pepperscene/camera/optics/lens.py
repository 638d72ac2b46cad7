"""The lens: focal length, aperture, transmittance and vignetting, and its file."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.camera.optics.distortion import (
    MODELS,
    Distortion,
    DistortionModel,
    LensModel,
    make_distortion,
)
from pepperscene.camera.optics.stray_light import StrayLight, StrayLightTable
from pepperscene.document import Document, read_toml, validate
from pepperscene.spectra.files import Coefficient, SourcedDocument, find_material

_MIN_ANGLE_STEP_RAD: Final = 1e-6  # chosen: no table is finer; a thousandth of what an instrument resolves

# Bounds of lens files.
_FOCAL_LENGTH_MM: Final = (0.1, 10_000.0)
"""Chosen: endoscopes have 0.3 mm, telescopes of amateurs a few metres."""
_F_NUMBER: Final = (0.5, 1000.0)
"""0.5 is the limit of a lens in air, whose cone of light fills a hemisphere; the other end is chosen: pinhole
cameras have some hundreds."""
_LEAST_TRANSMITTANCE: Final = 1e-6  # chosen: the densest neutral filters, which watch the sun, have 1e-5

_NO_DISTORTION: Final = Distortion()
_TYPICAL_STRAY_LIGHT: Final = StrayLight()
FY_OVER_FX: Final = (0.25, 4.0)
"""Chosen: anamorphic lenses of the cinema have 2; calibrations of others stay within a per cent of 1."""


@dataclass(frozen=True, eq=False)
class AngularProfile:
    """Relative intensity against the angle to an axis (a beam, vignetting), linear in between.

    Attributes:
        angle_rad: `(n,)` increasing from 0, at most pi/2; read-only.
        relative_intensity: `(n,)` at least 0, and 1 on the axis; read-only.
        beyond: value after the last angle: zero (a beam ends), or held (a vignetting table).
    """

    angle_rad: NDArray[np.float64]
    relative_intensity: NDArray[np.float64]
    beyond: Literal["zero", "hold"] = "zero"

    def __post_init__(self) -> None:
        angle = np.array(self.angle_rad, dtype=float)
        relative = np.array(self.relative_intensity, dtype=float)
        if angle.ndim != 1 or angle.size < 2 or angle[0] != 0 or not np.all(np.diff(angle) > 0):
            raise ValueError("angles must be one increasing list of at least two numbers from 0")
        if not np.diff(angle).min() >= _MIN_ANGLE_STEP_RAD:
            least = math.degrees(_MIN_ANGLE_STEP_RAD)
            raise ValueError(f"angles must be at least {least:.1g} degrees apart")
        if angle[-1] > math.pi / 2 + 1e-12:
            raise ValueError("angles must not exceed a right angle")
        if relative.shape != angle.shape:
            raise ValueError("angles and relative intensities must be equally long")
        if relative[0] != 1 or not np.all((relative >= 0) & np.isfinite(relative)):
            raise ValueError("relative intensities must be finite, at least 0, and 1 at angle 0")
        for name, values in (("angle_rad", angle), ("relative_intensity", relative)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def at(self, angle_rad: ArrayLike) -> NDArray[np.float64]:
        """Relative intensity `(...)` at angles `(...)`."""
        end = 0.0 if self.beyond == "zero" else float(self.relative_intensity[-1])
        angle = np.asarray(angle_rad, dtype=float)
        return np.asarray(np.interp(angle, self.angle_rad, self.relative_intensity, right=end))


@dataclass(frozen=True)
class Lens:
    """A thin lens.

    Attributes:
        focal_length_m: also the distance from the projection centre to the sensor.
        f_number: focal length over the diameter of the entrance pupil.
        transmittance: fraction of the light that the glass transmits, without colour.
        distortion: geometric distortion, around the optical axis.
        principal_offset_m: where the optical axis meets the sensor, right and down of its centre.
        vignetting: mechanical vignetting by field angle, on top of the natural fall-off of
            `camera.relative_illumination`; None for none.
        fy_over_fx: focal length down the image over that along its rows. Other than 1, the image is
            stretched, as by an anamorphic lens or by a calibration whose two focal lengths differ.
        stray_light: diffraction, scatter, veiling glare and ghosts, switched on by `Developing.stray_light`.
    """

    name: str
    focal_length_m: float
    f_number: float
    transmittance: float = 1.0
    distortion: DistortionModel = _NO_DISTORTION
    principal_offset_m: tuple[float, float] = (0.0, 0.0)
    vignetting: AngularProfile | None = None
    fy_over_fx: float = 1.0
    stray_light: StrayLight = _TYPICAL_STRAY_LIGHT

    def __post_init__(self) -> None:
        is_finite = math.isfinite(self.focal_length_m) and math.isfinite(self.f_number)
        positive = self.focal_length_m > 0 and self.f_number >= 0.5
        if not (is_finite and positive and 0 < self.transmittance <= 1):
            allowed = "focal length must be > 0, f-number >= 0.5 and transmittance in (0, 1]"
            raise ValueError(f"{self.name}: {allowed}")
        low, high = FY_OVER_FX
        if not low <= self.fy_over_fx <= high:
            raise ValueError(f"{self.name}: fy over fx must be {low:g} to {high:g}")
        right, down = (float(length) for length in self.principal_offset_m)
        if not (math.isfinite(right) and math.isfinite(down)):
            raise ValueError(f"{self.name}: the principal point's offset must be finite")
        object.__setattr__(self, "principal_offset_m", (right, down))


class ProfileTable(Document, ABC):
    """Relative values against the angle to an axis."""

    angle_deg: Annotated[tuple[Annotated[float, Field(ge=0, le=90)], ...], Field(min_length=2)]

    @model_validator(mode="after")
    def _check_profile(self) -> ProfileTable:
        self.profile()
        return self

    @abstractmethod
    def profile(self) -> AngularProfile:
        """The table as a curve."""


class VignettingTable(ProfileTable):
    """Relative illumination that mechanical vignetting leaves, against the field angle."""

    # Above 1 for lenses whose pupil grows with the angle; twice is beyond what is built.
    relative: tuple[Annotated[float, Field(ge=0, le=2)], ...]

    def profile(self) -> AngularProfile:
        """The table as a curve, held beyond its last angle."""
        return AngularProfile(np.deg2rad(self.angle_deg), np.array(self.relative), beyond="hold")


class DistortionTable(Document):
    """A distortion model and its coefficients; those that are left out are 0."""

    model: LensModel = "plumb_bob"
    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0
    k3: Coefficient = 0.0
    k4: Coefficient = 0.0
    k5: Coefficient = 0.0
    k6: Coefficient = 0.0

    @model_validator(mode="after")
    def _check_model(self) -> DistortionTable:
        allowed = MODELS[self.model]
        for name in sorted(self.model_fields_set - {"model"}):
            if name not in allowed:
                names = ", ".join(allowed)
                raise ValueError(f"{name} is not a coefficient of the model {self.model}, which has {names}")
        return self

    def distortion(self) -> DistortionModel:
        """The table as a distortion model."""
        return make_distortion(self.model, [getattr(self, name) for name in MODELS[self.model]])


SensorMillimetres = Annotated[float, Field(ge=-100, le=100)]


class LensDocument(SourcedDocument):
    """A file of `materials/lenses`."""

    focal_length_mm: Annotated[float, Field(ge=_FOCAL_LENGTH_MM[0], le=_FOCAL_LENGTH_MM[1])]
    f_number: Annotated[float, Field(ge=_F_NUMBER[0], le=_F_NUMBER[1])]
    transmittance: Annotated[float, Field(ge=_LEAST_TRANSMITTANCE, le=1)]
    fy_over_fx: Annotated[float, Field(ge=FY_OVER_FX[0], le=FY_OVER_FX[1])] = 1.0
    principal_offset_mm: tuple[SensorMillimetres, SensorMillimetres] = (0.0, 0.0)
    distortion: DistortionTable
    vignetting: VignettingTable | None = None
    stray_light: StrayLightTable | None = None


def load_lens(name_or_path: str | Path) -> Lens:
    """Load a lens from its file, or a shipped one by its name.

    Raises:
        InputError: the file is missing or invalid; the message names file, key and value.
    """
    path = find_material("lenses", name_or_path)
    document = validate(LensDocument, read_toml(path), path)
    right, down = document.principal_offset_mm
    return Lens(
        name=document.name,
        focal_length_m=document.focal_length_mm * 1e-3,
        f_number=document.f_number,
        transmittance=document.transmittance,
        distortion=document.distortion.distortion(),
        principal_offset_m=(right * 1e-3, down * 1e-3),
        vignetting=document.vignetting.profile() if document.vignetting else None,
        fy_over_fx=document.fy_over_fx,
        stray_light=document.stray_light.stray_light() if document.stray_light else _TYPICAL_STRAY_LIGHT,
    )

"""The lens: focal length, aperture, transmittance, vignetting and stray light, and its file."""

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
from pepperscene.document import Document, read_toml, validate
from pepperscene.spectra.files import Coefficient, SourcedDocument, find_material

_MOST_STRAY, _MOST_IN_ALL = 0.9, 0.95  # chosen: a lens that loses more of its light shows no image


@dataclass(frozen=True)
class Ghost:
    """A weak, blurred image by two reflections inside the lens, scaled about the optical axis.

    Attributes:
        magnification: of the ghost relative to the image; below 0 it is mirrored through the axis.
        radius_m: radius on the sensor of the disc into which a point is spread: the aperture out of focus.
        fraction: of the light that goes into the ghost.
    """

    magnification: float
    radius_m: float
    fraction: float


_TYPICAL_GHOSTS: Final = (Ghost(-1.0, 4e-4, 2.5e-4), Ghost(-0.4, 2e-4, 2.5e-5), Ghost(0.6, 6e-4, 2.5e-5))
"""Chosen, with reflections as in the model of Hullin et al. 2011 (ACM Trans. Graph. 30:108): a coated surface
reflects 0.5 %, and the sensor with the filter in front of it 5 %. The strongest ghost is reflected by the
sensor and a surface of the lens, others by two surfaces. Positions and sizes depend on the design, which is
not known; those of Lee & Eisemann 2013 (Comput. Graph. Forum 32:1) lie on both sides of the axis."""


@dataclass(frozen=True)
class StrayLight:
    """Light that a lens does not image as a point: diffraction, scatter, veiling glare and ghosts.

    A point is imaged as the diffraction pattern of the aperture, which depends on the f-number alone. A
    fraction of its light is scattered by surfaces and dust into the point spread function

        (exponent - 1) / (pi width^2) (1 + (r / width)^2)^-exponent

    of the distance r on the sensor (Bitlis, Jansson & Allebach 2007, Proc. SPIE 6498:64980V, on the axis).
    Further fractions spread evenly over the image (veiling glare) or form ghosts.

    Attributes:
        scatter: fraction of the light that is scattered. The default is that of a measured compact camera
            (Olympus SP-510 UZ; Wei, Cao, Bouman & Allebach 2009, Proc. SPIE 7246:72460B, second hand), as are
            width and exponent; two thirds of it stay within 12 micrometres.
        scatter_width_m: half of its light stays within about three widths.
        scatter_exponent: half the power by which the scattered light decreases.
        veil: fraction of the light that reflections between surfaces spread evenly. The default is chosen for
            seven coated glasses: 91 pairs of surfaces that each reflect 0.5 %. Together with the scatter, it
            gives a veiling glare index (ISO 9358) of 1 to 2 %.
        ghosts: the ghosts.

    Raises:
        ValueError: a number is out of range, or no light is left for the image.
    """

    scatter: float = 0.39
    scatter_width_m: float = 1.76e-6
    scatter_exponent: float = 1.31
    veil: float = 0.0023
    ghosts: tuple[Ghost, ...] = _TYPICAL_GHOSTS

    def __post_init__(self) -> None:
        fractions = [self.scatter, self.veil, *(ghost.fraction for ghost in self.ghosts)]
        # Written so that nan fails too.
        if not (min(fractions) >= 0.0 and sum(fractions) <= _MOST_IN_ALL):
            raise ValueError(
                f"fractions of stray light must be at least 0, together at most {_MOST_IN_ALL:g}"
            )
        if not (0.0 < self.scatter_width_m < math.inf and 1.0 < self.scatter_exponent < math.inf):
            raise ValueError("scatter must have a positive width and an exponent above 1")
        for ghost in self.ghosts:
            is_finite = math.isfinite(ghost.magnification) and math.isfinite(ghost.radius_m)
            if not (is_finite and ghost.magnification != 0.0 and ghost.radius_m > 0.0):
                raise ValueError("a ghost must have a magnification other than 0, and a positive radius")


Fraction = Annotated[float, Field(ge=0, le=_MOST_STRAY)]
# Chosen: beyond it, a ghost spreads over a hundred times the image.
Magnification = Annotated[float, Field(ge=-10.0, le=10.0)]
Radius = Annotated[float, Field(ge=1e-3, le=1000)]  # chosen: from a pixel to more than any sensor


class StrayLightTable(Document):
    """The table `[stray_light]` of a lens file; what is left out has the default of `StrayLight`.

    The three lists have an entry for each ghost.
    """

    scatter: Fraction = StrayLight.scatter
    # Chosen: a hundredth of the smallest pixel to a hundred large ones.
    scatter_width_um: Annotated[float, Field(ge=0.01, le=1000)] = StrayLight.scatter_width_m * 1e6
    # At 1 the integral over the plane is infinite; chosen just above it. Smooth optics have 1.2 to 1.6.
    scatter_exponent: Annotated[float, Field(ge=1.05, le=10)] = StrayLight.scatter_exponent
    veil: Fraction = StrayLight.veil
    ghost_magnification: tuple[Magnification, ...] = tuple(g.magnification for g in _TYPICAL_GHOSTS)
    ghost_radius_mm: tuple[Radius, ...] = tuple(g.radius_m * 1e3 for g in _TYPICAL_GHOSTS)
    ghost_fraction: tuple[Fraction, ...] = tuple(g.fraction for g in _TYPICAL_GHOSTS)

    @model_validator(mode="after")
    def _check_stray_light(self) -> StrayLightTable:
        lengths = {len(self.ghost_magnification), len(self.ghost_radius_mm), len(self.ghost_fraction)}
        if len(lengths) > 1:
            raise ValueError(
                "ghost_magnification, ghost_radius_mm and ghost_fraction must have one value for each ghost"
            )
        self.stray_light()
        return self

    def stray_light(self) -> StrayLight:
        """The table in metres."""
        lists = zip(self.ghost_magnification, self.ghost_radius_mm, self.ghost_fraction, strict=True)
        ghosts = tuple(Ghost(scale, radius * 1e-3, fraction) for scale, radius, fraction in lists)
        width_m = self.scatter_width_um * 1e-6
        return StrayLight(self.scatter, width_m, self.scatter_exponent, self.veil, ghosts)


_MIN_ANGLE_STEP_RAD: Final = 1e-6  # chosen: no table is finer; a thousandth of what an instrument resolves

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
                model = f"the model {self.model}, which has {', '.join(allowed)}"
                raise ValueError(f"{name} is not a coefficient of {model}")
        return self

    def distortion(self) -> DistortionModel:
        """The table as a distortion model."""
        return make_distortion(self.model, [getattr(self, name) for name in MODELS[self.model]])


SensorMillimetres = Annotated[float, Field(ge=-100, le=100)]


class LensDocument(SourcedDocument):
    """A file of `materials/lenses`."""

    # Chosen: endoscopes have 0.3 mm, telescopes of amateurs a few metres.
    focal_length_mm: Annotated[float, Field(ge=0.1, le=10_000)]
    # 0.5 is the limit of a lens in air, whose cone of light fills a hemisphere; pinholes have some hundreds.
    f_number: Annotated[float, Field(ge=0.5, le=1000)]
    # Chosen: the densest neutral filters, which watch the sun, have 1e-5.
    transmittance: Annotated[float, Field(ge=1e-6, le=1)]
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

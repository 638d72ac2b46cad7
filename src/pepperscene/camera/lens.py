"""The lens: focal length, aperture, transmittance, distortion and vignetting, and its file."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document, read_toml, validate
from pepperscene.spectra.files import Coefficient, SourcedDocument, find_material

_NEWTON_STEPS: Final = 30  # chosen: quadratic convergence needs about 6; the rest is for strong distortion
_TOLERANCE: Final = 1e-12  # chosen: of slopes, 1e-9 of a pixel and far above rounding
_MIN_ANGLE_STEP_RAD: Final = 1e-6  # chosen: no table is finer; a thousandth of what an instrument resolves

# Bounds of lens files.
_FOCAL_LENGTH_MM: Final = (0.1, 10_000.0)
"""Chosen: endoscopes have 0.3 mm, telescopes of amateurs a few metres."""
_F_NUMBER: Final = (0.5, 1000.0)
"""0.5 is the limit of a lens in air, whose cone of light fills a hemisphere; the other end is chosen: pinhole
cameras have some hundreds."""
_LEAST_TRANSMITTANCE: Final = 1e-6  # chosen: the densest neutral filters, which watch the sun, have 1e-5


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
class Distortion:
    """Brown-Conrady distortion, the "plumb bob" model of OpenCV and ROS, on slopes (x/z, y/z).

    With r^2 = x^2 + y^2 and R = 1 + k1 r^2 + k2 r^4 + k3 r^6:
    x' = x R + 2 p1 x y + p2 (r^2 + 2 x^2),  y' = y R + p1 (r^2 + 2 y^2) + 2 p2 x y.

    Method: D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in astuple(self)):
            raise ValueError("distortion coefficients must be finite")

    @property
    def is_zero(self) -> bool:
        """Whether all coefficients are zero."""
        return not any(astuple(self))

    @property
    def fold_radius(self) -> float:
        """The radius (a slope) at which the radial part starts to decrease; inf if it never does.

        Rays from beyond would fold back into the image; none are traced there.
        """
        # d(r R)/dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 with s = r^2 vanishes first at the largest
        # t = 1/s > 0 of t^3 + 3 k1 t^2 + 5 k2 t + 7 k3 = 0, which is well posed for coefficients of zero too.
        roots = np.polynomial.Polynomial([7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0]).roots()
        real = np.real(roots[np.abs(np.imag(roots)) <= 1e-9 * np.abs(roots)])
        turning = real[real > 1e-12]  # ignore turning points beyond a slope of a million
        return float(1 / np.sqrt(turning.max())) if turning.size else math.inf

    def distort(self, slopes: ArrayLike) -> NDArray[np.float64]:
        """Distorted slopes `(..., 2)` of ideal ones `(..., 2)`."""
        ideal = np.asarray(slopes, dtype=float)
        if self.is_zero:
            return ideal.copy()
        x, y = np.moveaxis(ideal, -1, 0)
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        distorted_x = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        distorted_y = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return np.stack([distorted_x, distorted_y], axis=-1)

    def undistort(self, slopes: ArrayLike) -> NDArray[np.float64]:
        """Ideal slopes `(..., 2)` of distorted ones `(..., 2)`; the inverse of `distort`.

        Newton's iteration with the exact Jacobian, on all points at once.

        Raises:
            ValueError: a point has no ideal slope, or is where the distortion folds.
        """
        target = np.asarray(slopes, dtype=float)
        ideal = target.copy()
        if self.is_zero:
            return ideal
        with np.errstate(all="ignore"):  # a diverging point becomes nan or inf and is reported below
            for _ in range(_NEWTON_STEPS):
                dx, dy = np.moveaxis(self.distort(ideal) - target, -1, 0)
                xx, xy, yy = self._jacobian(ideal)
                det = xx * yy - xy * xy
                step = np.stack([(yy * dx - xy * dy) / det, (xx * dy - xy * dx) / det], axis=-1)
                ideal -= step
                if not np.abs(step).max(initial=0.0) > _TOLERANCE * 1e-2:
                    break
            error = np.abs(self.distort(ideal) - target).max(axis=-1)
            unfolded = (self.area_scale(ideal) > 0) & (
                np.hypot(ideal[..., 0], ideal[..., 1]) < self.fold_radius
            )
            valid = (error < _TOLERANCE) & unfolded
        if not np.all(valid):
            x, y = target[~valid][0]
            raise ValueError(f"the distortion cannot be inverted at the image slope ({x:.3f}, {y:.3f})")
        return ideal

    def area_scale(self, slopes: ArrayLike) -> NDArray[np.float64]:
        """Factor `(...)` by which a small area at ideal slopes `(..., 2)` is magnified in the image.

        The determinant of the Jacobian of `distort`: below 1 where barrel distortion contracts the image.
        """
        xx, xy, yy = self._jacobian(np.asarray(slopes, dtype=float))
        return np.asarray(xx * yy - xy * xy)

    def _jacobian(self, slopes: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """The symmetric Jacobian of `distort`: dx'/dx, dx'/dy = dy'/dx, dy'/dy, each `(...)`."""
        x, y = slopes[..., 0], slopes[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        growth = 2 * (self.k1 + r2 * (2 * self.k2 + r2 * 3 * self.k3))
        return (
            radial + growth * x * x + 2 * self.p1 * y + 6 * self.p2 * x,
            growth * x * y + 2 * self.p1 * x + 2 * self.p2 * y,
            radial + growth * y * y + 6 * self.p1 * y + 2 * self.p2 * x,
        )


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
    """

    name: str
    focal_length_m: float
    f_number: float
    transmittance: float = 1.0
    distortion: Distortion = Distortion()
    principal_offset_m: tuple[float, float] = (0.0, 0.0)
    vignetting: AngularProfile | None = None

    def __post_init__(self) -> None:
        is_finite = math.isfinite(self.focal_length_m) and math.isfinite(self.f_number)
        positive = self.focal_length_m > 0 and self.f_number >= 0.5
        if not (is_finite and positive and 0 < self.transmittance <= 1):
            allowed = "focal length must be > 0, f-number >= 0.5 and transmittance in (0, 1]"
            raise ValueError(f"{self.name}: {allowed}")
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
    """The coefficients of `Distortion`."""

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0
    k3: Coefficient = 0.0


SensorMillimetres = Annotated[float, Field(ge=-100, le=100)]


class LensDocument(SourcedDocument):
    """A file of `materials/lenses`."""

    focal_length_mm: Annotated[float, Field(ge=_FOCAL_LENGTH_MM[0], le=_FOCAL_LENGTH_MM[1])]
    f_number: Annotated[float, Field(ge=_F_NUMBER[0], le=_F_NUMBER[1])]
    transmittance: Annotated[float, Field(ge=_LEAST_TRANSMITTANCE, le=1)]
    principal_offset_mm: tuple[SensorMillimetres, SensorMillimetres] = (0.0, 0.0)
    distortion: DistortionTable
    vignetting: VignettingTable | None = None


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
        distortion=Distortion(**document.distortion.model_dump()),
        principal_offset_m=(right * 1e-3, down * 1e-3),
        vignetting=document.vignetting.profile() if document.vignetting else None,
    )

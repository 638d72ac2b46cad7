"""The flash: a matrix of LEDs beside the lens, with a narrow beam and a short pulse."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.camera.lens import AngularProfile
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shipped_folder
from pepperscene.spectra import Spectrum, with_illuminance
from pepperscene.spectra.files import (
    CurveTable,
    Millimetres,
    NotNegative,
    SourcedDocument,
    find_material,
    read_curve,
)

_NODES: Final = 24  # of Gauss' quadrature; chosen: for each smooth piece exact to 1e-9 or better


@dataclass(frozen=True, eq=False)
class Flash:
    """Equal discs in a plane across the optical axis; every point of each has the same angular profile.

    What the whole flash gives straight ahead sets its strength, in lux, or in watts for a lamp whose light
    cannot be seen.

    Attributes:
        name: for reports.
        spectrum: relative spectral power distribution (SPD), `(n,)`.
        at_m: distance of the plane on which the strength is told; it faces the flash.
        profile: intensity of an emitter against the angle to the flash's axis.
        illuminance_lx: on that plane, straight ahead of `offset_m`, from all emitters together; or None.
        irradiance_W_m2: the same in W m-2 over all wavelengths; exactly one of the two is given.
        radius_m: of one emitter; 0 makes it a point.
        emitters_m: `(k, 2)` centres of the emitters from `offset_m`, right and down; read-only.
        offset_m: `(3,)` the flash's centre in camera axes (x right, y down, z forward).
        pulse_s: how long it shines, with constant power; the exposure starts with it.
    """

    name: str
    spectrum: Spectrum
    at_m: float
    profile: AngularProfile
    illuminance_lx: float | None = None
    irradiance_W_m2: float | None = None  # noqa: N815 (the unit is written so)
    radius_m: float = 0.0
    emitters_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, 2)))
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pulse_s: float = 50e-6

    def __post_init__(self) -> None:
        strengths = [s for s in (self.illuminance_lx, self.irradiance_W_m2) if s is not None]
        if len(strengths) != 1:
            raise ValueError(f"{self.name}: exactly one of illuminance_lx and irradiance_W_m2 is needed")
        if not min(*strengths, self.at_m, self.pulse_s) > 0 or not self.radius_m >= 0:
            raise ValueError(f"{self.name}: strength, distance and pulse must be positive, radius at least 0")
        if self.spectrum.values.ndim != 1 or not self.spectrum.values.min() >= 0:
            raise ValueError(f"{self.name}: the spectrum must be one curve, at least 0")
        if self.illuminance_lx is not None and not is_visible(self.spectrum):
            raise ValueError(f"{self.name}: a spectrum without light in 400 to 700 nm has no lux")
        if not self.spectrum.integral() > 0:
            raise ValueError(f"{self.name}: the spectrum must not be 0 throughout")
        emitters = np.array(self.emitters_m, dtype=float)
        if emitters.ndim != 2 or emitters.shape[1] != 2 or not len(emitters):
            raise ValueError(f"{self.name}: emitters must be (k, 2) with k >= 1, not {emitters.shape}")
        if not np.isfinite(emitters).all():
            raise ValueError(f"{self.name}: emitters must be finite")
        emitters.setflags(write=False)
        object.__setattr__(self, "emitters_m", emitters)
        if not self._per_intensity > 0:
            raise ValueError(f"{self.name}: no light of the profile falls straight ahead at {self.at_m:g} m")

    @property
    def axial_area_m2(self) -> float:
        """Axial intensity over the irradiance that the whole flash gives straight ahead at `at_m`.

        An emitting point gives E = I / d^2 on its axis. Beside it by rho, at the angle theta = atan(rho / d),
        E = I p(theta) cos(theta) / (d^2 + rho^2). Each of k discs holds I / k, evenly over its area, so that
        E / I is the mean of p(theta) cos(theta) / (d^2 + rho^2) over all points of all discs.
        """
        return 1.0 / self._per_intensity

    @cached_property
    def _per_intensity(self) -> float:
        """Irradiance straight ahead at `at_m` over the axial intensity, m-2: the mean of all emitters."""
        beside = np.hypot(*self.emitters_m.T)
        if self.radius_m < 1e-9 * self.at_m:  # points, to rounding
            return float(self._per_point(beside).mean())
        # Emitters at the same distance, to a picometre, give the same.
        distances, counts = np.unique(beside.round(12), return_counts=True)
        return float(np.average([self._per_disc(distance) for distance in distances], weights=counts))

    def _per_point(self, beside_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """p(theta) cos(theta) / (d^2 + rho^2) of points at the distance rho from the axis, m-2."""
        distance2 = beside_m**2 + self.at_m**2
        return self.profile.at(np.arctan2(beside_m, self.at_m)) * self.at_m / distance2**1.5

    def _per_disc(self, beside_m: float) -> float:
        """The mean of `_per_point` over the disc whose centre lies at this distance from the axis, m-2.

        Points at the distance rho from the axis fill an arc of the half-angle phi inside the disc, with
        sin^2(phi / 2) = (a^2 - (rho - c)^2) / (4 rho c), so that the mean is an integral over rho alone.
        """
        near, far = abs(beside_m - self.radius_m), beside_m + self.radius_m
        start = 0.0 if beside_m < self.radius_m else near
        # Pieces end where the profile bends and where whole circles become arcs.
        bends = self.at_m * np.tan(self.profile.angle_rad[self.profile.angle_rad < 1.57])
        edges = np.unique(np.clip(np.concatenate([[start, near, far], bends]), start, far))
        # rho = middle - half cos(u) takes the root of arcs out of the ends of a piece.
        node, weight = np.polynomial.legendre.leggauss(_NODES)
        u = (node + 1) * (math.pi / 2)
        middle, half = (edges[1:] + edges[:-1])[:, None] / 2, np.diff(edges)[:, None] / 2
        rho = middle - half * np.cos(u)
        step = half * np.sin(u) * weight * (math.pi / 2)
        if beside_m < 1e-9 * self.radius_m:  # centred, to rounding: whole circles alone
            arc = np.full_like(rho, 2 * math.pi)
        else:
            with np.errstate(divide="ignore"):
                sine2 = (self.radius_m**2 - (rho - beside_m) ** 2) / (4 * rho * beside_m)
            arc = 4 * np.arcsin(np.sqrt(np.clip(sine2, 0.0, 1.0)))
        return float(np.sum(self._per_point(rho) * arc * rho * step)) / (math.pi * self.radius_m**2)

    def irradiance(self) -> Spectrum:
        """W m-2 nm-1 straight ahead at `at_m` during the pulse; its strength is the stated one."""
        if self.illuminance_lx is not None:
            return with_illuminance(self.spectrum, self.illuminance_lx)
        assert self.irradiance_W_m2 is not None  # exactly one is given
        return self.spectrum.times(self.irradiance_W_m2 / float(self.spectrum.integral()))

    def radiant_intensity(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """`(n,)` W sr-1 nm-1 of all emitters together on the axis, during the pulse."""
        return self.irradiance().at(wavelength_nm) * self.axial_area_m2


def square_matrix(columns: int, rows: int, pitch_m: float) -> NDArray[np.float64]:
    """`(rows * columns, 2)` centres of a matrix of emitters around (0, 0), row by row."""
    right = (np.arange(columns) - (columns - 1) / 2) * pitch_m
    down = (np.arange(rows) - (rows - 1) / 2) * pitch_m
    return np.stack(np.meshgrid(right, down), axis=-1).reshape(-1, 2)


def is_visible(spectrum: Spectrum) -> bool:
    """Whether there is light between 400 and 700 nm, so that lux can be told."""
    return bool(spectrum.at(np.arange(400.0, 701.0)).any())


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
    path = find_material("flashes", wanted)
    told = validate(FlashDocument, read_toml(path), path)
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
        raise InputError(path, f"does not fit the other values: {fault}", key="profile") from None


def _spectrum(path: Path, told: FlashDocument) -> Spectrum:
    """The curve of a CSV file beside this one, or of a shipped one ("light/houser2013_cool_white_led")."""
    file, column = told.spectrum.file, told.spectrum.column
    shipped = shipped_folder("materials") / f"{file.removesuffix('.csv')}.csv"
    if not is_file(path.parent / file) and is_file(shipped):
        file = str(shipped)
    found = read_curve(path, "spectrum", file, column)
    if told.illuminance_lx is not None and not is_visible(found):
        allowed = "must hold light in 400 to 700 nm, or the strength be told as irradiance_W_m2"
        raise InputError(path, allowed, key="spectrum.column", value=column)
    if not found.integral() > 0:
        raise InputError(path, "must hold some light", key="spectrum.column", value=column)
    return found

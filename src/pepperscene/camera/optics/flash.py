"""The flash: a matrix of LEDs beside the lens with a narrow beam and a short pulse, and its file."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.camera.lamps.lamp import check_spectrum, rotation_matrix
from pepperscene.camera.optics.lens import AngularProfile, ProfileTable
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, scale_to_illuminance
from pepperscene.spectra.files import LEAST_PEAK, CurveTable, SourcedDocument, find_material, read_light

_NODES: Final = 24  # of Gauss' quadrature; chosen: for each smooth piece exact to 1e-9 or better

_LEAST_LIGHT_AHEAD: Final = 1e-6
"""Of what a point with the axial intensity gives at the reference point. Chosen: the strength of a lamp that
hardly shines straight ahead says nothing about its other directions."""

_STRONGEST_W_SR: Final = 1e6
"""Axial intensity; chosen: ten thousand times the shipped LED matrix, and near the strongest searchlights.
A hundred times as much would overflow single precision in the renderer."""
_FLASH_SIZE_MM: Final = 1e4  # radius, pitch and offset; chosen: a lamp as wide as a greenhouse's bays


@dataclass(frozen=True, eq=False)
class Flash:
    """Equal discs in a plane across the optical axis; every point of each has the same angular profile.

    The strength is that of all emitters together, straight ahead of `offset_m` on a plane at `at_m` that
    faces the flash: in lux, or in W m-2 for a lamp without visible light.

    Attributes:
        spectrum: relative spectral power distribution (SPD), `(n,)`.
        at_m: distance at which the strength is given.
        profile: intensity of an emitter against the angle to the flash's axis.
        illuminance_lx: strength in lux, or None.
        irradiance_W_m2: strength in W m-2 over all wavelengths, or None; exactly one of the two is given.
        radius_m: radius of one emitter; 0 makes it a point.
        emitters_m: `(k, 2)` centres of the emitters from `offset_m`, right and down; read-only.
        offset_m: `(3,)` the flash's centre in camera axes (x right, y down, z forward).
        pulse_s: duration of constant power; `Shutter.pulse_begin` defines when it starts.
        rotation: `(3, 3)` from the flash's axes to the camera's, for a camera of a rig whose flash belongs to
            another one; None if they are the same. Read-only.
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
    rotation: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        strengths = [s for s in (self.illuminance_lx, self.irradiance_W_m2) if s is not None]
        emitters = np.array(self.emitters_m, dtype=float)
        if len(strengths) != 1:
            raise ValueError(f"{self.name}: exactly one of illuminance_lx and irradiance_W_m2 is needed")
        if not min(*strengths, self.at_m, self.pulse_s) > 0 or not self.radius_m >= 0:
            raise ValueError(f"{self.name}: strength, distance and pulse must be positive, radius at least 0")
        check_spectrum(self.spectrum, self.name)
        if self.illuminance_lx is not None and not _is_visible(self.spectrum):
            raise ValueError(f"{self.name}: a spectrum without light in 400 to 700 nm has no lux")
        if emitters.ndim != 2 or emitters.shape[1] != 2 or not len(emitters):
            raise ValueError(f"{self.name}: emitters must be (k, 2) with k >= 1, not {emitters.shape}")
        if not np.isfinite(emitters).all():
            raise ValueError(f"{self.name}: emitters must be finite")
        emitters.setflags(write=False)
        object.__setattr__(self, "emitters_m", emitters)
        if self.rotation is not None:
            object.__setattr__(self, "rotation", rotation_matrix(self.rotation, self.name))
        if not self._irradiance_per_intensity * self.at_m**2 > _LEAST_LIGHT_AHEAD:
            raise ValueError(f"{self.name}: no light of the profile falls straight ahead at {self.at_m:g} m")

    @property
    def axial_area_m2(self) -> float:
        """Axial intensity over the irradiance of the whole flash straight ahead at `at_m`.

        On its axis, a point of intensity I gives E = I / d^2. At the distance rho from the axis, at the angle
        theta = atan(rho / d), E = I p(theta) cos(theta) / (d^2 + rho^2). Each of k discs emits I / k, evenly
        over its area, so E / I is the mean of p(theta) cos(theta) / (d^2 + rho^2) over all discs.
        """
        return 1.0 / self._irradiance_per_intensity

    @cached_property
    def _irradiance_per_intensity(self) -> float:
        """Irradiance straight ahead at `at_m` over the axial intensity, m-2: the mean over all emitters."""
        rho = np.hypot(*self.emitters_m.T)
        if self.radius_m < 1e-9 * self.at_m:  # points, to rounding
            return float(self._points_irradiance(rho).mean())
        # Emitters at the same distance, to a picometre, contribute the same.
        distances, counts = np.unique(rho.round(12), return_counts=True)
        return float(np.average([self._disc_irradiance(distance) for distance in distances], weights=counts))

    def _points_irradiance(self, rho: NDArray[np.float64]) -> NDArray[np.float64]:
        """p(theta) cos(theta) / (d^2 + rho^2) of points at the distance rho from the axis, m-2."""
        distance2 = rho**2 + self.at_m**2
        return self.profile.at(np.arctan2(rho, self.at_m)) * self.at_m / distance2**1.5

    def _disc_irradiance(self, centre: float) -> float:
        """The mean of `_points_irradiance` over the disc whose centre is at this distance from the axis, m-2.

        Points at the distance rho from the axis fill an arc of the half-angle phi inside the disc, with
        sin^2(phi / 2) = (a^2 - (rho - c)^2) / (4 rho c), so the mean is an integral over rho alone.
        """
        near, far = abs(centre - self.radius_m), centre + self.radius_m
        start = 0.0 if centre < self.radius_m else near
        # Integrate piecewise: pieces end at the profile's nodes and where full circles become arcs.
        nodes = self.at_m * np.tan(self.profile.angle_rad[self.profile.angle_rad < 1.57])
        edges = np.unique(np.clip(np.concatenate([[start, near, far], nodes]), start, far))
        # rho = middle - half cos(u) removes the square root of the arcs at the ends of a piece.
        node, weight = np.polynomial.legendre.leggauss(_NODES)
        u = (node + 1) * (math.pi / 2)
        middle, half = (edges[1:] + edges[:-1])[:, None] / 2, np.diff(edges)[:, None] / 2
        rho = middle - half * np.cos(u)
        step = half * np.sin(u) * weight * (math.pi / 2)
        if centre < 1e-9 * self.radius_m:  # centred, to rounding: full circles only
            arc = np.full_like(rho, 2 * math.pi)
        else:
            with np.errstate(divide="ignore"):
                sine2 = (self.radius_m**2 - (rho - centre) ** 2) / (4 * rho * centre)
            arc = 4 * np.arcsin(np.sqrt(np.clip(sine2, 0.0, 1.0)))
        return float(np.sum(self._points_irradiance(rho) * arc * rho * step)) / (math.pi * self.radius_m**2)

    def emitter_positions(self) -> NDArray[np.float64]:
        """`(k, 3)` centres of the emitters in camera axes, metres."""
        centres = np.pad(self.emitters_m, ((0, 0), (0, 1)))
        return np.asarray(self.offset_m) + (centres if self.rotation is None else centres @ self.rotation.T)

    def irradiance(self) -> Spectrum:
        """W m-2 nm-1 straight ahead at `at_m` during the pulse."""
        if self.illuminance_lx is not None:
            return scale_to_illuminance(self.spectrum, self.illuminance_lx)
        assert self.irradiance_W_m2 is not None  # exactly one is given
        return self.spectrum.times(self.irradiance_W_m2 / float(self.spectrum.integral()))

    def radiant_intensity(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """`(n,)` W sr-1 nm-1 of all emitters together on the axis, during the pulse."""
        return self.irradiance().at(wavelength_nm) * self.axial_area_m2


def _is_visible(spectrum: Spectrum) -> bool:
    """Whether there is light between 400 and 700 nm, so that lux can be given."""
    return bool(spectrum.at(np.arange(400.0, 701.0)).any())


Strength = Annotated[float, Field(ge=1e-6, le=1e9)]
"""Lux or W m-2. Chosen: a moonless night sky gives 1e-4 lx, the sun 1e5, and LEDs at 1 mm 1e8."""
FlashMillimetres = Annotated[float, Field(ge=-_FLASH_SIZE_MM, le=_FLASH_SIZE_MM)]


class BeamTable(ProfileTable):
    """Relative intensity against the angle to the flash's axis."""

    # Chosen: LEDs that shine sideways ("batwing") have 1.5 to 5.
    relative_intensity: tuple[Annotated[float, Field(ge=0, le=100)], ...]

    def profile(self) -> AngularProfile:
        """The beam; it ends at the last angle."""
        return AngularProfile(np.deg2rad(self.angle_deg), np.array(self.relative_intensity))


class MatrixTable(Document):
    """Emitters in rows and columns around the flash's centre."""

    columns: Annotated[int, Field(ge=1, le=100)]
    rows: Annotated[int, Field(ge=1, le=100)]
    # Chosen: the finest displays have emitters of a few micrometres.
    pitch_mm: Annotated[float, Field(ge=1e-3, le=_FLASH_SIZE_MM)]

    def centres_m(self) -> NDArray[np.float64]:
        """`(rows * columns, 2)` emitter centres, right and down, row by row."""
        pitch = self.pitch_mm * 1e-3
        right = (np.arange(self.columns) - (self.columns - 1) / 2) * pitch
        down = (np.arange(self.rows) - (self.rows - 1) / 2) * pitch
        return np.stack(np.meshgrid(right, down), axis=-1).reshape(-1, 2)


class FlashDocument(SourcedDocument):
    """A file of `materials/flashes`."""

    illuminance_lx: Strength | None = None
    irradiance_W_m2: Strength | None = None  # noqa: N815 (the unit is written so)
    at_mm: Annotated[float, Field(ge=1.0, le=1e5)]  # chosen: photometers measure lamps within 100 m
    # Chosen: nanoseconds (electric sparks) to a quarter of an hour (lamps that stay on).
    pulse_us: Annotated[float, Field(ge=1e-3, le=1e9)]
    radius_mm: Annotated[float, Field(ge=0, le=_FLASH_SIZE_MM)]
    offset_mm: tuple[FlashMillimetres, FlashMillimetres, FlashMillimetres]
    matrix: MatrixTable | None = None
    spectrum: CurveTable
    profile: BeamTable

    @model_validator(mode="after")
    def _check_consistency(self) -> FlashDocument:
        if (self.illuminance_lx is None) == (self.irradiance_W_m2 is None):
            raise ValueError("exactly one of illuminance_lx and irradiance_W_m2 must be given")
        matrix = self.matrix
        several = matrix is not None and max(matrix.columns, matrix.rows) > 1
        if matrix and several and self.radius_mm > matrix.pitch_mm / 2 * (1 + 1e-9):
            raise ValueError("radius_mm must be at most half of matrix.pitch_mm, or emitters overlap")
        return self


def load_flash(name_or_path: str | Path) -> Flash:
    """Load a flash from its file, or a shipped one by its name.

    Raises:
        InputError: the file or its spectrum is missing or invalid; the message names file, key and value.
    """
    path = find_material("flashes", name_or_path)
    document = validate(FlashDocument, read_toml(path), path)
    right, down, forward = (length * 1e-3 for length in document.offset_mm)
    try:
        flash = Flash(
            name=document.name,
            spectrum=_read_spectrum(path, document),
            at_m=document.at_mm * 1e-3,
            profile=document.profile.profile(),
            illuminance_lx=document.illuminance_lx,
            irradiance_W_m2=document.irradiance_W_m2,
            radius_m=document.radius_mm * 1e-3,
            emitters_m=document.matrix.centres_m() if document.matrix else np.zeros((1, 2)),
            offset_m=(right, down, forward),
            pulse_s=document.pulse_us * 1e-6,
        )
    except ValueError as error:
        # The only remaining error: the beam is so narrow that no emitter lights the reference point.
        raise InputError(path, f"does not fit the other values: {error}", key="profile") from None
    _check_intensity(path, document, flash)
    return flash


def _check_intensity(path: Path, document: FlashDocument, flash: Flash) -> None:
    """Raise `InputError` if the strength at this distance means a lamp that cannot exist."""
    intensity = float(flash.irradiance().integral()) * flash.axial_area_m2
    if not intensity <= _STRONGEST_W_SR:
        key = "illuminance_lx" if document.illuminance_lx is not None else "irradiance_W_m2"
        problem = (
            f"at at_mm = {document.at_mm:g} is an intensity of {intensity:.3g} W/sr on the axis, "
            f"and at most {_STRONGEST_W_SR:g} W/sr are allowed"
        )
        raise InputError(path, problem, key=key, value=getattr(document, key))


def _read_spectrum(path: Path, document: FlashDocument) -> Spectrum:
    """The curve of a CSV file in the same folder, or of a shipped one ("light/houser2013_cool_white_led")."""
    column = document.spectrum.column
    spectrum = read_light(path, document.spectrum)
    if document.illuminance_lx is not None and not _is_visible(spectrum):
        allowed = "must contain light in 400 to 700 nm, or give the strength as irradiance_W_m2"
        raise InputError(path, allowed, key="spectrum.column", value=column)
    if not spectrum.values.max() >= LEAST_PEAK:
        raise InputError(path, "must contain some light", key="spectrum.column", value=column)
    # Light is traced on a grid of half nanometres: a line between whole ones could be missed.
    first, last = spectrum.range_nm
    if not spectrum.at(np.arange(math.ceil(first), last + 0.5)).max(initial=0.0) >= LEAST_PEAK:
        allowed = "must contain light at a whole number of nanometres"
        raise InputError(path, allowed, key="spectrum.column", value=column)
    return spectrum

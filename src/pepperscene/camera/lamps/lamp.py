"""Lamps in the scene or at the camera: a shape that emits evenly, its beam, spectrum and strength."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.lamps.beam import Beam
from pepperscene.spectra import Spectrum, illuminance
from pepperscene.spectra.lights import umol_per_joule
from pepperscene.spectra.wavebands import PAR

Array = NDArray[np.float64]

_POINTS: Final = 4096
"""Of a shape, for integrals over it. Chosen: those of closed forms are then within 1e-4."""
_LEAST_AHEAD: Final = 1e-9
"""Irradiance straight ahead over the flux and the squared distance. Chosen: below, lux defines no flux."""

STRONGEST_W: Final = 1e6
"""Of light of a lamp. Chosen: two thousand times the strongest lights of greenhouses."""


@dataclass(frozen=True)
class EmitterShape:
    """A matrix of equal elements across the lamp's axis, each of which emits evenly.

    Attributes:
        columns, rows: numbers of elements along the lamp's x and y axes.
        pitch_m: from one element to the next, in each direction.
        size_m: of an element: width and height, 0 for a line or a point; or inner and outer radius.
        is_round: whether the elements are discs or rings.
    """

    columns: int = 1
    rows: int = 1
    pitch_m: tuple[float, float] = (0.0, 0.0)
    size_m: tuple[float, float] = (0.0, 0.0)
    is_round: bool = False

    @property
    def extent_m(self) -> float:
        """Distance of the furthest emitting point from the centre."""
        halves = [0.5 * (n - 1) * pitch for n, pitch in zip(self._counts, self.pitch_m, strict=True)]
        if self.is_round:
            return math.hypot(*halves) + self.size_m[1]
        return math.hypot(*(half + 0.5 * size for half, size in zip(halves, self.size_m, strict=True)))

    @property
    def _counts(self) -> tuple[int, int]:
        return self.columns, self.rows

    def points_m(self, samples: ArrayLike) -> Array:
        """`(k, 3)` points in the lamp's axes, evenly spread as `samples` `(k, 2)` are in the unit square."""
        scaled = np.asarray(samples, float) * self._counts
        cell = np.minimum(np.floor(scaled), np.array(self._counts) - 1)
        centre = (cell - 0.5 * (np.array(self._counts) - 1)) * self.pitch_m
        u, v = (scaled - cell).T
        if self.is_round:
            inner, outer = self.size_m
            radius, turn = np.sqrt(inner**2 + u * (outer**2 - inner**2)), 2 * math.pi * v
            offset = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=-1)
        else:
            offset = np.stack([u - 0.5, v - 0.5], axis=-1) * self.size_m
        return np.pad(centre + offset, ((0, 0), (0, 1)))

    def spread_points_m(self) -> Array:
        """`(k, 3)` points at the middles of equal parts of the shape."""
        if self == EmitterShape():
            return np.zeros((1, 3))
        counts = [max(n, 1) for n in self._part_counts()]
        u, v = ((np.arange(n) + 0.5) / n for n in counts)
        return self.points_m(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))

    def _part_counts(self) -> tuple[int, int]:
        """Parts in each direction, a whole number for each element."""
        if not self.is_round and self.size_m[1] == 0 and self.rows == 1:
            return _POINTS // self.columns * self.columns or self.columns, 1
        each = max(int(math.sqrt(_POINTS / (self.columns * self.rows))), 2)
        return each * self.columns, each * self.rows


POINT: Final = EmitterShape()


def ring(outer_m: float, inner_m: float = 0.0) -> EmitterShape:
    """A ring, or a disc with an inner radius of 0."""
    return EmitterShape(size_m=(inner_m, outer_m), is_round=True)


@dataclass(frozen=True, eq=False)
class Lamp:
    """A lamp; its surface is no object of the scene, so that it is not seen and casts no shadow.

    Attributes:
        name: of the lamp.
        spectrum: relative spectral power distribution, `(n,)`.
        flux_W: radiant flux over all wavelengths, during the pulse if there is one.
        beam: of every point of the shape, in the lamp's axes.
        shape: where the lamp emits.
        position_m: `(3,)` the centre of the shape.
        rotation: `(3, 3)` from the lamp's axes, whose z is the beam's, to those of the world or, for a lamp
            of a camera, to the camera's (x right, y down, z forwards); read-only.
        pulse_s: duration of its light in each exposure; None for a lamp that shines all the time.

    Raises:
        ValueError: a value is not finite or out of range.
    """

    name: str
    spectrum: Spectrum
    flux_W: float  # noqa: N815 (the unit is written so)
    beam: Beam
    shape: EmitterShape = POINT
    position_m: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    pulse_s: float | None = None

    def __post_init__(self) -> None:
        position = np.array(self.position_m, float)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise ValueError(f"{self.name}: the position must be three finite numbers")
        rotation = rotation_matrix(self.rotation, self.name)
        if not 0 < self.flux_W <= STRONGEST_W:
            raise ValueError(f"{self.name}: must emit more than 0 and at most {STRONGEST_W:g} W of light")
        if not (self.pulse_s is None or 0 < self.pulse_s < math.inf):
            raise ValueError(f"{self.name}: the pulse must be positive and finite")
        check_spectrum(self.spectrum, self.name)
        position.setflags(write=False)
        object.__setattr__(self, "position_m", position)
        object.__setattr__(self, "rotation", rotation)

    @property
    def unit_spectrum(self) -> Spectrum:
        """The spectrum of 1 W, nm-1."""
        return self.spectrum.times(1.0 / float(self.spectrum.integral()))

    def duty(self, exposure_s: float) -> float:
        """Fraction of an exposure during which the lamp shines."""
        return 1.0 if self.pulse_s is None else min(self.pulse_s, exposure_s) / exposure_s

    def with_strength(
        self,
        *,
        flux_lm: float | None = None,
        ppf_umol_s: float | None = None,
        illuminance_lx: float | None = None,
        at_m: float = 1.0,
    ) -> Lamp:
        """The same lamp with another strength, of which exactly one is given.

        Args:
            flux_lm: luminous flux, lumens.
            ppf_umol_s: photosynthetic photon flux in 400 to 700 nm, umol s-1.
            illuminance_lx: on a plane that faces the lamp straight ahead, at `at_m`.
            at_m: distance of that plane.

        Raises:
            ValueError: not exactly one is given, or the lamp has no such light.
        """
        given = [value for value in (flux_lm, ppf_umol_s, illuminance_lx) if value is not None]
        if len(given) != 1:
            raise ValueError(f"{self.name}: exactly one strength is needed, not {len(given)}")
        per_watt = self._photons_per_watt()
        if ppf_umol_s is None and per_watt > 0:  # infrared light has a trace of lumens, which define no flux
            per_watt = illuminance(self.unit_spectrum)
        if illuminance_lx is not None:
            ahead = replace(self, position_m=np.zeros(3), rotation=np.eye(3))
            factor = float(ahead.irradiance_factor([[0.0, 0.0, at_m]], [[0.0, 0.0, -1.0]])[0])
            per_watt *= factor if factor * at_m**2 > _LEAST_AHEAD else 0.0
        if not per_watt > 0:
            raise ValueError(f"{self.name}: has no light of this kind, so this strength defines no flux")
        return replace(self, flux_W=given[0] / per_watt)

    @property
    def flux_lm(self) -> float:
        """Luminous flux, lumens."""
        return self.flux_W * illuminance(self.unit_spectrum)

    @property
    def ppf_umol_s(self) -> float:
        """Photosynthetic photon flux in 400 to 700 nm, umol s-1."""
        return self.flux_W * self._photons_per_watt()

    def _photons_per_watt(self) -> float:
        """Of light in 400 to 700 nm, umol s-1 per watt of all light."""
        nm = np.union1d(np.arange(PAR.first_nm, PAR.last_nm + 0.25, 0.25), self.spectrum.wavelength_nm)
        nm = nm[(nm >= PAR.first_nm) & (nm <= PAR.last_nm)]
        return float(np.trapezoid(self.unit_spectrum.at(nm) * umol_per_joule(nm), nm))

    def irradiance_factor(self, points_m: ArrayLike, normals: ArrayLike) -> Array:
        """`(n,)` irradiance of planes over the radiant flux, m-2, without any shadow.

        The mean over the shape of the beam times the cosine to the plane's normal, over squared distances.

        Args:
            points_m: `(n, 3)` in the axes of `rotation`.
            normals: `(n, 3)` unit vectors towards the lit side.
        """
        sources = self.position_m + self.shape.spread_points_m() @ self.rotation.T
        factors = np.empty(len(np.asarray(points_m)))
        for k, (point, normal) in enumerate(zip(np.asarray(points_m), np.asarray(normals), strict=True)):
            ray = point - sources
            square = np.maximum((ray**2).sum(axis=-1), 1e-18)
            direction = ray / np.sqrt(square)[:, None]
            received = np.maximum(-(direction @ normal), 0.0)
            factors[k] = np.mean(self.beam.at(direction @ self.rotation) * received / square)
        return factors

    def moved(self, rotation: ArrayLike, translation_m: ArrayLike) -> Lamp:
        """The lamp after a rotation `(3, 3)` and a translation `(3,)`."""
        turn = np.asarray(rotation, float)
        position = turn @ self.position_m + np.asarray(translation_m, float)
        return replace(self, position_m=position, rotation=turn @ self.rotation)

    def to_metadata(self) -> dict[str, Any]:
        """JSON-ready description."""
        described: dict[str, Any] = {
            "name": self.name,
            "position_m": self.position_m.tolist(),
            "axis": self.rotation[:, 2].tolist(),
            "flux_W": float(self.flux_W),
            "flux_lm": self.flux_lm,
            "ppf_umol_s": self.ppf_umol_s,
        }
        return described if self.pulse_s is None else {**described, "pulse_s": float(self.pulse_s)}


def rotation_matrix(values: ArrayLike, name: str) -> Array:
    """A read-only copy; raises ValueError, which names the device, unless it is a rotation `(3, 3)`."""
    rotation = np.array(values, float)
    is_orthogonal = rotation.shape == (3, 3) and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    if not is_orthogonal or np.linalg.det(rotation) < 0:
        raise ValueError(f"{name}: rotation must be a (3, 3) rotation, without reflection")
    rotation.setflags(write=False)
    return rotation


def check_spectrum(spectrum: Spectrum, name: str) -> None:
    """Raise ValueError, which names the device, unless a spectrum is one curve of light."""
    if spectrum.values.ndim != 1 or not spectrum.values.min() >= 0:
        raise ValueError(f"{name}: the spectrum must be one curve, at least 0")
    if not spectrum.integral() > 0:
        raise ValueError(f"{name}: the spectrum must not be 0 throughout")


def lamp_spectrum(lamps: Iterable[Lamp], exposure_s: float) -> Spectrum | None:
    """Relative spectrum of the light of some lamps together, by their flux; None without lamps.

    Lamps that flash count by the part of an exposure in which they shine.
    """
    parts = [(lamp.unit_spectrum, lamp.flux_W * lamp.duty(exposure_s)) for lamp in lamps]
    if not parts:
        return None
    nm = np.unique(np.concatenate([spectrum.wavelength_nm for spectrum, _ in parts]))
    return Spectrum(nm, np.sum([power * spectrum.at(nm) for spectrum, power in parts], axis=0))


def lamps_seen_from(lamps: Iterable[Lamp], extrinsics: ArrayLike) -> tuple[Lamp, ...]:
    """The lamps of a camera in the axes of another one; `extrinsics` `(4, 4)` lead from those to its own."""
    inverse = np.linalg.inv(np.asarray(extrinsics, float))
    return tuple(lamp.moved(inverse[:3, :3], inverse[:3, 3]) for lamp in lamps)


def aimed_axes(axis: ArrayLike, turn_rad: float = 0.0) -> Array:
    """`(3, 3)` axes of a lamp in columns: z along `axis`, x as near to that of the surroundings as possible.

    x and y are turned by `turn_rad` about z. A lamp along the x axis of the surroundings has its own x along
    their y.

    Raises:
        ValueError: the axis has no length.
    """
    z = np.asarray(axis, float)
    length = float(np.linalg.norm(z))
    if not 0 < length < math.inf:
        raise ValueError("a lamp must aim at a point that is not its own place")
    z = z / length
    reference = np.eye(3)[1 if abs(z[0]) > 1.0 - 1e-9 else 0]
    x = reference - (reference @ z) * z
    x /= np.linalg.norm(x)
    x = math.cos(turn_rad) * x + math.sin(turn_rad) * np.cross(z, x)
    return np.stack([x, np.cross(z, x), z], axis=1)

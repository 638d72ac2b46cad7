"""A projector of dots, as in active stereo cameras: its pattern, its light, and its file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.camera.optics.flash import Flash, FlashMillimetres
from pepperscene.camera.optics.lens import AngularProfile
from pepperscene.document import read_toml, validate
from pepperscene.spectra import Spectrum
from pepperscene.spectra.files import SourcedDocument, find_material

_PATTERN: Final = 20_180_117
"""Seed of every pattern, which is that of a device and not of a frame. Chosen: any number does."""
_FWHM: Final = math.sqrt(8.0 * math.log(2.0))  # full width at half maximum over the standard deviation
_FLOOD_ANGLES: Final = 64  # chosen: linear between them, the intensity is within 1e-3
_LONGEST_EXPOSURE_S: Final = 1.0  # as of recipes; the projector shines during all of it
_SPECTRUM_STEP_NM: Final = 0.25  # chosen: half of the grid on which light is traced
_LARGEST_FIELD_DEG: Final = 140.0  # chosen: slopes of the dots' directions stay below 3


@dataclass(frozen=True, eq=False)
class Projector:
    """A point that sends out equal dots of light in fixed directions, each with a Gaussian profile.

    The field of projection is divided into cells of equal size in the slopes x/z and y/z. Each cell has one
    dot, at a random place that is the same for all projectors of this shape. So dots are nowhere dense, and
    no part of the pattern repeats along a row.

    Attributes:
        name: of the device.
        power_W: of the light that leaves it, in all dots together.
        dots: number of dots; the pattern has the nearest number that fills whole rows and columns.
        width_rad, height_rad: angles of the field of projection.
        dot_rad: full width of a dot at half of its maximum.
        wavelength_nm: centre of the emission.
        bandwidth_nm: full width of the emission at half of its maximum.
        offset_m: `(3,)` the projector's place in the axes of the left imager: right, down, forward.
    """

    name: str
    power_W: float  # noqa: N815 (the unit is written so)
    dots: int
    width_rad: float
    height_rad: float
    dot_rad: float
    wavelength_nm: float = 850.0
    bandwidth_nm: float = 2.0
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        positive = (self.power_W, self.dot_rad, self.bandwidth_nm, self.width_rad, self.height_rad)
        # Written so that nan fails too.
        if not (min(positive) > 0 and max(self.width_rad, self.height_rad) < math.pi and self.dots >= 1):
            raise ValueError(f"{self.name}: power, angles and dots must be positive, angles below pi")

    @property
    def half_slopes(self) -> tuple[float, float]:
        """Largest slopes x/z and y/z of the field of projection."""
        return math.tan(self.width_rad / 2.0), math.tan(self.height_rad / 2.0)

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of the cells, which are as square as whole numbers allow."""
        right, down = self.half_slopes
        columns = max(round(math.sqrt(self.dots * right / down)), 1)
        return max(round(self.dots / columns), 1), columns

    def directions(self) -> NDArray[np.float64]:
        """`(rows, columns, 3)` unit directions of the dots in camera axes, by cell."""
        rows, columns = self.grid
        right, down = self.half_slopes
        place = np.random.default_rng(_PATTERN).random((rows, columns, 2))
        row, column = np.mgrid[:rows, :columns]
        x = ((column + place[..., 0]) / columns * 2.0 - 1.0) * right
        y = ((row + place[..., 1]) / rows * 2.0 - 1.0) * down
        directions = np.stack([x, y, np.ones_like(x)], axis=-1)
        return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))

    @property
    def dot_deviation_rad(self) -> float:
        """Standard deviation of a dot's profile."""
        return self.dot_rad / _FWHM

    @property
    def dot_intensity(self) -> float:
        """W sr-1 in the middle of a dot: its power over 2 pi times the variance of its profile."""
        rows, columns = self.grid
        return self.power_W / (rows * columns) / (2.0 * math.pi * self.dot_deviation_rad**2)

    @property
    def spectrum(self) -> Spectrum:
        """Relative spectral power distribution, nm-1, with the integral 1: a Gaussian."""
        deviation = self.bandwidth_nm / _FWHM
        steps = math.ceil(5.0 * deviation / _SPECTRUM_STEP_NM)
        offset = np.asarray(_SPECTRUM_STEP_NM * np.arange(-steps, steps + 1), np.float64)
        values = np.exp(-0.5 * (offset / deviation) ** 2)
        return Spectrum(self.wavelength_nm + offset, values / (values.sum() * _SPECTRUM_STEP_NM))

    def spectral_power(self, grid_nm: ArrayLike) -> NDArray[np.float64]:
        """`(n,)` nm-1 on a wavelength grid of equal steps, with the integral 1.

        Lines narrower than the steps keep their power.
        """
        grid = np.asarray(grid_nm, dtype=float)
        step, spectrum = float(grid[1] - grid[0]), self.spectrum
        weights, _ = np.histogram(
            spectrum.wavelength_nm,
            np.append(grid - step / 2.0, grid[-1] + step / 2.0),
            weights=spectrum.values,
        )
        return np.asarray(weights * (_SPECTRUM_STEP_NM / step))

    def flood(self) -> Flash:
        """A flash of the same power, spectrum and place, without dots, for light that is scattered again.

        Dots are equally dense in the slopes of their directions, so their mean intensity is proportional to
        1 / cos^3 of the angle to the axis. So is that of the flash, inside a circle with the area of the
        field of projection.
        """
        right, down = self.half_slopes
        area = 4.0 * right * down
        edge = math.atan(math.sqrt(area / math.pi))
        angle = np.linspace(0.0, edge, _FLOOD_ANGLES)
        return Flash(
            name=f"{self.name} without dots",
            spectrum=self.spectrum,
            at_m=1.0,
            profile=AngularProfile(angle, np.cos(angle) ** -3.0),
            irradiance_W_m2=self.power_W / area,
            offset_m=self.offset_m,
            pulse_s=_LONGEST_EXPOSURE_S,
        )


class ProjectorDocument(SourcedDocument):
    """A file of `materials/projectors`."""

    kind: Literal["measured", "standard", "MODEL"] = "MODEL"
    power_mW: Annotated[float, Field(ge=1e-3, le=1e5)]  # noqa: N815 (the unit is written so)
    dots: Annotated[int, Field(ge=1, le=1_000_000)]
    width_deg: Annotated[float, Field(ge=1, le=_LARGEST_FIELD_DEG)]
    height_deg: Annotated[float, Field(ge=1, le=_LARGEST_FIELD_DEG)]
    dot_mrad: Annotated[float, Field(ge=0.01, le=100)]
    wavelength_nm: Annotated[float, Field(ge=300, le=2500)]
    bandwidth_nm: Annotated[float, Field(ge=0.5, le=200)]
    offset_mm: tuple[FlashMillimetres, FlashMillimetres, FlashMillimetres]

    @model_validator(mode="after")
    def _check_dots(self) -> ProjectorDocument:
        # Light of a dot is looked up in its own cell and in the eight around it.
        rows, columns = (projector := self.projector()).grid
        right, down = projector.half_slopes
        # A slope near the border of the field covers a smaller angle than in its middle.
        cosine2 = 1.0 / (1.0 + right**2 + down**2)
        if 3.0 * projector.dot_deviation_rad > cosine2 * min(2.0 * right / columns, 2.0 * down / rows):
            raise ValueError(f"dot_mrad = {self.dot_mrad:g} is too wide for {self.dots} dots in this field")
        return self

    def projector(self) -> Projector:
        """The projector in SI units."""
        right, down, forward = (length * 1e-3 for length in self.offset_mm)
        return Projector(
            name=self.name,
            power_W=self.power_mW * 1e-3,
            dots=self.dots,
            width_rad=math.radians(self.width_deg),
            height_rad=math.radians(self.height_deg),
            dot_rad=self.dot_mrad * 1e-3,
            wavelength_nm=self.wavelength_nm,
            bandwidth_nm=self.bandwidth_nm,
            offset_m=(right, down, forward),
        )


def load_projector(name_or_path: str | Path) -> Projector:
    """Load a projector from its file, or a shipped one by its name.

    Raises:
        InputError: the file is missing or invalid; the message names file, key and value.
    """
    path = find_material("projectors", name_or_path)
    return validate(ProjectorDocument, read_toml(path), path).projector()

"""The greenhouse's cover: how much light it transmits, and how its haze scatters that light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pepperscene.camera.sensor.sensor_files import read_fraction
from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, illuminance, photopic_efficiency
from pepperscene.spectra.files import CurveTable, SourcedDocument, find_material

_CONVERGED: Final = 1e-12  # chosen: rounding of doubles, well below that of the float32 sky
_MAX_ITERATIONS: Final = 1000  # chosen: ten times the iterations of the narrowest lobe

_MIN_VISIBLE: Final = 1e-6  # luminous transmittance; chosen: a hundredth of a blackout screen's
_MIN_VISIBLE_SHARE: Final = 0.1
"""Luminous transmittance over the greatest at any wavelength. Chosen: the light below a darker cover is
infrared, and its illuminance would mean more of that than the renderer's numbers can hold."""

NARROWEST_HAZE_DEG: Final = 2.0
"""ASTM D1003 counts light scattered by more than 2.5 degrees as haze; a narrower lobe is not haze."""

WIDEST_HAZE_DEG: Final = 90.0


def directions(rows: int, columns: int) -> NDArray[np.float64]:
    """`(rows, columns, 3)` unit directions through the texel centres of a map of the whole sphere."""
    polar = (np.arange(rows) + 0.5) / rows * np.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2.0 * np.pi
    horizontal = np.sin(polar)[:, None]
    vertical = np.broadcast_to(np.cos(polar)[:, None], (rows, columns))
    return np.stack([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), vertical], axis=-1)


def row_geometry(rows: int, columns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean cosine to the zenith and solid angle of a texel, by row; both exact for the row's band."""
    edges = np.arange(rows + 1) / rows * np.pi
    top, bottom = np.cos(edges[:-1]), np.cos(edges[1:])
    return (top + bottom) / 2.0, (top - bottom) * 2.0 * np.pi / columns


@dataclass(frozen=True, eq=False)
class Haze:
    """Scattering by a level, hazy sheet, tabulated for maps of the sphere.

    Light from one direction of the upper hemisphere leaves as radiance over the whole hemisphere,

        f(out, in) = a(out) a(in) exp((cos angle(out, in) - 1) / width^2)

    per unit of irradiance on the sheet. The exponential is the normal distribution on a sphere (von Mises and
    Fisher). The factors `a` depend on elevation only; with them the integral of f(out, in) cos(out) over the
    upper hemisphere is 1 for every `in`. So no light is lost, and because f is symmetric (Helmholtz
    reciprocity), a uniform sky stays uniform.

    Attributes:
        width_rad: width of the lobe.
        columns: columns of the maps.
        series: `(out rows, in rows, m)` real, the exponential as a Fourier series in the azimuth difference.
        balance: `(out rows,)` the factors `a`; rows below the horizon continue them and receive no light.
        projected: `(in rows,)` projected solid angle of a texel.
    """

    width_rad: float
    columns: int
    series: NDArray[np.float64]
    balance: NDArray[np.float64]
    projected: NDArray[np.float64]

    def scatter(self, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance below the sheet for radiance above it, maps `(k, rows, columns)`; 0 beyond `out rows`."""
        out_rows, in_rows = self.series.shape[:2]
        entering = radiance[:, :in_rows] * (self.balance[:in_rows] * self.projected)[:, None]
        entering_series = np.fft.rfft(entering, axis=-1)[..., : self.series.shape[-1]]
        leaving = np.einsum("ijm,kjm->kim", self.series, entering_series) * self.balance[:, None]
        below = np.zeros_like(radiance)
        # Rounding must not make dark texels negative.
        below[:, :out_rows] = np.maximum(np.fft.irfft(leaving, self.columns, axis=-1), 0.0)
        return below

    def lobe(self, towards: NDArray[np.float64], source: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance map `(rows, columns)` of a scattered beam from `source` `(3,)`, up to a factor.

        `towards`, `(rows, columns, 3)`, are the map's directions.
        """
        out_rows = self.balance.size
        below = np.zeros(towards.shape[:2])
        cosine = towards[:out_rows] @ source
        below[:out_rows] = self.balance[:, None] * np.exp((cosine - 1.0) / self.width_rad**2)
        return below


@lru_cache(maxsize=4)
def tabulate_haze(width_rad: float, rows: int, columns: int, out_rows: int) -> Haze:
    """Tabulate the scattering of a lobe for maps of the whole sphere, with an even number of rows.

    `width_rad` is the standard deviation of the scattered light's direction along each of two axes, where it
    is small. Below the sheet, `out_rows` rows are computed, at least down to the horizon.
    """
    in_rows = rows // 2
    cosines, solid_angles = row_geometry(rows, columns)
    projected = (cosines * solid_angles)[:in_rows]
    polar = (np.arange(out_rows) + 0.5) / rows * np.pi
    azimuth = np.arange(columns) / columns * 2.0 * np.pi
    series = np.empty((out_rows, in_rows, columns // 2 + 1))
    for row, angle in enumerate(polar):
        horizontal = np.sin(angle) * np.sin(polar[:in_rows, None]) * np.cos(azimuth)
        cosine = horizontal + np.cos(angle) * np.cos(polar[:in_rows, None])
        # An even function of the azimuth has a real series.
        series[row] = np.fft.rfft(np.exp((cosine - 1.0) / width_rad**2)).real
    # A smooth lobe needs few terms; those left out are below rounding.
    strongest = np.abs(series).max(axis=(0, 1))
    terms = int(np.flatnonzero(strongest > 1e-13 * strongest[0])[-1]) + 1
    series = np.ascontiguousarray(series[..., :terms])
    return Haze(width_rad, columns, series, _balance(series[..., 0], projected), projected)


def _balance(mean: NDArray[np.float64], projected: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(out rows,)` the factors `a`, by Sinkhorn's iteration with half steps for common row and column
    factors.

    `mean`, `(out rows, in rows)`, is the exponential summed over the azimuth.
    """
    in_rows = projected.size
    factors = np.ones(in_rows)
    for _ in range(_MAX_ITERATIONS):
        target = 1.0 / (mean[:in_rows] @ (factors * projected))
        if np.abs(target / factors - 1.0).max() < _CONVERGED:
            break
        factors = np.sqrt(factors * target)
    return np.asarray(1.0 / (mean @ (factors * projected)))


@dataclass(frozen=True, eq=False)
class Cover:
    """A sheet of glass or film between the sky and the crop.

    Attributes:
        transmittance: fraction of the sky's light that passes, scattered or not, in [0, 1].
        haze: fraction of the transmitted light that is scattered, in [0, 1].
        haze_width_rad: standard deviation of its direction per axis (see `Haze`); unused without haze.

    Raises:
        ValueError: a number is out of range, or no visible light passes.
    """

    name: str
    transmittance: Spectrum
    haze: float = 0.0
    haze_width_rad: float = 0.0

    def __post_init__(self) -> None:
        values = self.transmittance.values
        if values.ndim != 1 or values.min() < 0.0 or values.max() > 1.0:
            raise ValueError("transmittance must be one curve in [0, 1]")
        if illuminance(self.transmittance) <= 0.0:
            raise ValueError("transmittance must let visible light through")
        if not 0.0 <= self.haze <= 1.0:
            raise ValueError(f"haze must be in [0, 1], not {self.haze}")
        narrowest, widest = np.radians([NARROWEST_HAZE_DEG, WIDEST_HAZE_DEG])
        if self.haze > 0.0 and not narrowest <= self.haze_width_rad <= widest:
            raise ValueError(
                f"haze_width_rad must be in [{narrowest:.4f}, {widest:.4f}], not {self.haze_width_rad}"
            )


class CoverDocument(SourcedDocument):
    """A file of `materials/covers`."""

    kind: Literal["measured", "standard", "MODEL"]
    transmittance: CurveTable
    haze: Annotated[float, Field(ge=0, le=1)]
    haze_width_deg: Annotated[float, Field(ge=NARROWEST_HAZE_DEG, le=WIDEST_HAZE_DEG)] | None = None

    @model_validator(mode="after")
    def _check_haze_width(self) -> CoverDocument:
        if self.haze > 0.0 and self.haze_width_deg is None:
            raise ValueError("haze_width_deg is required when haze is more than 0")
        return self


def load_cover(name_or_path: str | Path) -> Cover:
    """Load a cover from its file, or a shipped one by its name.

    The transmittance at the ends of the file's wavelength range also applies beyond it.

    Raises:
        InputError: the file or its curve is missing or invalid; the message names file, key and value.
    """
    path = find_material("covers", name_or_path)
    document = validate(CoverDocument, read_toml(path), path)
    table, width_rad = document.transmittance, float(np.radians(document.haze_width_deg or 0.0))
    transmittance = replace(read_fraction(path, "transmittance", table.file, table.column), outside="hold")
    observer, greatest = photopic_efficiency(), float(transmittance.values.max())
    visible = float(observer.integral(transmittance) / observer.integral())
    if not visible >= max(_MIN_VISIBLE, _MIN_VISIBLE_SHARE * greatest):
        problem = (
            f"must let visible light through: {visible:.3g} of it passes; at least {_MIN_VISIBLE:g} and "
            f"{_MIN_VISIBLE_SHARE:g} of the greatest transmittance, {greatest:.3g}, must"
        )
        raise InputError(path, problem, key="transmittance.column", value=table.column)
    return Cover(document.name, transmittance, document.haze, width_rad)

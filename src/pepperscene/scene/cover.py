"""The greenhouse's roof: what it lets through, and how much of that it spreads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, illuminance
from pepperscene.spectra.files import CurveTable, SourcedDocument, find_material, read_curve

_BALANCED: Final = 1e-12  # chosen: rounding of doubles, well below that of the float32 sky
_TURNS: Final = 1000  # chosen: ten times what the narrowest lobe takes


def directions(rows: int, columns: int) -> NDArray[np.float64]:
    """`(rows, columns, 3)` unit directions through the centres of a map of the whole sphere."""
    polar = (np.arange(rows) + 0.5) / rows * np.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2.0 * np.pi
    flat = np.sin(polar)[:, None]
    up = np.broadcast_to(np.cos(polar)[:, None], (rows, columns))
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1)


def row_geometry(rows: int, columns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean cosine to the zenith and solid angle of a texel, by row; both exact for the row's band."""
    edges = np.arange(rows + 1) / rows * np.pi
    top, bottom = np.cos(edges[:-1]), np.cos(edges[1:])
    return (top + bottom) / 2.0, (top - bottom) * 2.0 * np.pi / columns


@dataclass(frozen=True, eq=False)
class Haze:
    """The scattering tabulated for maps of `rows` by `columns`.

    Attributes:
        width_rad: of the lobe.
        columns: of the maps.
        waves: `(out rows, in rows, m)` real, the exponential as a Fourier series in the azimuth between.
        balance: `(out rows,)` the factors `a`; rows below the horizon continue them and receive no light.
        level: `(in rows,)` projected solid angle of a texel.
    """

    width_rad: float
    columns: int
    waves: NDArray[np.float64]
    balance: NDArray[np.float64]
    level: NDArray[np.float64]

    def spread(self, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Maps `(k, rows, columns)` of radiance below the sheet for those above it; 0 beyond `out rows`."""
        lowest, upper = self.waves.shape[:2]
        entering = radiance[:, :upper] * (self.balance[:upper] * self.level)[:, None]
        series = np.fft.rfft(entering, axis=-1)[..., : self.waves.shape[-1]]
        leaving = np.einsum("ijm,kjm->kim", self.waves, series) * self.balance[:, None]
        below = np.zeros_like(radiance)
        # What rounding leaves where all is dark must not be negative.
        below[:, :lowest] = np.maximum(np.fft.irfft(leaving, self.columns, axis=-1), 0.0)
        return below

    def lobe(self, towards: NDArray[np.float64], source: NDArray[np.float64]) -> NDArray[np.float64]:
        """Such a map of a beam from `source` `(3,)`, up to a factor; `towards` are the map's directions."""
        lowest = self.balance.size
        below = np.zeros(towards.shape[:2])
        facing = towards[:lowest] @ source
        below[:lowest] = self.balance[:, None] * np.exp((facing - 1.0) / self.width_rad**2)
        return below


@lru_cache(maxsize=4)
def haze(width_rad: float, rows: int, columns: int, lowest: int) -> Haze:
    """The scattering of a lobe of this width.

    Args:
        width_rad: standard deviation of the scattered light's direction along each of two axes, where small.
        rows: of the maps of the whole sphere, even.
        columns: of the maps.
        lowest: the last row that is wanted below the sheet, at least the horizon's.
    """
    upper = rows // 2
    cosines, solid_angles = row_geometry(rows, columns)
    level = (cosines * solid_angles)[:upper]
    polar = (np.arange(lowest) + 0.5) / rows * np.pi
    turn = np.arange(columns) / columns * 2.0 * np.pi
    waves = np.empty((lowest, upper, columns // 2 + 1))
    for row, angle in enumerate(polar):
        across = np.sin(angle) * np.sin(polar[:upper, None]) * np.cos(turn)
        facing = across + np.cos(angle) * np.cos(polar[:upper, None])
        # Even in the azimuth, so that its series is real.
        waves[row] = np.fft.rfft(np.exp((facing - 1.0) / width_rad**2)).real
    # A smooth lobe needs few waves; what is left out is below rounding.
    strongest = np.abs(waves).max(axis=(0, 1))
    waves = np.ascontiguousarray(waves[..., : int(np.flatnonzero(strongest > 1e-13 * strongest[0])[-1]) + 1])
    return Haze(width_rad, columns, waves, _balance(waves[..., 0], level), level)


def _balance(mean: NDArray[np.float64], level: NDArray[np.float64]) -> NDArray[np.float64]:
    """The factors `a` by row: Sinkhorn's iteration, its steps halved so that rows and columns share factors.

    Args:
        mean: `(out rows, in rows)` the exponential summed over the azimuth.
        level: `(in rows,)` projected solid angle of a texel.
    """
    upper = level.size
    factors = np.ones(upper)
    for _ in range(_TURNS):
        wanted = 1.0 / (mean[:upper] @ (factors * level))
        if np.abs(wanted / factors - 1.0).max() < _BALANCED:
            break
        factors = np.sqrt(factors * wanted)
    return np.asarray(1.0 / (mean @ (factors * level)))


NARROWEST_HAZE_DEG: Final = 2.0
"""ASTM D1003 counts as haze what leaves its way by more than 2.5 degrees; a narrower lobe is no haze."""

WIDEST_HAZE_DEG: Final = 90.0


@dataclass(frozen=True, eq=False)
class Cover:
    """A sheet of glass or film between the sky and the crop.

    Attributes:
        name: as its file tells it.
        transmittance: share of the light from the sky that comes through, spread or not, in [0, 1].
        haze: share of that light that is spread, in [0, 1].
        haze_width_rad: standard deviation of its direction along each of two axes (`scene.haze`); not used
            without haze.

    Raises:
        ValueError: a number lies outside its range, or no visible light comes through.
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
            raise ValueError(f"haze must lie in [0, 1], not {self.haze}")
        narrowest, widest = np.radians([NARROWEST_HAZE_DEG, WIDEST_HAZE_DEG])
        if self.haze > 0.0 and not narrowest <= self.haze_width_rad <= widest:
            raise ValueError(
                f"haze_width_rad must lie in [{narrowest:.4f}, {widest:.4f}], not {self.haze_width_rad}"
            )

    def through(self, light: Spectrum) -> Spectrum:
        """The spectrum of this light below the cover, on the nodes of both."""
        return light.times(self.transmittance)


class CoverDocument(SourcedDocument):
    """A file of `materials/covers`."""

    kind: Literal["measured", "standard", "MODEL"]
    transmittance: CurveTable
    haze: Annotated[float, Field(ge=0, le=1)]
    haze_width_deg: Annotated[float, Field(ge=NARROWEST_HAZE_DEG, le=WIDEST_HAZE_DEG)] | None = None

    @model_validator(mode="after")
    def _haze_has_a_width(self) -> CoverDocument:
        if self.haze > 0.0 and self.haze_width_deg is None:
            raise ValueError("haze_width_deg must be given where haze is more than 0")
        return self


def load_cover(wanted: str | Path) -> Cover:
    """The cover of a file, or of a shipped one by its bare name.

    Beyond the wavelengths of its file the transmittance is held.

    Raises:
        InputError: the file or its curve is missing or wrong; the message names file, key and value.
    """
    path = find_material("covers", wanted)
    told = validate(CoverDocument, read_toml(path), path)
    file, column = told.transmittance.file, told.transmittance.column
    transmittance = replace(read_curve(path, "transmittance", file, column), outside="hold")
    above = transmittance.values > 1.0
    if above.any():
        row = int(np.argmax(above))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        found = float(transmittance.values[row])
        raise InputError(path.parent / file, "must be a share, at most 1", key=key, value=found)
    if illuminance(transmittance) <= 0.0:
        raise InputError(path, "must let visible light through", key="transmittance.column", value=column)
    return Cover(told.name, transmittance, told.haze, float(np.radians(told.haze_width_deg or 0.0)))

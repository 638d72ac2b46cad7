"""Spectral bands: response curves, their description, and the tables of sensor files that define them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum
from pepperscene.spectra.files import NonEmptyText, cell_error, read_spectra

Array = NDArray[np.float64]
BandShape = Literal["gaussian", "box"]
_STEP_NM: Final = 0.25
"""Of tabulated curves. Chosen: half of the wavelength grid on which light is traced; the width of a Gaussian
of 2 nm is then exact to 0.01 nm."""
_REACH: Final = 2.0
"""Half of a Gaussian's range over its full width at half maximum. Chosen: the curve is 1.5e-5 there, and
filters block more than a ten-thousandth of the light beside their band."""
MOST_BANDS: Final = 1000
"""Chosen: line scanners have up to 950 (Headwall Hyperspec VNIR E series)."""
DEFAULT_PEAK: Final = 0.5
"""Electrons per photon. Chosen: silicon behind a filter has 0.3 to 0.7 in its best range."""
Centre = Annotated[float, Field(ge=200.0, le=2500.0)]
"""Chosen from the deep ultraviolet; the optics of plants are known up to 2500 nm."""
Width = Annotated[float, Field(ge=1.0, le=1000.0)]
"""Full width at half maximum. Chosen: light is traced on a grid of half nanometres, and the widest filters
pass all that silicon detects."""
Peak = Annotated[float, Field(ge=1e-6, le=1)]


@dataclass(frozen=True)
class Band:
    """A band of a sensor, by the curve of its response.

    Attributes:
        name: in the sensor's file, such as "red edge"; "" for none.
        centre_nm: mean wavelength, weighted with the response; to 0.01 nm.
        width_nm: full width at half maximum: between the outermost wavelengths with half of the response's
            peak; to 0.01 nm.
    """

    name: str
    centre_nm: float
    width_nm: float

    def to_json(self) -> dict[str, Any]:
        """JSON-ready description."""
        return {"name": self.name, "centre_nm": self.centre_nm, "width_nm": self.width_nm}


def band_curves(bands: Sequence[BandTable]) -> Spectrum:
    """The responses `(c, n)` of c bands: Gaussians or boxes of given widths at half maximum and peaks."""
    numbers = np.array([(band.centre_nm, band.width_nm, band.peak) for band in bands])
    centres, widths, peaks = numbers.T[..., None]
    is_box = np.array([band.shape == "box" for band in bands])[:, None]
    reach = np.where(is_box, 0.5, _REACH) * widths + _STEP_NM
    first, last = (centres - reach).min() / _STEP_NM, (centres + reach).max() / _STEP_NM
    nm = _STEP_NM * np.arange(math.floor(first), math.ceil(last) + 1)
    offsets = np.abs(nm - centres)
    gaussians = np.where(offsets <= _REACH * widths, np.exp2(-((2.0 * offsets / widths) ** 2)), 0.0)
    # Means over a step, so that the area is exact wherever a box ends.
    boxes = np.clip((0.5 * widths - offsets) / _STEP_NM + 0.5, 0.0, 1.0)
    return Spectrum(nm, peaks * np.where(is_box, boxes, gaussians))


def describe_bands(response: Spectrum, names: Sequence[str] = ()) -> tuple[Band, ...]:
    """The bands of response curves `(c, n)`, with their names if there are some.

    Raises:
        ValueError: a curve is 0 everywhere.
    """
    labels = names or [""] * len(response.values)
    curves = [Spectrum(response.wavelength_nm, values) for values in response.values]
    return tuple(Band(name, *_centre_and_width(curve)) for name, curve in zip(labels, curves, strict=True))


def _centre_and_width(curve: Spectrum) -> tuple[float, float]:
    nm, values = curve.wavelength_nm, curve.values
    total, peak = float(curve.integral()), float(values.max())
    if not total > 0.0:
        raise ValueError("has a band that detects no light")
    # Wavelength is linear too, so the integral of the product is exact.
    centre = float(curve.integral(Spectrum(nm, nm))) / total
    above = np.flatnonzero(values >= 0.5 * peak)
    first, last = int(above[0]), int(above[-1])
    low = _crossing(nm, values, first - 1, first, 0.5 * peak) if first > 0 else nm[0]
    high = _crossing(nm, values, last + 1, last, 0.5 * peak) if last + 1 < nm.size else nm[-1]
    return round(centre, 2), round(float(high - low), 2)


def _crossing(nm: Array, values: Array, below: int, above: int, level: float) -> float:
    """Wavelength between two neighbouring entries at which the curve has a level."""
    share = (level - values[below]) / (values[above] - values[below])
    return float(nm[below] + share * (nm[above] - nm[below]))


class BandTable(Document):
    """One band: `[[bands]]`."""

    centre_nm: Centre
    width_nm: Width
    name: NonEmptyText | None = None
    peak: Peak = DEFAULT_PEAK
    shape: BandShape = "gaussian"


class RegularBandsTable(Document):
    """Bands of equal width at equal steps: `[regular_bands]`."""

    first_nm: Centre
    last_nm: Centre
    count: Annotated[int, Field(ge=2, le=MOST_BANDS)]
    width_nm: Width
    peak: Peak = DEFAULT_PEAK
    shape: BandShape = "gaussian"

    @model_validator(mode="after")
    def _check_order(self) -> RegularBandsTable:
        if not self.first_nm < self.last_nm:
            raise ValueError(f"first_nm = {self.first_nm:g} must be below last_nm = {self.last_nm:g}")
        return self


class BandCurvesTable(Document):
    """Curves of a CSV file beside the TOML file: `[band_curves]`; all columns, or some by name."""

    file: NonEmptyText
    columns: Annotated[list[NonEmptyText], Field(min_length=1, max_length=MOST_BANDS)] | None = None


BandTables = tuple[BandTable, ...] | RegularBandsTable | BandCurvesTable


def read_bands(path: Path, tables: BandTables) -> tuple[Spectrum, tuple[str, ...]]:
    """The responses `(c, n)` of the bands of a sensor file, and their names; "" for a band without one."""
    if isinstance(tables, BandCurvesTable):
        return _read_curves(path, tables)
    if isinstance(tables, RegularBandsTable):
        width_nm, peak, shape = tables.width_nm, tables.peak, tables.shape
        centres = np.linspace(tables.first_nm, tables.last_nm, tables.count).tolist()
        bands = [BandTable(centre_nm=nm, width_nm=width_nm, peak=peak, shape=shape) for nm in centres]
        return band_curves(bands), ()
    names = tuple(band.name or "" for band in tables)
    for number, name in enumerate(names):
        if name and name in names[:number]:
            raise InputError(path, "must be different for each band", key=f"bands.{number}.name", value=name)
    return band_curves(tables), names if any(names) else ()


def _read_curves(path: Path, table: BandCurvesTable) -> tuple[Spectrum, tuple[str, ...]]:
    """The columns of a CSV file, which are named by its header."""
    file = path.parent / table.file
    if not file.is_file():
        raise InputError(path, "is not a file in the same folder", key="band_curves.file", value=table.file)
    found = read_spectra(file)
    names = tuple(table.columns or found)
    if len(names) > MOST_BANDS:
        raise InputError(file, f"must be at most {MOST_BANDS}", key="number of curves", value=len(names))
    for number, name in enumerate(names):
        if name not in found or name in names[:number]:
            problem = f"must be different columns of {table.file}: {', '.join(found)}"
            raise InputError(path, problem, key="band_curves.columns", value=name)
    nm = found[names[0]].wavelength_nm
    for name in names:
        values = found[name].values
        if not (values.min() >= 0 and values.max() <= 1):
            row = int(np.argmax((values < 0) | (values > 1)))
            raise cell_error(file, row, name, values[row], "must be from 0 to 1")
    return Spectrum(nm, np.stack([found[name].values for name in names])), names

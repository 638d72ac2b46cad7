"""The image sensor: photosites behind a Bayer mosaic, or all alike."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, photons_per_joule
from pepperscene.spectra.files import (
    CurveTable,
    NotNegative,
    SourcedDocument,
    Text,
    find_material,
    read_curve,
)

Pattern = Literal["rggb", "bggr", "grbg", "gbrg", "mono"]
BAYER = ("rggb", "bggr", "grbg", "gbrg")
MOST_BITS = 16  # digital numbers are kept in 16 bits


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor whose `binning` x `binning` blocks of photosites make the pixels of the image.

    On a Bayer sensor with an even binning a block holds whole quads: red, green and blue of a pixel are the
    means of its photosites of that colour, and no colour is interpolated. With a binning of 1 every photosite
    is a pixel, whose two other colours are demosaiced. On a monochrome sensor a pixel is its block's mean.

    Attributes:
        name: for reports.
        columns, rows: of the image.
        pitch_m: of one photosite.
        quantum_efficiency: `(c, n)` photo-electrons per incident photon (the spectral response functions,
            SRF), with any filter that belongs to the sensor; c = 3 for red, green and blue photosites, or 1.
        full_well_e: electrons at which a photosite is full.
        read_noise_e: standard deviation of the temporal dark noise of one photosite, in electrons, at every
            gain.
        bits: of the analogue-to-digital converter, 1 to 16.
        black_level_dn: digital number of a dark photosite.
        binning: photosites per pixel and direction: 1 or even on Bayer sensors, any on monochrome ones.
        pattern: colours of the quad at the upper left, read line by line; "mono" if and only if c is 1.
        gain: of the amplifier; at 1 a full well reads full scale, at 2 half a well does.
    """

    name: str
    columns: int
    rows: int
    pitch_m: float
    quantum_efficiency: Spectrum
    full_well_e: float
    read_noise_e: float
    bits: int
    black_level_dn: float
    binning: int = 2
    pattern: Pattern = "rggb"
    gain: float = 1.0

    def __post_init__(self) -> None:
        qe = self.quantum_efficiency.values
        if qe.ndim != 2 or len(qe) not in (1, 3) or not (qe.min() >= 0 and qe.max() <= 1):
            raise ValueError(f"{self.name}: quantum efficiency must be (3, n) or (1, n) within [0, 1]")
        if self.pattern not in (*BAYER, "mono") or (self.pattern == "mono") != (len(qe) == 1):
            raise ValueError(f"{self.name}: pattern {self.pattern!r} does not go with {len(qe)} colours")
        if fault := fault_of_binning(self.pattern, self.binning, self.columns, self.rows):
            raise ValueError(f"{self.name}: {fault}")
        if not (min(self.pitch_m, self.full_well_e) > 0 and self.read_noise_e >= 0):
            raise ValueError(f"{self.name}: pitch and full well must be positive, read noise at least 0")
        if not 1 <= self.bits <= MOST_BITS:
            raise ValueError(f"{self.name}: bits must lie in [1, {MOST_BITS}]")
        if not 0 <= self.black_level_dn < self.full_scale_dn:
            raise ValueError(f"{self.name}: black level must lie in [0, {self.full_scale_dn})")
        if not 0 < self.gain < np.inf:
            raise ValueError(f"{self.name}: gain must be positive")

    @property
    def channels(self) -> int:
        """Colours of its photosites: 3, or 1 on a monochrome sensor."""
        return len(self.quantum_efficiency.values)

    @property
    def site_shape(self) -> tuple[int, int]:
        """Rows and columns of photosites."""
        return self.rows * self.binning, self.columns * self.binning

    @property
    def pixel_pitch_m(self) -> float:
        """Of one image pixel."""
        return self.pitch_m * self.binning

    @property
    def full_scale_dn(self) -> int:
        """The largest digital number."""
        return int(2**self.bits - 1)

    @property
    def gain_e_per_dn(self) -> float:
        """Electrons per digital number."""
        return self.full_well_e / (self.full_scale_dn - self.black_level_dn) / self.gain

    @property
    def photosites(self) -> tuple[int, ...]:
        """How many photosites of each colour are averaged for an image pixel; all 1 where none are."""
        if self.channels == 1:
            return (self.binning**2,)
        quads = max(self.binning // 2, 1) ** 2
        return quads, 2 * quads if self.binning > 1 else 1, quads

    def electrons_per_joule(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """`(c, n)` photo-electrons per joule of light on a photosite: QE lambda / (h c)."""
        return self.quantum_efficiency.at(wavelength_nm) * photons_per_joule(wavelength_nm)

    def with_settings(self, bits: int | None = None, gain: float | None = None) -> Sensor:
        """The same sensor with another converter resolution or amplifier gain; None leaves it as it is.

        The black level keeps its share of the converter's range, and the gain does not move it.

        Raises:
            ValueError: bits beyond [1, 16], or a gain that is not positive.
        """
        bits = self.bits if bits is None else bits
        if not 1 <= bits <= MOST_BITS:
            raise ValueError(f"{self.name}: bits must lie in [1, {MOST_BITS}]")
        black = self.black_level_dn * (2**bits - 1) / self.full_scale_dn
        gain = self.gain if gain is None else gain
        return dataclasses.replace(self, bits=bits, black_level_dn=black, gain=gain)

    def with_filter(self, filter: Spectrum) -> Sensor:
        """The sensor behind a filter of this transmittance `(n,)`, at the wavelengths of both curves."""
        own = self.quantum_efficiency.wavelength_nm
        # A filter that ends within the sensor's range ends there, not on the way to the sensor's next knot.
        ends = np.nextafter(filter.wavelength_nm[[0, -1]], [-np.inf, np.inf])
        nm = np.unique(np.concatenate([own, filter.wavelength_nm, ends]))
        nm = nm[(nm >= own[0]) & (nm <= own[-1])]
        through = Spectrum(nm, self.quantum_efficiency.at(nm) * filter.at(nm))
        return dataclasses.replace(self, quantum_efficiency=through)


def fault_of_binning(pattern: Pattern, binning: int, columns: int, rows: int) -> str:
    """What is wrong with a binning and an image size on a pattern, or nothing."""
    if min(columns, rows) < 1 or binning < 1:
        return "the image must be at least 1 x 1, and binning at least 1"
    if pattern == "mono":
        return ""
    if binning % 2 and binning != 1:
        return f"binning must be 1 or even on a Bayer pattern, as blocks hold whole quads, not {binning}"
    if binning == 1 and (columns % 2 or rows % 2):
        return f"{columns} x {rows} photosites hold no whole Bayer quads; columns and rows must be even"
    return ""


class EfficiencyTable(Document):
    """Columns of a CSV file beside the TOML file: red, green and blue, or the only one."""

    file: Text
    columns: Annotated[list[Text], Field(min_length=1, max_length=3)]


class SensorDocument(SourcedDocument):
    """A file of `materials/sensors`."""

    kind: Literal["measured", "standard", "MODEL"]
    columns: Annotated[int, Field(ge=1, le=20_000)]
    rows: Annotated[int, Field(ge=1, le=20_000)]
    pattern: Pattern
    binning: Annotated[int, Field(ge=1, le=16)]
    pitch_um: Annotated[float, Field(gt=0, le=1000)]
    full_well_e: Annotated[float, Field(ge=1, le=1e9)]
    read_noise_e: Annotated[float, Field(ge=0, le=1e9)]
    bits: Annotated[int, Field(ge=1, le=MOST_BITS)]
    black_level_dn: NotNegative
    quantum_efficiency: EfficiencyTable
    infrared_cut: CurveTable | None = None

    @model_validator(mode="after")
    def _black_within_the_range(self) -> SensorDocument:
        if self.black_level_dn >= 2**self.bits - 1:
            raise ValueError(f"black_level_dn must be below the full scale of {2**self.bits - 1}")
        return self

    @model_validator(mode="after")
    def _pixels_on_the_pattern(self) -> SensorDocument:
        if fault := fault_of_binning(self.pattern, self.binning, self.columns, self.rows):
            raise ValueError(fault)
        if len(self.quantum_efficiency.columns) != (colours := 1 if self.pattern == "mono" else 3):
            raise ValueError(f"quantum_efficiency.columns must name {colours} for the pattern {self.pattern}")
        return self


def load_sensor(wanted: str | Path) -> Sensor:
    """The sensor of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file or its curves are missing or wrong; the message names file, key and value.
    """
    path = find_material("sensors", wanted)
    told = validate(SensorDocument, read_toml(path), path)
    table = told.quantum_efficiency
    curves = [read_curve(path, "quantum_efficiency", table.file, column) for column in table.columns]
    efficiency = Spectrum(curves[0].wavelength_nm, np.stack([one.values for one in curves]))
    if efficiency.values.max() > 1:
        highest = float(efficiency.values.max())
        raise InputError(
            path, "must be a share of the photons, at most 1", key="quantum_efficiency", value=highest
        )
    sensor = Sensor(
        name=told.name,
        columns=told.columns,
        rows=told.rows,
        pitch_m=told.pitch_um * 1e-6,
        quantum_efficiency=efficiency,
        full_well_e=told.full_well_e,
        read_noise_e=told.read_noise_e,
        bits=told.bits,
        black_level_dn=told.black_level_dn,
        binning=told.binning,
        pattern=told.pattern,
    )
    return sensor if told.infrared_cut is None else sensor.with_filter(_cut(path, told.infrared_cut))


def _cut(path: Path, table: CurveTable) -> Spectrum:
    """The transmittance of the filter that belongs to the sensor."""
    found = read_curve(path, "infrared_cut", table.file, table.column)
    if found.values.max() > 1:
        highest = float(found.values.max())
        raise InputError(path, "must be a share of the light, at most 1", key="infrared_cut", value=highest)
    return found


@dataclass(frozen=True, eq=False)
class Filter:
    """A sheet of glass before the lens that lets some wavelengths through.

    Its transmittance is the same for all angles: true of coloured glass to a few per cent, not of
    interference filters, whose edges move towards the blue for oblique light.

    Attributes:
        name: for reports.
        transmittance: share of the light that it lets through, `(n,)` within [0, 1]; 0 beyond its range.
    """

    name: str
    transmittance: Spectrum

    def __post_init__(self) -> None:
        values = self.transmittance.values
        if values.ndim != 1 or not (values.min() >= 0 and values.max() <= 1):
            raise ValueError(f"{self.name}: transmittance must be one curve within [0, 1]")


class FilterDocument(SourcedDocument):
    """A file of `materials/filters`."""

    kind: Literal["measured", "standard", "MODEL"]
    transmittance: CurveTable


def load_filter(wanted: str | Path) -> Filter:
    """The filter of a file, or of a shipped one by its bare name.

    Raises:
        InputError: the file or its curve is missing or wrong; the message names file, key and value.
    """
    path = find_material("filters", wanted)
    told = validate(FilterDocument, read_toml(path), path)
    file, column = told.transmittance.file, told.transmittance.column
    found = read_curve(path, "transmittance", file, column)
    if found.values.max() > 1:
        row = int(np.argmax(found.values > 1))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        raise InputError(
            path.parent / file, "must be a share, at most 1", key=key, value=float(found.values[row])
        )
    return Filter(told.name, found)


def read_fraction(path: Path, table: str, curve: CurveTable) -> Spectrum:
    """Read a curve within [0, 1] from the CSV file beside `path`; it is 0 beyond its range."""
    spectrum = read_curve(path, table, curve.file, curve.column)
    above = spectrum.values > 1.0
    if above.any():
        row = int(np.argmax(above))
        key = f"row {row + 2}, column {curve.column}"  # as a text editor counts: the header is row 1
        value = float(spectrum.values[row])
        raise InputError(path.parent / curve.file, "must be at most 1", key=key, value=value)
    return spectrum

"""The image sensor: Bayer or monochrome photosites, the filter in front of them, and their files."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, photons_per_joule
from pepperscene.spectra.files import (
    CurveTable,
    NonEmptyText,
    NonNegative,
    SourcedDocument,
    find_material,
    read_curve,
)

Pattern = Literal["rggb", "bggr", "grbg", "gbrg", "mono"]
_BAYER: Final = ("rggb", "bggr", "grbg", "gbrg")
_MAX_BITS: Final = 16  # digital numbers are stored in 16 bits

# Bounds of sensor files.
_PITCH_UM: Final = (0.1, 1000.0)
"""Chosen: two photosites within a quarter of a wavelength of light see the same (the smallest that are made
have 0.5 um), and the largest pixels of X-ray detectors have 0.2 mm."""
_MAX_PHOTOSITES: Final = 500_000_000
"""Chosen: the sensors with the most have 410 million (Canon 2025), and an image needs 4 bytes for each."""
_HIGHEST_BLACK: Final = 0.9  # of full scale; chosen: cameras use a sixteenth, thermal ones up to a half
_LOWEST_EFFICIENCY: Final = 1e-6
"""At the peak of a curve. Chosen: a photosite that misses all but a millionth of the photons sees nothing."""


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor whose `binning` x `binning` blocks of photosites form the pixels of the image.

    With an even binning, a block of a Bayer sensor holds whole quads: red, green and blue of a pixel are the
    means of its photosites of that colour, without interpolation. With a binning of 1, every photosite is a
    pixel, and its two other colours are demosaiced. On a monochrome sensor, a pixel is the mean of its block.

    Attributes:
        columns, rows: size of the image.
        pitch_m: pitch of the photosites.
        quantum_efficiency: `(c, n)` photo-electrons per incident photon (the spectral response functions,
            SRF), with any filter that belongs to the sensor; c = 3 for red, green and blue photosites, or 1.
        full_well_e: electrons at which a photosite is full.
        read_noise_e: temporal dark noise of one photosite (standard deviation), in electrons, at every gain.
        bits: resolution of the analogue-to-digital converter, 1 to 16.
        black_level_dn: digital number of a dark photosite.
        binning: photosites per pixel and direction: 1 or even on Bayer sensors, any on monochrome ones.
        pattern: colours of the upper left quad, row by row; "mono" if and only if c is 1.
        gain: gain of the amplifier; at 1 a full well reaches full scale, at 2 half a full well does.
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
        if self.pattern not in (*_BAYER, "mono") or (self.pattern == "mono") != (len(qe) == 1):
            raise ValueError(f"{self.name}: pattern {self.pattern!r} does not match {len(qe)} colours")
        if error := _binning_error(self.pattern, self.binning, self.columns, self.rows):
            raise ValueError(f"{self.name}: {error}")
        numbers = (self.pitch_m, self.full_well_e, self.read_noise_e)
        if not (np.isfinite(numbers).all() and min(numbers[:2]) > 0 and self.read_noise_e >= 0):
            raise ValueError(f"{self.name}: pitch and full well must be positive, read noise at least 0")
        if not 1 <= self.bits <= _MAX_BITS:
            raise ValueError(f"{self.name}: bits must be in [1, {_MAX_BITS}]")
        if not 0 <= self.black_level_dn < self.full_scale_dn:
            raise ValueError(f"{self.name}: black level must be in [0, {self.full_scale_dn})")
        if not 0 < self.gain < np.inf:
            raise ValueError(f"{self.name}: gain must be positive")

    @property
    def channels(self) -> int:
        """Number of colours of its photosites: 3, or 1 on a monochrome sensor."""
        return len(self.quantum_efficiency.values)

    @property
    def site_shape(self) -> tuple[int, int]:
        """Rows and columns of photosites."""
        return self.rows * self.binning, self.columns * self.binning

    @property
    def pixel_pitch_m(self) -> float:
        """Pitch of the image pixels."""
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
        """Number of photosites of each colour that are averaged for a pixel; all 1 with a binning of 1."""
        if self.channels == 1:
            return (self.binning**2,)
        quads = max(self.binning // 2, 1) ** 2
        return quads, 2 * quads if self.binning > 1 else 1, quads

    def electrons_per_joule(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """`(c, n)` photo-electrons per joule of light on a photosite: QE lambda / (h c)."""
        return self.quantum_efficiency.at(wavelength_nm) * photons_per_joule(wavelength_nm)

    def with_settings(self, bits: int | None = None, gain: float | None = None) -> Sensor:
        """The same sensor with another converter resolution or amplifier gain; None keeps the current one.

        The black level keeps its fraction of the converter's range; the gain does not change it.

        Raises:
            ValueError: bits outside [1, 16], or a gain that is not positive.
        """
        bits = self.bits if bits is None else bits
        black = self.black_level_dn * (2**bits - 1) / self.full_scale_dn
        gain = self.gain if gain is None else gain
        return dataclasses.replace(self, bits=bits, black_level_dn=black, gain=gain)

    def with_filter(self, transmittance: Spectrum) -> Sensor:
        """The same sensor behind a filter of this transmittance `(n,)`, at the wavelengths of both curves."""
        sensor_nm, filter_nm = self.quantum_efficiency.wavelength_nm, transmittance.wavelength_nm
        # A filter that ends within the sensor's range falls to 0 there, not by the sensor's next node.
        limits = np.nextafter(filter_nm[[0, -1]], [-np.inf, np.inf])
        nm = np.unique(np.concatenate([sensor_nm, filter_nm, limits]))
        nm = nm[(nm >= sensor_nm[0]) & (nm <= sensor_nm[-1])]
        product = Spectrum(nm, self.quantum_efficiency.at(nm) * transmittance.at(nm))
        return dataclasses.replace(self, quantum_efficiency=product)


def _binning_error(pattern: Pattern, binning: int, columns: int, rows: int) -> str:
    """The reason why a binning and an image size do not fit a pattern, or ""."""
    if min(columns, rows) < 1 or binning < 1:
        return "the image must be at least 1 x 1, and binning at least 1"
    if pattern == "mono":
        return ""
    if binning % 2 and binning != 1:
        return f"binning must be 1 or even on a Bayer pattern, as blocks hold whole quads, not {binning}"
    if binning == 1 and (columns % 2 or rows % 2):
        return f"{columns} x {rows} photosites hold no whole Bayer quads; columns and rows must be even"
    return ""


@dataclass(frozen=True, eq=False)
class Filter:
    """An optical filter in front of the lens.

    Its transmittance is the same for all angles: true of coloured glass to a few per cent, not of
    interference filters, whose edges shift towards the blue for oblique light.

    Attributes:
        transmittance: fraction of the light that passes, `(n,)` within [0, 1]; 0 beyond its range.
    """

    name: str
    transmittance: Spectrum

    def __post_init__(self) -> None:
        values = self.transmittance.values
        if values.ndim != 1 or not (values.min() >= 0 and values.max() <= 1):
            raise ValueError(f"{self.name}: transmittance must be one curve within [0, 1]")


class EfficiencyTable(Document):
    """Columns of a CSV file next to the TOML file: red, green and blue, or the only one."""

    file: NonEmptyText
    columns: Annotated[list[NonEmptyText], Field(min_length=1, max_length=3)]


class SensorDocument(SourcedDocument):
    """A file of `materials/sensors`."""

    kind: Literal["measured", "standard", "MODEL"]
    columns: Annotated[int, Field(ge=1, le=20_000)]
    rows: Annotated[int, Field(ge=1, le=20_000)]
    pattern: Pattern
    binning: Annotated[int, Field(ge=1, le=16)]
    pitch_um: Annotated[float, Field(ge=_PITCH_UM[0], le=_PITCH_UM[1])]
    full_well_e: Annotated[float, Field(ge=1, le=1e9)]
    read_noise_e: Annotated[float, Field(ge=0, le=1e9)]
    bits: Annotated[int, Field(ge=1, le=_MAX_BITS)]
    black_level_dn: NonNegative
    quantum_efficiency: EfficiencyTable
    infrared_cut: CurveTable | None = None

    @model_validator(mode="after")
    def _check_consistency(self) -> SensorDocument:
        full_scale = 2**self.bits - 1
        if self.black_level_dn > _HIGHEST_BLACK * full_scale:
            allowed = f"below the full scale of {full_scale}, at most {_HIGHEST_BLACK:g} of it"
            raise ValueError(f"black_level_dn must be {allowed}")
        if self.read_noise_e > self.full_well_e:
            raise ValueError(f"read_noise_e must be at most full_well_e, {self.full_well_e:g}")
        if error := _binning_error(self.pattern, self.binning, self.columns, self.rows):
            raise ValueError(error)
        photosites = self.columns * self.rows * self.binning**2
        if photosites > _MAX_PHOTOSITES:
            size = f"columns x rows x binning^2 = {photosites}"
            raise ValueError(f"{size} photosites must be at most {_MAX_PHOTOSITES}")
        if len(self.quantum_efficiency.columns) != (colours := 1 if self.pattern == "mono" else 3):
            raise ValueError(f"quantum_efficiency.columns must name {colours} for the pattern {self.pattern}")
        return self


class FilterDocument(SourcedDocument):
    """A file of `materials/filters`."""

    kind: Literal["measured", "standard", "MODEL"]
    transmittance: CurveTable


def load_sensor(name_or_path: str | Path) -> Sensor:
    """Load a sensor from its file, or a shipped one by its name.

    Raises:
        InputError: the file or its curves are missing or invalid; the message names file, key and value.
    """
    path = find_material("sensors", name_or_path)
    document = validate(SensorDocument, read_toml(path), path)
    table = document.quantum_efficiency
    curves = [read_fraction(path, "quantum_efficiency", table.file, column) for column in table.columns]
    for column, curve in zip(table.columns, curves, strict=True):
        if not (peak := float(curve.values.max())) >= _LOWEST_EFFICIENCY:
            allowed = f"must reach at least {_LOWEST_EFFICIENCY:g} at some wavelength"
            raise InputError(
                path.parent / table.file, allowed, key=f"maximum of the column {column}", value=peak
            )
    sensor = Sensor(
        name=document.name,
        columns=document.columns,
        rows=document.rows,
        pitch_m=document.pitch_um * 1e-6,
        quantum_efficiency=Spectrum(curves[0].wavelength_nm, np.stack([curve.values for curve in curves])),
        full_well_e=document.full_well_e,
        read_noise_e=document.read_noise_e,
        bits=document.bits,
        black_level_dn=document.black_level_dn,
        binning=document.binning,
        pattern=document.pattern,
    )
    cut = document.infrared_cut
    return (
        sensor
        if cut is None
        else sensor.with_filter(read_fraction(path, "infrared_cut", cut.file, cut.column))
    )


def load_filter(name_or_path: str | Path) -> Filter:
    """Load a filter from its file, or a shipped one by its name.

    Raises:
        InputError: the file or its curve is missing or invalid; the message names file, key and value.
    """
    path = find_material("filters", name_or_path)
    document = validate(FilterDocument, read_toml(path), path)
    table = document.transmittance
    return Filter(document.name, read_fraction(path, "transmittance", table.file, table.column))


def read_fraction(path: Path, table: str, file: str, column: str) -> Spectrum:
    """Read a curve within [0, 1] from a column of the CSV file next to `path`; it is 0 beyond its range.

    Raises:
        InputError: the file or the column is missing, or a value is out of range.
    """
    spectrum = read_curve(path, table, file, column)
    above = spectrum.values > 1.0
    if above.any():
        row = int(np.argmax(above))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        raise InputError(path.parent / file, "must be at most 1", key=key, value=float(spectrum.values[row]))
    return spectrum

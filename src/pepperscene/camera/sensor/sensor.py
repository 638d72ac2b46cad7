"""The image sensor: Bayer or monochrome photosites, or bands, and the filter in front of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.sensor.area_average import AreaAverage
from pepperscene.camera.sensor.bands import Band, describe_bands
from pepperscene.errors import ArgumentError
from pepperscene.outputs import BAND_OUTPUTS, COLOUR_OUTPUTS
from pepperscene.spectra import Spectrum, photons_per_joule

Pattern = Literal["rggb", "bggr", "grbg", "gbrg", "mono", "bands"]
_BAYER: Final[tuple[Pattern, ...]] = ("rggb", "bggr", "grbg", "gbrg")
MAX_BITS: Final = 16  # digital numbers are stored in 16 bits


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor whose `binning` x `binning` blocks of photosites form the pixels of the image.

    With an even binning, a block of a Bayer sensor holds whole quads: red, green and blue of a pixel are the
    means of its photosites of that colour, without interpolation. With a binning of 1, every photosite is a
    pixel, and its two other colours are demosaiced. On a monochrome sensor, a pixel is the mean of its block.
    With a `reduction`, all photosites are read out and demosaiced, and a pixel is the mean over its area.
    A sensor with bands has all of them in every pixel, as a filter wheel, a lens for each band, or a line
    scanner gives them: each band is an image of its own, as of a monochrome sensor.

    Attributes:
        columns, rows: size of the image.
        pitch_m: pitch of the photosites.
        quantum_efficiency: `(c, n)` photo-electrons per incident photon (the spectral response functions,
            SRF), with any filter that belongs to the sensor; c = 3 for red, green and blue photosites, 1, or
            any number of bands.
        full_well_e: electrons at which a photosite is full.
        read_noise_e: temporal dark noise of one photosite (standard deviation), in electrons, at every gain.
        bits: resolution of the analogue-to-digital converter, 1 to 16.
        black_level_dn: digital number of a dark photosite.
        binning: photosites per pixel and direction: 1 or even on Bayer sensors, any on monochrome ones.
        pattern: colours of the upper left quad, row by row; "mono" for a single channel, or "bands".
        gain: gain of the amplifier; at 1 a full well reaches full scale, at 2 half a full well does.
        reduction: photosites per pixel and direction of a mode that averages areas, at least 1, with a
            binning of 1; None: `binning` decides.
        line_time_s: time from the exposure of one row of the image to that of the next one below, of a
            rolling shutter or a line scanner; 0: all rows are exposed together.
        band_names: of the channels of a sensor with bands; empty for none.
        line_scan: whether it is a line scanner (push broom): it has a single line of photosites, and each row
            of the image is that line at another time.
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
    reduction: Fraction | None = None
    line_time_s: float = 0.0
    band_names: tuple[str, ...] = ()
    line_scan: bool = False

    def __post_init__(self) -> None:
        qe = self.quantum_efficiency.values
        if qe.ndim != 2 or not (qe.min() >= 0 and qe.max() <= 1):
            raise ValueError(f"{self.name}: quantum efficiency must be (c, n) within [0, 1]")
        if self.pattern != "bands" and (
            self.pattern not in (*_BAYER, "mono") or len(qe) != (1 if self.pattern == "mono" else 3)
        ):
            raise ValueError(f"{self.name}: pattern {self.pattern!r} does not match {len(qe)} colours")
        error = binning_error(self.pattern, self.binning, self.columns, self.rows, self.reduction)
        if error:
            raise ValueError(f"{self.name}: {error}")
        if not 0 <= self.line_time_s < np.inf:
            raise ValueError(f"{self.name}: the time from row to row must be at least 0")
        numbers = (self.pitch_m, self.full_well_e, self.read_noise_e)
        if not (np.isfinite(numbers).all() and min(numbers[:2]) > 0 and self.read_noise_e >= 0):
            raise ValueError(f"{self.name}: pitch and full well must be positive, read noise at least 0")
        if not 1 <= self.bits <= MAX_BITS:
            raise ValueError(f"{self.name}: bits must be in [1, {MAX_BITS}]")
        if not 0 <= self.black_level_dn < self.full_scale_dn:
            raise ValueError(f"{self.name}: black level must be in [0, {self.full_scale_dn})")
        if not 0 < self.gain < np.inf:
            raise ValueError(f"{self.name}: gain must be positive")
        if self.band_names and len(self.band_names) != len(qe):
            raise ValueError(f"{self.name}: {len(qe)} bands need as many names")
        if self.line_scan and not (self.pattern in ("mono", "bands") and self.line_time_s > 0):
            raise ValueError(
                f"{self.name}: a line scanner needs a time from row to row, and no Bayer pattern"
            )

    @property
    def channels(self) -> int:
        """Number of colours of its photosites: 3, or 1 on a monochrome sensor; or of its bands."""
        return len(self.quantum_efficiency.values)

    @property
    def site_shape(self) -> tuple[int, int]:
        """Rows and columns of photosites that are read out."""
        if self.areas is not None:
            down, right = self.areas
            return down.sites, right.sites
        return self.rows * self.binning, self.columns * self.binning

    @property
    def areas(self) -> tuple[AreaAverage, AreaAverage] | None:
        """How areas of photosites become pixels, down the image and along rows; None without reduction."""
        if self.reduction is None:
            return None
        return AreaAverage(self.rows, self.reduction), AreaAverage(self.columns, self.reduction)

    @property
    def pixel_pitch_m(self) -> float:
        """Pitch of the image pixels."""
        return self.pitch_m * (self.binning if self.reduction is None else float(self.reduction))

    @property
    def full_scale_dn(self) -> int:
        """The largest digital number."""
        return int(2**self.bits - 1)

    @property
    def gain_e_per_dn(self) -> float:
        """Electrons per digital number."""
        return self.full_well_e / (self.full_scale_dn - self.black_level_dn) / self.gain

    @property
    def photosites(self) -> tuple[float, ...]:
        """Number of photosites of each colour that are averaged for a pixel; all 1 with a binning of 1.

        With a reduction, the number of photosites of equal weight with the same noise. On a Bayer sensor it
        is approximate, at least 1: interpolated colours share photosites.
        """
        if self.areas is not None:
            count = self.areas[0].count * self.areas[1].count
            if self.pattern in ("mono", "bands"):
                return (count,) * self.channels
            return tuple(max(count * n / 4, 1.0) for n in (1, 2, 1))
        if self.pattern in ("mono", "bands"):
            return (self.binning**2,) * self.channels
        quads = max(self.binning // 2, 1) ** 2
        return quads, 2 * quads if self.binning > 1 else 1, quads

    @cached_property
    def line(self) -> Sensor:
        """The line of photosites of a line scanner, as a sensor with a single row."""
        return dataclasses.replace(self, rows=1, line_scan=False)

    @cached_property
    def bands(self) -> tuple[Band, ...]:
        """The bands of its channels, by their response with any filter.

        Raises:
            ValueError: a channel detects no light.
        """
        return describe_bands(self.quantum_efficiency, self.band_names)

    def electrons_per_joule(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """`(c, n)` photo-electrons per joule of light on a photosite: QE lambda / (h c)."""
        return self.quantum_efficiency.at(wavelength_nm) * photons_per_joule(wavelength_nm)

    def check_outputs(self, names: Iterable[str]) -> None:
        """Raise `ArgumentError` if an output needs a sensor with bands, or one without."""
        has_bands = self.pattern == "bands"
        wrong = (COLOUR_OUTPUTS if has_bands else BAND_OUTPUTS).intersection(names)
        if not wrong:
            return
        problem = f"{min(wrong)!r} needs a sensor with bands, which {self.name} has not"
        if has_bands:
            others = ", ".join(repr(name) for name in ("electrons", *sorted(BAND_OUTPUTS)))
            problem = (
                f"{min(wrong)!r} needs a colour or monochrome sensor; {self.name} has bands: use {others}"
            )
        raise ArgumentError("outputs", problem)

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

    def with_size(self, columns: int, rows: int) -> Sensor:
        """The same sensor in a mode with another image size.

        The image is the largest part of that shape in the middle of the photosites. If a whole number of
        photosites makes a pixel, and an even one on a Bayer sensor, they are binned; else areas are averaged.
        The photosites of the image keep their size, noise and colours. A line scanner records any number of
        rows, in the same time for each.

        Raises:
            ValueError: the image has more columns or rows than there are photosites, or none.
        """
        if self.line_scan:
            return self._with_lines(columns, rows)
        site_rows, site_columns = self.site_shape
        if not (1 <= columns <= site_columns and 1 <= rows <= site_rows):
            allowed = f"1 x 1 to {site_columns} x {site_rows}, the photosites of {self.name}"
            raise ValueError(f"an image of {columns} x {rows} pixels must be {allowed}")
        factor = min(Fraction(site_columns, columns), Fraction(site_rows, rows))
        line_time_s = self.line_time_s * float(factor) * self.pitch_m / self.pixel_pitch_m
        mode = dataclasses.replace(
            self, columns=columns, rows=rows, binning=1, reduction=factor, line_time_s=line_time_s
        )
        # Bin if blocks of whole photosites make a pixel, and the image is in the middle of whole photosites.
        margins = (site_columns - columns * factor) / 2, (site_rows - rows * factor) / 2
        is_whole = all(length.denominator == 1 for length in (factor, *margins))
        if is_whole and not binning_error(self.pattern, int(factor), columns, rows):
            mode = dataclasses.replace(mode, binning=int(factor), reduction=None)
        # The first photosite of the mode can have another colour than that of the sensor.
        left, top = (site_columns - mode.site_shape[1]) // 2, (site_rows - mode.site_shape[0]) // 2
        return dataclasses.replace(mode, pattern=_shifted_pattern(self.pattern, left, top))

    def _with_lines(self, columns: int, rows: int) -> Sensor:
        """The line scanner with other numbers of columns and lines."""
        site_columns = self.site_shape[1]
        if not (1 <= columns <= site_columns and rows >= 1):
            allowed = f"have 1 to {site_columns} columns, the photosites of {self.name}, and at least one row"
            raise ValueError(f"an image of {columns} x {rows} pixels must {allowed}")
        factor = Fraction(site_columns, columns)
        if factor.denominator == 1:
            return dataclasses.replace(self, columns=columns, rows=rows, binning=int(factor), reduction=None)
        return dataclasses.replace(self, columns=columns, rows=rows, binning=1, reduction=factor)

    def with_filter(self, transmittance: Spectrum) -> Sensor:
        """The same sensor behind a filter of this transmittance `(n,)`, at the wavelengths of both curves."""
        sensor_nm, filter_nm = self.quantum_efficiency.wavelength_nm, transmittance.wavelength_nm
        # A filter that ends within the sensor's range falls to 0 there, not by the sensor's next node.
        limits = np.nextafter(filter_nm[[0, -1]], [-np.inf, np.inf])
        nm = np.unique(np.concatenate([sensor_nm, filter_nm, limits]))
        nm = nm[(nm >= sensor_nm[0]) & (nm <= sensor_nm[-1])]
        product = Spectrum(nm, self.quantum_efficiency.at(nm) * transmittance.at(nm))
        return dataclasses.replace(self, quantum_efficiency=product)


def binning_error(
    pattern: Pattern, binning: int, columns: int, rows: int, reduction: Fraction | None = None
) -> str:
    """The reason why a binning or reduction and an image size do not fit a pattern, or ""."""
    if min(columns, rows) < 1 or binning < 1:
        return "the image must be at least 1 x 1, and binning at least 1"
    if reduction is not None:
        return (
            "" if binning == 1 and reduction >= 1 else "a reduction must be at least 1, with a binning of 1"
        )
    if pattern in ("mono", "bands"):
        return ""
    if binning % 2 and binning != 1:
        return f"binning must be 1 or even on a Bayer pattern, as blocks hold whole quads, not {binning}"
    if binning == 1 and (columns % 2 or rows % 2):
        return f"{columns} x {rows} photosites hold no whole Bayer quads; columns and rows must be even"
    return ""


def _shifted_pattern(pattern: Pattern, left: int, top: int) -> Pattern:
    """The pattern of the photosites from a column and a row on."""
    if pattern in ("mono", "bands"):
        return pattern
    letters = (pattern[2 * ((row + top) % 2) + (column + left) % 2] for row in (0, 1) for column in (0, 1))
    shifted = "".join(letters)
    return next(name for name in _BAYER if name == shifted)


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

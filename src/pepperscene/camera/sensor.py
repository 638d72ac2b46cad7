"""The image sensor: a Bayer mosaic whose quads become image pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra import Spectrum, photons_per_joule


@dataclass(frozen=True, eq=False)
class Sensor:
    """A Bayer sensor read with binning: a `binning` x `binning` block of photosites gives one image pixel.

    The red, green and blue of a pixel are the means of its photosites of that colour: 1, 2 and 1 of them for
    a binning of 2. No colour is interpolated.

    Attributes:
        name: for reports.
        columns, rows: of the image.
        pitch_m: of one photosite.
        quantum_efficiency: `(3, n)` photo-electrons per incident photon for red, green and blue photosites
            (the spectral response functions, SRF), with the infrared-cut filter.
        full_well_e: electrons at which a photosite is full.
        read_noise_e: standard deviation of the temporal dark noise of one photosite.
        bits: of the analogue-to-digital converter.
        black_level_dn: digital number of a dark photosite.
        binning: photosites per pixel and direction; even, so that every block holds whole quads.
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

    def __post_init__(self) -> None:
        qe = self.quantum_efficiency.values
        if qe.ndim != 2 or qe.shape[0] != 3 or qe.min() < 0 or qe.max() > 1:
            raise ValueError(f"{self.name}: quantum efficiency must be (3, n) within [0, 1]")
        if self.binning < 2 or self.binning % 2 or min(self.columns, self.rows) < 1:
            raise ValueError(f"{self.name}: binning must be even and the image at least 1 x 1")
        if min(self.pitch_m, self.full_well_e) <= 0 or self.read_noise_e < 0:
            raise ValueError(f"{self.name}: pitch and full well must be positive, read noise at least 0")
        if not 0 <= self.black_level_dn < self.full_scale_dn:
            raise ValueError(f"{self.name}: black level must lie in [0, {self.full_scale_dn})")

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
        """Electrons per digital number, such that a full well reads full scale."""
        return self.full_well_e / (self.full_scale_dn - self.black_level_dn)

    @property
    def photosites(self) -> tuple[int, int, int]:
        """How many red, green and blue photosites make one image pixel."""
        quads = (self.binning // 2) ** 2
        return quads, 2 * quads, quads

    def electrons_per_joule(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """`(3, n)` photo-electrons per joule of light on a photosite: QE lambda / (h c)."""
        return self.quantum_efficiency.at(wavelength_nm) * photons_per_joule(wavelength_nm)

"""Tables of a sensor with bands: what its bands see of surfaces and lights, and how wavelengths are drawn.

Light that meets one surface only is carried by band, with its integrals over wavelength taken in advance, as
by the channels of other sensors. Light that meets more is carried at one wavelength per sample and band, on
the grid of the spectra: the quantity u of a sample, well spread over the samples of a pixel, selects one of
`slots` equally likely places in the list of a band, in which a wavelength is repeated in proportion to its
share of what the band detects, and at least once. With the weight of a wavelength divided by its number of
places the expectation is the trapezoidal rule itself, as of light that meets one surface.

What paths do is the same for all bands: three broad channels decide it, each with a third of the light that
the sensor detects (`broad`), sorted by wavelength. They are never 0 where a band is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.arrays import BATCH, channel_array, device_array, device_uint
from pepperscene.render.kernel.camera import SpectralResponse
from pepperscene.render.kernel.scene import SkyTables
from pepperscene.render.surface.optics import Optics
from pepperscene.render.variant import mitsuba_modules

Spectra = NDArray[np.float64]

BROAD: Final = 3
"""Broad channels: as many as a colour sensor has, whose code and guides of the denoiser serve them."""
_SLOTS_PER_WAVELENGTH: Final = 4
"""Chosen: numbers of places are rounded, which changes the shares of wavelengths by some per cent."""


@dataclass(frozen=True, eq=False)
class LightTables:
    """Light sources in the bands, padded to a multiple of `BATCH`: by band, or by band and slot.

    Attributes:
        flash: radiant intensity on the axis; None without a flash.
        sun: irradiance across its beam; None without a sun.
        sky: radiance of each of the sky's spectra.
        lamps: of 1 W of each of the lamps' spectra.
    """

    flash: Any | None
    sun: Any | None
    sky: tuple[Any, ...]
    lamps: tuple[Any, ...]

    @classmethod
    def of(
        cls, emission: Emission, factors: Spectra, columns: NDArray[np.int64] | None = None
    ) -> LightTables:
        """Sums over wavelength of emission times factors `(padded, n)`, or their products at `columns`."""

        def table(spectrum: Spectra) -> Any:
            if columns is None:
                return device_array(np.einsum("bn,n->b", factors, spectrum))
            return device_array(factors * spectrum[columns])

        flash, sun = (None if light is None else table(light) for light in (emission.flash, emission.sun))
        sky, lamps = (tuple(table(light) for light in lights) for lights in (emission.sky, emission.lamps))
        return cls(flash, sun, sky, lamps)


@dataclass(frozen=True, eq=False)
class Emission:
    """Spectra `(n,)` of the lights on the grid of the response; None where there is no such light."""

    flash: Spectra | None
    sun: Spectra | None
    sky: tuple[Spectra, ...]
    lamps: tuple[Spectra, ...] = ()

    @classmethod
    def of(cls, response: SpectralResponse, sky: SkyTables | None, *, has_flash: bool) -> Emission:
        """The lights of a frame."""
        size = response.grid_nm.size
        spectra = () if sky is None else sky.radiance
        sun = None if sky is None or sky.sun_frame is None else np.asarray(sky.sun_irradiance, float)[:size]
        flash = response.flash if has_flash else None
        lamps = () if response.lamps is None else tuple(response.lamps.spectra)
        return cls(flash, sun, tuple(np.asarray(table, float)[:size] for table in spectra), lamps)

    def mean(self) -> Spectra | float:
        """`(n,)` mean of the lights, each divided by its mean; 1 without any."""
        every = (self.flash, self.sun, *self.sky, *self.lamps)
        lights = [light for light in every if light is not None and light.any()]
        return np.mean([light / light.mean() for light in lights], axis=0) if lights else 1.0


@dataclass(frozen=True, eq=False)
class BandTables:
    """Kernel data of the bands; `band_tables` makes it.

    Attributes:
        count: number of bands.
        carriers: the surfaces in the broad channels.
        spectra: the surfaces at the wavelengths of the response's grid.
        flash_optics, sun_optics, lamp_optics: in the bands, under each light; as of `FrameTables`.
        colours: the lights by band.
        slots: number of slots of a band, in the kernel.
        columns: `(padded * slots,)` column of the spectra of each slot.
        emission: the lights by band and slot, over the density of the slot.
        white: `(c,)` see `SampleVariance`; the mean of the bands in each of them.
        per_white: `(padded,)` its inverse, 0 for padding.
    """

    count: int
    carriers: Optics
    spectra: Optics
    flash_optics: Optics
    sun_optics: Optics | None
    lamp_optics: tuple[Optics, ...]
    colours: LightTables
    slots: Any
    columns: Any
    emission: LightTables
    white: Spectra
    per_white: Any

    @property
    def batches(self) -> range:
        """First band of each batch."""
        return range(0, self.count, BATCH)

    def slot(self, position: Any) -> Any:
        """Slots of samples at positions in [0, 1)."""
        mi, dr = mitsuba_modules()
        return dr.minimum(mi.UInt32(position * mi.Float(self.slots)), self.slots - 1)


def broad_response(response: SpectralResponse) -> SpectralResponse:
    """The response of three broad channels, each with a third of the sampling density."""
    mass = response.density * response.trapezoid_nm
    middle = (np.cumsum(mass) - 0.5 * mass) / mass.sum()
    third = np.minimum((BROAD * middle).astype(int), BROAD - 1)
    electrons = response.electrons_per_joule
    peaks = electrons.max(axis=0)
    total = (electrons / np.where(peaks > 0.0, peaks, 1.0)).sum(axis=1)
    broad = np.where(third[:, None] == np.arange(BROAD), total[:, None], 0.0)
    return replace(response, electrons_per_joule=broad, by_band=False)


def band_tables(
    optics: Optics,
    response: SpectralResponse,
    sky: SkyTables | None,
    *,
    has_flash: bool,
    direct_sun: bool,
    direct_lamps: bool,
) -> BandTables:
    """Transfer the data of the bands to the device.

    Args:
        optics: of the scene, with spectra on the response's grid.
        response: of the camera.
        sky: of the frame.
        has_flash: whether its flash counts.
        direct_sun: whether sunlight at first hits is direct light.
        direct_lamps: whether that of the lamps is.
    """
    weights = response.electrons_per_joule * response.trapezoid_nm[:, None]
    count = weights.shape[1]
    weights = np.pad(weights, ((0, 0), (0, -count % BATCH)))
    emission = Emission.of(response, sky, has_flash=has_flash)
    reference = response.flash if response.flash.any() else np.ones(response.grid_nm.size)
    # The same unit for all bands: in bands without a flash, daylight would be many times their own.
    white = np.full(count, np.einsum("n,nb->b", reference, weights[:, :count]).mean() or 1.0)
    broad = broad_response(response).electrons_per_joule > 0.0
    columns, factors = _slots(weights.T, emission.mean())
    sun_optics = None
    if direct_sun and emission.sun is not None:
        sun_optics = optics.by_channel(weights * emission.sun[:, None])
    return BandTables(
        count=count,
        carriers=optics.by_channel((response.density * response.trapezoid_nm)[:, None] * broad),
        spectra=optics,
        flash_optics=optics.by_channel(weights * reference[:, None]),
        sun_optics=sun_optics,
        lamp_optics=tuple(
            optics.by_channel(weights * spectrum[:, None])
            for spectrum in (emission.lamps if direct_lamps else ())
        ),
        colours=LightTables.of(emission, weights.T),
        slots=device_uint(columns.shape[1]),
        columns=device_array(columns, np.uint32),
        emission=LightTables.of(emission, factors, columns),
        white=white,
        per_white=device_array(np.pad(1.0 / white, (0, -count % BATCH))),
    )


def _slots(weights: Spectra, light: Spectra | float) -> tuple[NDArray[np.int64], Spectra]:
    """Columns of the spectra in the slots of each band, and the weight of each over the density of its slot.

    Args:
        weights: `(b, n)` of the wavelengths in each band.
        light: `(n,)` typical light, which the density follows by half.

    Returns:
        `(b, slots)` each; slots without a wavelength have the weight 0.
    """
    most = max(int((weights > 0.0).sum(axis=1).max()), 1)
    slots = 1 << int(np.ceil(np.log2(_SLOTS_PER_WAVELENGTH * most)))
    columns, factors = np.zeros((len(weights), slots), np.int64), np.zeros((len(weights), slots))
    for band, row in enumerate(weights):
        used = np.flatnonzero(row)
        if not used.size:
            continue
        density = row[used] * (1.0 + np.broadcast_to(light, row.shape)[used])
        ends = np.rint(np.cumsum(density) / density.sum() * (slots - used.size))
        counts = 1 + np.diff(ends, prepend=0.0).astype(np.int64)
        columns[band] = np.repeat(used, counts)
        factors[band] = np.repeat(row[used] * slots / counts, counts)
    return columns, factors


def gather_batch(table: Any, entries: list[Any]) -> Any:
    """Entries of a table of floats for the bands of a batch."""
    mi, dr = mitsuba_modules()
    result = channel_array(BATCH)(0.0)
    for k, entry in enumerate(entries):
        result[k] = dr.gather(mi.Float, table, entry)
    return result

"""Spectral indices: normalised differences of the reflectance in two bands.

References: NDVI (Rouse et al. 1974, NASA SP-351), NDRE (Barnes et al. 2000, 5th Int. Conf. Precision Agric.),
PRI (Gamon, Penuelas & Field 1992, Remote Sens. Environ. 41:35).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.errors import ArgumentError, InputError

_NEAR_INFRARED: Final = (780.0, 900.0)
"""Range of the plateau of leaves, in which a band at any wavelength will do."""

INDICES: Final[Mapping[str, tuple[tuple[float, float], tuple[float, float]]]] = {
    "ndvi": (_NEAR_INFRARED, (640.0, 690.0)),
    "ndre": (_NEAR_INFRARED, (700.0, 740.0)),
    "pri": ((526.0, 536.0), (565.0, 575.0)),
}
"""Normalised differences of two bands, the second subtracted from the first: the range of each one's centre,
nm. Of several bands in a range, the one nearest to its middle is used."""


def spectral_index(name: str, reflectance: NDArray[Any], bands_nm: ArrayLike) -> NDArray[Any]:
    """An index of `INDICES`, "ndvi", "ndre" or "pri", from reflectances.

    Args:
        name: of the index.
        reflectance: `(..., c)` in c bands.
        bands_nm: `(c,)` centre of each band, nm.

    Returns:
        `(...)`; nan where a reflectance is nan, and 0 where their sum is not above 0.

    Raises:
        ArgumentError: there is no such index.
        InputError: a band is missing.
    """
    if name not in INDICES:
        raise ArgumentError("name", f"must be one of {', '.join(INDICES)}", value=name)
    return normalised_difference(reflectance, *index_bands(name, bands_nm))


def has_index(name: str, bands_nm: ArrayLike) -> bool:
    """Whether there are bands for an index of `INDICES`."""
    return None not in [_band(limits, bands_nm) for limits in INDICES[name]]


def index_bands(name: str, bands_nm: ArrayLike) -> list[int]:
    """The numbers of the two bands of an index; raises `InputError` if one is missing."""
    found = []
    for low, high in INDICES[name]:
        if (band := _band((low, high), bands_nm)) is None:
            raise InputError(name, f"needs a band from {low:g} to {high:g} nm")
        found.append(band)
    return found


def _band(limits_nm: tuple[float, float], bands_nm: ArrayLike) -> int | None:
    """Number of the band in a range that is nearest to its middle; None if there is none."""
    off = np.abs(np.asarray(bands_nm, float) - 0.5 * sum(limits_nm))
    nearest = int(off.argmin())
    return nearest if off[nearest] <= 0.5 * (limits_nm[1] - limits_nm[0]) else None


def normalised_difference(reflectance: NDArray[Any], first: int, second: int) -> NDArray[Any]:
    """Normalised differences `(...)` of two bands; 0 where both are 0, nan where one is nan."""
    a, b = reflectance[..., first], reflectance[..., second]
    total = a + b
    unknown = np.where(np.isnan(total), np.nan, 0.0)
    return np.divide(a - b, total, out=unknown, where=total > 0)

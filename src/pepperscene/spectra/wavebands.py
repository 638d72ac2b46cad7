"""Ranges of wavelength in which absorbed light is measured."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from pepperscene.errors import ArgumentError

_NAME: Final = re.compile(r"[a-z][a-z0-9_]{0,30}")
_MOST: Final = 16  # chosen: each further band takes samples from the others
FIRST_NM: Final = 300.0
LAST_NM: Final = 1100.0
"""Range of the spectra of daylight."""


@dataclass(frozen=True)
class Waveband:
    """A range of wavelengths.

    Attributes:
        name: begins the names of its columns.
        first_nm, last_nm: its limits.
    """

    name: str
    first_nm: float
    last_nm: float

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ArgumentError("bands", f"a band is named in lower-case letters, digits and _: {self.name}")
        if not (self.first_nm >= FIRST_NM and self.first_nm + 1.0 <= self.last_nm <= LAST_NM):
            limits = f"{self.first_nm:g} to {self.last_nm:g} nm"
            raise ArgumentError(
                "bands",
                f"{self.name} must be 1 nm wide or more, within {FIRST_NM:g} to {LAST_NM:g} nm, not {limits}",
            )


PAR: Final = Waveband("par", 400.0, 700.0)
"""Photosynthetically active radiation (McCree 1972, Agricultural Meteorology 9:191)."""

WAVEBANDS: Final = {
    band.name: band
    for band in (
        PAR,
        Waveband("uva", 315.0, 400.0),  # ISO 21348
        Waveband("blue", 400.0, 500.0),
        Waveband("green", 500.0, 600.0),
        # Smith 1982, Annual Review of Plant Physiology 33:481: 10 nm around 660 and 730 nm.
        Waveband("red", 655.0, 665.0),
        Waveband("far_red", 725.0, 735.0),
        Waveband("nir", 700.0, 1100.0),
    )
}
"""Bands by name; those of colours without a source are chosen thirds of PAR."""


def parse_wavebands(texts: Iterable[str | Waveband]) -> tuple[Waveband, ...]:
    """Bands from names of `WAVEBANDS` and texts such as "red_edge=700-740".

    Raises:
        ArgumentError: a name is unknown or occurs twice, limits are no numbers, or there are too many.
    """
    bands = tuple(text if isinstance(text, Waveband) else _parse(text.strip()) for text in texts)
    if not 1 <= len(bands) <= _MOST:
        raise ArgumentError("bands", f"must be 1 to {_MOST} bands, not {len(bands)}")
    names = [band.name for band in bands]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError("bands", f"{name} is named twice")
    return bands


def _parse(text: str) -> Waveband:
    name, is_own, limits = text.partition("=")
    if not is_own and name in WAVEBANDS:
        return WAVEBANDS[name]
    found = re.fullmatch(r"(\d{3,4}(?:\.\d+)?)-(\d{3,4}(?:\.\d+)?)", limits.strip())
    if found is None:
        known = ", ".join(WAVEBANDS)
        raise ArgumentError("bands", f"{text!r} is neither one of {known} nor like red_edge=700-740")
    return Waveband(name.strip(), float(found[1]), float(found[2]))

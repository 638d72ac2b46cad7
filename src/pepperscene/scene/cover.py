"""The greenhouse's roof: what it lets through, and how much of that it spreads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from pepperscene.document import read_toml, validated
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, illuminance
from pepperscene.spectra.sourced_file import CurveTable, SourcedDocument, curve, locate

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
    path = locate("covers", wanted)
    told = validated(CoverDocument, read_toml(path), path)
    file, column = told.transmittance.file, told.transmittance.column
    transmittance = replace(curve(path, "transmittance", file, column), outside="hold")
    above = transmittance.values > 1.0
    if above.any():
        row = int(np.argmax(above))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        found = float(transmittance.values[row])
        raise InputError(path.parent / file, key, found, "must be a share, at most 1")
    if illuminance(transmittance) <= 0.0:
        raise InputError(path, "transmittance.column", column, "must let visible light through")
    return Cover(told.name, transmittance, told.haze, float(np.radians(told.haze_width_deg or 0.0)))

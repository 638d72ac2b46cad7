"""Filters before the lens: their files (TOML) and what they let through."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pepperscene.document import read_toml, validated
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum
from pepperscene.spectra.sourced_file import CurveTable, SourcedDocument, curve, locate


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
    path = locate("filters", wanted)
    told = validated(FilterDocument, read_toml(path), path)
    file, column = told.transmittance.file, told.transmittance.column
    found = curve(path, "transmittance", file, column)
    if found.values.max() > 1:
        row = int(np.argmax(found.values > 1))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        raise InputError(path.parent / file, key, float(found.values[row]), "must be a share, at most 1")
    return Filter(told.name, found)

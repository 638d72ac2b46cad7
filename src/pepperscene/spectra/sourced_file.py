"""What files of sensors, lenses, flashes, filters and covers share: sources of all numbers, and curves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from pepperscene.document import Document
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shelf
from pepperscene.spectra.reading import read_spectrum
from pepperscene.spectra.spectrum import Spectrum

# Bounds beyond what can be built; they keep slips of units and of the pen out.
NotNegative = Annotated[float, Field(ge=0, le=1e6)]
Millimetres = Annotated[float, Field(ge=-1e6, le=1e6)]
Coefficient = Annotated[float, Field(ge=-100, le=100)]
Text = Annotated[str, Field(min_length=1)]


class SourcedDocument(Document):
    """A file in which every number has its source."""

    name: Text
    licence: Text
    sources: dict[str, Text]

    @model_validator(mode="after")
    def _every_number_has_a_source(self) -> SourcedDocument:
        owed = self.model_fields_set - {"name", "licence", "sources", "kind"}
        if missing := sorted(owed - self.sources.keys()):
            raise ValueError(f"[sources] must tell where {', '.join(missing)} comes from")
        if idle := sorted(self.sources.keys() - owed):
            raise ValueError(f"[sources] names {', '.join(idle)}, which the file does not hold")
        return self


class CurveTable(Document):
    """One column of a CSV file beside the TOML file."""

    file: Text
    column: Text


def locate(folder: str, wanted: str | Path) -> Path:
    """A path as it is, a bare name in the shipped folder."""
    path, shipped = Path(wanted), shelf("materials") / folder
    if is_file(path):
        return path
    if path.parent == Path(".") and is_file(shipped / f"{path}.toml"):
        return shipped / f"{path}.toml"
    names = ", ".join(sorted(file.stem for file in shipped.glob("*.toml")))
    raise InputError(str(wanted), "", None, f"no such file, nor one of the shipped {folder}: {names}")


def curve(path: Path, table: str, file: str, column: str) -> Spectrum:
    """One column of the CSV file beside `path`: a curve that is nowhere negative, 0 beyond its range."""
    beside = path.parent / file
    if not is_file(beside):
        raise InputError(path, f"{table}.file", file, "is not a file beside this one")
    found = read_spectrum(beside, column)
    negative = found.values < 0
    if negative.any():
        row = int(np.argmax(negative))
        key = f"row {row + 2}, column {column}"  # as a text editor counts: the header is row 1
        raise InputError(beside, key, float(found.values[row]), "must be at least 0")
    return found

"""Files of image signal processors: presets in TOML, as of `materials/isps`, and tone curves in CSV."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from pydantic import ConfigDict

from pepperscene.camera.isp.processor import TONE_CURVES, ImageProcessor, Points, tone_points
from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.spectra.files import SourcedDocument, find_material, read_table


class ProcessorDocument(SourcedDocument):
    """A file of `materials/isps`: a name, the keys of `[developing.isp]` but for `preset`, and sources."""

    model_config = ConfigDict(extra="allow")


def load_processor(name_or_path: str | Path) -> ImageProcessor:
    """Load a preset from its TOML file, or a shipped one by its name; its tone curve is read, too.

    Raises:
        InputError: a file is missing or not valid; the message names file, key and value.
    """
    path = find_material("isps", name_or_path)
    values = validate(ProcessorDocument, read_toml(path), path).model_extra or {}
    if "preset" in values:
        raise InputError(path, "is not a known key", key="preset")
    processor = validate(ImageProcessor, values, path)
    curve = processor.tone_curve
    if isinstance(curve, str) and curve not in TONE_CURVES:
        # Relative to the preset's folder.
        return dataclasses.replace(processor, tone_curve=read_tone_curve(path.parent / curve))
    return processor


def read_tone_curve(path: str | Path) -> Points:
    """Read a tone curve: a CSV file with the columns `light` and `code`, each 0 to 1.

    Raises:
        InputError: the file is missing, is no such table, or its curve does not rise; see `tone_points`.
    """
    header, rows = read_table(Path(path), ("light",))
    if header[1:] != ["code"]:
        raise InputError(path, "must be light,code", key="header", value=",".join(header))
    try:
        return tone_points(rows)
    except ValueError as error:
        raise InputError(path, str(error)) from None

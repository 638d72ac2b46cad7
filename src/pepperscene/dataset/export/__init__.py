"""Exports: a data set in the formats that training code reads."""

from pepperscene.dataset.export.run import FORMATS, Exported, Exporter, Format, export
from pepperscene.dataset.export.source import OnFrame, Source, new_folder, require, sources
from pepperscene.dataset.export.splits import Splits, read_splits, split_by_sets

__all__ = [
    "FORMATS",
    "Exported",
    "Exporter",
    "Format",
    "OnFrame",
    "Source",
    "Splits",
    "export",
    "new_folder",
    "read_splits",
    "require",
    "sources",
    "split_by_sets",
]

"""Exports: a data set in the formats that training code reads."""

from pepperscene.dataset.export.formats import FORMATS, Exported, Exporter, Format
from pepperscene.dataset.export.source import OnFrame, Source, require, sources
from pepperscene.dataset.export.splits import Splits, read_splits, split_by_sets
from pepperscene.dataset.export.target import new_folder
from pepperscene.dataset.export.whole import export

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

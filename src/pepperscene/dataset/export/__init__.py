"""Exports: a data set in the formats that training code reads."""

from pepperscene.dataset.export.run import FORMATS, Exporter, ExportFormat, ExportResult, export_dataset
from pepperscene.dataset.export.source import ExportSource, OnFrame, export_sources, new_folder, require
from pepperscene.dataset.export.splits import Splits, read_splits, split_by_sets

__all__ = [
    "FORMATS",
    "ExportFormat",
    "ExportResult",
    "ExportSource",
    "Exporter",
    "OnFrame",
    "Splits",
    "export_dataset",
    "export_sources",
    "new_folder",
    "read_splits",
    "require",
    "split_by_sets",
]

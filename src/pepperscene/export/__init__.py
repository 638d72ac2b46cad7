"""Exports of a data set to the formats of training code."""

from pepperscene.dataset.splits import Splits, read_splits, split_by_sets
from pepperscene.export.run import FORMATS, ExportResult, export_dataset

__all__ = ["FORMATS", "ExportResult", "Splits", "export_dataset", "read_splits", "split_by_sets"]

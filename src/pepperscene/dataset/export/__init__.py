"""Exports of a data set to the formats of training code."""

from pepperscene.dataset.export.run import FORMATS, ExportResult, export_dataset
from pepperscene.dataset.export.splits import Splits, read_splits, split_by_sets

__all__ = ["FORMATS", "ExportResult", "Splits", "export_dataset", "read_splits", "split_by_sets"]

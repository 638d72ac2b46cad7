"""Measured colour: patches, colour statistics, and the similarity of two image sets."""

from pepperscene.colour.comparison.bootstrap import Estimate
from pepperscene.colour.comparison.compare import compare
from pepperscene.colour.comparison.figure import comparison_figure
from pepperscene.colour.comparison.result import Comparison, KindComparison, comparison_json
from pepperscene.colour.comparison.tables import comparison_tables, format_tables
from pepperscene.colour.patches.chart import Calibration, calibrate
from pepperscene.colour.patches.open import open_patches
from pepperscene.colour.patches.patch import MeasuredSpectrum, Patch, PatchSet
from pepperscene.colour.statistics import (
    ColourStatistics,
    circular_emd,
    circular_mean,
    circular_sd,
    delta_e_2000,
    linear_srgb_to_lab,
    resultant_length,
)

__all__ = [
    "Calibration",
    "ColourStatistics",
    "Comparison",
    "Estimate",
    "KindComparison",
    "MeasuredSpectrum",
    "Patch",
    "PatchSet",
    "calibrate",
    "circular_emd",
    "circular_mean",
    "circular_sd",
    "compare",
    "comparison_figure",
    "comparison_json",
    "comparison_tables",
    "delta_e_2000",
    "format_tables",
    "linear_srgb_to_lab",
    "open_patches",
    "resultant_length",
]

"""The colour room: patches of measured colour, what they have in common, and how alike two sets are."""

from pepperscene.colour.comparison.compare import compare
from pepperscene.colour.comparison.result import Comparison, KindComparison
from pepperscene.colour.patches.chart import Calibration, calibrate
from pepperscene.colour.patches.open import open_patches
from pepperscene.colour.patches.patch import MeasuredSpectrum, Patch, PatchSet
from pepperscene.colour.statistics.bootstrap import Estimate
from pepperscene.colour.statistics.circular import (
    circular_emd,
    circular_mean,
    circular_median,
    circular_sd,
    resultant_length,
)
from pepperscene.colour.statistics.colours import ColourStatistics, delta_e_2000, linear_srgb_to_lab

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
    "circular_median",
    "circular_sd",
    "compare",
    "delta_e_2000",
    "linear_srgb_to_lab",
    "open_patches",
    "resultant_length",
]

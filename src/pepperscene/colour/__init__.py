"""The colour room: patches of measured colour, what they have in common, and how alike two sets are."""

from pepperscene.colour.chart import Calibration, calibrate
from pepperscene.colour.circle import (
    circular_emd,
    circular_mean,
    circular_median,
    circular_sd,
    resultant_length,
)
from pepperscene.colour.comparing import compare
from pepperscene.colour.comparison import Comparison, KindComparison
from pepperscene.colour.measure import Measure
from pepperscene.colour.opening import open_patches
from pepperscene.colour.patch import MeasuredSpectrum, Patch, PatchSet
from pepperscene.colour.statistics import ColourStatistics, delta_e_2000, lab

__all__ = [
    "Calibration",
    "ColourStatistics",
    "Comparison",
    "KindComparison",
    "Measure",
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
    "lab",
    "open_patches",
    "resultant_length",
]

"""The colour room: patches of measured colour, what they have in common, and how alike two sets are."""

from pepperscene.colour.circle import (
    circular_emd,
    circular_mean,
    circular_median,
    circular_sd,
    resultant_length,
)
from pepperscene.colour.patch import MeasuredSpectrum, Patch, PatchSet
from pepperscene.colour.statistics import ColourStatistics, delta_e_2000, lab

__all__ = [
    "ColourStatistics",
    "MeasuredSpectrum",
    "Patch",
    "PatchSet",
    "circular_emd",
    "circular_mean",
    "circular_median",
    "circular_sd",
    "delta_e_2000",
    "lab",
    "resultant_length",
]

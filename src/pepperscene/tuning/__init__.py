"""The tuning room: pigments, light and exposure fitted to measured colour by the renderer's derivatives."""

from pepperscene.tuning.fit import fitted
from pepperscene.tuning.outcome import Fit, KindFit, SpectrumFit
from pepperscene.tuning.parameter import Parameter, known_parameters, parameters_of
from pepperscene.tuning.subject import Subject
from pepperscene.tuning.tune import Tuning, Verification, tune
from pepperscene.tuning.twin import twin_patches
from pepperscene.tuning.written import write_tuned

__all__ = [
    "Fit",
    "KindFit",
    "Parameter",
    "SpectrumFit",
    "Subject",
    "Tuning",
    "Verification",
    "fitted",
    "known_parameters",
    "parameters_of",
    "tune",
    "twin_patches",
    "write_tuned",
]

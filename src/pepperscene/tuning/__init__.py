"""The tuning room: pigments, light and exposure fitted to measured colour by the renderer's derivatives."""

from pepperscene.tuning.fit.least_squares import fitted
from pepperscene.tuning.fit.result import Fit, KindFit, SpectrumFit
from pepperscene.tuning.model.subject import Subject
from pepperscene.tuning.output.write import write_tuned
from pepperscene.tuning.parameters.parameter import Parameter, known_parameters, parameters_of
from pepperscene.tuning.twin import twin_patches
from pepperscene.tuning.workflow import Tuning, Verification, tune

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

"""The tuning room: pigments, light and exposure fitted to measured colour by the renderer's derivatives."""

from pepperscene.tuning.fit.least_squares import fit_parameters
from pepperscene.tuning.fit.result import FitResult, KindFit, SpectrumFit
from pepperscene.tuning.model.subject import TuningTarget
from pepperscene.tuning.output.write import write_tuned
from pepperscene.tuning.parameters.parameter import Parameter, known_parameters, select_parameters
from pepperscene.tuning.twin import simulate_patches
from pepperscene.tuning.workflow import TuningResult, Verification, tune

__all__ = [
    "FitResult",
    "KindFit",
    "Parameter",
    "SpectrumFit",
    "TuningResult",
    "TuningTarget",
    "Verification",
    "fit_parameters",
    "known_parameters",
    "select_parameters",
    "simulate_patches",
    "tune",
    "write_tuned",
]

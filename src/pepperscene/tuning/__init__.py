"""Differentiable fits of pigments, light, exposure and camera to measured colour."""

from pepperscene.tuning.fit.least_squares import FitResult, KindFit, SpectrumFit, fit_parameters
from pepperscene.tuning.model.target import TuningTarget
from pepperscene.tuning.output.write import write_tuned
from pepperscene.tuning.parameters.parameter import Parameter, known_parameters, select_parameters
from pepperscene.tuning.simulated import simulate_patches
from pepperscene.tuning.whole_scene import Verification
from pepperscene.tuning.workflow import TuningResult, tune

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

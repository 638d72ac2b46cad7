"""Differentiable fits of pigments, light, exposure and camera to measured colour."""

from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.least_squares import FitResult, KindFit, SpectrumFit, fit_parameters
from pepperscene.tuning.parameters import known_parameters, select_parameters
from pepperscene.tuning.report import RunInfo
from pepperscene.tuning.target import TuningTarget, simulate_patches
from pepperscene.tuning.whole_scene import Verification
from pepperscene.tuning.workflow import TuningOptions, TuningResult, tune
from pepperscene.tuning.write import write_tuned

__all__ = [
    "FitResult",
    "KindFit",
    "Parameter",
    "RunInfo",
    "SpectrumFit",
    "TuningOptions",
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

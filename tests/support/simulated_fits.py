"""Fits to simulated patches with hidden parameter values, compared with the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pepperscene.camera import Camera, decode_tone
from pepperscene.colour import Patch, PatchSet, delta_e_2000, linear_srgb_to_lab
from pepperscene.cultivar import Cultivar
from pepperscene.recipe.recipe import Recipe
from pepperscene.render.quality import Quality
from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.least_squares import FitResult, fit_parameters
from pepperscene.tuning.parameters import known_parameters, select_parameters
from pepperscene.tuning.problem import FitProblem
from pepperscene.tuning.target import TuningTarget

KINDS = ("leaf", "pepper.unripe", "pepper.ripe", "peduncle", "stem", "shoot")
"""Kinds that together show every surface but the calyx."""

HIDDEN = (
    "leaf.chlorophyll", "leaf.carotenoid", "leaf.structure", "leaf.state", "leaf.spread", "leaf.roughness",
    "fruit.chlorophyll", "fruit.carotenoid", "fruit.brown", "fruit.flesh", "fruit.ripeness",
    "fruit.roughness", "fruit.ior", "petiole.chlorophyll", "stem.chlorophyll", "stem.brown",
    "peduncle.chlorophyll", "peduncle.flesh", "flash.colour", "flash.power", "exposure", "white_balance",
)  # fmt: skip
"""Parameters that may be hidden: some of every group."""

EQUIVALENT = (("flash.power", "exposure"),)
"""Pairs of which a draw has one at most: twice the light and twice the gain differ by their noise alone."""

FEW_SAMPLES = Quality(4, 4, 4, 1, target=None, denoise=False)


def no_patches(kinds: Sequence[str] = KINDS) -> PatchSet:
    """A grey pixel of each kind, so that a target has views."""
    grey = np.full((1, 3), 188, np.uint8)
    return PatchSet("none", tuple(Patch(kind, kind, "none", decode_tone(grey), grey) for kind in kinds))


def all_parameters(recipe: Recipe, cultivar: Cultivar, camera: Camera) -> dict[str, Parameter]:
    """All parameters by name; those of path ends cannot be selected together with those of the whole path."""
    names = known_parameters(cultivar, camera)
    ends = [name for name in names if name.count(".") == 2]
    others = select_parameters(recipe, cultivar, camera, [name for name in names if name not in ends])
    parameters = {one.name: one for one in (*others, *select_parameters(recipe, cultivar, camera, ends))}
    return {name: parameters[name] for name in names}


def draw_names(rng: np.random.Generator, count: int = 5, among: Sequence[str] = HIDDEN) -> tuple[str, ...]:
    """Some of the names, without equivalent pairs."""
    while True:
        names = tuple(sorted(rng.choice(among, count, replace=False).tolist(), key=among.index))
        if not any(set(pair) <= set(names) for pair in EQUIVALENT):
            return names


def draw_values(parameters: Sequence[Parameter], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Values from the prior distributions."""
    return {one.name: np.array([prior.draw(rng) for prior in one.prior]) for one in parameters}


@dataclass(frozen=True, eq=False)
class Recovery:
    """Fitted and true values of hidden parameters.

    Attributes:
        labels: `(p,)` labels of the entries.
        true, fitted, sd: `(p,)` values and posterior standard deviations.
        relative_error: `(p,)` relative to the true value; for entries that can be 0 (exponents of the flash's
            colour), to the prior sd.
        deviance: Squared error of all entries in units of the posterior covariance: chi-squared with p
            degrees of freedom if that is right.
        delta_e: CIEDE2000 between patch and model after the fit, by view.
        fit: The fit.
    """

    labels: tuple[str, ...]
    true: np.ndarray
    fitted: np.ndarray
    sd: np.ndarray
    relative_error: np.ndarray
    deviance: float
    delta_e: dict[str, float]
    fit: FitResult


def recover(target: TuningTarget, problem: FitProblem, values: Mapping[str, np.ndarray]) -> Recovery:
    """Fit simulated patches, again with the noise at the values found; compare the result with the truth."""
    first = fit_parameters(target, problem)
    problem = target.problem([one.name for one in problem.parameters], noise_at=first.values)
    fit = fit_parameters(target, problem)
    true, fitted, sd = (
        np.concatenate([what[one.name] for one in fit.parameters]) for what in (values, fit.values, fit.sd)
    )
    size = np.where(
        [one.parameter.name == "flash.colour" for one in problem.entries], problem.sd, np.abs(true)
    )
    error = (fitted - true) / sd
    return Recovery(
        labels=tuple(entry.label for entry in problem.entries),
        true=true,
        fitted=fitted,
        sd=sd,
        relative_error=np.abs(fitted - true) / size,
        deviance=float(error @ np.linalg.solve(fit.correlation, error)),
        delta_e=patch_delta_e(problem, fit),
        fit=fit,
    )


def patch_delta_e(problem: FitProblem, fit: FitResult) -> dict[str, float]:
    """CIEDE2000 between the mean colours of patches and model, by observation, at the best values."""
    target = np.array([one.target[:3] for one in problem.observations])
    pixels = [one.linear(fit.tuned_parts) for one in problem.observations]
    model = np.array([linear_srgb_to_lab(one.mean(axis=0)) for one in pixels])
    labels = [one.label for one in problem.observations]
    return dict(zip(labels, delta_e_2000(target, model).tolist(), strict=True))

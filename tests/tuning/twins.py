"""What twins hide, and how what a fit finds of it is held against the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pepperscene.camera import decode_tone
from pepperscene.colour import Patch, PatchSet, delta_e_2000
from pepperscene.tuning.fit.least_squares import fit_parameters
from pepperscene.tuning.fit.result import FitResult
from pepperscene.tuning.model.observables import lab_of
from pepperscene.tuning.model.problem import FitProblem
from pepperscene.tuning.model.subject import TuningTarget
from pepperscene.tuning.parameters.parameter import Parameter

KINDS = ("leaf", "pepper.unripe", "pepper.ripe", "peduncle", "stem", "shoot")
"""Of organs that a fit looks at: together they show every surface but the calyx."""

HIDDEN = (
    "leaf.chlorophyll", "leaf.carotenoid", "leaf.structure", "leaf.state", "leaf.spread", "leaf.roughness",
    "fruit.chlorophyll", "fruit.carotenoid", "fruit.brown", "fruit.flesh", "fruit.ripeness",
    "fruit.roughness", "fruit.ior", "petiole.chlorophyll", "stem.chlorophyll", "stem.brown",
    "peduncle.chlorophyll", "peduncle.flesh", "flash.colour", "flash.power", "exposure", "white_balance",
)  # fmt: skip
"""What a twin may hide: of every kind of parameter some."""

SAME = (("flash.power", "exposure"),)
"""Pairs of which a draw takes one: twice the light and twice the gain differ by their noise alone."""


def no_patches(kinds: Sequence[str] = KINDS) -> PatchSet:
    """A grey pixel of each kind: what a subject needs to have views."""
    grey = np.full((1, 3), 188, np.uint8)
    return PatchSet("none", tuple(Patch(kind, kind, "none", decode_tone(grey), grey) for kind in kinds))


def drawn_names(rng: np.random.Generator, count: int = 5, among: Sequence[str] = HIDDEN) -> tuple[str, ...]:
    """Some of the names, drawn again where two of them move the same thing."""
    while True:
        names = tuple(sorted(rng.choice(among, count, replace=False).tolist(), key=among.index))
        if not any(set(pair) <= set(names) for pair in SAME):
            return names


def drawn_values(parameters: Sequence[Parameter], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A point of the bounds: every entry by its own law."""
    return {one.name: np.array([law.draw(rng) for law in one.prior]) for one in parameters}


# --- one twin from end to end -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Recovery:
    """What a fit found of what was hidden.

    Attributes:
        labels: `(p,)` of the entries.
        true, found, sd: `(p,)`.
        relative: `(p,)` errors, of the true values' sizes; of those that can be 0 (exponents of the flash's
            colour), of the sd of their bounds.
        deviance: of all entries together, squared, in units of the fit's own covariance: chi-squared with p
            degrees of freedom if that is honest.
        open: `(p,)` whether the fit says that it cannot be determined.
        delta_e: by view, CIEDE2000 between patch and model at the end.
        fit: itself.
    """

    labels: tuple[str, ...]
    true: np.ndarray
    found: np.ndarray
    sd: np.ndarray
    relative: np.ndarray
    deviance: float
    open: np.ndarray
    delta_e: dict[str, float]
    fit: FitResult


def recovered(
    subject: TuningTarget, problem: FitProblem, values: Mapping[str, np.ndarray], told=None
) -> Recovery:
    """Fit a twin, and hold what was found against what was hidden."""
    fit = fit_parameters(subject, problem, on_progress=told)
    true, found, sd = (
        np.concatenate([what[one.name] for one in fit.parameters]) for what in (values, fit.values, fit.sd)
    )
    size = np.where(
        [one.parameter.name == "flash.colour" for one in problem.entries], problem.sd, np.abs(true)
    )
    off = (found - true) / sd
    labels = tuple(entry.label for entry in problem.entries)
    return Recovery(
        labels=labels,
        true=true,
        found=found,
        sd=sd,
        relative=np.abs(found - true) / size,
        deviance=float(off @ np.linalg.solve(fit.correlation, off)),
        open=np.array([any(said.startswith(label) for said in fit.undetermined) for label in labels]),
        delta_e=patch_delta_e(problem, fit),
        fit=fit,
    )


def patch_delta_e(problem: FitProblem, fit: FitResult) -> dict[str, float]:
    """CIEDE2000 between the mean colours of each cell's patch and model, at the best values."""
    target = np.array([cell.target[:3] for cell in problem.cells])
    model = np.array([lab_of(cell.linear(fit.tuned).mean(axis=0)) for cell in problem.cells])
    labels = [cell.label for cell in problem.cells]
    return dict(zip(labels, delta_e_2000(target, model).tolist(), strict=True))

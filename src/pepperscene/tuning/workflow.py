"""Several sets of patches as one."""

from __future__ import annotations

import datetime
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.colour import MeasuredSpectrum, Patch, PatchSet
from pepperscene.tuning.fit.diagnostics import SEEN
from pepperscene.tuning.fit.least_squares import STARTS, fit_parameters
from pepperscene.tuning.fit.result import FitResult
from pepperscene.tuning.model.observables import numbers
from pepperscene.tuning.model.problem import FitProblem, NeighbourEffect
from pepperscene.tuning.model.subject import TuningTarget
from pepperscene.tuning.output.figure import BeforeAfter
from pepperscene.tuning.output.write import check_folder, write_tuned
from pepperscene.tuning.parameters.tuned import TunedParts
from pepperscene.tuning.whole_scene import Likeness, SceneStatistics, likeness, rendered

if TYPE_CHECKING:
    from pepperscene.dataset import Recipe


def merge_patches(sets: Sequence[PatchSet]) -> PatchSet:
    """All patches and spectra of several sets; names of pictures that two sets share get their set's before.

    Raises:
        ValueError: no set at all.
    """
    if not sets:
        raise ValueError("at least one set of patches is needed")
    if len(sets) == 1:
        return sets[0]
    names = [f"{one.name} {i + 1}" if _twice(one.name, sets) else one.name for i, one in enumerate(sets)]
    pictures = Counter(picture for one in sets for picture in one.pictures)
    called = Counter(part.name for one in sets for part in _parts(one))

    def told(name: str, of: str, counts: Counter[str]) -> str:
        return f"{of}: {name}" if counts[name] > 1 else name

    return PatchSet(
        " and ".join(names),
        tuple(
            replace(patch, name=told(patch.name, of, called), picture=told(patch.picture, of, pictures))
            for one, of in zip(sets, names, strict=True)
            for patch in one.patches
        ),
        tuple(
            replace(spectrum, name=told(spectrum.name, of, called))
            for one, of in zip(sets, names, strict=True)
            for spectrum in one.spectra
        ),
    )


def _parts(one: PatchSet) -> tuple[Patch | MeasuredSpectrum, ...]:
    return (*one.patches, *one.spectra)


def _twice(name: str, sets: Sequence[PatchSet]) -> bool:
    return sum(one.name == name for one in sets) > 1


Array = NDArray[np.float64]

ROUNDS: Final = 3
VERIFY: Final = 4
"""Chosen: frames of the whole scene; organs enough, in half a minute each time."""
_NEAR: Final = 1.0
"""Chosen: CIELAB units by which the whole scene may miss what a fit took it for: what can just be seen."""


@dataclass(frozen=True, eq=False)
class Verification:
    """Frames of the whole scene against the patches, by kind.

    Attributes:
        before, after: against the patches of the fit, at the recipe's values and at the tuned ones.
        held_before, held_after: the same against those that the fit did not see.
        frames: how many were rendered for each.
        rounds: fits that were made, the later ones with what the scene adds to single organs.
    """

    before: Mapping[str, Likeness]
    after: Mapping[str, Likeness]
    held_before: Mapping[str, Likeness]
    held_after: Mapping[str, Likeness]
    frames: int
    rounds: int


@dataclass(frozen=True, eq=False)
class TuningResult:
    """What `tune` did.

    Attributes:
        fit: what was found.
        files: that were written, the recipe first.
        verification: against the whole scene, or None.
    """

    fit: FitResult
    files: tuple[Path, ...]
    verification: Verification | None


def tune(
    recipe: Recipe | str | Path,
    patches: PatchSet | str | Path,
    names: Sequence[str],
    out: str | Path,
    *,
    bounds: str | Path | Mapping[str, Any] | None = None,
    hold_out: Sequence[str] = (),
    starts: int = STARTS,
    seed: int = 0,
    verify: int = VERIFY,
    quality: str = "draft",
    when: datetime.date | None = None,
    options: Mapping[str, Any] | None = None,
    extends: str | Path | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> TuningResult:
    """Fit parameters of a recipe to patches, and write the tuned recipe.

    Args:
        recipe: or the name of a shipped one, or a path.
        patches: or what `open_patches` opens.
        names: of the parameters (see `known_parameters`).
        out: a new or an empty folder.
        bounds: of parameters, over the shipped ones.
        hold_out: pictures whose patches the fit does not see.
        starts: at most.
        seed: of organs, light, noise and starts.
        verify: frames of the whole scene that are rendered before and after; 0 leaves the scene out. With
            frames, the fit is made again with what the scene adds to single organs, until that stays.
        quality: of those frames.
        when: the date to write down; None for today.
        options: to write down, ready for JSON.
        extends: file that a `Recipe` was read from, which the written one extends; a name or a path is its
            own.
        on_progress: is called with a line now and then.

    Raises:
        InputError: an argument or a file is not valid; nothing is written.
        OutputError: the folder holds something, or cannot be written to.
        SetupError: the machine cannot render; nothing is written.
    """
    from pepperscene.colour import PatchSet, open_patches
    from pepperscene.dataset import Recipe, load_recipe

    source = extends if isinstance(recipe, Recipe) else recipe
    shown = recipe if isinstance(recipe, Recipe) else load_recipe(recipe)
    every = patches if isinstance(patches, PatchSet) else open_patches(patches)
    seen, held = (every.without(hold_out), every.select(hold_out)) if hold_out else (every, None)
    date = when or datetime.date.today()
    subject = TuningTarget(shown, seen, bounds=bounds, seed=seed)
    subject.parameters(names)
    check_folder(Path(out))

    def write(
        fit: FitResult,
        folder: str | Path,
        frames: BeforeAfter | None,
        verification: Verification | None = None,
    ) -> tuple[Path, ...]:
        return write_tuned(
            shown,
            fit,
            folder,
            patches=seen,
            when=date,
            extends=source,
            options=options,
            frames=frames,
            verification=None if verification is None else asdict(verification),
        )

    if not verify:
        fit = fit_parameters(
            subject, subject.problem(names), starts=starts, seed=seed, on_progress=on_progress
        )
        return TuningResult(fit, write(fit, out, None), None)

    # The whole scene tells what neighbours do to an organ's light; with that the fit is made, and again with
    # what the tuned scene tells.
    before = rendered(shown, verify, quality)
    around = surroundings(subject, subject.tuned({}), before)
    for round_ in range(1, ROUNDS + 1):
        problem = subject.problem(names, around)
        fit = fit_parameters(
            subject, problem, starts=starts if round_ == 1 else 1, seed=seed, on_progress=on_progress
        )
        with tempfile.TemporaryDirectory(prefix="pepperscene-") as folder:
            after = rendered(load_recipe(write(fit, folder, None)[0]), verify, quality)
        off = farthest(problem, fit.tuned, after)
        if on_progress is not None:
            on_progress(
                f"round {round_}: the whole scene lies {off:.1f} CIELAB units from what the fit took it for"
            )
        if off < _NEAR:
            break
        around = surroundings(subject, fit.tuned, after)
    kinds = subject.kinds
    nothing: Mapping[str, Likeness] = {}
    verification = Verification(
        likeness(before.patches, seen, kinds),
        likeness(after.patches, seen, kinds),
        nothing if held is None else likeness(before.patches, held, kinds),
        nothing if held is None else likeness(after.patches, held, kinds),
        verify,
        round_,
    )
    fit = replace(fit, diagnostics=(*fit.diagnostics, *told_of(verification)))
    return TuningResult(
        fit, write(fit, out, BeforeAfter(before.picture, after.picture), verification), verification
    )


def told_of(verification: Verification) -> tuple[str, ...]:
    """Sentences on kinds whose colour came no nearer in the whole scene, or lies far off there."""
    sides = {"the patches": (verification.before, verification.after)}
    sides["patches that the fit did not see"] = (verification.held_before, verification.held_after)
    found = []
    for whose, (before, after) in sides.items():
        for kind, now in after.items():
            was = before[kind].delta_e
            if now.delta_e is None or was is None or now.delta_e <= SEEN:
                continue
            how = "came no nearer to" if now.delta_e >= was else "still lies off"
            found.append(
                f"In the whole scene the mean colour of {kind} {how} {whose}: dE2000 {was:.1f} before, "
                f"{now.delta_e:.1f} after."
            )
    return tuple(found)


def surroundings(
    subject: TuningTarget, made: TunedParts, whole: SceneStatistics
) -> dict[str, NeighbourEffect]:
    """What the whole scene does to single organs of each kind, at a recipe's tuned parts."""
    found = {}
    for kind in subject.kinds:
        eyes, seen = [eye for eye in subject.eyes if eye.view.kind == kind], whole.numbers(kind)
        if seen is None:
            continue
        mean = np.concatenate([eye.electrons(made) for eye in eyes]).mean(axis=0)
        # Views count electrons of the recipe's own time, which without a flash is what exposure changes.
        time = made.exposure if subject.camera.flash is None else 1.0
        shade = whole.electrons[kind] / np.maximum(time * mean, 1e-9)
        alike = numbers(np.concatenate([eye.linear(made, shade) for eye in eyes]))
        found[kind] = NeighbourEffect(shade, seen - alike)
    return found


def farthest(problem: FitProblem, made: TunedParts, whole: SceneStatistics) -> float:
    """By how much the whole scene's mean colours miss those that a fit took them for, CIELAB units."""
    found = [0.0]
    for cell in problem.cells:
        seen = whole.numbers(cell.label)
        if seen is not None:
            found.append(float(np.linalg.norm((seen - cell.predicted(made))[:3])))
    return max(found)

"""Tuning of a recipe to patches from end to end: fit, verification in the whole scene, files."""

from __future__ import annotations

import datetime
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from pepperscene.colour import MeasuredSpectrum, Patch, PatchSet, open_patches
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.tuning.figure import BeforeAfter
from pepperscene.tuning.least_squares import STARTS, FitResult, fit_parameters
from pepperscene.tuning.report import RunInfo
from pepperscene.tuning.target import TuningTarget
from pepperscene.tuning.whole_scene import (
    Verification,
    colour_agreement,
    describe_verification,
    largest_difference,
    neighbour_effects,
    render_statistics,
)
from pepperscene.tuning.write import check_folder, write_tuned

MAX_ROUNDS: Final = 3
VERIFY_FRAMES: Final = 4  # chosen: enough organs, in half a minute each time
_CONVERGED: Final = 1.0  # chosen: CIELAB units between scene and model; a difference that is just visible


@dataclass(frozen=True, eq=False)
class TuningOptions:
    """How `tune` fits a recipe and verifies the result.

    Attributes:
        bounds: A bounds file or its tables, overriding the shipped bounds.
        hold_out: Pictures whose patches are excluded from the fit.
        starts: Maximum number of starts.
        seed: Seed of organs, light, noise and starts.
        verify: Number of frames of the whole scene to render before and after; 0 for none. With frames, the
            fit is repeated with the effect of neighbours on single organs, until it converges.
        quality: Quality of those frames.
        allow_code: Whether the recipe's code may run, which frames of the whole scene can need.
        when: Date to write into the files; None for today.
    """

    bounds: str | Path | Mapping[str, Any] | None = None
    hold_out: Sequence[str] = ()
    starts: int = STARTS
    seed: int = 0
    verify: int = VERIFY_FRAMES
    quality: str = "draft"
    allow_code: bool = False
    when: datetime.date | None = None


_DEFAULT_OPTIONS: Final = TuningOptions()


@dataclass(frozen=True, eq=False)
class TuningResult:
    """Result of `tune`.

    Attributes:
        fit: The fit.
        files: Files that were written, the recipe first.
        verification: Agreement in the whole scene, or None.
    """

    fit: FitResult
    files: tuple[Path, ...]
    verification: Verification | None


def merge_patches(sets: Sequence[PatchSet]) -> PatchSet:
    """Return all patches and spectra of several sets, with the name of the set before repeated names."""
    if not sets:
        raise ValueError("at least one set of patches is needed")
    if len(sets) == 1:
        return sets[0]
    repeated = Counter(patch_set.name for patch_set in sets)
    set_names = [
        f"{patch_set.name} {i + 1}" if repeated[patch_set.name] > 1 else patch_set.name
        for i, patch_set in enumerate(sets)
    ]
    pictures = Counter(picture for patch_set in sets for picture in patch_set.pictures)
    members = Counter(patch.name for patch_set in sets for patch in patch_set.patches)
    members.update(spectrum.name for patch_set in sets for spectrum in patch_set.spectra)

    def unique(set_name: str, name: str, counts: Counter[str]) -> str:
        return f"{set_name}: {name}" if counts[name] > 1 else name

    patches: list[Patch] = []
    spectra: list[MeasuredSpectrum] = []
    for patch_set, set_name in zip(sets, set_names, strict=True):
        for patch in patch_set.patches:
            name = unique(set_name, patch.name, members)
            picture = unique(set_name, patch.picture, pictures)
            patches.append(replace(patch, name=name, picture=picture))
        for spectrum in patch_set.spectra:
            spectra.append(replace(spectrum, name=unique(set_name, spectrum.name, members)))
    return PatchSet(" and ".join(set_names), tuple(patches), tuple(spectra))


def tune(
    recipe: Recipe | str | Path,
    patches: PatchSet | str | Path,
    names: Sequence[str],
    out: str | Path,
    options: TuningOptions = _DEFAULT_OPTIONS,
    *,
    extends: str | Path | None = None,
    record: Mapping[str, Any] | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> TuningResult:
    """Fit parameters of a recipe to patches, and write the tuned recipe.

    Args:
        recipe: A recipe, the name of a shipped one, or a path.
        patches: Patches, or a path for `open_patches`.
        names: Names of the parameters to fit (see `known_parameters`).
        out: A new or an empty folder.
        options: How to fit and verify.
        extends: The file that a `Recipe` object was read from, which the written recipe extends. For a name
            or a path it is that file.
        record: Options to write into the files, serialisable as JSON.
        on_progress: Called with a line of text from time to time.

    Raises:
        InputError: An argument or a file is not valid; nothing is written.
        OutputError: The folder is not empty, or cannot be written to.
        SetupError: The machine cannot render; nothing is written.
    """
    source = extends if isinstance(recipe, Recipe) else recipe
    loaded = recipe if isinstance(recipe, Recipe) else load_recipe(recipe)
    measured = patches if isinstance(patches, PatchSet) else open_patches(patches)
    hold_out, verify = options.hold_out, options.verify
    fitted, held_out = (
        (measured.without(hold_out), measured.select(hold_out)) if hold_out else (measured, None)
    )
    target = TuningTarget(loaded, fitted, bounds=options.bounds, seed=options.seed)
    target.parameters(names)
    check_folder(Path(out))
    run = RunInfo.of(fitted, options.when or datetime.date.today(), record)
    write = partial(write_tuned, loaded, run=run, extends=source)
    render = partial(render_statistics, frames=verify, quality=options.quality, allow_code=options.allow_code)
    run_fit = partial(fit_parameters, target, seed=options.seed, on_progress=on_progress)
    if not verify:
        fit = run_fit(target.problem(names), starts=options.starts)
        return TuningResult(fit, write(fit, out), None)

    # Measure the effect of neighbours in the whole scene, fit with it, and repeat with the tuned scene.
    before = render(loaded)
    neighbours = neighbour_effects(target, target.tuned_parts({}), before)
    for round_ in range(1, MAX_ROUNDS + 1):
        problem = target.problem(names, neighbours)
        fit = run_fit(problem, starts=options.starts if round_ == 1 else 1)
        with tempfile.TemporaryDirectory(prefix="pepperscene-") as folder:
            after = render(load_recipe(write(fit, folder)[0]))
        difference = largest_difference(problem, fit.tuned_parts, after)
        if on_progress is not None:
            on_progress(f"round {round_}: whole scene and fit differ by up to {difference:.1f} CIELAB units")
        if difference < _CONVERGED:
            break
        neighbours = neighbour_effects(target, fit.tuned_parts, after)

    # Compare the scene before and after with all patches.
    kinds = target.kinds
    verification = Verification(
        before=colour_agreement(before.patches, fitted, kinds),
        after=colour_agreement(after.patches, fitted, kinds),
        held_before=colour_agreement(before.patches, held_out, kinds) if held_out else {},
        held_after=colour_agreement(after.patches, held_out, kinds) if held_out else {},
        frames=verify,
        rounds=round_,
    )
    fit = replace(fit, diagnostics=(*fit.diagnostics, *describe_verification(verification)))
    frames = BeforeAfter(before.picture, after.picture)
    files = write(fit, out, frames=frames, verification=asdict(verification))
    return TuningResult(fit, files, verification)

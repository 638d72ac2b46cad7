"""Frames of the whole scene: their agreement with patches, and the effect of neighbours on single organs."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.colour import PatchSet, delta_e_2000, linear_srgb_to_lab, open_patches
from pepperscene.colour.patches.open import organ_regions
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.recipe.recipe import Recipe
from pepperscene.truth.statistics import hue_spectrum_correlation
from pepperscene.tuning.diagnostics import VISIBLE_DELTA_E
from pepperscene.tuning.observables import observables
from pepperscene.tuning.problem import FitProblem, NeighbourEffect
from pepperscene.tuning.target import TuningTarget
from pepperscene.tuning.tuned import TunedParts

Array = NDArray[np.float64]

OUTPUTS: Final = ("colour", "class", "instance", "harvest", "electrons")
_PIXELS: Final = 20_000  # of a kind


@dataclass(frozen=True, eq=False)
class SceneStatistics:
    """Statistics of some frames of a recipe."""

    patches: PatchSet  # patches of the organs in the frames
    electrons: Mapping[str, Array]  # (3,) mean expected electrons, by kind
    picture: NDArray[np.uint8]  # (h, w, 3) uint8 colour image of the middle frame

    def observables(self, kind: str) -> Array | None:
        """`(8,)` observables of a kind's pixels; None if no frame shows it."""
        pixels = self.patches.pixels(kind, _PIXELS)
        return observables(pixels) if len(pixels) else None


@dataclass(frozen=True)
class Agreement:
    """Agreement of rendered frames and measured patches of a kind; None if one of them has none."""

    delta_e: float | None  # CIEDE2000 of mean colours
    correlation: float | None  # correlation of hue spectra (Barth et al. 2018, section 3.1.1)


@dataclass(frozen=True, eq=False)
class Verification:
    """Agreement of the whole scene with the patches, by kind.

    Attributes:
        before, after: With the patches of the fit, at the recipe's values and at the tuned ones.
        held_before, held_after: With the held-out patches.
        frames: Number of frames that were rendered for each.
        rounds: Number of fits; the later ones include the effect of neighbours on single organs.
    """

    before: Mapping[str, Agreement]
    after: Mapping[str, Agreement]
    held_before: Mapping[str, Agreement]
    held_after: Mapping[str, Agreement]
    frames: int
    rounds: int


def render_statistics(
    recipe: Recipe, frames: int, quality: str = "draft", *, allow_code: bool = False
) -> SceneStatistics:
    """Render a number of frames that are evenly distributed over the plan of a recipe.

    `allow_code` says whether the recipe's code may run.
    """
    total = recipe.plan.count
    count = min(frames, total)
    # Midpoints of equal parts of the plan.
    indices = [(2 * k + 1) * total // (2 * count) for k in range(count)]
    with tempfile.TemporaryDirectory(prefix="pepperscene-") as folder:
        options = BuildOptions(quality, allow_code=allow_code)
        dataset = build(recipe, Path(folder) / "frames", indices, OUTPUTS, options).dataset
        picture = dataset.image(indices[count // 2], "colour")
        return SceneStatistics(open_patches(dataset.folder), _mean_electrons(dataset, indices), picture)


def _mean_electrons(dataset: Dataset, frames: Sequence[int]) -> dict[str, Array]:
    """Mean electrons `(3,)` over all pixels of each kind."""
    images = open_images(dataset.folder)
    sums: dict[str, Array] = {}
    for picture, index in zip(images, frames, strict=True):
        electrons = dataset.image(index, "electrons")
        for kind, pixels in organ_regions(images, picture):
            total = np.array([*electrons[pixels].sum(axis=0, dtype=float), pixels.sum()])
            sums[kind] = sums.get(kind, np.zeros(4)) + total
    return {kind: total[:3] / total[3] for kind, total in sums.items()}


def colour_agreement(rendered: PatchSet, measured: PatchSet, kinds: Iterable[str]) -> dict[str, Agreement]:
    """Compare two sets of patches by kind."""
    agreement = {}
    for kind in kinds:
        if not (rendered.of_kind(kind) and measured.of_kind(kind)):
            agreement[kind] = Agreement(None, None)
            continue
        means = [linear_srgb_to_lab(side.pixels(kind).mean(axis=0)) for side in (rendered, measured)]
        spectra = [np.asarray(side.statistics(kind).hue_spectrum) for side in (rendered, measured)]
        hues = hue_spectrum_correlation(*spectra)
        agreement[kind] = Agreement(float(delta_e_2000(*means)), None if np.isnan(hues) else hues)
    return agreement


def describe_verification(verification: Verification) -> tuple[str, ...]:
    """Sentences on kinds whose mean colour in the whole scene did not improve, or still differs visibly."""
    sets = {"the patches": (verification.before, verification.after)}
    sets["the held-out patches"] = (verification.held_before, verification.held_after)
    sentences = []
    for name, (before, after) in sets.items():
        for kind, agreement in after.items():
            previous = before[kind].delta_e
            if agreement.delta_e is None or previous is None or agreement.delta_e <= VISIBLE_DELTA_E:
                continue
            comparison = "is no closer to" if agreement.delta_e >= previous else "still differs from"
            sentences.append(
                f"In the whole scene the mean colour of {kind} {comparison} {name}: dE2000 "
                f"{previous:.1f} before, {agreement.delta_e:.1f} after."
            )
    return tuple(sentences)


def neighbour_effects(
    target: TuningTarget, parts: TunedParts, scene: SceneStatistics
) -> dict[str, NeighbourEffect]:
    """Effect of neighbours on the views of each kind, from frames rendered with the same tuned parts."""
    effects = {}
    for kind in target.kinds:
        models = [model for model in target.view_models if model.view.kind == kind]
        scene_observables = scene.observables(kind)
        if scene_observables is None:
            continue
        mean = np.concatenate([model.electrons(parts) for model in models]).mean(axis=0)
        # The electrons of views are those of the recipe's exposure time; without a flash, exposure scales it.
        time = parts.exposure if target.camera.flash is None else 1.0
        shade = scene.electrons[kind] / np.maximum(time * mean, 1e-9)
        isolated = observables(np.concatenate([model.linear(parts, shade) for model in models]))
        effects[kind] = NeighbourEffect(shade, scene_observables - isolated)
    return effects


def largest_difference(problem: FitProblem, parts: TunedParts, scene: SceneStatistics) -> float:
    """Largest difference of mean colours between the scene and the model of a fit, in CIELAB units."""
    differences = [0.0]
    for observation in problem.observations:
        scene_observables = scene.observables(observation.label)
        if scene_observables is not None:
            differences.append(float(np.linalg.norm((scene_observables - observation.predicted(parts))[:3])))
    return max(differences)

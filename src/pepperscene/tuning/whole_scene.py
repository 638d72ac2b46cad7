"""The whole scene at a recipe's values: what a fit on single organs is held against in the end."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.colour import PatchSet, delta_e_2000, linear_srgb_to_lab
from pepperscene.truth.statistics import hue_spectrum_correlation
from pepperscene.tuning.model.observables import numbers

if TYPE_CHECKING:
    from pepperscene.dataset import Dataset, Recipe


Array = NDArray[np.float64]

OUTPUTS: Final = ("colour", "class", "instance", "harvest", "electrons")
_PIXELS: Final = 20_000  # of a kind


@dataclass(frozen=True, eq=False)
class SceneStatistics:
    """Frames of a recipe.

    Attributes:
        patches: their organs.
        electrons: `(3,)` that photosites expect on average, by kind.
        picture: `(h, w, 3)` uint8, the middle one of the frames.
    """

    patches: PatchSet
    electrons: Mapping[str, Array]
    picture: NDArray[np.uint8]

    def numbers(self, kind: str) -> Array | None:
        """`(8,)` of a kind's pixels as views have them; None where no frame shows it."""
        pixels = self.patches.pixels(kind, _PIXELS)
        return numbers(pixels) if len(pixels) else None


@dataclass(frozen=True)
class Likeness:
    """How alike rendered frames and measured patches of a kind are; None where one side has none.

    Attributes:
        delta_e: CIEDE2000 of mean colours.
        correlation: of hue spectra (Barth et al. 2018, section 3.1.1).
    """

    delta_e: float | None
    correlation: float | None


def rendered(recipe: Recipe, frames: int, quality: str = "draft") -> SceneStatistics:
    """Some frames of a recipe, evenly over its plan.

    Args:
        recipe: what is shown.
        frames: how many.
        quality: of `QUALITIES`.
    """
    from pepperscene.colour import open_patches
    from pepperscene.dataset import BuildOptions, build

    plan = recipe.plan
    total = plan.sets * plan.rotations * plan.frames
    count = min(frames, total)
    # The middles of even pieces of the plan.
    chosen = [(2 * k + 1) * total // (2 * count) for k in range(count)]
    with tempfile.TemporaryDirectory(prefix="pepperscene-") as folder:
        options = BuildOptions(quality)
        dataset = build(recipe, Path(folder) / "frames", chosen, OUTPUTS, options).dataset
        picture = dataset.image(chosen[count // 2], "colour")
        return SceneStatistics(open_patches(dataset.folder), _electrons(dataset, chosen), picture)


def _electrons(dataset: Dataset, frames: Sequence[int]) -> dict[str, Array]:
    """Mean electrons `(3,)` of each kind over all its pixels."""
    from pepperscene.colour.patches.open import organ_regions
    from pepperscene.dataset.readers import open_images

    images = open_images(dataset.folder)
    sums: dict[str, Array] = {}
    for picture, index in zip(images, frames, strict=True):
        light = dataset.image(index, "electrons")
        for kind, pixels in organ_regions(images, picture):
            seen = np.array([*light[pixels].sum(axis=0, dtype=float), pixels.sum()])
            sums[kind] = sums.get(kind, np.zeros(4)) + seen
    return {kind: total[:3] / total[3] for kind, total in sums.items()}


def likeness(one: PatchSet, other: PatchSet, kinds: Iterable[str]) -> Mapping[str, Likeness]:
    """How alike two sets of patches are, by kind."""
    found = {}
    for kind in kinds:
        if not (one.of_kind(kind) and other.of_kind(kind)):
            found[kind] = Likeness(None, None)
            continue
        means = [linear_srgb_to_lab(side.pixels(kind).mean(axis=0)) for side in (one, other)]
        spectra = [np.asarray(side.statistics(kind).hue_spectrum) for side in (one, other)]
        alike = hue_spectrum_correlation(*spectra)
        away = float(delta_e_2000(*means))
        found[kind] = Likeness(away, None if np.isnan(alike) else alike)
    return found

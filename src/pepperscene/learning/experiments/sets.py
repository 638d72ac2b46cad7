"""The image sets of the experiments: built from recipes, or opened."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, TypeVar

from pepperscene.atomic import digest as file_digest
from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.open import label_targets, open_images, published_halves
from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.experiments.splits import (
    Split,
    has_paper_numbers,
    real_folds,
    split_synthetic,
)
from pepperscene.learning.models.trained_model import MODEL_FILE
from pepperscene.learning.options import ExperimentOptions
from pepperscene.learning.training.run import describe_images
from pepperscene.recipe.plan import Plan
from pepperscene.recipe.recipe import digest
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe

OUTPUTS: Final = ("colour", "class")
"""Of the frames that are built: all that training and evaluation read."""

_GOLDEN_RATIO: Final = 0.6180339887498949
_FRAMES_OF_SCENE: Final = 10  # chosen: by then, rendering takes most of the time
_LEAST_SCENES: Final = 20  # chosen: plants differ less than views

Item = TypeVar("Item")


@dataclass(frozen=True)
class RecipeSource:
    """A recipe, whose frames with these indices are to be built into a folder of this name."""

    name: str
    recipe: ResolvedRecipe
    frames: tuple[int, ...]

    def describe(self) -> dict[str, Any]:
        """Name, number of images and digest as JSON values."""
        return {
            "name": self.name,
            "images": len(self.frames),
            "recipe_sha256": digest(dict(self.recipe.identity)),
        }


@dataclass(frozen=True, eq=False)
class Sources:
    """What the user has named, before the first frame is built.

    Attributes:
        synthetic: recipes and sets that exist, in the order of the arguments.
        real: photographs that have masks.
        unlabelled: number of photographs without a mask, which are left out.
        other: a set or the path of a trained model that is not related; None for none.
    """

    synthetic: tuple[RecipeSource | ImageSet, ...]
    real: ImageSet
    unlabelled: int
    other: ImageSet | Path | None

    def describe(self) -> dict[str, Any]:
        """What defines the images, as JSON values."""
        synthetic = [
            item.describe() if isinstance(item, RecipeSource) else describe_images(item)
            for item in self.synthetic
        ]
        other: dict[str, Any] | None = None
        if isinstance(self.other, ImageSet):
            other = {"kind": "set", **describe_images(self.other)}
        elif self.other is not None:
            file = self.other / MODEL_FILE if self.other.is_dir() else self.other
            digest = file_digest(file, "weights")
            other = {"kind": "model", "name": self.other.resolve().name, "sha256": digest}
        return {"synthetic": synthetic, "real": describe_images(self.real), "other": other}


@dataclass(frozen=True, eq=False)
class SplitSet:
    """A synthetic set and its split."""

    images: ImageSet
    split: Split

    def part(self, name: str) -> ImageSet:
        """The images for "train", "validation" or "test"."""
        return self.images.take(getattr(self.split, name))


@dataclass(frozen=True, eq=False)
class ExperimentSets:
    """All images of the experiments: synthetic sets, photographs, and the folds of these."""

    synthetic: tuple[SplitSet, ...]
    real: ImageSet
    folds: tuple[Split, ...]


def find_sources(
    recipes: Sequence[str | Path],
    real: str | Path,
    options: ExperimentOptions,
    other: str | Path | None = None,
    labels: str | None = None,
) -> Sources:
    """Open the sets and load the recipes that the user names; arguments are those of `run_experiments`.

    Raises:
        InputError: a recipe or a set is missing or not valid, or no photograph has a mask.
    """
    # Open what exists first, because recipes take longer.
    if not recipes:
        raise InputError("recipes", "must name at least one recipe or set")
    places = [Path(text) for text in recipes if _is_set(Path(text))]
    is_model = other is not None and (
        Path(other).suffix == ".safetensors" or (Path(other) / MODEL_FILE).is_file()
    )
    further = [] if other is None or is_model else [Path(other)]
    targets = label_targets([*places, Path(real), *further])
    applied = [labels if target else None for target in targets]
    opened = [_open(path, "synthetic", table) for path, table in zip(places, applied, strict=False)]
    photographs = _open(Path(real), "empirical", applied[len(places)])
    other_source: ImageSet | Path | None = None
    if other is not None:
        other_source = Path(other) if is_model else _open(Path(other), "synthetic", applied[-1])
    if labels is not None and not any(targets):
        raise ArgumentError("labels", "applies only to a folder of images with masks; no set is one")
    labelled, unlabelled = _with_masks(photographs)

    # Recipes share the frames evenly.
    names = [text for text in recipes if not _is_set(Path(text))]
    taken: set[str] = set()
    loaded = [_load_recipe(text, options, len(names), taken) for text in names]
    remaining, existing = iter(loaded), iter(opened)
    synthetic = tuple(next(existing) if _is_set(Path(text)) else next(remaining) for text in recipes)
    return Sources(synthetic, labelled, unlabelled, other_source)


def make_sets(
    sources: Sources, out: Path, options: ExperimentOptions, on_message: Callable[[str], None]
) -> ExperimentSets:
    """Build the frames of recipes into `out/sets`, those that are missing, and split all sets."""
    synthetic = []
    for item in sources.synthetic:
        images = _build(item, out, options, on_message) if isinstance(item, RecipeSource) else item
        as_paper = has_paper_numbers(images, sources.real)
        synthetic.append(SplitSet(images, split_synthetic(images, as_paper=as_paper)))
    as_paper = any(has_paper_numbers(item.images, sources.real) for item in synthetic)
    return ExperimentSets(tuple(synthetic), sources.real, real_folds(sources.real, as_paper=as_paper))


def spread_frames(plan: Plan, count: int) -> tuple[int, ...]:
    """Indices of frames that are spread evenly over the scenes of a plan, at varied views.

    A few frames are of some of the scenes only, because growing a row of plants takes as long as several
    frames of it.
    """
    indices = plan.select_indices(None)
    if count >= len(indices):
        return indices
    scenes: dict[int, list[int]] = {}
    for index in indices:
        scenes.setdefault(plan.frame(index).scene, []).append(index)
    # Enough scenes for the frames, however few a scene has.
    needed = -(-count // min(map(len, scenes.values())))
    number = min(len(scenes), max(_LEAST_SCENES, count // _FRAMES_OF_SCENE, needed))
    chosen = _spread(list(scenes.values()), number)
    return tuple(_spread([index for scene in chosen for index in scene], count))


def _spread(items: Sequence[Item], count: int) -> list[Item]:
    """Some of the items, in order: one of each stretch.

    The golden ratio varies the place in the stretch, which is the view along a path.
    """
    bounds = [number * len(items) // count for number in range(count + 1)]
    return [
        items[first + int((number * _GOLDEN_RATIO % 1) * (end - first))]
        for number, (first, end) in enumerate(pairwise(bounds))
    ]


def _is_set(path: Path) -> bool:
    return path.is_dir() or (path.suffix == ".json" and path.is_file())


def _open(path: Path, half: str, labels: str | None) -> ImageSet:
    """Open a set; of the published one, this half if it holds both."""
    both = path.is_dir() and len(published_halves(path)) > 1
    return open_images(path, half=half if both else None, labels=labels)


def _with_masks(images: ImageSet) -> tuple[ImageSet, int]:
    """The images that have a mask, and the number of the others."""
    masks = images.select("classes")
    labelled = [position for position in range(len(masks)) if masks[position].classes is not None]
    if not labelled:
        raise InputError(images.name, "holds no image with a mask")
    return images.take(labelled), len(images) - len(labelled)


def _load_recipe(name: str | Path, options: ExperimentOptions, recipes: int, taken: set[str]) -> RecipeSource:
    """Load a recipe at the size of the options, under a folder name that no other has."""
    height, width = options.size
    changes = {"camera.width": width, "camera.height": height}
    resolved = resolve_recipe(name, changes, allow_code=options.training.allow_code)
    resolved.check_code()
    stem = re.sub(r"[^A-Za-z0-9_.-]+", "_", resolved.recipe.name).strip(".") or "set"
    folder, number = stem, 1
    while folder in taken:
        number += 1
        folder = f"{stem}_{number}"
    taken.add(folder)
    frames = spread_frames(resolved.recipe.plan, max(3, options.frames // recipes))
    return RecipeSource(folder, resolved, frames)


def _build(
    source: RecipeSource, out: Path, options: ExperimentOptions, on_message: Callable[[str], None]
) -> ImageSet:
    """Build the missing frames of a recipe, and open them."""
    folder = out / "sets" / source.name
    result = build(
        source.recipe,
        folder,
        source.frames,
        OUTPUTS,
        BuildOptions(quality=options.quality, on_notice=on_message),
        on_frame=lambda progress: on_message(
            f"{source.name}: frame {progress.done} of {progress.total} {'built' if progress.made else 'kept'}"
            + ("" if progress.left_s is None else f", {progress.left_s:.0f} s left")
        ),
    )
    return open_images(result.dataset.folder)

"""The images of the experiments: synthetic sets with plants for training, validation and test; real folds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.dataset import BuildOptions, BuildProgress, build, load_recipe
from pepperscene.dataset.readers import PublishedSet, RenderedSet, open_images
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.recipe.plan import Plan
from pepperscene.errors import InputError
from pepperscene.learning.experiment_options import ExperimentOptions

HELD_OUT: Final = 0.1
"""Fraction of the plants for the validation, and as many for the test of A. Chosen."""

# Section 2.8 of the paper, which counts images from 1.
_PAPER_SYNTHETIC: Final = (range(8750), range(8750, 8800), range(8850, 8900))
_PAPER_REAL: Final = (range(30), range(40, 50))


@dataclass(frozen=True)
class SyntheticImages:
    """Images of one source, divided so that no plant is in two parts.

    Attributes:
        name: of the recipe or the set.
        training, validation, test: the parts.
        note: how the parts were made, as a sentence.
    """

    name: str
    training: ImageSet
    validation: ImageSet
    test: ImageSet
    note: str


@dataclass(frozen=True)
class RealFold:
    """Real images for training, and others for the test."""

    training: ImageSet
    test: ImageSet


def synthetic_images(
    source: str,
    out: Path,
    options: ExperimentOptions,
    on_frame: Callable[[BuildProgress], None] | None = None,
) -> SyntheticImages:
    """Open a set, or build the frames of a recipe.

    Args:
        source: folder of a set, or name or file of a recipe.
        out: folder of the sets that are built.
        options: number, size and quality of the frames.
        on_frame: called after each frame that is built.
    """
    if Path(source).is_dir():
        half = {"half": "synthetic"} if _is_published(Path(source)) else {}
        return _divide(Path(source).resolve().name, open_images(source, **half))
    # Frames of the chosen size, as many of each scene.
    scenes = _scene_count(load_recipe(source).plan)
    each = max(1, round(options.frames / scenes))
    count = scenes * each
    frames = np.unique(np.linspace(0, count - 1, min(count, options.frames)).round().astype(int)).tolist()
    changes: dict[str, Any] = {
        "plan.frames": each,
        "plan.select": frames,
        "camera.width": options.size[0],
        "camera.height": options.size[1],
    }
    recipe = load_recipe(source, changes)
    folder = out / recipe.name
    build(recipe, folder, None, ("colour", "class"), BuildOptions(options.quality), on_frame)
    return _divide(recipe.name, open_images(folder))


def real_folds(images: ImageSet) -> tuple[RealFold, ...]:
    """Two folds: the first half for training and the second for the test, and the other way round.

    The published data set has one: that of the paper.

    Raises:
        InputError: there are fewer than four images.
    """
    if isinstance(images, PublishedSet):
        training, test = (images.take([n for n in part if n < len(images)]) for part in _PAPER_REAL)
        if len(training) and len(test):
            return (RealFold(training, test),)
    if len(images) < 4:
        raise InputError(images.name, f"must hold four real images or more, not {len(images)}")
    first, second = images[: len(images) // 2], images[len(images) // 2 :]
    return RealFold(first, second), RealFold(second, first)


def _is_published(folder: Path) -> bool:
    return (folder / "synthetic_image_color").is_dir() and (folder / "empirical_image_color").is_dir()


def _scene_count(plan: Plan) -> int:
    return plan.count // plan.frames


def _divide(name: str, images: ImageSet) -> SyntheticImages:
    if isinstance(images, PublishedSet) and len(images) > _PAPER_SYNTHETIC[2].stop:
        parts: Sequence[Sequence[int]] = _PAPER_SYNTHETIC
        note = "images 1 to 8750 for training, 8751 to 8800 for validation, 8851 to 8900 for the test"
    else:
        groups = _plant_groups(images)
        held = max(1, round(HELD_OUT * len(groups)))
        if len(groups) >= 3:
            chosen = groups[: -2 * held], groups[-2 * held : -held], groups[-held:]
            parts = [[position for group in part for position in group] for part in chosen]
            numbers = [len(part) for part in chosen]
            note = "plants of {} sets for training, {} for validation, {} for the test".format(*numbers)
        else:
            held = max(1, round(HELD_OUT * len(images)))
            positions = list(range(len(images)))
            parts = positions[: -2 * held], positions[-2 * held : -held], positions[-held:]
            note = "the parts share plants, because the set has too few"
    if not all(map(len, parts)):
        raise InputError(images.name, f"must hold three images or more, not {len(images)}")
    training, validation, test = (images.take(part) for part in parts)
    return SyntheticImages(name, training, validation, test, f"{name}: {note}")


def _plant_groups(images: ImageSet) -> list[list[int]]:
    """Positions of the images of each set of plants; one group if plants are not known."""
    if not isinstance(images, RenderedSet):
        return [list(range(len(images)))]
    table = images.dataset.manifest()
    set_of = dict(zip(table["index"].to_pylist(), table["set"].to_pylist(), strict=True))
    groups: dict[int, list[int]] = {}
    for position, index in enumerate(images.items):
        groups.setdefault(set_of[index], []).append(position)
    return [groups[number] for number in sorted(groups)]

"""What the JSON files say: of a data set or a single frame, and of the photographs in it."""

from __future__ import annotations

from typing import Any

from pepperscene.dataset.recipe.plan import FrameSpec, frame_seed
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.frame import Frame
from pepperscene.truth import class_pixel_counts
from pepperscene.version import __version__


def dataset_info(
    recipe: Recipe, quality: str, form: str, target_error: float | None = None
) -> dict[str, Any]:
    """What frames depend on, but for their index: recipe, files, quality and version.

    Args:
        recipe: what is shown.
        quality: "draft", "standard" or "reference".
        form: name and number of the file's format.
        target_error: instead of the quality's own, or None.
    """
    told = {
        "format": form,
        "version": __version__,
        "quality": quality if target_error is None else f"{quality}, target error {target_error:g}",
        "recipe_sha256": recipe.sha256(),
        **recipe.identity(),
    }
    if recipe.expect is not None:
        told["expect"] = recipe.expect.model_dump(mode="json", exclude_none=True)
    return told


def frame_metadata(frame: Frame, shot: FrameSpec, recipe_seed: int) -> dict[str, Any]:
    """A frame's JSON but for its files; nothing in it differs between two runs."""
    facts: dict[str, Any] = {str(key): value for key, value in frame.metadata.items()}
    facts |= {
        "index": shot.index,
        "set": shot.set,
        "rotation": shot.rotation,
        "step": shot.step,
        "seed": frame_seed(recipe_seed, shot.index),
        "recipe_seed": recipe_seed,
    }
    if "class" in frame.images:
        facts["class_pixels"] = class_pixel_counts(frame.images["class"])
    return facts

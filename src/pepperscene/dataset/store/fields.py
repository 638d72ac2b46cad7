"""Reading the files of a data set with a check of all that readers, exports and reports use.

A data set may come from anywhere. Each function here returns the content of a file only if all that this
package uses of it has the right types; further keys are ignored. Whoever uses the content need not check it.
The check of a frame's JSON takes half a millisecond for 300 instances, as long as parsing it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.store.dataset import MARK, Dataset
from pepperscene.dataset.store.field_models import DatasetFields, FrameFields, HarvestFields
from pepperscene.dataset.store.images import read_image
from pepperscene.document import validate
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS


def frame_indices(dataset: Dataset) -> tuple[int, ...]:
    """The existing frames, ascending; raises `InputError` if there are none."""
    indices = dataset.indices()
    if not indices:
        raise InputError(dataset.folder, "holds no frames yet; build some first")
    return indices


def read_info(dataset: Dataset) -> Mapping[str, Any]:
    """The content of `dataset.json`, of valid types; raises `InputError` otherwise."""
    validate(DatasetFields, dataset.info, dataset.folder / MARK)
    return dataset.info


def has_ignored_pixels(info: Mapping[str, Any]) -> bool:
    """Whether the recipe in a `dataset.json`, of any content, lets images hold `IGNORE_CLASS`."""
    recipe = info.get("recipe")
    greenhouse = recipe.get("greenhouse") if isinstance(recipe, dict) else None
    return isinstance(greenhouse, dict) and greenhouse.get("far_rows_as") == "ignore"


def read_frame(dataset: Dataset, index: int) -> dict[str, Any]:
    """The content of a frame's JSON, of valid types; raises `InputError` if it is missing or damaged."""
    path = dataset.frame_path(index)
    content = dataset.metadata(index)
    validate(FrameFields, content, path)
    if content["index"] != index:
        raise InputError(path, f"must be {index}, as in the name", key="index", value=content["index"])
    return content


def read_output(dataset: Dataset, index: int, output: str) -> Any:
    """An output of a frame, as `Frame` holds it; of valid types if it is JSON.

    Raises:
        InputError: the file is missing, damaged, of another kind, or holds a class or distance that is none.
    """
    path = dataset.path(index, output)
    image, expected = read_image(path), OUTPUTS[output]
    if not expected.fits(image):
        raise InputError(
            path, f"must hold {expected.shape} {expected.dtype}, not {image.shape} {image.dtype}"
        )
    if output == "harvest":
        validate(HarvestFields, image, path)
    elif output == "class" and image.max(initial=0) >= len(OrganClass):
        is_ignored = image == IGNORE_CLASS if has_ignored_pixels(dataset.info) else False
        unknown = image[(image >= len(OrganClass)) & ~np.asarray(is_ignored)]
        if unknown.size:
            allowed = f"must hold class ids from 0 to {len(OrganClass) - 1}"
            raise InputError(path, f"{allowed}, not {int(unknown.max())}")
    elif output == "distance" and not (image >= 0).all():
        # Written so that nan fails too.
        raise InputError(path, "must hold distances from 0 metres, inf for none")
    return image

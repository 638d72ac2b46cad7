"""Labelled pictures for torch: the way in, which needs torch only once it is called."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.dataset.export.splits import Splits
from pepperscene.dataset.readers import RenderedSet, open_images
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import InputError, SetupError

if TYPE_CHECKING:
    from pepperscene.dataset.readers.torch_dataset import TorchImages


Sample = Mapping[str, Any]

KEYS: Final[Mapping[str, str]] = {
    "image": "colour", "mask": "classes", "instances": "instances", "distance": "distance_m",
}  # fmt: skip
"""What a sample can hold, and the field of `LabelledImage` that each is made of."""


def torch_images(
    source: ImageSet | str | Path,
    keys: Sequence[str] = ("image", "mask"),
    *,
    transform: Callable[[Sample], Sample] | None = None,
    dtype: str = "float32",
    splits: Splits | None = None,
    split: str = "train",
) -> TorchImages:
    """Labelled pictures as a `torch.utils.data.Dataset`.

    Args:
        source: a set of pictures, or a folder that `open_images` reads.
        keys: of a sample, out of `KEYS`: `image` (3, h, w), `mask` (h, w) int64 with class ids and `VOID`
            (255, for `ignore_index`), `instances` (h, w) int64, `distance` (h, w) float32 in metres, inf for
            none. Besides, a sample has its `name`.
        transform: takes a sample and returns another; must be picklable for workers.
        dtype: of the image: "float32", 0 to 1, or "uint8", 0 to 255.
        splits: of a data set of this package, whose frames have indices; None for all pictures.
        split: the one wanted of them.

    Raises:
        InputError: the folder cannot be read, an argument is not one of those allowed, or the split is empty.
        SetupError: torch is not installed.
    """
    unknown = [key for key in keys if key not in KEYS]
    if unknown or not keys:
        raise InputError("keys", f"must be some of {', '.join(KEYS)}, not {', '.join(unknown) or 'none'}")
    if dtype not in ("float32", "uint8"):
        raise InputError("dtype", f"must be float32 or uint8, not {dtype!r}")
    try:
        from pepperscene.dataset.readers.torch_dataset import TorchImages
    except ModuleNotFoundError as fault:
        if fault.name != "torch":
            raise
        raise SetupError("torch is not installed; `pip install torch` brings it") from None
    images = source if isinstance(source, ImageSet) else open_images(source)
    chosen = images if splits is None else in_split(images, splits, split)
    return TorchImages(chosen.select(*(KEYS[key] for key in keys)), tuple(keys), transform, dtype)


def in_split(images: ImageSet, splits: Splits, split: str) -> RenderedSet:
    """The frames of a data set that belong to a split.

    Raises:
        InputError: the pictures are no frames of a plan, or none of them belongs to it.
    """
    if not isinstance(images, RenderedSet):
        raise InputError("splits", f"go by frame index, which the pictures of {images.name} have not")
    places = [place for place, index in enumerate(images.items) if splits.named(index) == split]
    if not places:
        raise InputError("split", f"{split!r} holds no frame of {images.name}")
    return images.take(places)

"""Entry point to labelled images for torch, which imports torch when it is called."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.dataset.export.splits import Splits
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.open import RenderedSet, open_images
from pepperscene.errors import ArgumentError, SetupError

if TYPE_CHECKING:
    from pepperscene.dataset.readers.torch_dataset import TorchImages


Sample = Mapping[str, Any]

_FIELDS: Final[Mapping[str, str]] = {
    "image": "colour", "mask": "classes", "instances": "instances", "distance": "distance_m",
}  # fmt: skip
"""Field of `LabelledImage` by key of a sample."""


def torch_images(
    source: ImageSet | str | Path,
    keys: Sequence[str] = ("image", "mask"),
    *,
    transform: Callable[[Sample], Sample] | None = None,
    dtype: str = "float32",
    splits: Splits | None = None,
    split: str = "train",
) -> TorchImages:
    """Labelled images as a `torch.utils.data.Dataset`.

    Args:
        source: a set of images, or a folder for `open_images`.
        keys: of a sample: `image` (3, h, w), `mask` (h, w) int64 with class ids and `VOID` (255, for
            `ignore_index`), `instances` (h, w) int64, `distance` (h, w) float32 in metres, inf for none. A
            sample also has its `name`.
        transform: takes a sample and returns another; must be picklable for workers.
        dtype: of the image: "float32", 0 to 1, or "uint8", 0 to 255.
        splits: of a data set of this package, whose frames have indices; None for all images.
        split: name of the split to use.

    Raises:
        InputError: the folder cannot be read, an argument is not allowed, or the split is empty.
        SetupError: torch is not installed.
    """
    unknown = [key for key in keys if key not in _FIELDS]
    if unknown or not keys:
        allowed = ", ".join(_FIELDS)
        raise ArgumentError("keys", f"must be some of {allowed}, not {', '.join(unknown) or 'none'}")
    if dtype not in ("float32", "uint8"):
        raise ArgumentError("dtype", f"must be float32 or uint8, not {dtype!r}")
    try:
        from pepperscene.dataset.readers.torch_dataset import TorchImages
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise SetupError("torch is not installed; install it with `pip install torch`") from None
    images = source if isinstance(source, ImageSet) else open_images(source)
    if splits is not None:
        images = _select_split(images, splits, split)
    fields = {key: _FIELDS[key] for key in keys}
    return TorchImages(images.select(*fields.values()), fields, transform, dtype)


def _select_split(images: ImageSet, splits: Splits, split: str) -> RenderedSet:
    if not isinstance(images, RenderedSet):
        raise ArgumentError("splits", f"need frame indices, which the images of {images.name} do not have")
    positions = [position for position, index in enumerate(images.items) if splits.split_of(index) == split]
    if not positions:
        raise ArgumentError("split", f"{split!r} holds no frame of {images.name}")
    return images.take(positions)

"""Entry points to labelled images for torch, which import torch when they are called."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.open import RenderedSet, open_images
from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_augment_steps import ARRAY_KEYS
from pepperscene.dataset.splits import Splits
from pepperscene.errors import ArgumentError, SetupError

if TYPE_CHECKING:
    from pepperscene.dataset.readers.torch_data import SampleOptions, TorchDetections, TorchImages


Sample = Mapping[str, Any]


def torch_images(
    source: ImageSet | str | Path,
    keys: Sequence[str] = ("image", "mask"),
    *,
    classes: str | None = None,
    ripe_from: float | None = None,
    augmentation: Augmentation | None = None,
    transform: Callable[[Sample], Sample] | None = None,
    dtype: str = "float32",
    tensors: str = "auto",
    seed: int | None = None,
    splits: Splits | None = None,
    split: str = "train",
) -> TorchImages:
    """Labelled images as a `torch.utils.data.Dataset`.

    Args:
        source: a set of images, or a folder for `open_images`.
        keys: of a sample: `image` (3, h, w), `mask` (h, w) int64 with class ids and `VOID` (255, for
            `ignore_index`), `instances` (h, w) int64, and the names of other outputs that `LabelledImage`
            has, such as `distance`: (h, w) float32, or int64 for integers, with the same values. A sample
            also has its `name`.
        classes: "fruit=pepper,stalk=peduncle+stem", the classes of `mask`, numbered as by
            `pepperscene export --format semantic --classes`; the attribute `classes` of the result has their
            names. None for all classes, which are class ids without `ripe_from`.
        ripe_from: least ripeness of ripe fruit, which divides a class of all fruit, as of `export_dataset`.
            Ripeness needs a data set of this package with the outputs instance and harvest.
        augmentation: random changes of image and labels together, before the transform.
        transform: takes a sample and returns another, such as one of `torchvision.transforms.v2`; must be
            picklable for workers.
        dtype: of the image: "float32", 0 to 1, or "uint8", 0 to 255.
        tensors: "tv" for `tv_tensors.Image`, and `tv_tensors.Mask` for all labels, of torchvision 0.16 or
            newer; "plain" for plain tensors; "auto" for "tv" if torchvision can be imported, otherwise
            "plain". The attribute `tensors` of the result says which.
        seed: the random numbers of a sample depend only on this, the number given to `set_epoch` and the
            position of the sample, also those of the global generators of torch, NumPy and `random` in the
            transform. None: they come from the generators that the `DataLoader` seeds in each worker.
        splits: of a data set of this package, whose frames have indices; None for all images.
        split: name of the split to use.

    Raises:
        InputError: the folder cannot be read, an argument is not allowed, or the split is empty.
        SetupError: torch is not installed, or `tensors` is "tv" and torchvision cannot be imported.
    """
    keys = _as_tuple(keys)
    unknown = [str(key) for key in keys if key not in ARRAY_KEYS]
    if unknown or not keys:
        allowed = ", ".join(ARRAY_KEYS)
        raise ArgumentError("keys", f"must be some of {allowed}, not {', '.join(unknown) or 'none'}")
    options = _sample_options(augmentation, transform, dtype, tensors, seed)
    images = _open_split(source, splits, split)
    from pepperscene.dataset.readers.torch_data import MaskClasses, TorchImages

    is_mapped = classes is not None or ripe_from is not None
    mapping = MaskClasses.parse(images, classes, ripe_from) if is_mapped else None
    return TorchImages(images, keys, options, mapping)


def torch_detections(
    source: ImageSet | str | Path,
    classes: Sequence[str | int] = ("pepper",),
    *,
    min_pixels: int = 1,
    augmentation: Augmentation | None = None,
    transform: Callable[[Any, dict[str, Any]], Any] | None = None,
    dtype: str = "float32",
    tensors: str = "auto",
    seed: int | None = None,
    splits: Splits | None = None,
    split: str = "train",
) -> TorchDetections:
    """Images and the objects in them, in the form of torchvision's detection models and references.

    A sample is a pair of the image (3, h, w) and a dictionary of its n objects:

    - `boxes` (n, 4) float32: left, top, right and bottom edge in pixels, where the first pixel reaches from 0
      to 1; with torchvision a `tv_tensors.BoundingBoxes` of the format XYXY.
    - `labels` (n,) int64: the position in `classes`, from 1; 0 is the background of detection models.
    - `masks` (n, h, w) uint8: 1 for the visible pixels; with torchvision a `tv_tensors.Mask`.
    - `image_id`: the position in the set, an integer.
    - `area` (n,) float32: the number of visible pixels, as in COCO.
    - `iscrowd` (n,) int64: all 0.

    An object is all pixels of one instance number and one class. Objects of the class 255 (void) are left
    out. Images without objects have tensors of length 0. Use `collate_detections` for batches.

    Args:
        source: a set of images with class and instance images, or a folder for `open_images`.
        classes: names or ids of classes.
        min_pixels: objects with fewer visible pixels are left out; they are counted after augmentation.
        augmentation: random changes of image and labels together; boxes are made from the changed labels.
        transform: takes an image and a dictionary and returns both, such as one of
            `torchvision.transforms.v2`; must be picklable for workers.
        dtype: of the image: "float32", 0 to 1, or "uint8", 0 to 255.
        tensors: "auto", "plain" or "tv", as of `torch_images`.
        seed: as of `torch_images`.
        splits: of a data set of this package, whose frames have indices; None for all images.
        split: name of the split to use.

    Raises:
        InputError: the folder cannot be read, an argument is not allowed, or the split is empty.
        SetupError: torch is not installed, or `tensors` is "tv" and torchvision cannot be imported.
    """
    if not isinstance(min_pixels, int | np.integer) or min_pixels < 1:
        raise ArgumentError("min_pixels", f"must be an integer from 1, not {min_pixels!r}")
    ids = _class_ids(classes)
    options = _sample_options(augmentation, transform, dtype, tensors, seed)
    from pepperscene.dataset.readers.torch_data import TorchDetections

    return TorchDetections(_open_split(source, splits, split), options, ids, int(min_pixels))


def collate_detections(samples: Iterable[tuple[Any, Any]]) -> tuple[list[Any], list[Any]]:
    """A batch of `torch_detections` as a list of images and a list of dictionaries.

    Pass it as `collate_fn` of a `DataLoader`: images have different numbers of objects, which are no single
    tensor. Detection models of torchvision take these two lists.
    """
    images, targets = [], []
    for image, target in samples:
        images.append(image)
        targets.append(target)
    return images, targets


def _sample_options(
    augmentation: Augmentation | None,
    transform: Callable[..., Any] | None,
    dtype: str,
    tensors: str,
    seed: int | None,
) -> SampleOptions:
    if dtype not in ("float32", "uint8"):
        raise ArgumentError("dtype", f"must be float32 or uint8, not {dtype!r}")
    if augmentation is not None and not isinstance(augmentation, Augmentation):
        kind = type(augmentation).__name__
        raise ArgumentError("augmentation", f"must be an Augmentation, not {kind}: pass others as transform")
    if transform is not None and not callable(transform):
        raise ArgumentError("transform", f"must be a function, not {transform!r}")
    if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
        raise ArgumentError("seed", f"must be an integer from 0, or None, not {seed!r}")
    try:
        from pepperscene.dataset.readers.torch_data import SampleOptions, choose_tensors
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise SetupError("torch is not installed; install it with `pip install torch`") from None
    kind_of_tensors = choose_tensors(tensors)
    return SampleOptions(augmentation, transform, dtype, kind_of_tensors, None if seed is None else int(seed))


def _class_ids(classes: Sequence[str | int]) -> tuple[int, ...]:
    names = {organ_class.name.lower(): int(organ_class) for organ_class in OrganClass}
    given = _as_tuple(classes)
    ids = tuple(names.get(item, -1) if isinstance(item, str) else item for item in given)
    if not ids or len(set(ids)) < len(ids) or not set(ids) <= set(names.values()):
        allowed = f"{', '.join(names)}, each once"
        raise ArgumentError(
            "classes", f"must be some of {allowed}, not {', '.join(map(str, given)) or 'none'}"
        )
    return tuple(map(int, ids))


def _as_tuple(values: Any) -> tuple[Any, ...]:
    """The values of a sequence, or the only one."""
    return tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else (values,)


def _open_split(source: ImageSet | str | Path, splits: Splits | None, split: str) -> ImageSet:
    images = source if isinstance(source, ImageSet) else open_images(source)
    if splits is None:
        return images
    if not isinstance(images, RenderedSet):
        raise ArgumentError("splits", f"need frame indices, which the images of {images.name} do not have")
    positions = [position for position, index in enumerate(images.items) if splits.split_of(index) == split]
    if not positions:
        raise ArgumentError("split", f"{split!r} holds no frame of {images.name}")
    return images.take(positions)

"""The crops that a network is trained on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_augment_steps import (
    ColourJitter,
    RandomBlur,
    RandomFlip,
    RandomJpeg,
    RandomNoise,
    RandomResizedCrop,
)
from pepperscene.errors import InputError, PepperError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.objects import object_indices
from pepperscene.learning.options import TrainingOptions
from pepperscene.learning.training.colour_matching import ColourMatching


@final
class TrainingSamples(torch.utils.data.Dataset):
    """All crops of a training by number: crop n is the same in every run with the same seed.

    Every image occurs once before one occurs again. A crop is a pair: image `(3, h, w)` uint8, and labels
    `(h, w)` uint8, indices of the classes or 255. For a detector, labels are `(2, h, w)` int32: indices, with
    the number of classes for pixels of none of them, and numbers of instances.
    """

    def __init__(
        self,
        sets: Sequence[ImageSet],
        labels: ClassTable,
        options: TrainingOptions,
        matching: ColourMatching | None = None,
    ) -> None:
        self._detects = options.task == "detect"
        fields = ("colour", "classes", "instances") if self._detects else ("colour", "classes")
        self._sets = [images.select(*fields) for images in sets]
        self._images = [
            (which, position) for which, images in enumerate(sets) for position in range(len(images))
        ]
        self._labels, self._seed, self._width = labels, options.seed, options.width
        self._matching = matching
        self._augmentation = _augmentation(options.size, options.augmentation)

    def __getitem__(self, number: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Crop with a number; raises `InputError` if its image has no colour or no mask."""
        epoch, place = divmod(int(number), len(self._images))
        order = np.random.default_rng([self._seed, 0, epoch]).permutation(len(self._images))
        which, position = self._images[order[place]]
        arrays = self._read(self._sets[which], position)
        if self._matching is not None:
            own = np.random.default_rng([self._seed, 2, int(number)])
            arrays["image"] = self._matching(arrays["image"], own)
        # Random changes depend on the number alone, not on the worker that makes them.
        rng = np.random.default_rng([self._seed, 1, int(number)])
        changed = self._augmentation.apply(arrays, rng)
        image = torch.from_numpy(np.ascontiguousarray(changed["image"].transpose(2, 0, 1)))
        labels = changed["mask"]
        if self._detects:
            labels = np.stack([labels, changed["instances"]]).astype(np.int32)
        return image, torch.from_numpy(np.ascontiguousarray(labels))

    def _read(self, images: ImageSet, position: int) -> dict[str, NDArray[Any]]:
        image = images[position]
        needed: dict[str, Any] = {"colour image": image.colour, "mask": image.classes}
        if self._detects:
            needed["image of instances"] = image.instances
        for name, array in needed.items():
            if array is None:
                raise InputError(images.name, f"{image.name} has no {name}, which training needs")
        assert image.classes is not None
        indices = object_indices if self._detects else ClassTable.indices
        arrays: dict[str, Any] = {"image": image.colour, "mask": indices(self._labels, image.classes)}
        if self._detects:
            # Pillow takes other pixels of 16-bit images than of class images.
            arrays["instances"] = np.asarray(image.instances, np.int32)
        return _scaled(arrays, self._width)


@final
class TrainingBatches(torch.utils.data.Dataset):
    """The crops of each step, counted from 0, or the error of reading one.

    A `DataLoader` does not bring errors of several arguments back from its workers.
    """

    def __init__(self, samples: TrainingSamples, size: int) -> None:
        self._samples, self._size = samples, size

    def __getitem__(self, step: int) -> tuple[torch.Tensor, torch.Tensor] | PepperError:
        """Images and labels of a step."""
        try:
            pairs = [self._samples[number] for number in range(step * self._size, (step + 1) * self._size)]
        except PepperError as error:
            return error
        images, labels = zip(*pairs, strict=True)
        return torch.stack(images), torch.stack(labels)


def _augmentation(size: tuple[int, int], strength: float) -> Augmentation:
    """Random changes of a strength from 0 to 2; at 0, crops are moved only.

    The amounts at strength 1 are those of `Augmentation.standard`.
    """
    crop = RandomResizedCrop(size, scale=(0.5**strength, 2.0**strength))
    if strength == 0:
        return Augmentation((crop,))
    spread = min(1.0, 0.25 * strength)
    jitter = ColourJitter(
        brightness=spread,
        contrast=spread,
        saturation=spread,
        hue=0.02 * strength,
        gamma=min(1.0, 0.2 * strength),
        gains=0.06 * strength,
    )
    blur, noise = RandomBlur(sigma_px=1.5 * strength), RandomNoise(sigma=8.0 * strength)
    return Augmentation((RandomFlip(), crop, jitter, blur, noise, RandomJpeg()))


def _scaled(arrays: dict[str, NDArray[Any]], width: int | None) -> dict[str, NDArray[Any]]:
    """Arrays at a width; labels are not interpolated."""
    height, own = arrays["image"].shape[:2]
    if width is None or own == width:
        return arrays
    size = (width, max(1, round(height * width / own)))
    filters = {"image": Image.Resampling.BILINEAR}
    return {
        key: np.asarray(Image.fromarray(array).resize(size, filters.get(key, Image.Resampling.NEAREST)))
        for key, array in arrays.items()
    }

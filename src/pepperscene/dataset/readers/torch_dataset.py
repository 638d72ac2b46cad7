"""Labelled images as torch data sets; imported only on demand, since importing torch takes seconds."""

from __future__ import annotations

import operator
from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
import torch
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import ARRAYS, ImageSet
from pepperscene.dataset.readers.mask_classes import MaskClasses
from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_augment_step import ARRAY_KEYS
from pepperscene.dataset.readers.torch_objects import find_objects
from pepperscene.dataset.readers.torch_seeds import drawn_generator, global_seeds, sample_seeds
from pepperscene.dataset.readers.torch_tensors import TensorTypes, image_tensor, label_tensor
from pepperscene.errors import ArgumentError, InputError

FIELDS: Final[Mapping[str, str]] = dict(zip(ARRAY_KEYS, ARRAYS, strict=True))
"""Field of `LabelledImage` by key of a sample."""


@dataclass(frozen=True)
class SampleOptions:
    """How samples are made, for all torch data sets; see `torch_images`."""

    augmentation: Augmentation | None
    transform: Callable[..., Any] | None
    dtype: str
    tensors: TensorTypes
    seed: int | None


class TorchSet(torch.utils.data.Dataset):
    """A map-style data set, which the workers of a `DataLoader` read in parallel.

    Nothing is kept between samples, so that memory does not grow.
    """

    missing_hint: str
    """End of the message about an image without one of the keys."""

    def __init__(self, images: ImageSet, keys: tuple[str, ...], options: SampleOptions) -> None:
        self.images = images.select(*(FIELDS[key] for key in keys))
        self.keys, self.options = keys, options
        # In shared memory, where workers that stay alive between epochs (persistent_workers) see it.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def __len__(self) -> int:
        return len(self.images)

    def __repr__(self) -> str:
        kind = "tv_tensors of torchvision" if self.options.tensors.name == "tv" else "plain tensors"
        name = type(self).__name__
        return f"<{name} {self.images.name}: {len(self)} images, {', '.join(self.keys)}, as {kind}>"

    @property
    def tensors(self) -> str:
        """The type of the tensors: "plain", or "tv" for those of `torchvision.tv_tensors`."""
        return self.options.tensors.name

    @property
    def epoch(self) -> int:
        """The number given to `set_epoch`, at first 0."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Change the random numbers of a data set with a seed; call it before each epoch.

        Workers that stay alive between epochs notice it, too.

        Args:
            epoch: 0 or more.

        Raises:
            ArgumentError: the number is no integer, or below 0.
        """
        if not isinstance(epoch, int | np.integer) or epoch < 0:
            raise ArgumentError("epoch", f"must be an integer from 0, not {epoch!r}")
        self._epoch.fill_(int(epoch))

    def _targets(self, position: int, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """The arrays as targets of training, before they are augmented."""
        return arrays

    @abstractmethod
    def _parts(self, position: int, name: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, ...]:
        """The arguments of the transform, which are the sample if there is none."""

    def __getitem__(self, position: int) -> Any:
        """The sample at a position, read from its files, augmented and transformed."""
        image = self.images[position]
        position = operator.index(position) % len(self)
        arrays = {key: getattr(image, FIELDS[key]) for key in self.keys}
        for key, array in arrays.items():
            if array is None:
                raise InputError(self.images.name, f"{image.name} has no {key}{self.missing_hint}")
        arrays = self._targets(position, arrays)
        rng, seeds = self._random_numbers(position)
        if self.options.augmentation is not None:
            arrays = dict(self.options.augmentation.apply(arrays, rng))
        parts = self._parts(position, image.name, arrays)
        if self.options.transform is not None:
            with seeds:
                return self.options.transform(*parts)
        return parts if len(parts) > 1 else parts[0]

    def _random_numbers(self, position: int) -> tuple[np.random.Generator, AbstractContextManager[None]]:
        """The generator of the augmentation, and a context with the seeds of the transform."""
        if self.options.seed is not None:
            rng, seed = sample_seeds(self.options.seed, self.epoch, position)
            return rng, global_seeds(seed)
        return drawn_generator() if self.options.augmentation else np.random.default_rng(0), nullcontext()

    def _image(self, image: NDArray[np.uint8]) -> torch.Tensor:
        return self.options.tensors.image(image_tensor(image, self.options.dtype))


@final
class TorchImages(TorchSet):
    """Samples are dictionaries of tensors for each pixel; see `torch_images`."""

    missing_hint = ": leave it out of keys"

    def __init__(
        self, images: ImageSet, keys: tuple[str, ...], options: SampleOptions, mapping: MaskClasses | None
    ) -> None:
        super().__init__(images, keys, options)
        self.mapping = mapping

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes by their value in `mask`."""
        if self.mapping is None:
            return tuple(organ_class.name.lower() for organ_class in OrganClass)
        return self.mapping.names

    def _targets(self, position: int, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        if self.mapping is None or "mask" not in arrays:
            return arrays
        return {**arrays, "mask": self.mapping.mask(self.images, position, arrays["mask"])}

    def _parts(self, position: int, name: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, ...]:
        sample: dict[str, Any] = {"name": name}
        for key in self.keys:
            if key == "image":
                sample[key] = self._image(arrays[key])
            else:
                sample[key] = self.options.tensors.mask(label_tensor(arrays[key]))
        return (sample,)


@final
class TorchDetections(TorchSet):
    """Samples are pairs of an image and the targets of a detector; see `torch_detections`."""

    missing_hint = ", which detections need"

    def __init__(
        self,
        images: ImageSet,
        options: SampleOptions,
        classes: tuple[int, ...],  # ids of the classes of the labels 1, 2, ...
        min_pixels: int,
    ) -> None:
        super().__init__(images, ("image", "mask", "instances"), options)
        self.classes, self.min_pixels = classes, min_pixels

    def _parts(self, position: int, name: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, ...]:
        found = find_objects(arrays["mask"], arrays["instances"], self.classes, self.min_pixels)
        tensors, size = self.options.tensors, found.masks.shape[1:]
        target = {
            "boxes": tensors.boxes(torch.from_numpy(found.boxes), (size[0], size[1])),
            "labels": torch.from_numpy(found.labels),
            "masks": tensors.mask(torch.from_numpy(found.masks)),
            "image_id": position,
            "area": torch.from_numpy(found.pixels.astype(np.float32)),
            "iscrowd": torch.zeros(len(found.labels), dtype=torch.int64),
        }
        return self._image(arrays["image"]), target

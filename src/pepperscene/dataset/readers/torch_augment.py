"""Random changes of images together with their labels, for training; works without torchvision.

The steps compute with NumPy and Pillow, so that importing this module does not import torch.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self, final

import numpy as np

from pepperscene.dataset.readers.torch_augment_steps import (
    ARRAY_KEYS,
    Arrays,
    AugmentationStep,
    ColourJitter,
    RandomBlur,
    RandomFlip,
    RandomJpeg,
    RandomNoise,
    RandomResizedCrop,
)
from pepperscene.errors import ArgumentError


@final
@dataclass(frozen=True)
class Augmentation:
    """Random changes of a sample, one after another.

    Pass it as `augmentation=` of `torch_images` or `torch_detections`, which give it a generator for each
    sample. It is also a function of a sample with uint8 images, and can be passed as `transform=`.

    Attributes:
        steps: are applied in this order.

    Raises:
        ArgumentError: the steps are no sequence, or one is no `AugmentationStep`.
    """

    steps: tuple[AugmentationStep, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.steps, Iterable):
            kind = type(self.steps).__name__
            raise ArgumentError("steps", f"must be a sequence of augmentation steps, not {kind}")
        object.__setattr__(self, "steps", tuple(self.steps))
        for step in self.steps:
            if not isinstance(step, AugmentationStep):
                kind = type(step).__name__
                raise ArgumentError("steps", f"must be augmentation steps, such as RandomFlip(), not {kind}")

    @classmethod
    def standard(cls, size: tuple[int, int]) -> Self:
        """All steps with moderate strengths.

        Args:
            size: height and width of the results, in pixels.

        Raises:
            ArgumentError: the size is not two integers above 0.
        """
        # In the order in which a camera does it: geometry, light, lens, sensor, file.
        crop = RandomResizedCrop(size)
        return cls((RandomFlip(), crop, ColourJitter(), RandomBlur(), RandomNoise(), RandomJpeg()))

    def apply(self, arrays: Arrays, rng: np.random.Generator) -> Arrays:
        """The arrays of a sample after all steps; see `AugmentationStep.apply`."""
        for step in self.steps:
            arrays = step.apply(arrays, rng)
        return arrays

    def __call__(self, sample: Mapping[str, Any], rng: np.random.Generator | None = None) -> dict[str, Any]:
        """A changed copy of a sample.

        Args:
            sample: as `torch_images` returns it: `image` (3, h, w) uint8, `mask`, `instances`, `distance`,
                `depth_z`, `depth_sensor` and traits of tissue (h, w); other keys are copied. The types of the
                tensors are kept.
            rng: source of the random numbers; None seeds one from torch's generator, which a `DataLoader`
                seeds differently in each worker.

        Raises:
            ArgumentError: the image is not uint8.
        """
        import torch

        if rng is None:
            rng = np.random.default_rng(int(torch.randint(2**62, ())))
        tensors = {key: sample[key] for key in ARRAY_KEYS if key in sample}
        if "image" in tensors and tensors["image"].dtype != torch.uint8:
            problem = "must be uint8 to be augmented: pass augmentation=, or dtype='uint8'"
            raise ArgumentError("image", problem)
        arrays = {key: tensor.numpy() for key, tensor in tensors.items()}
        if "image" in arrays:
            arrays["image"] = arrays["image"].transpose(1, 2, 0)
        result = dict(sample)
        for key, array in self.apply(arrays, rng).items():
            planes = array.transpose(2, 0, 1) if key == "image" else array
            # A copy, because unchanged arrays share their memory with the sample.
            result[key] = torch.from_numpy(np.array(planes, order="C")).as_subclass(type(sample[key]))
        return result

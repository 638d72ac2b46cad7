"""Labelled pictures as a torch data set; imported only when one is wanted, as torch takes seconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, final

import torch
from numpy.typing import NDArray

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.torch_images import KEYS, Sample
from pepperscene.errors import InputError


@final
class TorchImages(torch.utils.data.Dataset):
    """A map-style data set, which workers of a `DataLoader` read side by side.

    Args:
        images: the pictures, of which only what is needed is read.
        keys: of a sample.
        transform: of a sample, or None.
        dtype: of the image.
    """

    def __init__(
        self,
        images: ImageSet,
        keys: tuple[str, ...],
        transform: Callable[[Sample], Sample] | None,
        dtype: str,
    ) -> None:
        self.images, self.keys, self.transform, self.dtype = images, keys, transform, dtype

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, place: int) -> Mapping[str, Any]:
        """A sample: tensors by key, and the picture's `name`.

        Raises:
            InputError: the picture lacks what a key is made of, or a file is damaged.
        """
        picture = self.images[int(place)]
        sample: dict[str, Any] = {"name": picture.name}
        for key in self.keys:
            image = getattr(picture, KEYS[key])
            if image is None:
                raise InputError(self.images.name, f"{picture.name} has no {key}: leave it out of keys")
            sample[key] = self._tensor(key, image)
        return sample if self.transform is None else self.transform(sample)

    def _tensor(self, key: str, image: NDArray[Any]) -> torch.Tensor:
        if key == "image":
            chw = torch.from_numpy(image).permute(2, 0, 1).contiguous()
            return chw.to(torch.float32) / 255.0 if self.dtype == "float32" else chw
        # Indices are int64 to torch, and its unsigned 16 bits know hardly any operation.
        return torch.from_numpy(image if key == "distance" else image.astype("int64"))

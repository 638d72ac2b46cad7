"""Labelled images as a torch data set; imported only on demand, since importing torch takes seconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, final

import torch
from numpy.typing import NDArray

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import InputError


@final
class TorchImages(torch.utils.data.Dataset):
    """A map-style data set, which the workers of a `DataLoader` read in parallel; see `torch_images`."""

    def __init__(
        self,
        images: ImageSet,
        fields: Mapping[str, str],  # of `LabelledImage` by key of a sample
        transform: Callable[[Mapping[str, Any]], Mapping[str, Any]] | None,
        dtype: str,
    ) -> None:
        self.images, self.fields, self.transform, self.dtype = images, dict(fields), transform, dtype

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, position: int) -> Mapping[str, Any]:
        """A sample: tensors by key, and the image's `name`."""
        image = self.images[int(position)]
        sample: dict[str, Any] = {"name": image.name}
        for key, field in self.fields.items():
            array = getattr(image, field)
            if array is None:
                raise InputError(self.images.name, f"{image.name} has no {key}: leave it out of keys")
            sample[key] = self._tensor(key, array)
        return sample if self.transform is None else self.transform(sample)

    def _tensor(self, key: str, array: NDArray[Any]) -> torch.Tensor:
        if key == "image":
            chw = torch.from_numpy(array).permute(2, 0, 1).contiguous()
            return chw.to(torch.float32) / 255.0 if self.dtype == "float32" else chw
        # torch uses int64 for indices, and supports hardly any operation on uint16.
        return torch.from_numpy(array if key == "distance" else array.astype("int64"))

"""Sets of images in memory, and a small stand-in for torchvision, which is not a dependency of the tests.

The stand-in has the names, arguments and types of the documentation of torchvision 0.16 and newer:
`tv_tensors.Image(data)`, `.Mask(data)` and `.BoundingBoxes(data, *, format, canvas_size)`, all subclasses of
`torch.Tensor`, and a transform that takes and returns any nesting of them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from pepperscene.dataset.readers.image_set import FIELDS, ImageSet, LabelledImage


@dataclass(frozen=True, eq=False, kw_only=True)
class MemorySet(ImageSet):
    """Images in memory, as items (colour, classes, instances, distance)."""

    name: str = "memory"
    fields: tuple = FIELDS

    def names(self):
        return tuple(f"image{number}" for number in range(len(self.items)))

    def read(self, item):
        number = next(k for k, other in enumerate(self.items) if other is item)
        fields = dict(zip(("colour", "classes", "instances", "distance_m"), item, strict=True))
        return LabelledImage(
            f"image{number}",
            **{name: array if name in self.fields else None for name, array in fields.items()},
        )


def coded_images(count=4, height=40, width=60):
    """Images whose pixels say their own coordinates: red and green hold row and column, 2 codes a pixel.

    Classes and instances are functions of the coordinates, too.
    """
    rows, columns = np.indices((height, width))
    items = []
    for number in range(count):
        colour = np.stack([2 * rows + 1, 2 * columns + 1, np.full_like(rows, number)], axis=-1)
        instances = (1 + columns + width * rows).astype(np.uint16)
        classes = (columns // 8).astype(np.uint8) % 8
        items.append((colour.astype(np.uint8), classes, instances, (rows + columns).astype(np.float32)))
    return MemorySet(items=tuple(items))


def make_torchvision(torch):
    """The modules of the stand-in by name, for `sys.modules`."""

    class TVTensor(torch.Tensor):
        def __new__(cls, data, *, dtype=None, device=None, requires_grad=None):
            return torch.as_tensor(data, dtype=dtype, device=device).as_subclass(cls)

        # As in torchvision, operations return plain tensors.
        @classmethod
        def __torch_function__(cls, func, types, args=(), kwargs=None):
            with torch._C.DisableTorchFunctionSubclass():
                result = func(*args, **kwargs or {})
            keeps = func in (torch.Tensor.clone, torch.Tensor.to, torch.Tensor.detach)
            return result.as_subclass(cls) if keeps and isinstance(result, torch.Tensor) else result

    class Image(TVTensor):
        def __new__(cls, data, **kwargs):
            tensor = super().__new__(cls, data, **kwargs)
            if tensor.ndim < 2:
                raise ValueError
            return tensor

    class Mask(TVTensor):
        pass

    class BoundingBoxes(TVTensor):
        def __new__(cls, data, *, format, canvas_size, **kwargs):
            tensor = super().__new__(cls, data, **kwargs)
            assert format == "XYXY"
            assert len(canvas_size) == 2
            assert all(type(number) is int for number in canvas_size)
            tensor.format, tensor.canvas_size = format, canvas_size
            return tensor

    class RandomHorizontalFlip(torch.nn.Module):
        """As in `torchvision.transforms.v2`: takes and returns any nesting of dicts and tuples."""

        def __init__(self, p=0.5):
            super().__init__()
            self.p = p

        def forward(self, *inputs):
            result = inputs if len(inputs) > 1 else inputs[0]
            return result if torch.rand(1) >= self.p else self._flip(result)

        def _flip(self, value):
            if isinstance(value, dict):
                return {key: self._flip(item) for key, item in value.items()}
            if isinstance(value, tuple):
                return tuple(self._flip(item) for item in value)
            if isinstance(value, BoundingBoxes):
                flipped = torch.Tensor(value.as_subclass(torch.Tensor))[:, [2, 1, 0, 3]].clone()
                flipped[:, [0, 2]] = value.canvas_size[1] - flipped[:, [0, 2]]
                return BoundingBoxes(flipped, format=value.format, canvas_size=value.canvas_size)
            if isinstance(value, Image | Mask):
                return value.as_subclass(torch.Tensor).flip(-1).as_subclass(type(value))
            return value

    modules = {name: ModuleType(name) for name in _NAMES}
    for kind in (TVTensor, Image, Mask, BoundingBoxes):
        setattr(modules["torchvision.tv_tensors"], kind.__name__, kind)
    modules["torchvision.transforms.v2"].RandomHorizontalFlip = RandomHorizontalFlip
    modules["torchvision"].tv_tensors = modules["torchvision.tv_tensors"]
    return modules


_NAMES = ("torchvision", "torchvision.tv_tensors", "torchvision.transforms", "torchvision.transforms.v2")


def install_torchvision(monkeypatch, torch):
    """Make the stand-in importable; returns its modules `tv_tensors` and `transforms.v2`."""
    modules = make_torchvision(torch)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return modules["torchvision.tv_tensors"], modules["torchvision.transforms.v2"]


def remove_torchvision(monkeypatch):
    """Make torchvision fail to import."""
    for name in _NAMES:
        monkeypatch.setitem(sys.modules, name, None)

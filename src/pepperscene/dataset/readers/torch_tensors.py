"""The tensors of samples: plain ones, or those of `torchvision.tv_tensors`; imported only on demand.

Transforms of `torchvision.transforms.v2` know images, masks and boxes by the types of `tv_tensors`.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Final, final

import torch
from numpy.typing import NDArray

from pepperscene.errors import ArgumentError, SetupError

TENSORS: Final = ("auto", "plain", "tv")
"""Allowed values of the argument `tensors`."""


class TensorTypes(ABC):
    """Makes the tensors of samples from arrays; picklable, for workers."""

    name: str

    @abstractmethod
    def image(self, tensor: torch.Tensor) -> torch.Tensor:
        """An image `(3, h, w)`."""

    @abstractmethod
    def mask(self, tensor: torch.Tensor) -> torch.Tensor:
        """One value for each pixel `(h, w)`, or one mask for each object `(n, h, w)`."""

    @abstractmethod
    def boxes(self, tensor: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
        """Boxes `(n, 4)`, as left, top, right, bottom, in an image of this height and width."""


@final
@dataclass(frozen=True)
class PlainTensors(TensorTypes):
    """Plain `torch.Tensor` for everything."""

    name: str = "plain"

    def image(self, tensor: torch.Tensor) -> torch.Tensor:
        """The tensor itself."""
        return tensor

    def mask(self, tensor: torch.Tensor) -> torch.Tensor:
        """The tensor itself."""
        return tensor

    def boxes(self, tensor: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
        """The tensor itself."""
        return tensor


@final
@dataclass(frozen=True)
class TvTensors(TensorTypes):
    """Subclasses of `torch.Tensor` of `torchvision.tv_tensors`, torchvision 0.16 or newer."""

    name: str = "tv"

    def image(self, tensor: torch.Tensor) -> torch.Tensor:
        """A `tv_tensors.Image`."""
        return _tv_tensors().Image(tensor)

    def mask(self, tensor: torch.Tensor) -> torch.Tensor:
        """A `tv_tensors.Mask`."""
        return _tv_tensors().Mask(tensor)

    def boxes(self, tensor: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
        """A `tv_tensors.BoundingBoxes` of the format XYXY."""
        return _tv_tensors().BoundingBoxes(tensor, format="XYXY", canvas_size=size)


def choose_tensors(tensors: str) -> TensorTypes:
    """The tensor types of an argument: "auto", "plain" or "tv".

    Raises:
        ArgumentError: another value.
        SetupError: "tv", and torchvision cannot be imported.
    """
    if tensors not in TENSORS:
        raise ArgumentError("tensors", f"must be {', '.join(TENSORS)}, not {tensors!r}")
    if tensors == "plain":
        return PlainTensors()
    try:
        _tv_tensors()
    # A torchvision of another build than torch fails with one of these, and with others in future.
    except Exception as error:
        if tensors == "auto":
            return PlainTensors()
        lines = str(error).splitlines() or [type(error).__name__]
        problem = f"torchvision.tv_tensors cannot be imported ({lines[0]})"
        remedy = "install a torchvision of the same build as torch, or use tensors='plain'"
        raise SetupError(f"{problem}; {remedy}") from None
    return TvTensors()


def _tv_tensors() -> Any:
    return importlib.import_module("torchvision.tv_tensors")


def image_tensor(image: NDArray[Any], dtype: str) -> torch.Tensor:
    """The image `(h, w, 3)` uint8 as `(3, h, w)`: "uint8", or "float32" from 0 to 1."""
    # A copy in any case: arrays may be mirrored views, which torch does not take.
    chw = torch.from_numpy(image.transpose(2, 0, 1).copy())
    return chw.to(torch.float32).div_(255.0) if dtype == "float32" else chw


def label_tensor(values: NDArray[Any]) -> torch.Tensor:
    """Values of pixels `(h, w)`: int64 for integers, float32 for distances."""
    # torch uses int64 for indices, and supports hardly any operation on uint16.
    return torch.from_numpy(values.copy() if values.dtype.kind == "f" else values.astype("int64"))

"""Layers that networks of this package share."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from pepperscene.errors import ArgumentError


def check_width(width: object, most: float) -> None:
    """Raise `ArgumentError` unless a factor of the number of channels is above 0 and at most `most`."""
    if not isinstance(width, int | float) or not 0 < width <= most:
        raise ArgumentError("model", f"width must be a number above 0 and at most {most:g}, not {width}")


def convolution(
    inputs: int, outputs: int, stride: int = 1, dilation: int = 1, *, rectified: bool = True
) -> nn.Sequential:
    """A convolution of 3x3 pixels that keeps the size at stride 1, with batch normalisation."""
    layers: list[nn.Module] = [
        nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, bias=False),
        nn.BatchNorm2d(outputs),
    ]
    return nn.Sequential(*layers, *([nn.ReLU(inplace=True)] if rectified else []))


def join_finer(coarse: torch.Tensor, fine: torch.Tensor) -> torch.Tensor:
    """Features at twice the resolution of the coarse ones, beside the fine ones."""
    enlarged = functional.interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)
    return torch.cat([enlarged, fine], dim=1)


def pad_to_multiple(images: torch.Tensor, size: int) -> torch.Tensor:
    """Images with their last rows and columns repeated up to whole multiples of a size.

    Then the layers of all resolutions fit each other.
    """
    height, width = images.shape[-2:]
    padding = (0, -width % size, 0, -height % size)
    return functional.pad(images, padding, mode="replicate") if any(padding) else images

"""A small network for training on processors without a GPU.

An encoder of residual blocks down to an eighth of half the size, and a decoder with skip connections as in
U-Net (Ronneberger et al. 2015, "U-Net: convolutional networks for biomedical image segmentation", MICCAI).
All layers work at half of the image's size or less, where most of the time would be spent otherwise: the last
one predicts the four pixels of each half-size pixel at once (Shi et al. 2016, "Real-time single image and
video super-resolution using an efficient sub-pixel convolutional neural network", CVPR).
"""

from __future__ import annotations

from typing import Final, Self, final

import torch
from torch import nn
from torch.nn import functional

from pepperscene.errors import ArgumentError

_CHANNELS: Final = (24, 32, 64, 96)
"""At a half, a quarter, an eighth and a sixteenth of the size. Chosen: 0.9 million weights, and about 2 GFLOP
for an image of 400 x 300 pixels."""

_SIXTEENTH: Final = 16
_MOST_WIDTH: Final = 8.0  # chosen: 60 million weights, as many as the paper's network


@final
class SmallNetwork(nn.Module):
    """Logits `(n, classes, h, w)` of images `(n, 3, h, w)` in sRGB, 0 to 1.

    Args:
        classes: number of classes.
        width: factor of the number of channels.

    Raises:
        ArgumentError: the width is out of range.
    """

    def __init__(self, classes: int, width: float = 1.0) -> None:
        super().__init__()
        check_width(width, _MOST_WIDTH)
        half, quarter, eighth, sixteenth = (max(8, round(width * channels / 8) * 8) for channels in _CHANNELS)
        self.stem = convolution(3, half, stride=2)
        self.quarter = nn.Sequential(convolution(half, quarter, stride=2), _Residual(quarter))
        self.eighth = nn.Sequential(
            convolution(quarter, eighth, stride=2), _Residual(eighth), _Residual(eighth)
        )
        self.sixteenth = nn.Sequential(
            convolution(eighth, sixteenth, stride=2),
            # Dilation widens the field of view to most of the image, at no cost.
            *(_Residual(sixteenth, dilation) for dilation in (1, 2, 4)),
        )
        self.to_eighth = convolution(sixteenth + eighth, eighth)
        self.to_quarter = convolution(eighth + quarter, quarter)
        self.to_half = convolution(quarter + half, half)
        self.classify = nn.Conv2d(half, 4 * classes, 1)
        self.quarter_channels = quarter

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Logits of the classes."""
        height, width = images.shape[-2:]
        half, decoded = self._decode(images)
        decoded = self.to_half(join_finer(decoded, half))
        return functional.pixel_shuffle(self.classify(decoded), 2)[..., :height, :width]

    def quarter_features(self, images: torch.Tensor) -> torch.Tensor:
        """Features `(n, quarter_channels, h', w')` at a quarter of the size of the padded images."""
        return self._decode(images)[1]

    def without_last_layers(self) -> Self:
        """The network without the layers that `quarter_features` does not use."""
        self.to_half, self.classify = None, None
        return self

    def _decode(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Features at a half of the size, of the encoder, and at a quarter, of the decoder."""
        half = self.stem(pad_to_multiple(images, _SIXTEENTH) * 4 - 2)
        quarter = self.quarter(half)
        eighth = self.eighth(quarter)
        decoded = self.to_eighth(join_finer(self.sixteenth(eighth), eighth))
        return half, self.to_quarter(join_finer(decoded, quarter))


class _Residual(nn.Module):
    """Two convolutions whose result is added to their input (He et al. 2016, CVPR)."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        self.first = convolution(channels, channels, dilation=dilation)
        self.second = convolution(channels, channels, dilation=dilation, rectified=False)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return functional.relu(features + self.second(self.first(features)))


# --- layers that other networks use too ---------------------------------------------------------------------


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

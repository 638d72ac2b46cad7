"""The loss of a detector: targets from labelled objects, and the distance of its maps from them."""

from __future__ import annotations

from typing import Any, Final, NamedTuple, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from pepperscene.learning.models.detections import STRIDE
from pepperscene.learning.models.detector import ObjectMaps, mask_logits, near_boxes
from pepperscene.learning.objects import labelled_objects

_EXTENT: Final = 0.54  # of the box in which cells learn it: Liu et al. 2020, section 4
_LEAST_NEARNESS: Final = 0.01  # chosen: other cells contribute less than a hundredth of a centre
_BOX_WEIGHT: Final = 2.0  # chosen: between FCOS (1) and TTFNet (5)


class ObjectTargets(NamedTuple):
    """What the maps of a crop `(3, h, w)` with m objects should be, in cells of 4 x 4 pixels.

    Attributes:
        centres: `(k, h', w')` nearness to the next centre of an object of each class, 1 at centres.
        counts: `(h', w')` whether the cell counts: False in ignored parts.
        nearness: `(m, h', w')` nearness to the centre of each object: 1 there, a Gaussian around it.
        boxes: `(m, 4)` left, upper, right and lower side in pixels.
        labels: `(m,)` index of the class.
        masks: `(m, h', w')` share of the cell that belongs to the object.
    """

    centres: torch.Tensor
    counts: torch.Tensor
    nearness: torch.Tensor
    boxes: torch.Tensor
    labels: torch.Tensor
    masks: torch.Tensor


def object_targets(
    labels: torch.Tensor, cells: tuple[int, int], classes: int, least_area: int
) -> ObjectTargets:
    """Targets of one crop.

    Args:
        labels: `(2, h, w)` indices as of `object_indices`, and numbers of instances.
        cells: height and width of the maps.
        classes: number of classes.
        least_area: least pixels of an object; smaller ones are ignored.
    """
    indices, instances = labels.cpu().numpy()
    found, ignored = labelled_objects(indices.astype(np.uint8), instances, classes, least_area)
    pads = (0, cells[1] * STRIDE - indices.shape[1], 0, cells[0] * STRIDE - indices.shape[0])
    boxes, own = torch.from_numpy(found.boxes), torch.from_numpy(found.labels)
    nearness = _nearness(boxes, *cells)
    centres = torch.zeros(classes, *cells)
    for index in range(classes):
        if (own == index).any():
            centres[index] = nearness[own == index].amax(dim=0)
    # The centre of an ignored object may be in a cell beside its pixels.
    void = functional.max_pool2d(_cell_means(ignored[None], pads, 1.0), 3, stride=1, padding=1)[0] > 0
    counts = ~void | (centres.amax(dim=0) == 1)
    targets = ObjectTargets(centres, counts, nearness, boxes, own, _cell_means(found.masks, pads, 0.0))
    return ObjectTargets(*(tensor.to(labels.device) for tensor in targets))


def _cell_means(masks: NDArray[Any], pads: tuple[int, ...], outside: float) -> torch.Tensor:
    """Means of masks `(m, h, w)` over the pixels of each cell, `(m, h', w')`; crops end within a cell."""
    padded = functional.pad(torch.from_numpy(masks).float(), pads, value=outside)
    return functional.avg_pool2d(padded[:, None], STRIDE)[:, 0]


def _nearness(boxes: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Gaussians `(m, h', w')` about the cells with the centres of boxes, as wide as Liu et al. 2020 choose.

    "Training-time-friendly network for real-time object detection", AAAI.
    """
    middles, sides = (boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]
    last = torch.tensor([width - 1, height - 1])
    cells = (middles / STRIDE).floor().minimum(last)
    sigmas = (_EXTENT * sides / STRIDE + 1) / 6
    x = (torch.arange(width) - cells[:, :1]) / sigmas[:, :1]
    y = (torch.arange(height) - cells[:, 1:]) / sigmas[:, 1:]
    return torch.exp(-(x[:, None, :] ** 2 + y[:, :, None] ** 2) / 2)


@final
class DetectionLoss(nn.Module):
    """Sum of the losses of centres, boxes and masks.

    Centres: the focal loss of Law and Deng 2018, "CornerNet", ECCV, Eq. 1. Boxes: the generalised IoU
    (Rezatofighi et al. 2019, CVPR) in the cells around each centre, weighted by nearness (Liu et al. 2020).
    Masks: cross-entropy and Dice's coefficient (Milletari et al. 2016, "V-Net", 3DV) in the box.
    Number of classes and least pixels of an object are those of `object_targets`.
    """

    def __init__(self, classes: int, least_area: int) -> None:
        super().__init__()
        self._classes, self._least_area = classes, least_area

    def forward(self, maps: ObjectMaps, labels: torch.Tensor) -> torch.Tensor:
        """Mean over the objects of a batch, of its maps and labels `(n, 2, h, w)`."""
        cells = maps.centres.shape[-2:]
        targets = [object_targets(label, cells, self._classes, self._least_area) for label in labels]
        total = maps.centres.new_zeros(())
        for number, target in enumerate(targets):
            total = total + _centre_loss(maps.centres[number], target)
            if len(target.boxes):
                own = ObjectMaps(*(tensor[number] for tensor in maps))
                total = total + _BOX_WEIGHT * _box_loss(own, target) + _mask_loss(own, target)
        return total / max(1, sum(len(target.boxes) for target in targets))


def _centre_loss(logits: torch.Tensor, target: ObjectTargets) -> torch.Tensor:
    """Focal loss `()` of the centres of an image, summed over cells."""
    shares = logits.sigmoid()
    positive = (1 - shares) ** 2 * functional.logsigmoid(logits)
    negative = (1 - target.centres) ** 4 * shares**2 * functional.logsigmoid(-logits)
    losses = torch.where(target.centres == 1, positive, negative)
    return -(losses * target.counts).sum()


def _box_loss(maps: ObjectMaps, target: ObjectTargets) -> torch.Tensor:
    """1 - generalised IoU, summed over objects: of each, a mean over the cells that it owns."""
    owners = _owners(target)
    rows, columns = torch.nonzero(owners >= 0, as_tuple=True)
    number = owners[rows, columns]
    middles = torch.stack([columns, rows], dim=1) * STRIDE + STRIDE / 2
    distances = maps.distances[:, rows, columns].T
    predicted = torch.cat([middles - distances[:, :2], middles + distances[:, 2:]], dim=1)
    losses = 1 - generalised_iou(predicted, target.boxes[number])
    weights = target.nearness[number, rows, columns]
    totals = torch.zeros(len(target.boxes), device=weights.device).index_add(0, number, weights)
    return (losses * weights / totals[number]).sum()


def _owners(target: ObjectTargets) -> torch.Tensor:
    """Number of the object that each cell belongs to `(h', w')`, the smallest that is near; -1 for none."""
    sides = target.boxes[:, 2:] - target.boxes[:, :2]
    areas = sides.prod(dim=1)[:, None, None]
    areas = torch.where(target.nearness > _LEAST_NEARNESS, areas, torch.inf)
    least, number = areas.min(dim=0)
    return torch.where(least.isfinite(), number, -1)


def generalised_iou(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Generalised IoU `(p,)` of pairs of boxes `(p, 4)`: -1 for boxes far apart, 1 for equal ones."""
    area = lambda low, high: (high - low).clamp(min=0).prod(dim=1)  # noqa: E731
    common = area(first[:, :2].maximum(second[:, :2]), first[:, 2:].minimum(second[:, 2:]))
    union = area(first[:, :2], first[:, 2:]) + area(second[:, :2], second[:, 2:]) - common
    hull = area(first[:, :2].minimum(second[:, :2]), first[:, 2:].maximum(second[:, 2:]))
    return common / union.clamp(min=1e-6) - (hull - union) / hull.clamp(min=1e-6)


def _mask_loss(maps: ObjectMaps, target: ObjectTargets) -> torch.Tensor:
    """Loss of masks, summed over objects: of each, for the weights at its centre and at its highest peak."""
    height, width = target.counts.shape
    nearness = target.nearness.flatten(1)
    middle = nearness.argmax(dim=1)
    owned = _owners(target).flatten() == torch.arange(len(middle), device=middle.device)[:, None]
    centres = maps.centres.detach().sigmoid().flatten(1)[target.labels] * owned
    # An object whose cells all belong to smaller ones has its centre alone.
    peak = torch.where(owned.any(dim=1), centres.argmax(dim=1), middle)
    cells = torch.cat([middle, peak])
    boxes, masks = target.boxes.repeat(2, 1), target.masks.repeat(2, 1, 1)

    logits = mask_logits(maps.prototypes, maps.weights.flatten(1)[:, cells].T, boxes)
    inside = near_boxes(boxes, height, width).float()
    entropy = functional.binary_cross_entropy_with_logits(logits, masks, reduction="none")
    shares, masks = logits.sigmoid() * inside, masks * inside
    plane = (1, 2)
    overlap = 2 * (shares * masks).sum(plane) / ((shares**2 + masks**2).sum(plane)).clamp(min=1e-6)
    return ((entropy * inside).sum(plane) / inside.sum(plane) + 1 - overlap).sum() / 2

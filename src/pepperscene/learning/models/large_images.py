"""Applying a network to large images in parts: tiles that overlap, or strips of rows."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from pepperscene.errors import InputError
from pepperscene.learning.models.trained_model import TrainedModel, apply_model

MOST_WHOLE: Final = 12_500_000
"""Chosen: pixels of an image that is computed as a whole; a photograph of 4096 x 3048 pixels."""
_MOST_SCALED: Final = 120_000_000  # chosen: pixels of a scaled image, as many as are read
TILE: Final = 2048  # chosen: side of the part of a tile that is used, whole multiples of all strides
OVERLAP: Final = 640
"""Chosen: pixels around it that the network sees too, beyond the reach of the networks of this package."""
_STRIP: Final = 2_000_000  # chosen: pixels of a strip of probabilities

Part = tuple[slice, slice]
"""Rows and columns of a part of an image."""


def is_large(colour: NDArray[np.uint8], width: int | None) -> bool:
    """Whether an image `(h, w, 3)`, or what the network sees of it at this width, is computed in parts."""
    height, columns = network_size(colour.shape[:2], width)
    return max(height * columns, colour.shape[0] * colour.shape[1]) > MOST_WHOLE


def network_size(size: tuple[int, ...], width: int | None) -> tuple[int, int]:
    """Height and width in pixels of what a network sees of an image of this size.

    Raises:
        InputError: too many pixels.
    """
    height, columns = size
    if width is not None and width != columns:
        height, columns = max(1, round(height * width / columns)), width
    if height * columns > _MOST_SCALED:
        raise InputError(
            "image",
            f"has {size[1]} x {size[0]} pixels, and {columns} x {height} at the model's width; at most "
            f"{_MOST_SCALED // 10**6} million are allowed",
        )
    return height, columns


def probability_parts(
    model: TrainedModel, colour: NDArray[np.uint8]
) -> Iterator[tuple[Part, NDArray[np.float32]]]:
    """Rows and columns of parts of an image `(h, w, 3)`, and the probabilities `(k, rows, columns)` there.

    They are those of the whole image up to rounding, if the network sees no farther than `OVERLAP`.

    Args:
        model: its network in the mode of evaluation.
        colour: sRGB, 8 bits.
    """
    size, own = network_size(colour.shape[:2], model.width), colour.shape[:2]
    tiles = _tiles(model.module, _scaled(colour, size))
    if size == own:
        for part, logits in tiles:
            yield part, model.decide(logits).numpy()
        return
    whole: torch.Tensor | None = None
    for (rows, columns), logits in tiles:
        whole = logits.new_empty((len(logits), *size)) if whole is None else whole
        whole[:, rows, columns] = logits
    assert whole is not None
    step = max(1, _STRIP // own[1])
    for start in range(0, own[0], step):
        rows = slice(start, min(start + step, own[0]))
        yield (rows, slice(0, own[1])), model.decide(_enlarged_rows(whole, own, rows)).numpy()


def _scaled(colour: NDArray[np.uint8], size: tuple[int, int]) -> torch.Tensor:
    """The image `(3, h, w)` at a size: 8 bits if it keeps its own, else from 0 to 1."""
    planes = torch.from_numpy(colour).permute(2, 0, 1)
    if size == colour.shape[:2]:
        return planes
    # One channel at a time, because real numbers take four times the memory.
    return torch.cat(
        [
            functional.interpolate(
                plane[None, None].float().div_(255), size=size, mode="bilinear", align_corners=False,
                antialias=True,
            )[0]
            for plane in planes
        ]
    )  # fmt: skip


def _tiles(module: nn.Module, image: torch.Tensor) -> Iterator[tuple[Part, torch.Tensor]]:
    """Rows and columns of the tiles of an image `(3, h, w)`, and the logits `(k, rows, columns)` there."""
    height, width = image.shape[1:]
    if height * width <= MOST_WHOLE:
        yield (slice(0, height), slice(0, width)), _apply(module, image)
        return
    for top, left in product(range(0, height, TILE), range(0, width, TILE)):
        rows, columns = slice(top, min(top + TILE, height)), slice(left, min(left + TILE, width))
        first, start = max(top - OVERLAP, 0), max(left - OVERLAP, 0)
        seen = image[:, first : rows.stop + OVERLAP, start : columns.stop + OVERLAP]
        logits = _apply(module, seen)
        yield (
            (rows, columns),
            logits[:, top - first : rows.stop - first, left - start : columns.stop - start],
        )


def _apply(module: nn.Module, image: torch.Tensor) -> torch.Tensor:
    """Logits `(k, h, w)` of an image `(3, h, w)`, on the processor."""
    batch = image[None].to(next(module.parameters()).device)
    if batch.dtype == torch.uint8:
        batch = batch.float() / 255
    with torch.inference_mode():
        return apply_model(module, batch)[0].float().cpu()


def _enlarged_rows(logits: torch.Tensor, size: tuple[int, ...], rows: slice) -> torch.Tensor:
    """Rows of logits `(k, h, w)` that are enlarged to a height and a width, as by bilinear `interpolate`."""
    source = logits.shape[1]
    at = (torch.arange(rows.start, rows.stop, dtype=torch.float32) + 0.5) * (source / size[0]) - 0.5
    at = at.clamp(min=0.0)
    low = at.long().clamp(max=source - 1)
    high, part = (low + 1).clamp(max=source - 1), (at - low)[:, None]
    mixed = logits[:, low] * (1.0 - part) + logits[:, high] * part
    return functional.interpolate(
        mixed[None], size=(mixed.shape[1], size[1]), mode="bilinear", align_corners=False
    )[0]

"""The objects that a detector finds in an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self, final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

LEAST_SCORE: Final = 0.05
"""Of objects that are kept. Chosen: less certain ones are noise, and measures hardly change without them."""

STRIDE: Final = 4
"""Pixels of a cell of the head of a detector."""


@final
@dataclass(frozen=True, eq=False)
class Detections:
    """n objects in an image of h x w pixels, the most certain first.

    Attributes:
        boxes: `(n, 4)` float32: left, upper, right and lower side, in pixels from the image's corner.
        scores: `(n,)` float32, from 0 to 1.
        labels: `(n,)` int64, index of the class.
        size: height and width of the image.
        seen: height and width of the image that the network saw.
        cells: `(n, h', w')` float32, probabilities of the masks in cells of 4 x 4 pixels of that image.
    """

    boxes: NDArray[np.float32]
    scores: NDArray[np.float32]
    labels: NDArray[np.int64]
    size: tuple[int, int]
    seen: tuple[int, int]
    cells: NDArray[np.float32]

    @classmethod
    def of_network(
        cls,
        boxes: NDArray[np.float32],
        scores: NDArray[np.float32],
        labels: NDArray[np.int64],
        masks: NDArray[np.float32],
        *,
        seen: tuple[int, int],
        size: tuple[int, int],
    ) -> Self:
        """The detections of `FoundObjects` of an image that was scaled to the size that the network saw."""
        kept = scores >= LEAST_SCORE
        factors = np.array([size[1] / seen[1], size[0] / seen[0]] * 2, np.float32)
        return cls(boxes[kept] * factors, scores[kept], labels[kept], size, seen, masks[kept])

    def __len__(self) -> int:
        return len(self.scores)

    def mask(self, number: int) -> NDArray[np.bool_]:
        """The mask `(h, w)` of an object: pixels of its box with an interpolated probability above a half."""
        left, top = np.floor(self.boxes[number, :2]).astype(int)
        right, bottom = np.minimum(np.ceil(self.boxes[number, 2:]).astype(int), self.size[::-1])
        mask = np.zeros(self.size, bool)
        if right <= left or bottom <= top:
            return mask
        # Pillow interpolates between the middles of cells, also those outside of this region.
        cells = Image.fromarray(self.cells[number])
        x, y = self.seen[1] / self.size[1] / STRIDE, self.seen[0] / self.size[0] / STRIDE
        region = (left * x, top * y, min(right * x, cells.width), min(bottom * y, cells.height))
        shape = (int(right - left), int(bottom - top))
        mask[top:bottom, left:right] = (
            np.asarray(cells.resize(shape, Image.Resampling.BILINEAR, box=region)) > 0.5
        )
        return mask

"""Masks as run lengths, in COCO's uncompressed form.

Pixels are counted column by column from the top left: first those outside (maybe none), then those inside,
and so on in turn (T.-Y. Lin et al. 2014, "Microsoft COCO"; the layout is that of `pycocotools.mask`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def run_lengths(
    mask: NDArray[np.bool_], size: tuple[int, int] | None = None, corner: tuple[int, int] = (0, 0)
) -> dict[str, list[int]]:
    """`{"size": [h, w], "counts": [...]}` of a mask, which may be a part of a picture.

    Args:
        mask: `(rows, columns)`.
        size: `(h, w)` of the picture; None where the mask is all of it.
        corner: column and row of the mask's first pixel in the picture.

    Raises:
        ValueError: the mask does not lie in the picture.
    """
    height, width = size or mask.shape
    left, top = corner
    if min(left, top) < 0 or left + mask.shape[1] > width or top + mask.shape[0] > height:
        raise ValueError(f"a mask of {mask.shape} at {corner} does not lie in a picture of {(height, width)}")
    column, row = np.nonzero(mask.T)
    inside = (left + column) * height + top + row
    # Runs end where the next pixel inside is not the next pixel.
    gap = np.flatnonzero(np.diff(inside) != 1)
    first, last = inside[np.append(0, gap + 1)[: inside.size]], inside[np.append(gap, -1)[: inside.size]]
    edges = np.concatenate([[0], np.stack([first, last + 1], axis=1).ravel(), [height * width]])
    counts = np.diff(edges).tolist()
    # Nothing is left behind the last pixel: no run.
    return {"size": [height, width], "counts": counts[:-1] if len(counts) > 1 and counts[-1] == 0 else counts}


def mask_of(runs: Mapping[str, Sequence[Any]]) -> NDArray[np.bool_]:
    """`(h, w)` the mask that run lengths tell.

    Raises:
        ValueError: the runs do not fill the picture.
    """
    height, width = runs["size"]
    counts = np.asarray(runs["counts"], dtype=np.intp)
    if (counts.size and counts.min() < 0) or counts.sum() != height * width:
        raise ValueError(f"runs of {counts.sum()} pixels do not fill a picture of {height} x {width}")
    inside = np.repeat(np.arange(counts.size) % 2 == 1, counts)
    return inside.reshape(width, height).T

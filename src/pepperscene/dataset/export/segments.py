"""A picture in segments: every organ by itself, and what is no organ of a plant by its class.

- Organs: instances of a plant, of any class but the background. Their id is their value in the instance
  image.
- The rest of each class, 65536 + class: the background, what has an organ's class but belongs to no plant, as
  the wire that a whole row hangs from, and organs of which too little is seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.export.source import ExportSource
from pepperscene.errors import InputError, SetupError


def library(module: str) -> Any:
    """A module of a library that comes with the extra `export`.

    Raises:
        SetupError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        raise SetupError(
            f"this format needs {name}, which is not installed; `pip install 'pepperscene[export]'` brings it"
        ) from None


REST: Final = 1 << 16
"""Id of the rest of class 0; instances are 16-bit numbers."""

Encoded = dict[str, Any]
"""A mask as pycocotools holds it: `size` (rows, columns) and `counts`, the lengths of runs as text."""


@dataclass(frozen=True, eq=False)
class Segment:
    """The pixels of one organ, or of the rest of a class.

    Attributes:
        id: above 0, unique in its picture.
        organ_class: of all its pixels.
        about: what the frame's JSON says of the instance; empty for the rest of a class.
        mask: its pixels.
        area: how many there are.
        box: left, top, width, height of their bounds, pixels.
    """

    id: int
    organ_class: OrganClass
    about: Mapping[str, Any]
    mask: Encoded
    area: int
    box: tuple[int, int, int, int]

    @property
    def is_organ(self) -> bool:
        """Whether it is one organ of a plant."""
        return self.id < REST


def segment_ids(source: ExportSource, smallest_px: int = 1) -> NDArray[np.uint32]:
    """The segment of every pixel of a frame, `(h, w)`; above 0.

    Args:
        source: the frame.
        smallest_px: organs of which fewer pixels are seen belong to the rest of their class.

    Raises:
        InputError: the instance image is damaged or holds a value that the frame's JSON does not tell.
    """
    instance = source.image("instance")
    table = np.zeros(REST, dtype=np.uint32)
    table[0] = REST
    for value, about in source.facts["instances"].items():
        organ_class = about["class"]
        own = organ_class != OrganClass.BACKGROUND and about["plant"] >= 0 and about["pixels"] >= smallest_px
        table[int(value)] = int(value) if own else REST + organ_class
    ids = np.take(table, instance)
    if not ids.all():
        untold = int(instance[ids == 0][0])
        raise InputError(
            source.path("instance"), f"instance {untold} is not in the frame's JSON", value=untold
        )
    return ids


def segments(source: ExportSource, ids: NDArray[np.uint32]) -> list[Segment]:
    """The segments of a picture, by ascending id.

    Args:
        source: the frame.
        ids: `(h, w)`, of `segment_ids`.

    Raises:
        SetupError: pycocotools is not installed.
    """
    coder = library("pycocotools.mask")
    height, width = ids.shape
    counts = all_run_lengths(ids)
    masks = coder.frPyObjects(
        [{"size": [height, width], "counts": runs} for runs in counts.values()], height, width
    )
    boxes = coder.toBbox(masks).astype(int).tolist()
    known = source.facts["instances"]
    found = []
    for (value, runs), mask, box in zip(counts.items(), masks, boxes, strict=True):
        about = known[str(value)] if value < REST else {}
        organ_class = OrganClass(about["class"] if about else value - REST)
        found.append(Segment(value, organ_class, about, as_text(mask), sum(runs[1::2]), tuple(box)))
    return found


def as_text(mask: Mapping[str, Any]) -> Encoded:
    """A mask of pycocotools as JSON can hold it."""
    return {"size": [int(side) for side in mask["size"]], "counts": mask["counts"].decode("ascii")}


def all_run_lengths(ids: NDArray[np.integer[Any]]) -> dict[int, list[int]]:
    """COCO's uncompressed run lengths of every value's mask, by ascending value.

    Lengths go down the columns, first the pixels of other values, then its own, and so on in turn. All masks
    are made in one pass: a mask after the other would look at the picture hundreds of times.
    """
    # Runs of equal values down the columns, sorted by value; those of a value stay in order.
    column = ids.ravel(order="F")
    starts = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1])
    ends = np.concatenate([starts[1:], [column.size]])
    values = column[starts]
    order = np.argsort(values, kind="stable")
    starts, ends, values = starts[order], ends[order], values[order]

    # What lies between a run and the one before of the same value, or the picture's begin.
    first = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    before = np.concatenate([[0], ends[:-1]])
    before[first] = 0
    lengths = np.stack([starts - before, ends - starts], axis=1).ravel()
    last = np.concatenate([first[1:], [len(values)]])
    counts = {}
    for begin, end in zip(first.tolist(), last.tolist(), strict=True):
        after = int(column.size - ends[end - 1])
        counts[int(values[begin])] = [*lengths[2 * begin : 2 * end].tolist(), *([after] if after else [])]
    return counts

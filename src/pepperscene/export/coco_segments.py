"""The segments of an image for COCO: organs, rests of classes and ignored regions, with their masks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.dataset_frame import IGNORED, REST, DatasetFrame
from pepperscene.dataset.selection import Category, Selection
from pepperscene.libraries import import_library


@dataclass(frozen=True, eq=False)
class Segment:
    """The pixels of one organ, of the rest of a class, or all ignored pixels of an image."""

    id: int  # above 0, unique in its image
    organ_class: OrganClass  # the background for ignored pixels
    categories: tuple[Category, ...]  # one for an organ; all possible ones for other segments
    is_void: bool  # whether panoptic images cannot show it, because it may be of several categories or none
    entry: Mapping[str, Any]  # of the instance in the frame's JSON; empty for the rest of a class
    mask: dict[str, Any]  # `size` (rows, columns) and `counts`, the run lengths as text
    area: int
    box: tuple[int, int, int, int]  # left, top, width, height

    @property
    def is_crowd(self) -> bool:
        """Whether it is the rest of an organ's class."""
        return not self.entry and self.organ_class != OrganClass.BACKGROUND


def find_segments(frame: DatasetFrame, ids: NDArray[np.uint32], selection: Selection) -> list[Segment]:
    """The segments of a frame with its `segment_ids` `(h, w)`, by ascending id."""
    coder = import_library("pycocotools.mask")
    height, width = ids.shape
    lengths = segment_run_lengths(ids)
    masks = coder.frPyObjects(
        [{"size": [height, width], "counts": runs} for runs in lengths.values()], height, width
    )
    boxes = coder.toBbox(masks).astype(int).tolist()
    entries = frame.metadata["instances"]
    segments = []
    for (segment_id, runs), mask, box in zip(lengths.items(), masks, boxes, strict=True):
        entry = entries[str(segment_id)] if segment_id < REST else {}
        organ_class, categories, is_void = _segment_categories(segment_id, entry, frame, selection)
        area = sum(runs[1::2])
        mask = json_mask(mask)
        segments.append(Segment(segment_id, organ_class, categories, is_void, entry, mask, area, tuple(box)))
    return segments


def _segment_categories(
    segment_id: int, entry: Mapping[str, Any], frame: DatasetFrame, selection: Selection
) -> tuple[OrganClass, tuple[Category, ...], bool]:
    """`organ_class`, `categories` and `is_void` of a segment."""
    if segment_id == IGNORED:
        return OrganClass.BACKGROUND, selection.categories, True
    if not entry:
        rest = OrganClass(segment_id - REST)
        is_void = rest != OrganClass.BACKGROUND and selection.category(rest) is None
        return rest, selection.possible(rest), is_void
    organ_class = OrganClass(entry["class"])
    category = selection.category(organ_class, frame.fruit_for(selection).get(segment_id))
    return organ_class, () if category is None else (category,), False


def segment_run_lengths(ids: NDArray[np.integer[Any]]) -> dict[int, list[int]]:
    """COCO's uncompressed run lengths of the mask of every id, by ascending id.

    Run lengths go down the columns, alternating between pixels of other ids and of this one. All masks are
    made in one pass: separate masks would read the image hundreds of times.
    """
    # Runs of equal ids down the columns, sorted by id; those of an id stay in order.
    column = ids.ravel(order="F")
    starts = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1])
    ends = np.concatenate([starts[1:], [column.size]])
    values = column[starts]
    order = np.argsort(values, kind="stable")
    starts, ends, values = starts[order], ends[order], values[order]

    # Gap between a run and the previous one of the same id, or the start of the image.
    first = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    previous_end = np.concatenate([[0], ends[:-1]])
    previous_end[first] = 0
    lengths = np.stack([starts - previous_end, ends - starts], axis=1).ravel()
    last = np.concatenate([first[1:], [len(values)]])
    counts = {}
    for begin, end in zip(first.tolist(), last.tolist(), strict=True):
        after = int(column.size - ends[end - 1])
        counts[int(values[begin])] = [*lengths[2 * begin : 2 * end].tolist(), *([after] if after else [])]
    return counts


def json_mask(mask: Mapping[str, Any]) -> dict[str, Any]:
    """A mask of pycocotools with its run lengths as text, which JSON can hold."""
    return {"size": [int(side) for side in mask["size"]], "counts": mask["counts"].decode("ascii")}

"""YOLO as Ultralytics reads it: a text file for each image, one polygon, box or pose per line.

Formats: https://docs.ultralytics.com/datasets/segment/, https://docs.ultralytics.com/datasets/detect/ and
https://docs.ultralytics.com/datasets/pose/.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.dataset_frame import IGNORED, REST, DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.dataset.splits import DEFAULT_SPLIT
from pepperscene.dataset.store.images import png_bytes
from pepperscene.export.job import ExportJob
from pepperscene.libraries import import_library
from pepperscene.truth.keypoints import FLIP_INDICES, KEYPOINTS, fruit_keypoints

Points = NDArray[np.int32]
"""`(n, 2)` column and row of pixels."""

TOLERANCE_PX: Final = 0.35
"""Chosen: largest distance of a simplified side from its pixels; saves a fifth of the points."""

MAX_BRIDGE_FRACTION: Final = 0.04
"""Chosen: bridge pixels over those of the joined pieces, if each piece is large enough by itself."""

MAX_BRIDGE_RATIO: Final = 1.0
"""Chosen: pixels of a bridge over those of the piece that it leads to."""


@dataclass(frozen=True, eq=False)
class Ring:
    """A closed line through pixels, with further rings attached by bridges."""

    points: Points
    pixels: int  # enclosed by the line, and those of the line
    # By index of a point, rings and the index of their point at the other end of the bridge.
    attached: dict[int, list[tuple[Ring, int]]] = field(default_factory=dict)

    def attach(self, ring: Ring, point: int, other_point: int) -> None:
        """Join a ring by a bridge between two points."""
        self.attached.setdefault(point, []).append((ring, other_point))

    def outline(self, start: int = 0) -> list[list[int]]:
        """Points from one of them around the ring, over each bridge, around its ring, and back.

        The outline is closed by a line to its first point.
        """
        points: list[list[int]] = self.points.tolist()
        if not self.attached:
            return points[start:] + points[:start]
        outline = []
        for index in (*range(start, len(points)), *range(start)):
            outline.append(points[index])
            for ring, other in self.attached.get(index, ()):
                outline += [*ring.outline(other), ring.points[other].tolist(), points[index]]
        return outline


def mask_polygons(mask: NDArray[np.bool_], smallest_px: int) -> list[Points]:
    """Polygons of a mask, the one of the largest piece first.

    Points are pixels of the mask. Filled by the even-odd rule including their sides, as OpenCV's `fillPoly`
    does, they give the mask again except for `TOLERANCE_PX` and `MAX_BRIDGE_FRACTION`. Polygons of fewer than
    `smallest_px` pixels are left out.
    """
    polygons = []
    pieces = sorted(_find_pieces(mask), key=lambda piece: -piece.pixels)
    is_crowded, cv2 = len(pieces) > 2, import_library("cv2")
    labels = cv2.connectedComponents(mask.view(np.uint8))[1] if is_crowded else None
    while pieces:
        ring, pixels, pieces = _join_pieces(pieces, smallest_px, labels)
        if pixels >= smallest_px:
            polygons.append(np.array(ring.outline(), dtype=np.int32).reshape(-1, 2))
    return polygons


def _find_pieces(mask: NDArray[np.bool_]) -> list[Ring]:
    """The connected pieces of a mask, with their holes attached."""
    cv2 = import_library("cv2")
    contours, hierarchy = cv2.findContours(mask.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if len(contours) == 1:
        return [Ring(_simplify(contours[0]), int(np.count_nonzero(mask)))]
    rings, parents = [], [entry[3] for entry in hierarchy[0]] if contours else []
    for contour, parent in zip(contours, parents, strict=True):
        # The pixels on and within a line through pixels, by Pick's theorem; the line of a hole is outside it.
        length = _perimeter(contour[:, 0])
        pixels = round(cv2.contourArea(contour) + (1 if parent < 0 else -1) * length / 2) + 1
        rings.append(Ring(_simplify(contour), pixels))
    pieces = []
    for index, ring in enumerate(rings):
        if parents[index] >= 0:
            continue
        holes = [hole for hole, parent in zip(rings, parents, strict=True) if parent == index]
        for hole in holes:
            _, point, hole_point = _nearest_points(ring.points, hole.points)
            ring.attach(hole, point, hole_point)
        pieces.append(Ring(ring.points, ring.pixels - sum(hole.pixels for hole in holes), ring.attached))
    return pieces


def _join_pieces(
    pieces: list[Ring], smallest_px: int, labels: NDArray[np.int32] | None
) -> tuple[Ring, int, list[Ring]]:
    """The first piece with those worth a bridge attached, nearest first; its pixels; the other pieces.

    `labels` number the pieces of the mask where there are more than two: no bridge crosses a third piece,
    which may become a polygon of its own.
    """
    root, *others = pieces
    pixels, bridge_pixels = root.pixels, 0.0
    # The shortest bridge from what is joined to each of the others: length, both points, ring it starts from.
    bridges = [(*_nearest_points(root.points, other.points), root) for other in others]

    def is_worth(index: int) -> bool:
        cost, gain = max(bridges[index][0] - 1, 0.0), others[index].pixels
        is_cheap = bridge_pixels + cost <= MAX_BRIDGE_FRACTION * (pixels + gain)
        return cost <= MAX_BRIDGE_RATIO * gain and (is_cheap or gain < smallest_px)

    while candidates := [index for index in range(len(others)) if is_worth(index)]:
        nearest = min(candidates, key=lambda index: bridges[index][0])
        (length, point, other_point, ring), piece = bridges[nearest], others[nearest]
        if labels is not None and _crosses_third(labels, ring.points[point], piece.points[other_point]):
            bridges[nearest] = (np.inf, point, other_point, ring)
            continue
        del bridges[nearest], others[nearest]
        ring.attach(piece, point, other_point)
        pixels, bridge_pixels = pixels + piece.pixels, bridge_pixels + max(length - 1, 0.0)
        for index, other in enumerate(others):
            bridge = _nearest_points(piece.points, other.points)
            if bridge[0] < bridges[index][0]:
                bridges[index] = (*bridge, piece)
    return root, pixels, others


def _nearest_points(a: Points, b: Points) -> tuple[float, int, int]:
    """Number of pixels from the nearest point of one ring to that of another, and indices of both points."""
    steps = np.maximum(np.abs(a[:, None, 0] - b[None, :, 0]), np.abs(a[:, None, 1] - b[None, :, 1]))
    index_a, index_b = divmod(int(steps.argmin()), len(b))
    return float(steps[index_a, index_b]), index_a, index_b


def _crosses_third(labels: NDArray[np.int32], start: Points, end: Points) -> bool:
    """Whether the straight line between pixels of two pieces crosses another piece."""
    line = np.zeros(labels.shape, np.uint8)
    import_library("cv2").fillPoly(line, [np.stack([start, end])], 1)
    both = labels[[start[1], end[1]], [start[0], end[0]]]
    return bool(np.setdiff1d(labels[line > 0], [0, *both]).size)


def _perimeter(points: Points) -> int:
    """Number of pixels of a closed line whose sides are straight or diagonal."""
    steps = np.abs(np.diff(points, axis=0, append=points[:1]))
    return int(np.maximum(steps[:, 0], steps[:, 1]).sum())


def _simplify(contour: Points) -> Points:
    points: Points = import_library("cv2").approxPolyDP(contour, TOLERANCE_PX, True)[:, 0]
    return points


DECIMALS: Final = 6  # 1/200 of a pixel in images 5,000 pixels wide

_VALIDATION_NAMES: Final = ("val", "valid", "validation", "dev")
_YAML_WORDS: Final = frozenset({"y", "n", "yes", "no", "on", "off", "true", "false", "null"})
"""Names that are not text in YAML 1.1."""

LabelLines = Callable[[DatasetFrame, Selection, NDArray[np.uint32]], list[str]]
"""The lines of the label file of a frame, from its segment ids `(h, w)`."""


def write_yolo(job: ExportJob, folder: Path) -> None:
    """Write the files of `_write_layout` with polygons.

    A line is an organ of a plant: the number of its category in the selection, and the pixel centres of its
    polygon over the width and height of the image. If all classes are selected and fruit is one category,
    the numbers are the class ids minus 1. What belongs to no plant, organs that are not objects and pieces
    below the selection's `smallest_px` are left out, as the format has no crowd.
    """
    _write_layout(job, folder, _polygon_lines)


def _polygon_lines(frame: DatasetFrame, selection: Selection, ids: NDArray[np.uint32]) -> list[str]:
    """The lines of the label file of a frame with its `segment_ids`, by ascending instance."""
    height, width = ids.shape
    xs, ys = _pixel_centres(width), _pixel_centres(height)
    lines = []
    for found in _find_objects(frame, selection, ids):
        rows, columns = found.window
        for polygon in mask_polygons(ids[found.window] == found.instance, selection.smallest_px):
            # At least three points: readers take two for a box.
            points = polygon if len(polygon) > 2 else polygon[[0, 0, -1]]
            xy = " ".join(f"{xs[columns.start + x]} {ys[rows.start + y]}" for x, y in points.tolist())
            lines.append(f"{found.number} {xy}")
    return lines


def _pixel_centres(count: int) -> list[str]:
    """Relative positions in [0, 1] of the pixel centres of a row or column, as text."""
    return [f"{(position + 0.5) / count:.{DECIMALS}f}" for position in range(count)]


def write_yolo_detect(job: ExportJob, folder: Path) -> None:
    """Write the files of `_write_layout` with boxes.

    A line is an organ of a plant: the number of its category, and the centre, width and height of the box of
    its visible pixels over the width and height of the image.
    """
    _write_layout(job, folder, _box_lines)


def _box_lines(frame: DatasetFrame, selection: Selection, ids: NDArray[np.uint32]) -> list[str]:
    return [f"{found.number} {found.box(ids.shape)}" for found in _find_objects(frame, selection, ids)]


def write_yolo_pose(job: ExportJob, folder: Path) -> None:
    """Write the files of `_write_layout` with boxes and keypoints.

    A line is an organ of a plant: the number of its category, the box as in `write_yolo_detect`, and for each
    of the `KEYPOINTS` x and y over the width and height of the image and its visibility. Organs other than
    fruit have the visibility 0, as the format gives all classes the same keypoints.
    """
    numbers = [category for category, one in enumerate(job.selection.categories) if one.has_fruit]
    keys = [
        f"kpt_shape: [{len(KEYPOINTS)}, 3]  # x, y, visibility",
        f"flip_idx: {list(FLIP_INDICES)}",
        "kpt_names:",
        *(f"  {number}: [{', '.join(KEYPOINTS)}]" for number in numbers),
    ]
    _write_layout(job, folder, _pose_lines, keys)


def _pose_lines(frame: DatasetFrame, selection: Selection, ids: NDArray[np.uint32]) -> list[str]:
    height, width = ids.shape
    lines = []
    for found in _find_objects(frame, selection, ids):
        points = " ".join(
            f"{x / width:.{DECIMALS}f} {y / height:.{DECIMALS}f} {flag}"
            for x, y, flag in fruit_keypoints(frame.fruit.get(found.instance, {}))
        )
        lines.append(f"{found.number} {found.box(ids.shape)} {points}")
    return lines


def _write_layout(job: ExportJob, folder: Path, label_lines: LabelLines, keys: Sequence[str] = ()) -> None:
    """Write `images/train/000110.png`, `labels/train/000110.txt` and `data.yaml`.

    The format has no ignored pixels: if frames can have some, `ignore/train/000110.png` is 255 there and 0
    elsewhere, for training and evaluation code that reads it. `keys` are further lines of `data.yaml`.
    """
    data = _data_yaml(list(job.splits), job.selection, keys)
    (folder / "data.yaml").write_text(data, encoding="utf-8")
    for split, frames in job.frames_by_split():
        images, labels = folder / "images" / split, folder / "labels" / split
        images.mkdir(parents=True)
        labels.mkdir(parents=True)
        if job.has_ignored_pixels:
            (folder / "ignore" / split).mkdir(parents=True)
        for frame in frames:
            (images / f"{frame.name}.png").write_bytes(frame.content("colour"))
            ids = frame.segment_ids(job.selection)
            if job.has_ignored_pixels:
                mask = np.where(ids == IGNORED, np.uint8(IGNORE_CLASS), np.uint8(0))
                (folder / "ignore" / split / f"{frame.name}.png").write_bytes(png_bytes(mask))
            lines = "".join(f"{line}\n" for line in label_lines(frame, job.selection, ids))
            (labels / f"{frame.name}.txt").write_text(lines, encoding="ascii")


def _data_yaml(splits: Sequence[str], selection: Selection, keys: Sequence[str]) -> str:
    """`data.yaml`, with paths relative to its folder; readers require both `train` and `val`."""
    folders = {split: f"images/{split}" for split in splits}
    validation = next((name for name in _VALIDATION_NAMES if name in splits), splits[0])
    for name, substitute in ((DEFAULT_SPLIT, splits[0]), ("val", validation)):
        folders.setdefault(name, f"images/{substitute}  # there is no split of this name")
    names = [category.name for category in selection.categories]
    classes = [
        f"  {number}: {json.dumps(name) if name in _YAML_WORDS else name}"
        for number, name in enumerate(names)
    ]
    # Keys in quotes: `no`, `on` and `null` are not text in YAML.
    paths = [f'"{name}": {path}' for name, path in folders.items()]
    return "\n".join([*paths, *keys, "names:", *classes]) + "\n"


def _find_objects(
    frame: DatasetFrame, selection: Selection, ids: NDArray[np.uint32]
) -> Iterator[VisibleObject]:
    """Yield the objects of a frame with its `segment_ids`, by ascending instance."""
    from scipy import ndimage

    numbers = {category.id: number for number, category in enumerate(selection.categories)}
    fruit = frame.fruit_for(selection)
    for value, window in enumerate(ndimage.find_objects(ids.astype("int32"), max_label=REST - 1), start=1):
        if window is None:
            continue
        organ_class = OrganClass(frame.metadata["instances"][str(value)]["class"])
        category = selection.category(organ_class, fruit.get(value))
        if category is not None:
            yield VisibleObject(value, numbers[category.id], window)


@dataclass(frozen=True)
class VisibleObject:
    """An object of a frame."""

    instance: int  # its value in the instance image
    number: int  # of its category in the selection, from 0
    window: tuple[slice, slice]  # rows and columns of its visible pixels

    def box(self, shape: tuple[int, ...]) -> str:
        """Centre, width and height of its visible pixels over the `shape` (h, w) of the image, as text."""
        (height, width), (rows, columns) = shape, self.window
        (x, wide), (y, high) = _rounded_side(columns, width), _rounded_side(rows, height)
        return " ".join(f"{number:.{DECIMALS}f}" for number in (x, y, wide, high))


def _rounded_side(pixels: slice, count: int) -> tuple[float, float]:
    """Centre and length of a box along a side of `count` pixels, over its length, rounded.

    Where rounding would move an edge out of the image, the box is made shorter by the last digit.
    """
    centre = round(0.5 * (pixels.start + pixels.stop) / count, DECIMALS)
    length = round((pixels.stop - pixels.start) / count, DECIMALS)
    excess = length - 2.0 * min(centre, 1.0 - centre)
    if excess > 0.1 * 10.0**-DECIMALS:
        length = round(length - math.ceil(round(excess * 10.0**DECIMALS, 1)) * 10.0**-DECIMALS, DECIMALS)
    return centre, length

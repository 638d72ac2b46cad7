"""YOLO segmentation, as Ultralytics reads it: a text file for each picture, a polygon a line.

Format: https://docs.ultralytics.com/datasets/segment/.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.export.run import ExportResult
from pepperscene.dataset.export.segments import REST, library, segment_ids
from pepperscene.dataset.export.source import ExportSource, OnFrame, export_sources, new_folder, wanted_frames
from pepperscene.dataset.export.splits import EVERYTHING, Splits
from pepperscene.dataset.store.dataset import Dataset

Points = NDArray[np.int32]
"""`(n, 2)` column and row of pixels."""

TOLERANCE_PX: Final = 0.35
"""Chosen: how far a side may pass by the pixels that it stands for; fillers paint the same with a fifth fewer
points."""

BRIDGED: Final = 0.04
"""Chosen: most pixels of bridges over those of the pieces joined, where each could stand by itself."""

WORTH: Final = 1.0
"""Chosen: most pixels of a bridge over those of the piece that it leads to."""


@dataclass(frozen=True, eq=False)
class Ring:
    """A closed line through pixels, and those that hang on it by bridges.

    Attributes:
        points: in order; the last is joined to the first.
        pixels: how many it encloses, itself included.
        hung: by index of a point, rings and the index of the point of theirs that the bridge leads to.
    """

    points: Points
    pixels: int
    hung: dict[int, list[tuple[Ring, int]]] = field(default_factory=dict)

    def walk(self, start: int = 0) -> list[list[int]]:
        """The points in order from one of them, with those that hang on the ring, and back over each bridge.

        The walk ends one point before it would be closed.
        """
        points: list[list[int]] = self.points.tolist()
        if not self.hung:
            return points[start:] + points[:start]
        found = []
        for place in (*range(start, len(points)), *range(start)):
            found.append(points[place])
            for ring, there in self.hung.get(place, ()):
                found += [*ring.walk(there), ring.points[there].tolist(), points[place]]
        return found

    def hang(self, ring: Ring, here: int, there: int) -> None:
        """Join a ring by a bridge between two points."""
        self.hung.setdefault(here, []).append((ring, there))


def polygons(mask: NDArray[np.bool_], smallest_px: int) -> list[Points]:
    """The polygons of a mask, the greatest piece's first.

    Points are pixels of the mask, seen at their centres. Filled by the even-odd rule with the sides painted,
    as OpenCV's `fillPoly` does, they give the mask again but for `TOLERANCE_PX` and `BRIDGED`.

    Args:
        mask: `(h, w)`.
        smallest_px: polygons of fewer pixels are left out.

    Raises:
        SetupError: OpenCV is not installed.
    """
    found = []
    waiting = sorted(_pieces(mask), key=lambda piece: -piece.pixels)
    while waiting:
        whole, pixels, waiting = _joined(waiting, smallest_px)
        if pixels >= smallest_px:
            found.append(np.array(whole.walk(), dtype=np.int32).reshape(-1, 2))
    return found


def _pieces(mask: NDArray[np.bool_]) -> list[Ring]:
    """The connected pieces of a mask, with their holes."""
    cv2 = library("cv2")
    outlines, tree = cv2.findContours(mask.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if len(outlines) == 1:
        return [Ring(_simple(outlines[0]), int(np.count_nonzero(mask)))]
    rings = []
    for outline, (_next, _previous, _child, parent) in zip(
        outlines, tree[0] if outlines else (), strict=True
    ):
        # The pixels on and within a line through pixels, by Pick's theorem; a hole's line is not its own.
        steps = _steps(outline[:, 0])
        pixels = round(cv2.contourArea(outline) + (1 if parent < 0 else -1) * steps / 2) + 1
        rings.append(Ring(_simple(outline), pixels))
    pieces = []
    for place, ring in enumerate(rings):
        holes = [rings[other] for other in range(len(rings)) if tree[0][other][3] == place]
        if tree[0][place][3] >= 0:
            continue
        for hole in holes:
            _, here, there = _nearest(ring.points, hole.points)
            ring.hang(hole, here, there)
        pieces.append(Ring(ring.points, ring.pixels - sum(hole.pixels for hole in holes), ring.hung))
    return pieces


def _joined(pieces: list[Ring], smallest_px: int) -> tuple[Ring, int, list[Ring]]:
    """The first piece with those that are worth a bridge, nearest first; their pixels; the other pieces."""
    root, *others = pieces
    pixels, painted = root.pixels, 0.0
    # The shortest bridge from what is joined to each of the others: length, points, from which ring.
    best = [(*_nearest(root.points, other.points), root) for other in others]

    def fits(place: int) -> bool:
        cost, gain = max(best[place][0] - 1, 0.0), others[place].pixels
        cheap = painted + cost <= BRIDGED * (pixels + gain)
        return cost <= WORTH * gain and (cheap or gain < smallest_px)

    while fitting := [place for place in range(len(others)) if fits(place)]:
        place = min(fitting, key=lambda one: best[one][0])
        (length, here, there, ring), piece = best.pop(place), others.pop(place)
        ring.hang(piece, here, there)
        pixels, painted = pixels + piece.pixels, painted + max(length - 1, 0.0)
        for k, other in enumerate(others):
            new = _nearest(piece.points, other.points)
            if new[0] < best[k][0]:
                best[k] = (*new, piece)
    return root, pixels, others


def _nearest(these: Points, those: Points) -> tuple[float, int, int]:
    """How many pixels a line between the nearest points steps over, and their indices."""
    steps = np.maximum(
        np.abs(these[:, None, 0] - those[None, :, 0]), np.abs(these[:, None, 1] - those[None, :, 1])
    )
    here, there = divmod(int(steps.argmin()), len(those))
    return float(steps[here, there]), here, there


def _steps(points: Points) -> int:
    """How many pixels a closed line steps over; its sides run straight or diagonally."""
    steps = np.abs(np.diff(points, axis=0, append=points[:1]))
    return int(np.maximum(steps[:, 0], steps[:, 1]).sum())


def _simple(outline: Points) -> Points:
    """The outline that OpenCV gives, with fewer points."""
    points: Points = library("cv2").approxPolyDP(outline, TOLERANCE_PX, True)[:, 0]
    return points


_VALIDATION: Final = ("val", "valid", "validation", "dev")
_DECIMALS: Final = 6  # a two-hundredth of a pixel in pictures of 5,000


def export_yolo(
    dataset: Dataset,
    out: Path,
    splits: Splits,
    *,
    indices: Sequence[int] | None = None,
    on_frame: OnFrame | None = None,
    smallest_px: int = 12,
) -> ExportResult:
    """Write `images/train/000110.png`, `labels/train/000110.txt` and `data.yaml`.

    A line is an organ of a plant: its class id less 1, as ids start at 0 and the background has none, and
    its polygon over the width and height of the picture, through the centres of pixels. What belongs to no
    plant is left out, for the format knows no crowd.

    Args:
        dataset: with the outputs colour and instance.
        out: a new or an empty folder.
        splits: frames in none are left out.
        indices: of the frames wanted; None for all.
        on_frame: called after every frame.
        smallest_px: organs of which fewer pixels are seen are left out, and pieces of fewer. Chosen: three by
            four pixels, less than one pixel of a network's masks, a quarter as wide as its input.

    Raises:
        InputError: an output is missing, or a file is damaged.
        OutputError: the folder holds something, or cannot be written to.
        SetupError: OpenCV is not installed.
    """
    library("cv2")
    wanted = wanted_frames(dataset, splits, indices, ("colour", "instance"))
    names = list(splits.members(wanted))
    with new_folder(out, dataset.folder) as folder:
        for name in names:
            (folder / "images" / name).mkdir(parents=True)
            (folder / "labels" / name).mkdir(parents=True)
        (folder / "data.yaml").write_text(_description(names), encoding="utf-8")
        for source in export_sources(dataset, wanted, on_frame):
            split = splits.named(source.index)
            (folder / "images" / split / f"{source.name}.png").write_bytes(source.content("colour"))
            lines = label_lines(source, smallest_px)
            (folder / "labels" / split / f"{source.name}.txt").write_text(
                "".join(f"{line}\n" for line in lines), encoding="ascii"
            )
    return ExportResult(out, len(wanted), 2 * len(wanted) + 1)


def label_lines(source: ExportSource, smallest_px: int) -> list[str]:
    """The lines of a frame's label file, by ascending instance."""
    from scipy import ndimage

    ids = segment_ids(source, smallest_px)
    height, width = ids.shape
    across, down = _centres(width), _centres(height)
    known = source.facts["instances"]
    lines = []
    for value, window in enumerate(ndimage.find_objects(ids.astype("int32"), max_label=REST - 1), start=1):
        if window is None:
            continue
        rows, columns = window
        for polygon in polygons(ids[window] == value, smallest_px):
            xy = " ".join(
                f"{across[columns.start + x]} {down[rows.start + y]}" for x, y in _three(polygon).tolist()
            )
            lines.append(f"{known[str(value)]['class'] - 1} {xy}")
    return lines


def _three(polygon: Points) -> Points:
    """At least three points: readers take two for a box."""
    return polygon if len(polygon) > 2 else polygon[[0, 0, -1]]


def _centres(count: int) -> list[str]:
    """Where the centres of a row of pixels lie in [0, 1]."""
    return [f"{(place + 0.5) / count:.{_DECIMALS}f}" for place in range(count)]


def _description(names: Sequence[str]) -> str:
    """`data.yaml`; paths are seen from its own folder. Readers want both `train` and `val`."""
    lines = [f"{name}: images/{name}" for name in names]
    if EVERYTHING not in names:
        lines.append(f"train: images/{names[0]}  # there is no split of this name")
    if "val" not in names:
        other = next((name for name in _VALIDATION if name in names), names[0])
        lines.append(f"val: images/{other}  # there is no split of this name")
    lines.append("names:")
    lines += [f"  {one - 1}: {one.name.lower()}" for one in OrganClass if one != OrganClass.BACKGROUND]
    return "\n".join(lines) + "\n"

"""Polygons of masks: one closed line around the pieces and the holes of a mask, joined by bridges."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.libraries import import_library

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
    labels = _label_pieces(mask) if len(pieces) > 2 else None
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


def _label_pieces(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The number of the connected piece that each pixel belongs to, 0 outside the mask."""
    labels: NDArray[np.int32] = import_library("cv2").connectedComponents(mask.view(np.uint8))[1]
    return labels


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

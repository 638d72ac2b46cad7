"""What is compared between an export and its data set, and the differences that are allowed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

LARGEST_PX = 0.05
LARGEST_MM = 0.55
"""Rounding to millimetres, and single precision."""


@dataclass
class Figures:
    """Numbers of what was compared, and the largest differences; comparing raises `AssertionError`."""

    points: int = 0
    largest_px: float = 0.0
    depths: int = 0
    largest_mm: float = 0.0
    masks: int = 0  # equal to the last pixel, except those of `ious`
    ious: list[tuple[int, float]] = field(default_factory=list)  # with pixels, of approximate masks

    def add_points(self, found, expected, place):
        """Pixels `(n, 2)` of the same points."""
        error = np.linalg.norm(np.asarray(found, float) - expected, axis=1)
        assert (error <= LARGEST_PX).all(), f"{place}: a point is elsewhere"
        self.points += len(error)
        self.largest_px = max(self.largest_px, error.max(initial=0.0))

    def add_depths(self, found_mm, expected_mm, place, allowed_mm=LARGEST_MM):
        """Depths or distances `(n,)` of the same pixels."""
        error = np.abs(np.asarray(found_mm, float) - expected_mm)
        assert (error <= allowed_mm).all(), f"{place}: a depth differs"
        self.depths += error.size
        self.largest_mm = max(self.largest_mm, error.max(initial=0.0))

    def add_mask(self, found, expected, place):
        """Masks of the same object, which must have an intersection over union of 1."""
        assert (found == expected).all(), f"{place}: a mask differs"
        self.masks += 1

    def add_labels(self, found, expected, place):
        """Images of numbers; the pixels of each number are a mask."""
        assert found.shape == expected.shape, f"{place}: the size of an image differs"
        for value in np.union1d(found, expected):
            self.add_mask(found == value, expected == value, f"{place}, number {value}")

    def __str__(self):
        parts = []
        if self.points:
            parts.append(f"{self.points} points, {self.largest_px:.5f} px")
        if self.depths:
            parts.append(f"{self.depths} depths, {self.largest_mm:.3f} mm")
        if self.masks > len(self.ious):
            parts.append(f"{self.masks - len(self.ious)} masks, IoU 1")
        if self.ious:
            pixels, ious = np.array(self.ious).T
            large = ious[pixels > 200].min(initial=1.0)
            median, lowest = np.median(ious), ious.min()
            parts.append(f"{len(ious)} polygons, IoU {median:.4f}, {lowest:.4f}; above 200 px {large:.4f}")
        return "; ".join(parts)

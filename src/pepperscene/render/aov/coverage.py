"""How much of each pixel's area every class covers, for what is thinner than a pixel.

The share of rays through evenly spread points of a pixel that meet a class: a box filter over the pixel, with
everything sharp, in the lens geometry of the labels. Most pixels show one class alone. So a few rays go
through every pixel first, and many only where these, or those of a neighbour, do not agree; what the many
find is asked about in the same way, so that a thin thing is followed along from wherever it was found.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh
from pepperscene.render.kernel.arrays import device_number, device_table
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.variant import mitsuba_modules

POINTS: Final = 64
"""Chosen: of a pixel that is looked at closely. The share on one side of a straight edge is then told to
0.012 (root mean square)."""

_FEW: Final = 4
"""Chosen: of every pixel. Those of neighbours differ, so that sixteen pixels have all `POINTS` between
them."""

_LATTICE: Final = 37
"""Step of the lattice of points: of a dozen odd numbers the one with the least errors (root mean square) over
half-planes (0.012), and over strips of 0.1 and 0.3 pixels (0.016, 0.017), at random angles, that also does
well along the pixel's sides: 0.007 to 0.011, where the square grid's errors are 0.030 to 0.047."""

_AT_A_TIME: Final = 1 << 15
"""Chosen: pixels that are looked at closely in one go, 2 million rays: their memory stays below 40 MB."""


class Coverage:
    """What a scene's coverage images need to know of its mesh.

    Args:
        mesh: that the kernel's scene holds.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._classes = device_table(mesh.face_class, np.uint32)
        self._points = device_table(pixel_points())

    def image(self, scene: Any, view: CameraRays, *, everywhere: bool = False) -> NDArray[np.float16]:
        """`(h, w, 8)` share of each pixel's area that each `OrganClass` covers, multiples of 1/64.

        Args:
            scene: the kernel's, of the mesh.
            view: whose pixels.
            everywhere: True looks at all pixels closely; slow, to compare with.
        """
        shape = (view.height, view.width)
        if everywhere:
            seen, close = np.zeros(shape, np.uint8), np.ones(shape, bool)
            shares = np.zeros((*shape, len(OrganClass)), np.uint8)
        else:
            seen, close = self._seen(scene, view), np.zeros(shape, bool)
            shares = np.unpackbits(seen[..., None], axis=-1, bitorder="little") * np.uint8(POINTS)
        pixels = np.flatnonzero(close if everywhere else _mixed(seen))
        while pixels.size:
            found = self._counted(scene, view, pixels)
            shares.reshape(-1, len(OrganClass))[pixels] = found
            seen.ravel()[pixels] = np.packbits(found > 0, axis=1, bitorder="little")[:, 0]
            close.ravel()[pixels] = True
            pixels = np.flatnonzero(_mixed(seen) & ~close)
        # Exact: whole numbers up to 64 over a power of two.
        return shares.astype(np.float16) / np.float16(POINTS)

    def _seen(self, scene: Any, view: CameraRays) -> NDArray[np.uint8]:
        """`(h, w)` the classes that a few rays through each pixel meet, one bit each."""
        # Two by two pixels at a time: sixteen rays that go the same way are handed to Embree together.
        row, column = np.mgrid[: view.height + 1 & ~1, : view.width + 1 & ~1].astype(np.uint32)
        inside = np.minimum(row, view.height - 1) * view.width + np.minimum(column, view.width - 1)
        blocks = inside.reshape(inside.shape[0] // 2, 2, -1, 2).swapaxes(1, 2)
        pixels = np.ascontiguousarray(blocks).ravel()
        which = self._met(scene, view, pixels, _FEW)
        bits = (1 << which).astype(np.uint8).reshape(-1, _FEW)
        seen = np.empty((view.height, view.width), np.uint8)
        seen.ravel()[pixels] = bits[:, 0] | bits[:, 1] | bits[:, 2] | bits[:, 3]
        return seen

    def _counted(self, scene: Any, view: CameraRays, pixels: NDArray[np.intp]) -> NDArray[np.uint8]:
        """`(n, 8)` how many of all `POINTS` of some pixels meet each class."""
        found = np.empty((len(pixels), len(OrganClass)), np.uint8)
        for start in range(0, len(pixels), _AT_A_TIME):
            some = pixels[start : start + _AT_A_TIME].astype(np.uint32)
            which = self._met(scene, view, some, POINTS).astype(np.uint64)
            # Eight counts of at most 64 are the bytes of one number, the first class' the least.
            counts = (np.uint64(1) << (np.uint64(8) * which)).reshape(-1, POINTS).sum(axis=1, dtype=np.uint64)
            found[start : start + len(some)] = counts.astype("<u8").view(np.uint8).reshape(-1, 8)
        return found

    def _met(
        self, scene: Any, view: CameraRays, pixels: NDArray[np.uint32], points: int
    ) -> NDArray[np.uint32]:
        """`(n * points,)` the class that each ray meets."""
        mi, dr = mitsuba_modules()
        lane = dr.arange(mi.UInt32, len(pixels) * points)
        pixel = dr.gather(mi.UInt32, device_table(pixels, np.uint32), lane // points)
        row = pixel // device_number(view.width, whole=True)
        column = pixel - row * view.columns
        place = lane % points
        if points < POINTS:
            place += points * ((row % 4) * 4 + column % 4)
        at = dr.gather(mi.Point2f, self._points, place)
        towards = view.directions(column, row, at.x, at.y)
        hit = scene.ray_intersect_preliminary(mi.Ray3f(view.origin, towards), coherent=True)
        which = dr.gather(mi.UInt32, self._classes, hit.prim_index, hit.is_valid())
        return np.array(which)


def pixel_points() -> NDArray[np.float32]:
    """`(64, 2)` points of a pixel, in sixteen groups of four.

    A lattice, whose points differ in both coordinates: edges along the pixel's sides are told to 1/64, where
    a square grid of as many points has but eight steps. The four points of a group lie in the four quarters.

    Method: N. M. Korobov, "The approximate computation of multiple integrals", Doklady Akademii Nauk SSSR 124
    (1959) 1207.
    """
    number = np.arange(POINTS)
    points = np.stack([number, number * _LATTICE % POINTS], axis=1)
    # Each quarter's points by their column, and one of each quarter to a group.
    right, below = (points // (POINTS // 2)).T
    quarters = [points[(right == i % 2) & (below == i // 2)] for i in range(_FEW)]
    return ((np.stack(quarters, axis=1).reshape(-1, 2) + 0.5) / POINTS).astype(np.float32)


def _mixed(seen: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """`(h, w)` where a pixel and its eight neighbours do not all show one and the same class."""
    wide = np.pad(seen, 1, mode="edge")
    rows = wide[:-2] | wide[1:-1] | wide[2:]
    near = rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]
    return np.asarray((near & near - np.uint8(1)) != 0)

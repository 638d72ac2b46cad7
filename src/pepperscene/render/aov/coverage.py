"""Class coverage of each pixel's area, for structures thinner than a pixel.

Coverage is the fraction of rays through evenly spread points of a pixel that hit a class: a box filter over
the pixel, with everything in focus, in the lens geometry of the labels. Most pixels show a single class. So a
few rays go through every pixel first, and many only where these, or those of a neighbour, differ. Many rays
can reveal further classes, so the test is repeated: a thin structure is followed from wherever it was found.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.rows import row_strips
from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh
from pepperscene.render.arrays import device_array, device_uint
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.variant import mitsuba_modules

POINTS: Final = 64
"""Chosen: of a mixed pixel; the area next to a straight edge has an error of 0.012 (root mean square)."""
_COARSE_POINTS: Final = 4
"""Chosen: of every pixel. Neighbours have different ones, all `POINTS` among sixteen pixels."""
_LATTICE_STEP: Final = 37
"""Of a dozen odd numbers the one with the smallest errors (root mean square) over half-planes (0.012), and
over strips of 0.1 and 0.3 pixels (0.016, 0.017), at random angles, that is also good along the pixel's sides:
0.007 to 0.011, where the errors of the square grid are 0.030 to 0.047."""
_IGNORED: Final = len(OrganClass)
"""Index, in this module, of what is ignored: it has no channel, and is not background."""
_ONES: Final = np.append(np.uint64(1) << np.arange(0, 64, 8, dtype=np.uint64), np.uint64(0))
"""A count of one in the byte of each class; nothing is counted for what is ignored."""
_BATCH: Final = 1 << 15  # chosen: mixed pixels traced at once, 2 million rays, below 40 MB


class SceneCoverage:
    """The classes of a scene's triangles on the device.

    Args:
        mesh: of the Mitsuba scene.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._classes = device_array(np.minimum(mesh.face_class, _IGNORED), np.uint32)
        self._points = device_array(pixel_points())

    def image(self, scene: Any, rays: CameraRays) -> NDArray[np.float16]:
        """`(h, w, 8)` fraction of each pixel's area that each `OrganClass` covers, multiples of 1/64.

        They sum to 1 less the fraction that is ignored.
        """
        strips = row_strips(rays.width, rays.height)
        classes = np.concatenate([self._coarse_classes(scene, rays, rows) for rows in strips])
        refined = np.zeros(classes.shape, bool)
        organs = classes.astype(np.uint8)
        counts = np.unpackbits(organs[..., None], axis=-1, bitorder="little") * np.uint8(POINTS)
        pixels = np.flatnonzero(_is_mixed(classes))
        while pixels.size:
            mixed_counts = self._count_classes(scene, rays, pixels)
            counts.reshape(-1, len(OrganClass))[pixels] = mixed_counts
            is_ignored = mixed_counts.sum(axis=1, dtype=np.uint16) < POINTS
            classes.ravel()[pixels] = np.packbits(mixed_counts > 0, axis=1, bitorder="little")[:, 0]
            classes.ravel()[pixels[is_ignored]] |= np.uint16(1 << _IGNORED)
            refined.ravel()[pixels] = True
            pixels = np.flatnonzero(_is_mixed(classes) & ~refined)
        fractions = np.empty(counts.shape, np.float16)
        for rows in strips:
            # Exact: integers up to 64 over a power of two.
            np.divide(counts[rows], np.float16(POINTS), out=fractions[rows])
        return fractions

    def _coarse_classes(self, scene: Any, rays: CameraRays, rows: slice) -> NDArray[np.uint16]:
        """`(n, w)` the classes that a few rays through each pixel of some rows hit, one bit each."""
        # In blocks of two by two pixels: sixteen similar rays form one Embree packet.
        height = rows.stop - rows.start
        row, column = np.mgrid[: height + 1 & ~1, : rays.width + 1 & ~1].astype(np.uint32)
        inside = np.minimum(row, height - 1) * rays.width + np.minimum(column, rays.width - 1)
        blocks = inside.reshape(inside.shape[0] // 2, 2, -1, 2).swapaxes(1, 2)
        pixels = np.ascontiguousarray(blocks).ravel()
        first = np.uint32(rows.start * rays.width)
        hit_classes = self._trace(scene, rays, pixels + first, _COARSE_POINTS)
        bits = (1 << hit_classes).astype(np.uint16).reshape(-1, _COARSE_POINTS)
        classes = np.empty((height, rays.width), np.uint16)
        classes.ravel()[pixels] = bits[:, 0] | bits[:, 1] | bits[:, 2] | bits[:, 3]
        return classes

    def _count_classes(self, scene: Any, rays: CameraRays, pixels: NDArray[np.intp]) -> NDArray[np.uint8]:
        """`(n, 8)` number of the `POINTS` of each pixel that hit each class."""
        counts = np.empty((len(pixels), len(OrganClass)), np.uint8)
        for start in range(0, len(pixels), _BATCH):
            batch = pixels[start : start + _BATCH].astype(np.uint32)
            hit_classes = self._trace(scene, rays, batch, POINTS)
            # Eight counts of at most 64 are the bytes of one integer, the first class in the lowest.
            ones = np.take(_ONES, hit_classes).reshape(-1, POINTS)
            sums = ones.sum(axis=1, dtype=np.uint64)
            counts[start : start + len(batch)] = sums.astype("<u8").view(np.uint8).reshape(-1, 8)
        return counts

    def _trace(
        self, scene: Any, rays: CameraRays, pixels: NDArray[np.uint32], points: int
    ) -> NDArray[np.uint32]:
        """`(n * points,)` the class that each ray hits."""
        mi, dr = mitsuba_modules()
        lane = dr.arange(mi.UInt32, len(pixels) * points)
        pixel = dr.gather(mi.UInt32, device_array(pixels, np.uint32), lane // points)
        row = pixel // device_uint(rays.width)
        column = pixel - row * rays.device_width
        index = lane % points
        if points < POINTS:
            index += points * ((row % 4) * 4 + column % 4)
        at = dr.gather(mi.Point2f, self._points, index)
        origin, direction = rays.centre_rays(column, row, at.x, at.y)
        hit = scene.ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=True)
        return np.array(dr.gather(mi.UInt32, self._classes, hit.prim_index, hit.is_valid()))


def pixel_points() -> NDArray[np.float32]:
    """`(64, 2)` points of a pixel, in sixteen groups of four.

    A lattice, whose points differ in both coordinates: edges along the pixel's sides are resolved to 1/64,
    where a square grid has only eight steps. The points of a group are in the four quarters of the pixel.

    Method: N. M. Korobov, "The approximate computation of multiple integrals", Doklady Akademii Nauk SSSR 124
    (1959) 1207.
    """
    number = np.arange(POINTS)
    points = np.stack([number, number * _LATTICE_STEP % POINTS], axis=1)
    # The points of each quarter by their column, and one of each quarter to a group.
    right, below = (points // (POINTS // 2)).T
    quarters = [points[(right == i % 2) & (below == i // 2)] for i in range(_COARSE_POINTS)]
    return ((np.stack(quarters, axis=1).reshape(-1, 2) + 0.5) / POINTS).astype(np.float32)


def _is_mixed(classes: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """`(h, w)` whether a pixel and its eight neighbours show more than one class."""
    padded = np.pad(classes, 1, mode="edge")
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    nearby = rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]
    return np.asarray((nearby & nearby - np.uint16(1)) != 0)

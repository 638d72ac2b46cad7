"""The pixel coordinates of a camera as a table, for the kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from pepperscene.camera import Camera
from pepperscene.render.arrays import device_array, device_float, device_uint
from pepperscene.render.variant import mitsuba_modules

_NODES: Final = 257
"""Along each side. Chosen: between the nodes, the pixel coordinates of a lens of 90 degrees are right to a
few thousandths of a pixel."""
_MARGIN: Final = (
    0.02  # chosen: of the table beyond the image's extreme slopes, so that no border is at its rim
)
_OUTSIDE: Final = -1e9  # pixel coordinates where the lens has none


@dataclass(frozen=True, eq=False)
class ImageMap:
    """Pixel coordinates of a camera at a regular grid of undistorted slopes (x/z, y/z).

    Attributes:
        table: `(n * n * 3,)` at each node u, v, and pixels per unit of area in the plane of slopes.
        low, scale: the first node's slopes, and nodes per unit, of x and y each.
        size: width and height of the image.
        nodes: along each side.
    """

    table: Any
    low: tuple[Any, Any]
    scale: tuple[Any, Any]
    size: tuple[Any, Any]
    nodes: Any

    def lookup(self, x: Any, y: Any, active: Any) -> tuple[Any, Any]:
        """Whether slopes are in the image, and the pixels per unit of area there; linear between nodes."""
        mi, dr = mitsuba_modules()
        column, row = (x - self.low[0]) * self.scale[0], (y - self.low[1]) * self.scale[1]
        last = mi.Float(self.nodes - 1)
        in_table = active & (column >= 0.0) & (row >= 0.0) & (column < last) & (row < last)
        left, top = mi.UInt32(dr.select(in_table, column, 0.0)), mi.UInt32(dr.select(in_table, row, 0.0))
        across, down = column - mi.Float(left), row - mi.Float(top)
        first = top * self.nodes + left
        a, b, c, d = (
            dr.gather(mi.Vector3f, self.table, first + offset, in_table)
            for offset in (0, 1, self.nodes, self.nodes + 1)
        )
        found = dr.lerp(dr.lerp(a, b, across), dr.lerp(c, d, across), down)
        inside = in_table & (found.x >= 0.0) & (found.y >= 0.0)
        inside &= (found.x < self.size[0]) & (found.y < self.size[1])
        return inside, found.z


def image_map(camera: Camera) -> ImageMap:
    """The table of a camera; its pose and motion do not matter."""
    lowest, highest = camera.slope_limits()
    size = highest - lowest
    low, high = lowest - _MARGIN * size, highest + _MARGIN * size
    x, y = (np.linspace(low[axis], high[axis], _NODES) for axis in (0, 1))
    points = np.stack([*np.meshgrid(x, y), np.ones((_NODES, _NODES))], axis=-1)
    still = replace(camera, pose=np.eye(4), motion=None)
    pixels = still.project(points.reshape(-1, 3)).reshape(_NODES, _NODES, 2)
    du_dy, du_dx = np.gradient(pixels[..., 0], y, x)
    dv_dy, dv_dx = np.gradient(pixels[..., 1], y, x)
    area = np.asarray(du_dx * dv_dy - du_dy * dv_dx)
    table = np.concatenate([pixels, area[..., None]], axis=-1)
    # Beyond the field of the lens, and beside it where there is no derivative.
    table[..., :2] = np.nan_to_num(table[..., :2], nan=_OUTSIDE)
    scale = (_NODES - 1) / (high - low)
    return ImageMap(
        table=device_array(np.nan_to_num(table)),
        low=(device_float(low[0]), device_float(low[1])),
        scale=(device_float(scale[0]), device_float(scale[1])),
        size=(device_float(camera.width), device_float(camera.height)),
        nodes=device_uint(_NODES),
    )

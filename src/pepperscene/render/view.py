"""A camera's rays inside the kernel: one lens geometry for colour and for labels."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pepperscene.camera import Camera
from pepperscene.render.region import WORLD, Region
from pepperscene.render.upload import device_number, device_table
from pepperscene.render.variant import kernel


@dataclass(frozen=True, eq=False)
class View:
    """Rays of a camera. The lens is tabulated once at the pixels' corners; the pose is a kernel input, so
    that a moved camera reuses the compiled kernel.

    Attributes:
        width, height: of the image, pixels.
        columns: the width as a number that the kernel reads, so that other sizes compile nothing anew.
        slopes: `((h + 1) * (w + 1) * 2,)` undistorted (x/z, y/z) at the pixels' corners.
        rotation: camera to world.
        origin: the projection centre, in the coordinates of the scene's region.
        focus: distance of the plane in focus along the axis, units; None where all is sharp.
        aperture: radius of the entrance pupil, units.
        unit: of the region, metres.
    """

    width: int
    height: int
    columns: Any
    slopes: Any
    rotation: Any
    origin: Any
    focus: Any = None
    aperture: Any = None
    unit: float = 1.0

    def directions(self, column: Any, row: Any, dx: Any, dy: Any) -> Any:
        """Unit world directions through points (dx, dy) in [0, 1]^2 of pixels.

        Bilinear between the corners: exact for a pinhole, and off by less than 1e-6 rad for a lens whose
        distortion changes smoothly over a pixel.
        """
        _, dr = kernel()
        return dr.normalize(self.rotation @ self._towards(column, row, dx, dy))

    def rays(self, column: Any, row: Any, place: Any, next_2d: Callable[[], Any]) -> tuple[Any, Any]:
        """Origins and unit directions in the world of rays through points `place` of pixels.

        With a plane in focus they start anywhere on the entrance pupil and meet in that plane (the thin lens
        of Cook, Porter & Carpenter 1984); `next_2d` is asked only then.
        """
        mi, dr = kernel()
        towards = self._towards(column, row, place.x, place.y)
        if self.focus is None:
            return self.origin, dr.normalize(self.rotation @ towards)
        pupil = self.aperture * mi.warp.square_to_uniform_disk_concentric(next_2d())
        start = mi.Vector3f(pupil.x, pupil.y, 0.0)
        return (
            self.origin + self.rotation @ start,
            dr.normalize(self.rotation @ (self.focus * towards - start)),
        )

    def _towards(self, column: Any, row: Any, dx: Any, dy: Any) -> Any:
        """Camera-axis directions (x/z, y/z, 1), bilinear between the pixels' corners."""
        mi, dr = kernel()
        first = row * (self.columns + 1) + column

        def corner(offset: Any) -> Any:
            return dr.gather(mi.Point2f, self.slopes, first + offset)

        upper = dr.lerp(corner(0), corner(1), dx)
        lower = dr.lerp(corner(self.columns + 1), corner(self.columns + 2), dx)
        slope = dr.lerp(upper, lower, dy)
        return mi.Vector3f(slope.x, slope.y, 1.0)


class LensCache:
    """Keeps the last lens table: along a path only the pose changes."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._slopes: Any = None

    def view(self, camera: Camera, region: Region = WORLD) -> View:
        """The camera's rays in a region's coordinates."""
        mi, dr = kernel()
        key = (camera.lens, camera.width, camera.height, camera.sensor.name, camera.intrinsics.tobytes())
        if key != self._key:
            self._slopes = device_table(camera.ray_slopes())
            self._key = key
        rotation = mi.Matrix3f(np.asarray(camera.pose[:3, :3], np.float32))
        origin = mi.Point3f(*(float(x) for x in region.places(camera.pose[:3, 3])))
        dr.make_opaque(rotation, origin)
        columns = device_number(camera.width, whole=True)
        view = View(camera.width, camera.height, columns, self._slopes, rotation, origin, unit=region.unit)
        if camera.focus_m is None:
            return view
        focus, aperture = (
            mi.Float(float(length / region.unit)) for length in (camera.focus_m, camera.aperture_radius_m)
        )
        dr.make_opaque(focus, aperture)
        return dataclasses.replace(view, focus=focus, aperture=aperture)

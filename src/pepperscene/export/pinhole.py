"""Images of a camera with a distorting lens, resampled to those of a pinhole camera."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera

_ZOOMS: Final = np.geomspace(1.0, 4.0, 200)  # chosen: with more, a sixteenth of the image would be left


class PinholeImages:
    """Resamples images of a camera to a pinhole camera with the same size.

    Attributes:
        matrix: `(3, 3)` of the pinhole camera.
        is_identity: whether the camera is that one already.

    Args:
        camera: of the images.
        fills: whether the principal point is in the middle, and the focal lengths, which are those of the
            camera otherwise, so long that the camera's image fills all pixels.

    Raises:
        ValueError: no focal length up to four times the camera's does.
    """

    def __init__(self, camera: Camera, *, fills: bool = False) -> None:
        self._camera, self.matrix = camera, camera.intrinsics.copy()
        if fills:
            self.matrix[:2, 2] = camera.width / 2, camera.height / 2
            self._fill()
        self.is_identity = camera.lens.distortion.is_zero and np.allclose(
            self.matrix, camera.intrinsics, 1e-12
        )
        if self.is_identity:
            return
        v, u = np.mgrid[: camera.height, : camera.width] + 0.5
        self._column, self._row, self._inside = self._source(u, v)

    def _source(self, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """Columns and rows in the camera's image of pixel coordinates, and whether they are inside."""
        camera, matrix, diagonal = self._camera, self._camera.intrinsics, ([0, 1], [0, 1])
        slopes = (np.stack([u, v], axis=-1) - self.matrix[:2, 2]) / self.matrix[diagonal]
        inside = np.hypot(*np.moveaxis(slopes, -1, 0)) < camera.lens.distortion.fold_radius
        distorted = camera.lens.distortion.distort(np.where(inside[..., None], slopes, 0.0))
        # Indices of pixels: the centre of the first one is at 0.5.
        place = distorted * matrix[diagonal] + matrix[:2, 2] - 0.5
        nearest = np.rint(place)
        inside &= ((nearest >= 0) & (nearest < [camera.width, camera.height])).all(axis=-1)
        return place[..., 0], place[..., 1], inside

    def _fill(self) -> None:
        """Find the shortest focal lengths at which all pixels of the border show something."""
        is_border = np.ones((self._camera.height, self._camera.width), bool)
        is_border[1:-1, 1:-1] = False
        v, u = np.argwhere(is_border).T + 0.5
        focal = self.matrix[[0, 1], [0, 1]].copy()
        for zoom in _ZOOMS:
            self.matrix[[0, 1], [0, 1]] = zoom * focal
            if self._source(u, v)[2].all():
                return
        raise ValueError("its image does not fill that of a pinhole camera")

    def resample(self, image: NDArray[Any], outside: Any) -> NDArray[Any]:
        """`(h, w)` an image by the nearest pixels, with the value `outside` beyond it."""
        if self.is_identity:
            return image
        result = np.full(image.shape, outside, image.dtype)
        rows, columns = (np.rint(axis[self._inside]).astype(np.intp) for axis in (self._row, self._column))
        result[self._inside] = image[rows, columns]
        return result

    def resample_colour(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """`(h, w, c)` a photograph, interpolated linearly, black beyond it."""
        from scipy.ndimage import map_coordinates

        channels = [
            map_coordinates(image[..., k].astype(float), [self._row, self._column], order=1, mode="nearest")
            for k in range(image.shape[2])
        ]
        smooth = np.where(self._inside[..., None], np.stack(channels, axis=-1), 0.0)
        return np.rint(smooth).astype(np.uint8)

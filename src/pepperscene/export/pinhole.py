"""Images of a camera with a distorting lens, resampled to those of a pinhole camera."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera

_MOST_ZOOM: Final = 4.0  # chosen: of a lens that needs more, less than a sixteenth of the image would be left


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
        is_same = bool(np.allclose(self.matrix, camera.intrinsics, rtol=1e-12, atol=1e-9))
        self.is_identity = camera.lens.distortion.is_zero and is_same
        if self.is_identity:
            return
        v, u = np.mgrid[: camera.height, : camera.width] + 0.5
        # Indices of pixels: the centre of the first one is at 0.5.
        self._column, self._row, self._inside = self._source(u, v)

    def _source(self, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """Columns and rows in the camera's image of pixel coordinates, and whether they are inside."""
        camera, matrix = self._camera, self._camera.intrinsics
        slopes = np.stack(
            [
                (u - self.matrix[0, 2]) / self.matrix[0, 0],
                (v - self.matrix[1, 2]) / self.matrix[1, 1],
            ],
            axis=-1,
        )
        inside = np.hypot(*np.moveaxis(slopes, -1, 0)) < camera.lens.distortion.fold_radius
        distorted = camera.lens.distortion.distort(np.where(inside[..., None], slopes, 0.0))
        column = distorted[..., 0] * matrix[0, 0] + matrix[0, 2] - 0.5
        row = distorted[..., 1] * matrix[1, 1] + matrix[1, 2] - 0.5
        inside &= (np.rint(column) >= 0) & (np.rint(column) < camera.width)
        return column, row, inside & (np.rint(row) >= 0) & (np.rint(row) < camera.height)

    def _fill(self) -> None:
        """Find the shortest focal lengths at which all pixels of the border show something."""
        width, height = self._camera.width, self._camera.height
        u, v = np.arange(width) + 0.5, np.arange(height) + 0.5
        border_u = np.concatenate([u, u, np.full(height, 0.5), np.full(height, width - 0.5)])
        border_v = np.concatenate([np.full(width, 0.5), np.full(width, height - 0.5), v, v])
        focal = self.matrix[[0, 1], [0, 1]].copy()

        def fills(zoom: float) -> bool:
            self.matrix[[0, 1], [0, 1]] = zoom * focal
            return bool(self._source(border_u, border_v)[2].all())

        if fills(1.0):
            return
        low, high = 1.0, _MOST_ZOOM
        if not fills(high):
            raise ValueError("its image does not fill that of a pinhole camera")
        while high - low > 1e-3:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if fills(middle) else (middle, high)
        fills(high)

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

        if self.is_identity:
            return image
        channels = [
            map_coordinates(image[..., k].astype(float), [self._row, self._column], order=1, mode="nearest")
            for k in range(image.shape[2])
        ]
        smooth = np.where(self._inside[..., None], np.stack(channels, axis=-1), 0.0)
        return np.rint(smooth).astype(np.uint8)

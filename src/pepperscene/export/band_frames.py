"""What the exports of band images share: the images of a frame, and the bands that they have."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.bands import Band
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.band_channels import recorded_bands
from pepperscene.errors import InputError

BAND_IMAGES: Final = ("reflectance", "radiance", "bands")
"""Outputs that these formats write, those of them that all frames have."""

UNITS: Final = {
    "reflectance": "relative to the white reference",
    "radiance": "W m-2 sr-1 nm-1",
    "bands": "electrons",
}


def frame_bands(frame: DatasetFrame) -> tuple[Band, ...]:
    """The bands of a frame's sensor; raises `InputError` if it has none."""
    bands = recorded_bands(frame.metadata)
    if not bands:
        path = frame.dataset.frame_path(frame.index)
        raise InputError(path, "is required but missing", key="camera.bands")
    return bands


def band_image(frame: DatasetFrame, output: str, bands: tuple[Band, ...]) -> NDArray[np.float32]:
    """An output `(h, w, c)` of a frame; raises `InputError` if it has another number of bands."""
    image: NDArray[Any] = frame.image(output)
    if image.shape[2] != len(bands):
        problem = f"has {image.shape[2]} bands, and the frame's JSON lists {len(bands)}"
        raise InputError(frame.dataset.path(frame.index, output), problem)
    return image

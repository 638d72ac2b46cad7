"""Photographs as cameras store them: JPEG files with EXIF."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from io import BytesIO
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.isp.processor import ImageProcessor

QUALITY: Final = 90  # chosen: as cameras store by default
SUBSAMPLING: Final = "4:2:0"  # chosen: as most cameras do
_BASE_ISO: Final = 100  # chosen: at a gain of 1, as of most cameras
_LONGEST: Final = 1_000_000  # of a denominator; chosen: microseconds are exact


def photo_description(camera: Camera) -> dict[str, Any]:
    """What `jpeg_bytes` needs for an image of a camera, ready for JSON: quality, subsampling and EXIF tags.

    There is no time of day, because a frame depends on nothing but its recipe.
    """
    isp = camera.developing.isp or ImageProcessor()
    return {
        "jpeg_quality": QUALITY if isp.jpeg_quality is None else isp.jpeg_quality,
        "jpeg_subsampling": isp.jpeg_subsampling or SUBSAMPLING,
        "exif": {
            "Make": camera.sensor.name.partition(" ")[0],
            "Model": camera.sensor.name,
            "Software": "pepperscene",
            "ExposureTime": float(camera.exposure_s),
            "FNumber": float(camera.lens.f_number),
            "ISOSpeedRatings": round(_BASE_ISO * camera.sensor.gain),
            "FocalLength": 1e3 * float(camera.lens.focal_length_m),
            "LensModel": camera.lens.name,
        },
    }


def jpeg_bytes(image: NDArray[np.uint8], description: Mapping[str, Any]) -> bytes:
    """Encode an `(h, w, 3)` image as JPEG by Pillow, the same bytes for the same values.

    `description` is of `photo_description`; without it, quality and subsampling are `QUALITY` and
    `SUBSAMPLING`, and there is no EXIF.
    """
    from PIL import Image

    content = BytesIO()
    Image.fromarray(image).save(
        content,
        "JPEG",
        quality=description.get("jpeg_quality", QUALITY),
        subsampling=description.get("jpeg_subsampling", SUBSAMPLING),
        exif=_exif_bytes(description.get("exif", {})),
    )
    return content.getvalue()


def _exif_bytes(values: Mapping[str, Any]) -> bytes:
    """The EXIF block of values by the names of their tags; empty without values."""
    from PIL import ExifTags, Image, TiffImagePlugin

    if not values:
        return b""
    exif = Image.Exif()
    shooting = exif.get_ifd(ExifTags.IFD.Exif)
    for name, value in values.items():
        tag = ExifTags.Base[name]
        if isinstance(value, float):
            ratio = Fraction(value).limit_denominator(_LONGEST)
            value = TiffImagePlugin.IFDRational(ratio.numerator, ratio.denominator)
        # The first directory has the tags of TIFF, which have lower numbers.
        (exif if tag < ExifTags.Base.ExposureTime else shooting)[tag] = value
    return exif.tobytes()

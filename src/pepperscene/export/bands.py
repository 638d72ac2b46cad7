"""Spectral bands: ENVI files with wavelengths in a text header, and NumPy files with a table of the bands.

Formats: https://www.nv5geospatialsoftware.com/docs/ENVIHeaderFiles.html, which Spectral Python, GDAL, QGIS
and ENVI read; https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.bands import Band
from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.images import recorded_bands
from pepperscene.errors import InputError
from pepperscene.export.formats import BAND_IMAGES
from pepperscene.export.job import ExportJob, write_json

_UNITS: Final = {
    "reflectance": "relative to the white reference",
    "radiance": "W m-2 sr-1 nm-1",
    "bands": "electrons",
}
_FLOAT, _BYTE = 4, 1  # ENVI's numbers of data types
_CLASSES: Final = "class"
_LABELS: Final = (_CLASSES, "instance")
_IGNORED: Final = (128, 128, 128)  # colour of pixels to ignore; chosen: as in the output `class`


def write_envi(job: ExportJob, folder: Path) -> None:
    """Write `train/reflectance/000110.hdr` and `.img` of each band image, and the same of `class`.

    Numbers are 32-bit floats, little-endian, band after band (BSQ). The classes are an ENVI classification
    with the names and colours of the classes; pixels to ignore, if there can be some, are its last class.
    """
    outputs = job.common_outputs((*BAND_IMAGES, _CLASSES))
    for split, frames in job.frames_by_split():
        for output in outputs:
            (folder / split / output).mkdir(parents=True)
        for frame in frames:
            for output in outputs:
                path = folder / split / output / frame.name
                if output == _CLASSES:
                    classes = np.minimum(frame.image(output), len(OrganClass))[..., None]
                    _write(path, classes, _class_fields(has_ignored=job.has_ignored_pixels))
                else:
                    bands = _frame_bands(frame)
                    fields = _band_fields(frame, output, bands)
                    _write(path, _band_image(frame, output, bands).astype("<f4"), fields)


def _write(path: Path, image: NDArray[Any], fields: Mapping[str, Any]) -> None:
    """Write an image `(h, w, c)` with the header of its shape and some further fields."""
    height, width, count = image.shape
    shape = {"samples": width, "lines": height, "bands": count, "header offset": 0}
    layout = {"data type": _BYTE if image.dtype == np.uint8 else _FLOAT, "interleave": "bsq", "byte order": 0}
    lines = [f"{key} = {_value(value)}" for key, value in {**shape, **layout, **fields}.items()]
    path.with_suffix(".hdr").write_text("\n".join(["ENVI", *lines]) + "\n", encoding="utf-8")
    path.with_suffix(".img").write_bytes(np.ascontiguousarray(np.moveaxis(image, 2, 0)).tobytes())


def _value(value: Any) -> str:
    """A field's value: a list, or a text with spaces, is in braces."""
    if isinstance(value, str):
        return value
    return f"{{{', '.join(map(str, value))}}}" if isinstance(value, Iterable) else str(value)


def _band_fields(frame: DatasetFrame, output: str, bands: tuple[Band, ...]) -> dict[str, Any]:
    fields: dict[str, Any] = {
        "description": [f"{output} of frame {frame.index}, {_UNITS[output]}"],
        "file type": "ENVI Standard",
        "sensor type": "Unknown",
        "wavelength units": "Nanometers",
        "wavelength": [f"{band.centre_nm:g}" for band in bands],
        "fwhm": [f"{band.width_nm:g}" for band in bands],
        "data units": _UNITS[output],
    }
    if any(band.name for band in bands):
        # A comma or a brace would end a name.
        names = [band.name or f"{band.centre_nm:g} nm" for band in bands]
        fields["band names"] = [name.translate(str.maketrans(",{}", ";()")) for name in names]
    if output == "reflectance":
        fields["reflectance scale factor"] = 1.0
    return fields


def _class_fields(*, has_ignored: bool) -> dict[str, Any]:
    """The classification's fields: names and colours of the classes, and last of pixels to ignore."""
    names = [*(organ_class.name.lower() for organ_class in OrganClass), *["ignore"] * has_ignored]
    colours = [*CLASS_COLOURS[: len(OrganClass)], *[_IGNORED] * has_ignored]
    return {
        "file type": "ENVI Classification",
        "classes": len(names),
        "class names": names,
        "class lookup": [int(value) for colour in colours for value in colour],
    }


def write_npy(job: ExportJob, folder: Path) -> None:
    """Write `train/reflectance/000110.npy` of each band image and label, and `bands.json`.

    Band images are `(h, w, c)` float32, labels `(h, w)`. `bands.json` has the number, name, centre and full
    width at half maximum of each band, which are the same in all frames, and the units of the images.
    """
    outputs = job.common_outputs((*BAND_IMAGES, *_LABELS))
    table: dict[str, Any] | None = None
    for split, frames in job.frames_by_split():
        for output in outputs:
            (folder / split / output).mkdir(parents=True)
        for frame in frames:
            bands = _frame_bands(frame)
            listed = [{"number": number, **band.to_json()} for number, band in enumerate(bands, start=1)]
            units = {output: _UNITS[output] for output in outputs if output in _UNITS}
            table = table or {"bands": listed, "units": units}
            if listed != table["bands"]:
                problem = "must be the same in all frames of this format, which has one bands.json"
                raise InputError(frame.dataset.frame_path(frame.index), problem, key="camera.bands")
            for output in outputs:
                is_label = output in _LABELS
                image = frame.image(output) if is_label else _band_image(frame, output, bands)
                np.save(folder / split / output / f"{frame.name}.npy", image, allow_pickle=False)
    write_json(folder / "bands.json", table)


def _frame_bands(frame: DatasetFrame) -> tuple[Band, ...]:
    """The bands of a frame's sensor; raises `InputError` if it has none."""
    bands = recorded_bands(frame.metadata)
    if not bands:
        path = frame.dataset.frame_path(frame.index)
        raise InputError(path, "is required but missing", key="camera.bands")
    return bands


def _band_image(frame: DatasetFrame, output: str, bands: tuple[Band, ...]) -> NDArray[np.float32]:
    """An output `(h, w, c)` of a frame; raises `InputError` if it has another number of bands."""
    image: NDArray[Any] = frame.image(output)
    if image.shape[2] != len(bands):
        problem = f"has {image.shape[2]} bands, and the frame's JSON lists {len(bands)}"
        raise InputError(frame.dataset.path(frame.index, output), problem)
    return image

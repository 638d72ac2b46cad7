"""Columns of a Parquet export: content, and type for Hugging Face and for Arrow."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.manifest import DRAWN, FRUIT_COLUMNS, drawn_columns, fruit_rows
from pepperscene.errors import InputError

CLASS_NAMES: Final = tuple(organ.name.lower() for organ in OrganClass)

_IMAGE: Final = {"_type": "Image"}
_INT: Final = {"dtype": "int64", "_type": "Value"}
_FLOAT: Final = {"dtype": "float64", "_type": "Value"}
_TEXT: Final = {"dtype": "string", "_type": "Value"}
_CLASS: Final = {"names": list(CLASS_NAMES), "_type": "ClassLabel"}
_POSE: Final = {"shape": [4, 4], "dtype": "float64", "_type": "Array2D"}

_CAMERA_KEYS: Final = ("fx", "fy", "cx", "cy")
_DISTORTION_KEYS: Final = ("k1", "k2", "k3", "p1", "p2", "k4", "k5", "k6")
_PLUMB_BOB: Final = "plumb_bob"

_ORGAN: Final = {
    "instance": _INT,
    "class": _CLASS,
    "kind": _TEXT,
    "plant": _INT,
    "phytomer": _INT,
    "parent": _INT,
    "pixels": _INT,
    "box": [_INT],
    "far": {"dtype": "bool", "_type": "Value"},
}
_DTYPES: Final = {"double": "float64"}
"""Hugging Face's names of types that have another name in Parquet."""

_FRUIT: Final = {
    name: {"dtype": _DTYPES.get(dtype, dtype), "_type": "Value"}
    for name, dtype in FRUIT_COLUMNS.items()
    if name != "index"
}


@dataclass(frozen=True)
class Column:
    """One column of the Parquet files."""

    name: str
    feature: Any  # its type, as Hugging Face writes it in JSON
    meaning: str  # one line for the card
    value: Callable[[DatasetFrame], Any]  # its content for a frame


_VARIATION: Final = {
    "moment": (_INT, "number of the view; twins and the cameras of a rig share it"),
    "twin": (_INT, "number of the twin; twins differ in a few values only"),
    "rig_camera": (_TEXT, "name of the camera on the rig"),
}
_DRAWN: Final = "drawn"


def variation_columns(info: Mapping[str, Any]) -> tuple[Column, ...]:
    """The columns of moments, twins, rig cameras and drawn values that the recipe of a `dataset.json` has."""
    names = drawn_columns(info)
    columns = [
        Column(name, feature, meaning, _metadata_column(name))
        for name, (feature, meaning) in _VARIATION.items()
        if name in names
    ]
    if any(name.startswith(DRAWN) for name in names):
        meaning = "JSON: the values that differ between frames, by key of the recipe"
        columns.append(Column(_DRAWN, _TEXT, meaning, _drawn_text))
    return tuple(columns)


def frame_columns(outputs: Sequence[str], shape: tuple[int, int]) -> tuple[Column, ...]:
    """The columns of frames of a shape (h, w) that all have some outputs, at least colour and class."""
    distances = {"shape": list(shape), "dtype": "float32", "_type": "Array2D"}
    camera = {**dict.fromkeys((*_CAMERA_KEYS, *_DISTORTION_KEYS), _FLOAT), "model": _TEXT}
    optional = {
        "instance": Column("instances", _IMAGE, "16-bit instances; 0 is the sky", _image_column("instance")),
        "distance": Column(
            "distance",
            distances,
            "metres along the ray from the projection centre, inf in the sky",
            lambda frame: _distance_values(frame, shape),
        ),
        "harvest": Column("fruit", [_FRUIT], "visible fruit with hidden parts and cut points", _fruit_values),
    }
    return (
        Column("index", _INT, "of the frame in the whole plan", lambda frame: frame.index),
        Column("image", _IMAGE, "the photograph, 8-bit sRGB", _image_column("colour")),
        Column(
            "mask",
            _IMAGE,
            "class ids 0 to 7, or 255 to ignore, with a palette for display",
            _image_column("class"),
        ),
        *(optional[output] for output in optional if output in outputs),
        Column("organs", [_ORGAN], "the visible instances", _organ_values),
        Column("pixels", dict.fromkeys(CLASS_NAMES, _INT), "of each class", _class_pixels),
        Column("set", _INT, "of plants", _metadata_column("set")),
        Column("rotation", _INT, "of the row", _metadata_column("rotation")),
        Column("step", _INT, "along the camera's path", _metadata_column("step")),
        Column("pose", _POSE, "camera to world, metres; x right, y down, z forward", _pose_value),
        Column(
            "camera",
            camera,
            "focal lengths and principal point in pixels, distortion coefficients and the model's name",
            _camera_value,
        ),
    )


def arrow_type(feature: Any) -> Any:
    """The Arrow type of a feature in Hugging Face's Parquet files."""
    import pyarrow as pa

    if isinstance(feature, list):
        return pa.list_(arrow_type(feature[0]))
    kind = feature.get("_type")
    if kind is None:
        return pa.struct([(name, arrow_type(inner)) for name, inner in feature.items()])
    if kind == "Image":
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    if kind == "ClassLabel":
        return pa.int64()
    scalar = pa.type_for_alias(feature["dtype"])
    return pa.list_(pa.list_(scalar)) if kind == "Array2D" else scalar


def arrow_array(feature: Any, values: Sequence[Any]) -> Any:
    """The values of several frames as an Arrow array."""
    import pyarrow as pa

    if not (isinstance(feature, Mapping) and feature.get("_type") == "Array2D"):
        return pa.array(values, arrow_type(feature))
    # Lists of lists without a Python object for each number.
    stack = np.stack(values).astype(feature["dtype"])
    n, h, w = stack.shape
    rows = pa.ListArray.from_arrays(np.arange(0, n * h * w + 1, w, dtype=np.int32), stack.reshape(-1))
    return pa.ListArray.from_arrays(np.arange(0, n * h + 1, h, dtype=np.int32), rows)


def yaml_feature(feature: Any) -> dict[str, Any]:
    """A feature for the card's front matter."""
    if isinstance(feature, list):
        inner = yaml_feature(feature[0])
        return {"list": inner["dtype"] if list(inner) == ["dtype"] else inner.get("struct", inner)}
    kind = feature.get("_type")
    if kind is None:
        return {"struct": [{"name": name, **yaml_feature(inner)} for name, inner in feature.items()]}
    if kind == "Image":
        return {"dtype": "image"}
    if kind == "ClassLabel":
        # Keys of class labels are text in YAML.
        names = {str(number): name for number, name in enumerate(feature["names"])}
        return {"dtype": {"class_label": {"names": names}}}
    if kind == "Array2D":
        return {"dtype": {"array2_d": {"shape": feature["shape"], "dtype": feature["dtype"]}}}
    return {"dtype": feature["dtype"]}


def _image_column(output: str) -> Callable[[DatasetFrame], Mapping[str, Any]]:
    return lambda frame: {"bytes": frame.content(output), "path": f"{frame.name}_{output}.png"}


def _distance_values(frame: DatasetFrame, shape: tuple[int, int]) -> NDArray[np.float32]:
    distance: NDArray[np.float32] = frame.image("distance")
    if distance.shape != shape:
        (height, width), (rows, columns) = shape, distance.shape
        problem = f"has {columns}x{rows} pixels, but the first frame's classes {width}x{height}"
        raise InputError(frame.dataset.path(frame.index, "distance"), problem)
    return distance


def _metadata_column(key: str) -> Callable[[DatasetFrame], Any]:
    return lambda frame: frame.metadata.get(key)


def _drawn_text(frame: DatasetFrame) -> str:
    return json.dumps(frame.metadata.get(_DRAWN, {}), sort_keys=True, allow_nan=False)


def _class_pixels(frame: DatasetFrame) -> dict[str, int]:
    counts = frame.metadata.get("class_pixels", {})
    return {name: counts.get(name, 0) for name in CLASS_NAMES}


def _organ_values(frame: DatasetFrame) -> list[dict[str, Any]]:
    entries = frame.metadata["instances"]
    return [
        {
            **{key: entry.get(key) for key in _ORGAN},
            "instance": int(instance),
            "class": None if entry["class"] == IGNORE_CLASS else entry["class"],
            "far": entry.get("far", False),
        }
        for instance, entry in sorted(entries.items(), key=lambda item: int(item[0]))
    ]


def _fruit_values(frame: DatasetFrame) -> list[dict[str, Any]]:
    rows = fruit_rows(frame.index, frame.image("harvest"))
    return [{name: row.get(name) for name in _FRUIT} for row in rows]


def _pose_value(frame: DatasetFrame) -> NDArray[np.float64]:
    return np.asarray(frame.metadata["camera"]["pose"], np.float64)


def _camera_value(frame: DatasetFrame) -> dict[str, float | str]:
    camera = frame.metadata["camera"]
    distortion = camera["distortion"]
    return {
        **{key: float(camera[key]) for key in _CAMERA_KEYS},
        **{key: float(distortion.get(key, 0.0)) for key in _DISTORTION_KEYS},
        "model": str(distortion.get("model", _PLUMB_BOB)),
    }

"""The columns of a Parquet export: what each holds, and its type for Hugging Face and for Arrow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.export.source import ExportSource
from pepperscene.dataset.store.manifest import FRUIT_COLUMNS, fruit_rows

CLASS_NAMES: Final = tuple(organ.name.lower() for organ in OrganClass)

_IMAGE: Final = {"_type": "Image"}
_WHOLE: Final = {"dtype": "int64", "_type": "Value"}
_REAL: Final = {"dtype": "float64", "_type": "Value"}
_TEXT: Final = {"dtype": "string", "_type": "Value"}
_CLASS: Final = {"names": list(CLASS_NAMES), "_type": "ClassLabel"}

_CAMERA: Final = ("fx", "fy", "cx", "cy")
_DISTORTION: Final = ("k1", "k2", "k3", "p1", "p2")

_ORGAN: Final = {
    "instance": _WHOLE,
    "class": _CLASS,
    "kind": _TEXT,
    "plant": _WHOLE,
    "phytomer": _WHOLE,
    "parent": _WHOLE,
    "pixels": _WHOLE,
    "box": [_WHOLE],
}
_KINDS: Final = {"double": "float64"}
"""Parquet's words that Hugging Face has others for."""

_FRUIT: Final = {
    name: {"dtype": _KINDS.get(kind, kind), "_type": "Value"}
    for name, kind in FRUIT_COLUMNS.items()
    if name != "index"
}


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        name: its name.
        feature: its type, as Hugging Face writes it in JSON.
        meaning: one line for the card.
        value: what a frame has there.
    """

    name: str
    feature: Any
    meaning: str
    value: Callable[[ExportSource], Any]


def columns(outputs: Sequence[str], shape: tuple[int, int]) -> tuple[Column, ...]:
    """The columns of frames that have these outputs.

    Args:
        outputs: that all frames have; colour and class among them.
        shape: height and width of the frames.
    """
    distances = {"shape": list(shape), "dtype": "float32", "_type": "Array2D"}
    pose = {"shape": [4, 4], "dtype": "float64", "_type": "Array2D"}
    made = {
        "instance": Column("instances", _IMAGE, "16-bit organ numbers; 0 is the sky", _picture("instance")),
        "distance": Column(
            "distance",
            distances,
            "metres along the ray from the projection centre, inf in the sky",
            lambda source: source.image("distance"),
        ),
        "harvest": Column("fruit", [_FRUIT], "the fruit in view, hidden parts and cut points", _fruit),
    }
    return (
        Column("index", _WHOLE, "of the frame in the whole plan", lambda source: source.index),
        Column("image", _IMAGE, "the photograph, 8-bit sRGB", _picture("colour")),
        Column("mask", _IMAGE, "class ids 0 to 7, with a palette to look at", _picture("class")),
        *(made[output] for output in made if output in outputs),
        Column("organs", [_ORGAN], "what the organ numbers in view stand for", _organs),
        Column("pixels", dict.fromkeys(CLASS_NAMES, _WHOLE), "of each class", _pixels),
        Column("set", _WHOLE, "of plants", _fact("set")),
        Column("rotation", _WHOLE, "of the row", _fact("rotation")),
        Column("step", _WHOLE, "along the camera's path", _fact("step")),
        Column("pose", pose, "camera to world, metres; x right, y down, z forward", _pose),
        Column(
            "camera",
            dict.fromkeys((*_CAMERA, *_DISTORTION), _REAL),
            "focal lengths and principal point in pixels, Brown-Conrady distortion",
            _camera,
        ),
    )


def arrow_type(feature: Any) -> Any:
    """The Arrow type that Hugging Face keeps a feature in."""
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
    if kind == "Array2D":
        return pa.list_(pa.list_(_scalar(feature["dtype"])))
    return _scalar(feature["dtype"])


def arrow_array(feature: Any, values: Sequence[Any]) -> Any:
    """The values of several frames as Arrow holds them."""
    import pyarrow as pa

    if isinstance(feature, Mapping) and feature.get("_type") == "Array2D":
        return _nested(np.stack(values).astype(feature["dtype"]))
    return pa.array(values, arrow_type(feature))


def yaml_feature(feature: Any) -> dict[str, Any]:
    """A feature as the card's front matter writes it."""
    if isinstance(feature, list):
        inner = yaml_feature(feature[0])
        plain = inner["dtype"] if list(inner) == ["dtype"] else inner.get("struct", inner)
        return {"list": plain}
    kind = feature.get("_type")
    if kind is None:
        return {"struct": [{"name": name, **yaml_feature(inner)} for name, inner in feature.items()]}
    if kind == "Image":
        return {"dtype": "image"}
    if kind == "ClassLabel":
        return {"dtype": {"class_label": {"names": dict(enumerate_text(feature["names"]))}}}
    if kind == "Array2D":
        return {"dtype": {"array2_d": {"shape": feature["shape"], "dtype": feature["dtype"]}}}
    return {"dtype": feature["dtype"]}


def enumerate_text(names: Sequence[str]) -> list[tuple[str, str]]:
    """Names with their numbers as text, which YAML keys have to be there."""
    return [(str(number), name) for number, name in enumerate(names)]


def _scalar(dtype: str) -> Any:
    import pyarrow as pa

    return pa.type_for_alias(dtype)


def _nested(stack: NDArray[Any]) -> Any:
    """`(n, h, w)` as a column of lists of lists, without a Python object for each number."""
    import pyarrow as pa

    n, h, w = stack.shape
    rows = pa.ListArray.from_arrays(np.arange(0, n * h * w + 1, w, dtype=np.int32), stack.reshape(-1))
    return pa.ListArray.from_arrays(np.arange(0, n * h + 1, h, dtype=np.int32), rows)


def _picture(output: str) -> Callable[[ExportSource], Mapping[str, Any]]:
    return lambda source: {"bytes": source.content(output), "path": f"{source.name}_{output}.png"}


def _fact(key: str) -> Callable[[ExportSource], Any]:
    return lambda source: source.facts.get(key)


def _pixels(source: ExportSource) -> dict[str, int]:
    told = source.facts.get("class_pixels") or {}
    return {name: int(told.get(name, 0)) for name in CLASS_NAMES}


def _organs(source: ExportSource) -> list[dict[str, Any]]:
    told = source.facts.get("instances") or {}
    return [
        {**{key: organ.get(key) for key in _ORGAN}, "instance": int(number)}
        for number, organ in sorted(told.items(), key=lambda item: int(item[0]))
    ]


def _fruit(source: ExportSource) -> list[dict[str, Any]]:
    rows = fruit_rows(source.index, source.image("harvest"))
    return [{name: row.get(name) for name in _FRUIT} for row in rows]


def _pose(source: ExportSource) -> NDArray[np.float64]:
    return np.asarray(source.facts["camera"]["pose"], np.float64)


def _camera(source: ExportSource) -> dict[str, float]:
    told = source.facts["camera"]
    return {
        **{key: float(told[key]) for key in _CAMERA},
        **{key: float(told["distortion"][key]) for key in _DISTORTION},
    }

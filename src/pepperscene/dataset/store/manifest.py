"""The tables of a data set, `manifest.parquet` and `fruit.parquet`: columns, rows, and writing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, Final

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.atomic import atomic_write
from pepperscene.frame import OUTPUTS

MANIFEST: Final = "manifest.parquet"
FRUIT: Final = "fruit.parquet"

Row = dict[str, Any]
"""Values by column; a missing value is unknown."""

_ROWS_HELD: Final = 4096  # chosen: rows that are held in memory at a time, some megabytes
_BOX: Final = ("x0", "y0", "x1", "y1")

FRAME_COLUMNS: Final[Mapping[str, str]] = {
    "index": "int64",
    "set": "int32",
    "rotation": "int32",
    "step": "int32",
    "seed": "int64",
    "recipe_seed": "int64",
    **dict.fromkeys(("x_m", "y_m", "z_m"), "double"),
    "pose": "doubles",
    **{f"pixels_{organ_class.name.lower()}": "int64" for organ_class in OrganClass},
    "samples_per_pixel": "double",
    "error_codes": "double",
    "noise_codes": "double",
    "bytes": "int64",
    "render_s": "double",
    "write_s": "double",
    "worker": "string",
    "checksum": "string",
    **{f"{name}_sha256": "string" for name in OUTPUTS},
}
"""Columns of the manifest and their types, in Parquet's terms. Timings and the worker come from the journal
and are unknown where it is lost; all other values can be read from the frames again."""

FRUIT_COLUMNS: Final[Mapping[str, str]] = {
    "index": "int64",
    "instance": "int32",
    "plant": "int32",
    "phytomer": "int32",
    "kind": "string",
    **dict.fromkeys(("ripeness", "length_m", "diameter_m", "visible_fraction"), "double"),
    "visible_pixels": "int64",
    "amodal_pixels": "int64",
    "truncated": "bool",
    "occluders": "int32",
    **dict.fromkeys((f"foot_{axis}_m" for axis in "xyz"), "double"),
    **dict.fromkeys((f"along_{axis}" for axis in "xyz"), "double"),
    **dict.fromkeys((f"{kind}_{edge}" for kind in ("box", "amodal") for edge in _BOX), "int32"),
    "peduncle": "int32",
    **dict.fromkeys((f"cut_{axis}_m" for axis in "xyz"), "double"),
    **dict.fromkeys(("cut_u", "cut_v"), "double"),
    "cut_visible": "bool",
    **dict.fromkeys((f"approach_{axis}" for axis in "xyz"), "double"),
}  # fmt: skip
"""Columns of `fruit.parquet`: one row per fruit and frame; positions and directions in camera coordinates."""


def frame_row(metadata: Mapping[str, Any], outputs: Mapping[str, Any], checksum: str) -> Row:
    """The row of a frame, without timings: from its JSON, the entries of its images and its checksum."""
    columns = ("index", "set", "rotation", "step", "seed", "recipe_seed")
    row: Row = {name: metadata.get(name) for name in columns}
    pose = metadata.get("camera", {}).get("pose")
    if pose is not None:
        row |= {name: pose[axis][3] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
        row["pose"] = [number for line in pose for number in line]
    row |= {f"pixels_{name}": count for name, count in metadata.get("class_pixels", {}).items()}
    sampling = metadata.get("sampling", {})
    row |= {name: sampling.get(name) for name in ("samples_per_pixel", "error_codes", "noise_codes")}
    row |= {f"{name}_sha256": entry["sha256"] for name, entry in outputs.items()}
    row["bytes"] = sum(entry["bytes"] for entry in outputs.values())
    row["checksum"] = checksum
    return row


def fruit_rows(index: int, harvest: Mapping[str, Any]) -> Iterator[Row]:
    """Yield a row for each fruit in the output `harvest` of a frame."""
    for fruit in harvest["fruit"]:
        pose, peduncle = fruit["pose"], fruit["peduncle"]
        row: Row = {name: fruit[name] for name in FRUIT_COLUMNS if name in fruit and name != "peduncle"}
        row |= {"index": index, "occluders": len(fruit["occluders"])}
        row |= {f"foot_{axis}_m": pose[line][3] for line, axis in enumerate("xyz")}
        row |= {f"along_{axis}": pose[line][2] for line, axis in enumerate("xyz")}
        for kind, key in (("box", "box"), ("amodal", "amodal_box")):
            row |= {f"{kind}_{edge}": value for edge, value in zip(_BOX, fruit[key] or (), strict=False)}
        row |= _xyz("approach_{}", (fruit["approach"] or {}).get("camera"))
        if peduncle is not None:
            cut = peduncle["cut"]
            row |= {"peduncle": peduncle["instance"], "cut_visible": cut["visible"]}
            row |= _xyz("cut_{}_m", cut["camera_m"])
            row |= zip(("cut_u", "cut_v"), cut["px"] or (), strict=False)
        yield row


def _xyz(name: str, values: Any) -> Row:
    return {} if values is None else {name.format(axis): values[line] for line, axis in enumerate("xyz")}


def write_table(folder: Path, name: str, rows: Iterator[Row]) -> None:
    """Write `MANIFEST` or `FRUIT`, some thousand rows at a time."""
    import pyarrow
    from pyarrow import parquet

    columns, doubles = FRAME_COLUMNS if name == MANIFEST else FRUIT_COLUMNS, pyarrow.list_(pyarrow.float64())
    types = [doubles if kind == "doubles" else pyarrow.type_for_alias(kind) for kind in columns.values()]
    schema = pyarrow.schema(zip(columns, types, strict=True))
    with atomic_write(folder / name) as temporary, parquet.ParquetWriter(temporary, schema) as writer:
        while part := list(islice(rows, _ROWS_HELD)):
            values = {column: [row.get(column) for row in part] for column in columns}
            writer.write_table(pyarrow.table(values, schema=schema))

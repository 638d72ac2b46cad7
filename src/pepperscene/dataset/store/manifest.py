"""The tables of a data set, `manifest.parquet` and `fruit.parquet`: columns, rows, and writing."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.atomic import atomic_write
from pepperscene.classes import OrganClass
from pepperscene.dataset.store.drawn_columns import drawn_columns, drawn_kinds, drawn_row
from pepperscene.dataset.store.table_checksum import CHECKSUM_KEY, TableChecksum
from pepperscene.frame import OUTPUTS
from pepperscene.user_files import check_file, read_file

if TYPE_CHECKING:
    import pyarrow


MANIFEST: Final = "manifest.parquet"
FRUIT: Final = "fruit.parquet"

Row = dict[str, Any]
"""Values by column; a missing value is unknown."""

_ROWS_HELD: Final = 4096  # chosen: rows that are held in memory at a time, some megabytes
_BOX: Final = ("x0", "y0", "x1", "y1")
_INTEGER_BITS: Final = {"int32": 32, "int64": 64}

TIMINGS: Final = ("render_s", "write_s", "worker")
"""Columns of the manifest that only the journal knows."""

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
"""Columns of every manifest and their types, in Parquet's terms. Timings and the worker come from the journal
and are unknown where it is lost; all other values can be read from the frames again. Recipes with variation
have further columns; see `table_columns`."""

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
    """The row of a frame, without timings: from its JSON, the entries of its images and its checksum.

    Values of another type than their column's, which no build writes, are left out.
    """
    columns = ("index", "set", "rotation", "step", "seed", "recipe_seed")
    row: Row = {name: metadata.get(name) for name in columns}
    pose = _object(metadata, "camera").get("pose")
    if pose is not None and _is_matrix(pose):
        row |= {name: pose[axis][3] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
        row["pose"] = [number for line in pose for number in line]
    row |= {f"pixels_{name}": count for name, count in _object(metadata, "class_pixels").items()}
    sampling = _object(metadata, "sampling")
    row |= {name: sampling.get(name) for name in ("samples_per_pixel", "error_codes", "noise_codes")}
    entries = {name: entry for name, entry in outputs.items() if isinstance(entry, Mapping)}
    row |= {f"{name}_sha256": entry.get("sha256") for name, entry in entries.items()}
    sizes = [entry.get("bytes") for entry in entries.values()]
    row["bytes"] = sum(size for size in sizes if isinstance(size, int))
    row["checksum"] = checksum
    row |= drawn_row(metadata, entries)
    return {name: value for name, value in row.items() if _fits_any(name, value)}


def fits_columns(row: Row) -> bool:
    """Whether every value of a row can be stored in a column of its name in some manifest."""
    return all(_fits_any(name, value) for name, value in row.items())


def table_columns(name: str, info: Mapping[str, Any]) -> Mapping[str, str]:
    """The columns of `MANIFEST` or `FRUIT` and their types, for the content of a `dataset.json`."""
    return {**FRAME_COLUMNS, **drawn_columns(info)} if name == MANIFEST else FRUIT_COLUMNS


def stored_row(row: Row, columns: Mapping[str, str]) -> Row:
    """The values of a row that a table with these columns stores; those of other types are left out."""
    stored: Row = {}
    for name, kind in columns.items():
        if (value := row.get(name)) is not None and _fits(kind, value := _text_of(value, kind)):
            stored[name] = value
    return stored


def _text_of(value: Any, kind: str) -> Any:
    """A value for a column of a type; a text column holds numbers and Booleans as JSON."""
    return json.dumps(value) if kind == "string" and isinstance(value, bool | int | float) else value


def _fits_any(name: str, value: Any) -> bool:
    """Whether a value can be stored in a column of this name in any manifest."""
    kinds = (FRAME_COLUMNS[name],) if name in FRAME_COLUMNS else drawn_kinds(name) or (None,)
    return any(_fits(kind, value) for kind in kinds)


def _object(metadata: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = metadata.get(key)
    return value if isinstance(value, dict) else {}


def _is_matrix(value: Any) -> bool:
    """Whether a value is four lines of four entries."""
    is_line = [isinstance(line, list) and len(line) == 4 for line in value] if isinstance(value, list) else []
    return len(is_line) == 4 and all(is_line)


def _fits(kind: str | None, value: Any) -> bool:
    """Whether a value can be stored in a column of a type; None (unknown) always can."""
    if value is None or kind is None:
        return value is None
    if kind == "doubles":
        return isinstance(value, list) and all(_fits("double", number) for number in value)
    if kind in _INTEGER_BITS:
        limit = 1 << (_INTEGER_BITS[kind] - 1)
        return type(value) is int and -limit <= value < limit
    if kind == "double" and type(value) is int:
        # Arrow converts no larger ones.
        return _fits("int64", value)
    return type(value) is {"double": float, "bool": bool, "string": str}[kind]


def fruit_rows(index: int, harvest: Mapping[str, Any]) -> Iterator[Row]:
    """Yield a row for each fruit in the output `harvest` of a frame.

    Values of another type than their column's, which no build writes, are left out.
    """
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
        yield {name: value for name, value in row.items() if _fits(FRUIT_COLUMNS.get(name), value)}


def _xyz(name: str, values: Any) -> Row:
    return {} if values is None else {name.format(axis): values[line] for line, axis in enumerate("xyz")}


def write_table(folder: Path, name: str, rows: Iterator[Row], columns: Mapping[str, str]) -> None:
    """Write `MANIFEST` or `FRUIT`, some thousand rows at a time, with a checksum of all values.

    The columns are those of `table_columns`; see `stored_row` for the values.

    Without statistics of columns, which readers use to skip rows: a damaged one would hide rows, and the
    checksum of the values would not show it.
    """
    import pyarrow
    from pyarrow import parquet

    schema, checksum = table_schema(columns), TableChecksum()
    with (
        atomic_write(folder / name) as temporary,
        temporary.open("wb") as file,
        parquet.ParquetWriter(file, schema, write_statistics=False, write_page_checksum=True) as writer,
    ):
        while part := [stored_row(row, columns) for row in islice(rows, _ROWS_HELD)]:
            values = {column: [row.get(column) for row in part] for column in columns}
            table = pyarrow.table(values, schema=schema)
            checksum.add(table)
            writer.write_table(table)
        writer.add_key_value_metadata({CHECKSUM_KEY: checksum.hexdigest()})


def open_table_file(path: Path, folder: Path) -> pyarrow.NativeFile:
    """Open a table of the data set in a folder for Arrow, without a Python file; errors are `open_file`'s.

    One of Arrow's threads could drop the last reference to a Python file, and if the interpreter ends at that
    moment, the process is aborted (apache/arrow, issues 34314 and 50482).
    """
    import pyarrow

    try:
        return pyarrow.OSFile(os.fspath(check_file(path, "table", within=folder)))
    except UnicodeEncodeError:
        # The library takes no path that is not UTF-8.
        content = read_file(path, "table", within=folder)
        buffer = pyarrow.allocate_buffer(len(content))
        memoryview(buffer).cast("B")[:] = content
        return pyarrow.BufferReader(buffer)


def table_schema(columns: Mapping[str, str]) -> pyarrow.Schema:
    """The Arrow schema of a table with these columns, as of `table_columns`."""
    import pyarrow

    # Parquet names the entries of lists like this, so the schema is the same after reading.
    doubles = pyarrow.list_(pyarrow.field("element", pyarrow.float64()))
    types = [doubles if kind == "doubles" else pyarrow.type_for_alias(kind) for kind in columns.values()]
    return pyarrow.schema(zip(columns, types, strict=True))

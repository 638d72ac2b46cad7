"""The tables of a data set, `manifest.parquet` and `fruit.parquet`: columns, rows, and writing."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.atomic import atomic_write
from pepperscene.classes import OrganClass
from pepperscene.dataset.store.recorded_values import as_mapping, listed_values
from pepperscene.outputs import OUTPUTS
from pepperscene.user_files import check_file, read_file

if TYPE_CHECKING:
    import pyarrow

DRAWN: Final = "drawn."
"""Prefix of the names of columns of drawn values; the dotted key follows."""

_SHARED: Final[Mapping[str, str]] = {"moment": "int64", "twin": "int32", "rig_camera": "string"}
_EXPOSURE: Final[Mapping[str, str]] = {"exposure_us": "double", "gain": "double"}
_KINDS: Final[Mapping[str, str]] = {"number": "double", "integer": "double", "date": "string"}
_AUTO: Final = "auto"


def drawn_columns(info: Mapping[str, Any]) -> dict[str, str]:
    """Further columns of a data set's manifest and their types; none for a recipe without variation.

    They follow from the recipe in `dataset.json`, which need not be valid, so that they do not depend on
    which frames exist.
    """
    recipe = as_mapping(info.get("recipe"))
    variation, twins = as_mapping(recipe.get("variation")), as_mapping(recipe.get("twins"))
    rig = recipe.get("rig")
    columns: dict[str, str] = {}
    if twins or rig:
        columns["moment"] = _SHARED["moment"]
    if twins:
        columns["twin"] = _SHARED["twin"]
    if rig:
        columns["rig_camera"] = _SHARED["rig_camera"]
    # A twin's value takes the place of a drawn one.
    kinds = {name: _recorded_kind(as_mapping(identity)) for name, identity in variation.items()}
    kinds |= {name: _common_kind(values) for name, values in twins.items()}
    columns |= {f"{DRAWN}{name}": kinds[name] for name in sorted(kinds)}
    return {**columns, **(_EXPOSURE if _has_exposures(recipe, kinds) else {})}


def drawn_row(metadata: Mapping[str, Any], outputs: Iterable[str]) -> dict[str, Any]:
    """The values of a frame's JSON for all columns that `drawn_columns` can name, for any recipe."""
    row: dict[str, Any] = {name: metadata[name] for name in _SHARED if name in metadata}
    for name, value in as_mapping(metadata.get("drawn")).items():
        row[f"{DRAWN}{name}"] = json.dumps(value) if isinstance(value, list) else value
    # Without traced light, automatic exposure does not choose one, and no output depends on it.
    if any(OUTPUTS[name].traced for name in outputs if name in OUTPUTS):
        camera = as_mapping(metadata.get("camera")) | as_mapping(metadata.get("auto_exposure"))
        seconds = camera.get("exposure_s")
        if isinstance(seconds, int | float) and not isinstance(seconds, bool):
            row["exposure_us"] = seconds * 1e6
        row["gain"] = camera.get("gain")
    return row


def _has_exposures(recipe: Mapping[str, Any], varied: Iterable[str]) -> bool:
    """Whether exposure time or gain differ between frames."""
    rig = recipe.get("rig")
    cameras = [as_mapping(as_mapping(entry).get("camera")) for entry in rig] if isinstance(rig, list) else []
    is_auto = as_mapping(recipe.get("camera")).get("exposure_us") == _AUTO
    differs = {f"camera.{name}" for name in _EXPOSURE} & set(varied)
    return bool(is_auto or differs or any(_EXPOSURE.keys() & camera.keys() for camera in cameras))


def _recorded_kind(identity: Mapping[str, Any]) -> str:
    """The type of a varied value's column, from its record in `dataset.json`."""
    if "in_turn" in identity or "outcomes" in identity:
        return _common_kind(listed_values(identity))
    return _KINDS.get(str(identity.get("kind")), "string")


def _common_kind(values: Any) -> str:
    """The type of a column that holds each of some values; text if they have none in common."""
    kinds = {type(value) for value in values} if isinstance(values, list | tuple) else set()
    if kinds == {bool}:
        return "bool"
    return "double" if kinds and kinds <= {int, float} else "string"


MANIFEST: Final = "manifest.parquet"
FRUIT: Final = "fruit.parquet"

Row = dict[str, Any]
"""Values by column; a missing value is unknown."""

_ROWS_HELD: Final = 4096  # chosen: rows that are held in memory at a time, some megabytes
_BOX: Final = ("x0", "y0", "x1", "y1")
_INTEGER_BITS: Final = {"int32": 32, "int64": 64}

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
"""Columns of every manifest and their types, in Parquet's terms. Timings and the worker are known only from
the build; all other values are those of the frames' JSON. Recipes with variation have further columns; see
`table_columns`."""


@dataclass(frozen=True)
class TableColumn:
    """A column of a table: its type, in Parquet's terms, and what it holds; pages are written from it."""

    kind: str
    meaning: str


def column_types(table: Mapping[str, TableColumn]) -> dict[str, str]:
    """The columns of a table and their types, as `rows_table` takes them."""
    return {name: column.kind for name, column in table.items()}


def _columns(names: Iterable[str], kind: str, meaning: str) -> dict[str, TableColumn]:
    """Neighbouring columns that share a line of the page."""
    return dict.fromkeys(names, TableColumn(kind, meaning))


def axis_columns(name: str, meaning: str) -> dict[str, TableColumn]:
    """Columns of the three coordinates; `name` has `{}` in the place of the axis."""
    return _columns((name.format(axis) for axis in "xyz"), "double", meaning)


FRUIT_TABLE: Final[Mapping[str, TableColumn]] = {
    "index": TableColumn("int64", "the frame"),
    **_columns(("instance", "plant", "phytomer"), "int32", "value of the instance image, plant and phytomer"),
    "kind": TableColumn("string", "kind of organ"),
    "ripeness": TableColumn("double", "mean over the skin, 0 unripe to 1 ripe"),
    **_columns(("length_m", "diameter_m"), "double", "as grown, along the axis and across"),
    "visible_fraction": TableColumn("double", "`visible_pixels` over `amodal_pixels`"),
    **_columns(("visible_pixels", "amodal_pixels"), "int64", "of the visible part and of the whole fruit"),
    "truncated": TableColumn("bool", "whether the whole fruit reaches the image border"),
    "occluders": TableColumn("int32", "number of instances that occlude it"),
    **axis_columns("foot_{}_m", "stalk end (camera), the origin of `pose`"),
    **axis_columns("along_{}", "axis from the stalk end to the blossom end (camera), unit vector"),
    **_columns((f"box_{edge}" for edge in _BOX), "int32", "`box`"),
    **_columns((f"amodal_{edge}" for edge in _BOX), "int32", "`amodal_box`"),
    "peduncle": TableColumn("int32", "`instance` of its stalk"),
    **axis_columns("cut_{}_m", "cut point (camera)"),
    **_columns(("cut_u", "cut_v"), "double", "cut point, pixel coordinates"),
    "cut_visible": TableColumn("bool", "whether it is visible"),
    **axis_columns("approach_{}", "direction of the approach (camera)"),
    **axis_columns("foot_world_{}_m", "stalk end (world)"),
    **axis_columns("blossom_world_{}_m", "blossom end (world)"),
    **axis_columns("cut_world_{}_m", "cut point (world)"),
    **axis_columns("approach_world_{}", "direction of the approach (world)"),
}
"""Columns of `fruit.parquet`: one row per fruit and frame."""

FRUIT_COLUMNS: Final[Mapping[str, str]] = column_types(FRUIT_TABLE)


def frame_row(metadata: Mapping[str, Any]) -> Row:
    """The row of a frame, without timings: from its JSON, of any content."""
    columns = ("index", "set", "rotation", "step", "seed", "recipe_seed", "checksum")
    row: Row = {name: metadata.get(name) for name in columns}
    pose = as_mapping(metadata.get("camera")).get("pose")
    if pose is not None and _is_matrix(pose):
        row |= {name: pose[axis][3] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
        row["pose"] = [number for line in pose for number in line]
    row |= {f"pixels_{name}": count for name, count in as_mapping(metadata.get("class_pixels")).items()}
    sampling = as_mapping(metadata.get("sampling"))
    row |= {name: sampling.get(name) for name in ("samples_per_pixel", "error_codes", "noise_codes")}
    outputs = as_mapping(metadata.get("outputs"))
    entries = {
        name: entry for name, entry in outputs.items() if name in OUTPUTS and isinstance(entry, Mapping)
    }
    row |= {f"{name}_sha256": entry.get("sha256") for name, entry in entries.items()}
    sizes = [entry.get("bytes") for entry in entries.values()]
    row["bytes"] = sum(size for size in sizes if isinstance(size, int))
    return row | drawn_row(metadata, entries)


def table_columns(name: str, info: Mapping[str, Any]) -> Mapping[str, str]:
    """The columns of `MANIFEST` or `FRUIT` and their types, for the content of a `dataset.json`."""
    return {**FRAME_COLUMNS, **drawn_columns(info)} if name == MANIFEST else FRUIT_COLUMNS


def stored_row(row: Row, columns: Mapping[str, str]) -> Row:
    """The values of a row that a table with these columns stores; those of other types are left out."""
    stored: Row = {}
    for name, kind in columns.items():
        value = row.get(name)
        if kind == "string" and isinstance(value, bool | int | float):
            value = json.dumps(value)
        if value is not None and _fits(kind, value):
            stored[name] = value
    return stored


def _is_matrix(value: Any) -> bool:
    """Whether a value is four lines of four entries."""
    is_line = [isinstance(line, list) and len(line) == 4 for line in value] if isinstance(value, list) else []
    return len(is_line) == 4 and all(is_line)


def _fits(kind: str, value: Any) -> bool:
    """Whether a value can be stored in a column of a type."""
    if kind == "doubles":
        return isinstance(value, list) and all(_fits("double", number) for number in value)
    if kind in _INTEGER_BITS:
        limit = 1 << (_INTEGER_BITS[kind] - 1)
        return type(value) is int and -limit <= value < limit
    if kind == "double" and type(value) is int:
        # Arrow converts no larger ones.
        return _fits("int64", value)
    if kind == "double":
        return type(value) is float and math.isfinite(value)
    return type(value) is {"bool": bool, "string": str}[kind]


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
        approach = fruit["approach"] or {}
        row |= _xyz("approach_{}", approach.get("camera")) | _xyz("approach_world_{}", approach.get("world"))
        for name, key in (("foot", "stalk_end"), ("blossom", "blossom_end")):
            row |= _xyz(f"{name}_world_{{}}_m", (fruit.get(key) or {}).get("world_m"))
        if peduncle is not None:
            cut = peduncle["cut"]
            row |= {"peduncle": peduncle["instance"], "cut_visible": cut["visible"]}
            row |= _xyz("cut_{}_m", cut["camera_m"]) | _xyz("cut_world_{}_m", cut.get("world_m"))
            row |= zip(("cut_u", "cut_v"), cut["px"] or (), strict=False)
        yield stored_row(row, FRUIT_COLUMNS)


def _xyz(name: str, values: Any) -> Row:
    return {} if values is None else {name.format(axis): values[line] for line, axis in enumerate("xyz")}


def rows_table(rows: Iterable[Row], columns: Mapping[str, str]) -> pyarrow.Table:
    """A table with these columns, which are those of `table_columns`; see `stored_row` for the values."""
    import pyarrow
    from pyarrow.json import ParseOptions, ReadOptions, read_json

    schema, remaining, parts = table_schema(columns), iter(rows), []
    while part := list(islice(remaining, _ROWS_HELD)):
        # Arrow imports pandas to convert Python objects, where it is installed: a second of every build.
        lines = [json.dumps(stored_row(row, columns)) for row in part]
        file = pyarrow.BufferReader("\n".join(lines).encode())
        options = ParseOptions(explicit_schema=schema, unexpected_field_behavior="error")
        parts.append(read_json(file, ReadOptions(block_size=file.size() + 1), options))
    return pyarrow.concat_tables(parts) if parts else schema.empty_table()


def write_table(path: Path, table: pyarrow.Table) -> None:
    """Write a table of a data set."""
    from pyarrow import parquet

    with atomic_write(path) as temporary, temporary.open("wb") as file:
        parquet.write_table(table, file, write_page_checksum=True)


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
    """The Arrow schema of a table with these columns; a type with an s, such as "doubles", is a list."""
    import pyarrow

    def arrow_type(kind: str) -> pyarrow.DataType:
        if not kind.endswith("s"):
            return pyarrow.type_for_alias(kind)
        # Parquet names the entries of lists like this, so the schema is the same after reading.
        return pyarrow.list_(pyarrow.field("element", pyarrow.type_for_alias(kind.removesuffix("s"))))

    return pyarrow.schema([(name, arrow_type(kind)) for name, kind in columns.items()])

"""The table of `pepperscene visibility`: a row for each pose and each fruit in its view."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import atomic_write, check_can_write, write_errors
from pepperscene.building.viewpoints.recipe_visibility import SceneVisibility, ViewpointOptions
from pepperscene.dataset.store.manifest import table_schema
from pepperscene.errors import ArgumentError
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.version import __version__

if TYPE_CHECKING:
    import pyarrow

COLUMNS: Final[Mapping[str, str]] = {
    "scene": "int32",
    "pose": "int32",
    "name": "string",
    "frame": "int64",
    **dict.fromkeys(("x_m", "y_m", "z_m"), "double"),
    "reachable": "bool",
    "view": "int32",
    "instance": "int32",
    "plant": "int32",
    "phytomer": "int32",
    "kind": "string",
    "distance_m": "double",
    **dict.fromkeys(("visible_fraction", "facing_fraction", "surface_fraction", "visible_pixels"), "double"),
    "best": "bool",
    "peduncle": "int32",
    **dict.fromkeys(("peduncle_visible_fraction", "cut_visible_fraction"), "double"),
    "occluder_instances": "int32s",
    "occluder_classes": "int32s",
    "occluder_fractions": "doubles",
}
"""Columns and their types, in Parquet's terms; a type with an s is a list."""

SUFFIX: Final = ".parquet"
METADATA_KEY: Final = b"pepperscene"
"""Key of the table's metadata that has its origin as JSON."""


def check_table_path(path: Path) -> None:
    """Check that a table can be written.

    Raises:
        ArgumentError: the name does not end in .parquet.
        OutputError: the file cannot be written.
    """
    if path.suffix.lower() != SUFFIX:
        raise ArgumentError("out", f"{str(path)!r} must end in {SUFFIX}")
    check_can_write(path.absolute().parent, [path.name])


def write_visibility(
    path: Path, recipe: ResolvedRecipe, options: ViewpointOptions, scenes: Iterable[SceneVisibility]
) -> int:
    """Write the table and return its number of rows; the scenes are computed one after the other.

    Raises:
        PepperError: a scene cannot be computed, or the file cannot be written; then there is no file.
    """
    from pyarrow import parquet

    check_table_path(path)
    origin = {"recipe": recipe.recipe.name, "seed": recipe.recipe.seed, "version": __version__}
    content = json.dumps({**origin, "samples": options.samples}, sort_keys=True).encode()
    schema, rows = table_schema(COLUMNS).with_metadata({METADATA_KEY: content}), 0
    with write_errors(path):
        path.absolute().parent.mkdir(parents=True, exist_ok=True)
        with (
            atomic_write(path) as temporary,
            parquet.ParquetWriter(temporary, schema, compression="zstd") as writer,
        ):
            for scene in scenes:
                writer.write_table(scene_table(scene).replace_schema_metadata(schema.metadata))
                rows += len(scene.visibility)
    return rows


def scene_table(scene: SceneVisibility) -> pyarrow.Table:
    """The rows of one scene."""
    import pyarrow

    seen, fruit = scene.visibility, scene.visibility.fruit_index
    count, pose = len(scene.visibility), scene.visibility.pose_index
    instance, peduncle = seen.fruit[fruit], seen.peduncle[fruit]
    fruits = [scene.instances[index] for index in seen.fruit]
    position = seen.poses[pose, :3, 3]
    values: dict[str, Any] = {
        "scene": np.full(count, scene.spec.scene),
        "pose": pose,
        "name": None if scene.names is None else np.array(scene.names, dtype=object)[pose],
        "frame": None if scene.frames is None else np.array(scene.frames)[pose],
        **{f"{axis}_m": position[:, number] for number, axis in enumerate("xyz")},
        "reachable": None if scene.reachable is None else scene.reachable[pose],
        "view": _ranks(scene)[pose],
        "instance": instance + 1,
        "plant": np.array([one.plant for one in fruits], dtype=np.intp)[fruit],
        "phytomer": np.array([one.phytomer for one in fruits], dtype=np.intp)[fruit],
        "kind": np.array([one.kind for one in fruits], dtype=object)[fruit],
        "distance_m": np.linalg.norm(scene.centres_m[fruit] - position, axis=1),
        "visible_fraction": seen.visible_fraction,
        "facing_fraction": seen.facing_fraction,
        "surface_fraction": seen.surface_fraction,
        "visible_pixels": seen.visible_pixels,
        "best": scene.best[fruit] == pose,
        "peduncle": np.ma.masked_less(peduncle + 1, 1),
        "peduncle_visible_fraction": np.ma.masked_invalid(seen.peduncle_visible_fraction),
        "cut_visible_fraction": np.ma.masked_invalid(seen.cut_visible_fraction),
        **_occluder_lists(scene),
    }
    schema = table_schema(COLUMNS)
    arrays = [_column(values[field.name], field.type, count) for field in schema]
    return pyarrow.Table.from_arrays(arrays, schema=schema)


def _ranks(scene: SceneVisibility) -> NDArray[Any]:
    """`(n,)` the place of each pose among the next best views, from 1; masked for others."""
    ranks = np.zeros(len(scene.visibility.poses), dtype=np.int64)
    if scene.views is not None:
        ranks[scene.views.poses] = np.arange(len(scene.views.poses)) + 1
    return np.ma.masked_equal(ranks, 0)


def _occluder_lists(scene: SceneVisibility) -> dict[str, Any]:
    """The columns of occluders: for each row the entries of its list."""
    occluders, count = scene.visibility.occluders, len(scene.visibility)
    names = ("occluder_instances", "occluder_classes", "occluder_fractions")
    if occluders is None:
        return dict.fromkeys(names)
    offsets = np.searchsorted(occluders.row, np.arange(count + 1)).astype(np.int32)
    classes = np.array([one.class_id for one in scene.instances], dtype=np.int64)[occluders.instance]
    entries = (occluders.instance + 1, classes, occluders.fraction)
    return {name: (offsets, entry) for name, entry in zip(names, entries, strict=True)}


def _column(values: Any, kind: pyarrow.DataType, count: int) -> pyarrow.Array:
    """An Arrow array: of one value for each row, of lists as (offsets, entries), or of nothing."""
    import pyarrow

    if values is None:
        return pyarrow.nulls(count, kind)
    if isinstance(values, tuple):
        offsets, entries = values
        return pyarrow.ListArray.from_arrays(offsets, pyarrow.array(entries, kind.value_type), kind)
    mask = np.ma.getmaskarray(values) if isinstance(values, np.ma.MaskedArray) else None
    return pyarrow.array(np.ma.getdata(values), kind, mask=mask)

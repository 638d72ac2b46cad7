"""Traits of plants as tables: a row for each plant, each leaf blade and each fruit of a scene.

Areas and volumes are those of the triangles of the scene before culling, which mesh files have too. A leaf
that was left out of the row because it was deep in another (see `resolve_contacts`) is no leaf of the plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.atomic import check_can_write, write_files
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.classes import RIPE_FROM
from pepperscene.cultivar.organs import FORMS, OrganForm
from pepperscene.dataset.store.manifest import Row, TableColumn, axis_columns, column_types, rows_table
from pepperscene.errors import ArgumentError
from pepperscene.recipe.plan import FrameSpec, Plan
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.frame_setups import FrameSetup, FrameSetups
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe

if TYPE_CHECKING:
    import pyarrow

    from pepperscene.geometry.sizes import OrganSizes
    from pepperscene.grammar import Plant
    from pepperscene.scene import Scene

Rows = dict[str, list[Row]]
"""The rows of each table, by its name."""

FILE_FORMATS: Final = ("parquet", "csv")
_SOLIDS: Final = ("internode", "node", "stalk", "peduncle", "calyx", "fruit", "cut")
"""Forms of closed surfaces; blades and the petals of flowers are sheets."""

_ORIGIN: Final[Mapping[str, TableColumn]] = {
    "frame": TableColumn("int64", "the frame whose scene this is; in a growth series, that of its twin"),
    "twin": TableColumn("int32", "number of the twin; null in a recipe without twins"),
    "date": TableColumn("string", "date of the growth stage; null if the cultivar has none"),
    "plant": TableColumn("int32", "number of the plant, as in a frame's JSON"),
}
_ORGAN: Final[Mapping[str, TableColumn]] = {
    **_ORIGIN,
    "instance": TableColumn("int32", "value of the instance images of this scene"),
    "kind": TableColumn("string", "kind of organ"),
    "phytomer": TableColumn("int32", "position of its node along the main stem, 0 at the ground"),
    "age_phytomers": TableColumn("int32", "age in plastochrons: number of phytomers above"),
}

PLANT_TABLE: Final[Mapping[str, TableColumn]] = {
    **_ORIGIN,
    "cultivar": TableColumn("string", "name of the cultivar at its growth stage"),
    **axis_columns("{}_m", "foot of the stem (world); *z* is its height above the floor"),
    "height_m": TableColumn("double", "from the foot of the stem to the highest point of the plant"),
    "nodes": TableColumn("int32", "number of nodes of the main stem"),
    "leaf_count": TableColumn("int32", "number of leaf blades; leaflets of a compound leaf count"),
    "leaf_area_m2": TableColumn("double", "one-sided area of all leaf blades"),
    "ground_area_m2": TableColumn("double", "floor of each plant, with its part of the aisle"),
    "leaf_area_index": TableColumn("double", "`leaf_area_m2` over `ground_area_m2`"),
    "fruit_count": TableColumn("int32", "fruit load: number of fruit"),
    "ripe_fruit_count": TableColumn("int32", f"number of fruit with a ripeness of at least {RIPE_FROM:g}"),
    "fruit_volume_m3": TableColumn("double", "volume of all fruit"),
    "fresh_volume_m3": TableColumn("double", "volume of all organs but blades and flowers, which are sheets"),
}
LEAF_TABLE: Final[Mapping[str, TableColumn]] = {
    **_ORGAN,
    "area_m2": TableColumn("double", "one-sided area, as grown: folds and damage included"),
    "length_m": TableColumn("double", "length of the midrib"),
    "width_m": TableColumn("double", "width of the flat blade, without damage"),
    "inclination_deg": TableColumn("double", "mean angle of its surface to the horizontal, 0 to 90"),
    "leaf_age": TableColumn("double", "ageing, 0 healthy to 1 dried up, as in the output `leaf_age`"),
    **axis_columns("{}_m", "centroid of the blade (world); *z* is its height above the floor"),
}
FRUIT_TRAIT_TABLE: Final[Mapping[str, TableColumn]] = {
    **_ORGAN,
    "ripeness": TableColumn("double", "mean over the skin, 0 unripe to 1 ripe"),
    "length_m": TableColumn("double", "as grown, along the axis"),
    "diameter_m": TableColumn("double", "as grown, across the axis"),
    "volume_m3": TableColumn("double", "volume inside the skin"),
    **axis_columns("{}_m", "centroid of the body (world); *z* is its height above the floor"),
}
TABLES: Final = {"plants": PLANT_TABLE, "leaves": LEAF_TABLE, "fruit": FRUIT_TRAIT_TABLE}
"""Columns by the name of the table, which is that of its file."""


@dataclass(frozen=True, eq=False)
class PlantTraits:
    """Traits of the plants of a scene, or of the same plants on several dates.

    Attributes:
        plants: Arrow table with the columns of `PLANT_TABLE`, one row for each plant and date.
        leaves: with those of `LEAF_TABLE`, one row for each leaf blade.
        fruit: with those of `FRUIT_TRAIT_TABLE`, one row for each fruit.
    """

    plants: pyarrow.Table
    leaves: pyarrow.Table
    fruit: pyarrow.Table


def plant_traits(
    recipe: Recipe | ResolvedRecipe | str | Path,
    frame: int | None = None,
    on_stage: Callable[[str], None] | None = None,
) -> PlantTraits:
    """Measure the plants of a frame's scene; if its twins differ in their plants, on all of these dates.

    The plants are those of the recipe's own double row, without the far rows.

    Args:
        recipe: a recipe, its resolved form, a shipped name or a path.
        frame: index of the frame; None for the first that the recipe selects.
        on_stage: called with the name of each stage when it begins.

    Raises:
        InputError: the recipe, a file that it names or the index is not valid.
    """
    resolved = resolve_recipe(recipe)
    plan = resolved.recipe.plan
    spec = plan.first_frame(frame)
    setups = FrameSetups(resolved)
    dates: dict[str, FrameSpec] = {}
    for one in (spec, *_twins(plan, spec)):
        dates.setdefault(setups.at(one).plants, one)
    rows: Rows = {name: [] for name in TABLES}
    for one in sorted(dates.values(), key=lambda one: one.index):
        setup = setups.at(one)
        if on_stage is not None:
            on_stage(f"growing plants: {setup.cultivar.name}")
        scene, area = _grown_scene(setup, one)
        twin = one.twin if plan.twins > 1 else None
        _add_rows(rows, scene, area, {"frame": one.index, "twin": twin})
    return _tables(rows)


def scene_traits(scene: Scene, ground_area_m2: float) -> PlantTraits:
    """Measure the plants of a scene with a skeleton, without those of far rows; frame and twin are unknown.

    Args:
        scene: with all its triangles: a culled scene lacks organs. Organs without triangles have no row.
        ground_area_m2: floor for each plant, see `scene.ground_area`.

    Raises:
        ArgumentError: the scene has no skeleton, or its triangles were moved since it was assembled.
    """
    rows: Rows = {name: [] for name in TABLES}
    _add_rows(rows, scene, ground_area_m2, {})
    return _tables(rows)


def check_tables_output(names: Iterable[str], folder: Path, file_format: str) -> None:
    """Raise `ArgumentError` or `OutputError` if tables cannot be written in a format into a folder."""
    if file_format not in FILE_FORMATS:
        raise ArgumentError("format", f"must be {' or '.join(FILE_FORMATS)}, not {file_format!r}")
    check_can_write(folder, [f"{name}.{file_format}" for name in names])


def write_tables(
    tables: Mapping[str, pyarrow.Table], folder: str | Path, file_format: str
) -> tuple[Path, ...]:
    """Write tables into a folder, all or none; errors as of `check_tables_output`."""
    check_tables_output(tables, Path(folder), file_format)
    files = {f"{name}.{file_format}": encode_table(table, file_format) for name, table in tables.items()}
    return write_files(Path(folder), files)


def encode_table(table: pyarrow.Table, file_format: str) -> bytes:
    """The file of a table in one of `FILE_FORMATS`."""
    import pyarrow
    from pyarrow import csv, parquet

    stream = pyarrow.BufferOutputStream()
    if file_format == "csv":
        csv.write_csv(table, stream, csv.WriteOptions(quoting_style="needed"))
    else:
        parquet.write_table(table, stream, compression="zstd")
    content: bytes = stream.getvalue().to_pybytes()
    return content


def write_traits(traits: PlantTraits, folder: str | Path, file_format: str = "parquet") -> tuple[Path, ...]:
    """Write `plants`, `leaves` and `fruit` as `.parquet` or `.csv` into a folder, all or none.

    Args:
        traits: the tables.
        folder: made if missing; existing files of these names are replaced.
        file_format: "parquet" or "csv".

    Returns:
        The three files.

    Raises:
        InputError: the format is unknown.
        OutputError: a file cannot be written.
    """
    return write_tables({name: getattr(traits, name) for name in TABLES}, folder, file_format)


def _twins(plan: Plan, spec: FrameSpec) -> Iterator[FrameSpec]:
    """The frames of all twins at a frame's moment, of the same camera."""
    first = plan.first_of_moment(spec).index + spec.camera
    return (plan.frame(first + twin * plan.frames * plan.cameras) for twin in range(plan.twins))


def _grown_scene(setup: FrameSetup, spec: FrameSpec) -> tuple[Scene, float]:
    """The plants of a frame's scene in their row, without far rows, and the floor area of each."""
    from pepperscene.scene import assemble_scene, ground_area

    recipe = setup.recipe
    if recipe.greenhouse is not None:
        # No other random number depends on far rows, and the instances of plants come first.
        recipe = recipe.model_copy(update={"greenhouse": replace(recipe.greenhouse, far_rows=0)})
    builder = SceneBuilder(recipe, setup.cultivar)
    built = builder.scene(spec.set, spec.rotation)
    area = ground_area(1, builder.row, builder.greenhouse)
    return assemble_scene(built.mesh, skeleton=built.skeleton), area


def _add_rows(rows: Rows, scene: Scene, ground_area_m2: float, origin: Row) -> None:
    """Add the rows of a scene's plants."""
    from pepperscene.geometry.sizes import organ_sizes

    skeleton = scene.skeleton
    if skeleton is None:
        raise ArgumentError("scene", "needs a skeleton, which scenes of recipes have")
    skeleton.check_mesh(scene.mesh)
    for number, plant in enumerate(skeleton.plants):
        # In the order of the plant's organs.
        instances = np.array(skeleton.of_form(*FORMS, plant=number), dtype=np.intp)
        if scene.mesh.instances[int(instances[0])].far_row >= 0:
            continue
        sizes, nodes = organ_sizes(scene.mesh, instances), len(plant.of_form("node"))
        date = None if plant.grown_from is None or plant.grown_from.date is None else plant.grown_from.date
        columns = {**origin, "date": None if date is None else date.isoformat(), "plant": number}
        leaves, fruit = list[Row](), list[Row]()
        for place in np.flatnonzero(sizes.area_m2 > 0).tolist():
            row = {**columns, "instance": int(instances[place]) + 1, **_organ(plant, place, nodes)}
            match _form(plant, place):
                case "blade":
                    leaves.append(row | _leaf(plant, place, sizes))
                case "fruit":
                    fruit.append(row | _fruit(plant, place, sizes))
        base = skeleton.bases[number].tolist()
        rows["plants"].append(columns | _plant(plant, sizes, base, leaves, fruit, ground_area_m2))
        rows["leaves"] += leaves
        rows["fruit"] += fruit


def _form(plant: Plant, place: int) -> OrganForm:
    return plant.kinds[plant.organs[place].kind].form


def _organ(plant: Plant, place: int, nodes: int) -> Row:
    """The columns that leaves and fruit share."""
    organ = plant.organs[place]
    above = nodes - 1 - organ.phytomer
    return {"kind": organ.kind, "phytomer": organ.phytomer, "age_phytomers": above}


def _leaf(plant: Plant, place: int, sizes: OrganSizes) -> Row:
    measures = plant.organs[place].measures
    return {
        "area_m2": float(sizes.area_m2[place]),
        "length_m": measures["length_m"],
        "width_m": measures["width_m"],
        "inclination_deg": math.degrees(sizes.tilt_rad[place]),
        "leaf_age": measures.get("ageing", 0.0),
        **_position(sizes.surface_centre_m[place]),
    }


def _fruit(plant: Plant, place: int, sizes: OrganSizes) -> Row:
    measures = plant.organs[place].measures
    return {
        **{name: measures[name] for name in ("ripeness", "length_m", "diameter_m")},
        "volume_m3": float(sizes.volume_m3[place]),
        **_position(sizes.body_centre_m[place]),
    }


def _plant(
    plant: Plant,
    sizes: OrganSizes,
    base: Sequence[float],
    leaves: list[Row],
    fruit: list[Row],
    ground_area_m2: float,
) -> Row:
    """The plant's own columns, from the rows of its leaves and fruit."""
    leaf_area = math.fsum(row["area_m2"] for row in leaves)
    solid = [_form(plant, place) in _SOLIDS for place in range(len(plant.organs))]
    return {
        "cultivar": plant.cultivar,
        **_position(base),
        "height_m": float(sizes.top_m.max()) - base[2],
        "nodes": len(plant.of_form("node")),
        "leaf_count": len(leaves),
        "leaf_area_m2": leaf_area,
        "ground_area_m2": ground_area_m2,
        "leaf_area_index": leaf_area / ground_area_m2,
        "fruit_count": len(fruit),
        "ripe_fruit_count": sum(row["ripeness"] >= RIPE_FROM for row in fruit),
        "fruit_volume_m3": math.fsum(row["volume_m3"] for row in fruit),
        "fresh_volume_m3": math.fsum(sizes.volume_m3[solid].tolist()),
    }


def _position(point: ArrayLike) -> Row:
    return dict(zip(("x_m", "y_m", "z_m"), np.asarray(point, dtype=float).tolist(), strict=True))


def _tables(rows: Rows) -> PlantTraits:
    return PlantTraits(**{name: rows_table(rows[name], column_types(TABLES[name])) for name in TABLES})

"""Traits of plants as tables: a row for each plant, each leaf blade and each fruit of a scene.

Areas and volumes are those of the triangles of the scene before culling, which mesh files have too. A leaf
that was left out of the row because it was deep in another (see `resolve_contacts`) is no leaf of the plant.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import check_can_write, write_files
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.cultivar.organs import FORMS, OrganForm
from pepperscene.dataset.selection import RIPE_FROM
from pepperscene.dataset.store.manifest import Row, TableColumn, axis_columns, column_types, rows_table
from pepperscene.errors import ArgumentError
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.frame_setups import FrameSetup, FrameSetups
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.version import __version__

if TYPE_CHECKING:
    import pyarrow

    from pepperscene.geometry import OrganSizes
    from pepperscene.scene import Scene, Skeleton

Rows = dict[str, list[Row]]
"""The rows of each table, by its name."""

FILE_FORMATS: Final = ("parquet", "csv")
METADATA_KEY: Final = b"pepperscene"
"""Key of a table's metadata that has its origin as JSON."""

_SOLIDS: Final[tuple[OrganForm, ...]] = (
    "internode", "node", "stalk", "peduncle", "calyx", "fruit", "cut",
)  # fmt: skip
"""Forms of closed surfaces; blades and the petals of flowers are sheets."""

_STEM: Final = ("internode", "node")
_POSITION: Final = ("x_m", "y_m", "z_m")

_ORIGIN: Final[Mapping[str, TableColumn]] = {
    "frame": TableColumn("int64", "the frame whose scene this is; in a growth series, that of its twin"),
    "twin": TableColumn("int32", "number of the twin; null in a recipe without twins"),
    "date": TableColumn(
        "string", "date of the growth stage, such as 2016-04-15; null if the cultivar has none"
    ),
    "plant": TableColumn("int32", "number of the plant, as in a frame's JSON"),
}
_ORGAN: Final[Mapping[str, TableColumn]] = {
    **_ORIGIN,
    "instance": TableColumn("int32", "value of the instance images of this scene"),
    "kind": TableColumn("string", "kind of organ"),
    "phytomer": TableColumn("int32", "position of its node along the main stem, 0 at the ground"),
    "age_phytomers": TableColumn(
        "int32", "age in plastochrons: number of phytomers above, which are younger"
    ),
}

PLANT_TABLE: Final[Mapping[str, TableColumn]] = {
    **_ORIGIN,
    "cultivar": TableColumn("string", "name of the cultivar at its growth stage"),
    **axis_columns("{}_m", "foot of the stem (world); *z* is its height above the floor"),
    "height_m": TableColumn("double", "from the foot of the stem to the highest point of the plant"),
    "nodes": TableColumn("int32", "number of nodes of the main stem"),
    "leaf_count": TableColumn("int32", "number of leaf blades; each leaflet of a compound leaf counts"),
    "leaf_area_m2": TableColumn("double", "one-sided area of all leaf blades"),
    "ground_area_m2": TableColumn("double", "floor of each plant, with its part of the aisle"),
    "leaf_area_index": TableColumn("double", "`leaf_area_m2` over `ground_area_m2`"),
    "fruit_count": TableColumn("int32", "fruit load: number of fruit"),
    "ripe_fruit_count": TableColumn("int32", f"number of fruit with a ripeness of at least {RIPE_FROM:g}"),
    "fruit_volume_m3": TableColumn("double", "volume of all fruit"),
    "fresh_volume_m3": TableColumn(
        "double", "volume of stems, stalks, calyces and fruit; blades and petals are sheets without volume"
    ),
}
LEAF_TABLE: Final[Mapping[str, TableColumn]] = {
    **_ORGAN,
    "branch": TableColumn(
        "int32", "`instance` of the petiole, rachis or shoot on the main stem that bears it"
    ),
    "area_m2": TableColumn("double", "one-sided area, as grown: folds and damage included"),
    "length_m": TableColumn("double", "length of the midrib"),
    "width_m": TableColumn("double", "width of the flat blade, without damage"),
    "inclination_deg": TableColumn(
        "double", "mean angle of the surface to the horizontal, weighted by area: 0 level, 90 hanging"
    ),
    "leaf_age": TableColumn("double", "ageing, 0 healthy to 1 dried up, as in the output `leaf_age`"),
    **axis_columns("{}_m", "centroid of the blade (world); *z* is its height above the floor"),
}
FRUIT_TRAIT_TABLE: Final[Mapping[str, TableColumn]] = {
    **_ORGAN,
    "ripeness": TableColumn("double", "mean over the skin, 0 unripe to 1 ripe"),
    "length_m": TableColumn("double", "as grown, along the axis"),
    "diameter_m": TableColumn("double", "as grown, across the axis"),
    "surface_m2": TableColumn("double", "area of the skin"),
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
    spec = plan.frame(plan.select_indices(None if frame is None else [frame], "frame")[0])
    setups = FrameSetups(resolved)
    dates: dict[str, FrameSpec] = {}
    for one in (spec, *_twins(resolved.recipe, spec)):
        dates.setdefault(setups.at(one).plants, one)
    rows: Rows = {name: [] for name in TABLES}
    for one in sorted(dates.values(), key=lambda one: one.index):
        setup = setups.at(one)
        if on_stage is not None:
            on_stage(f"growing plants{'' if setup.cultivar.date is None else f' of {setup.cultivar.date}'}")
        scene, area = _grown_scene(setup, one)
        twin = one.twin if plan.twins > 1 else None
        for name, part in _measured(scene, area, {"frame": one.index, "twin": twin}).items():
            rows[name] += part
    return _tables(rows, {"recipe": resolved.recipe.name, "seed": resolved.recipe.seed})


def scene_traits(
    scene: Scene, ground_area_m2: float, origin: Mapping[str, int | None] | None = None
) -> PlantTraits:
    """Measure the plants of a scene with a skeleton, without those of far rows.

    Args:
        scene: with all its triangles: a culled scene lacks organs. Organs without triangles have no row.
        ground_area_m2: floor for each plant, see `scene.ground_area`.
        origin: the columns `frame` and `twin`, if they are known.

    Raises:
        ArgumentError: the scene has no skeleton, or its triangles were moved since it was assembled.
    """
    return _tables(_measured(scene, ground_area_m2, origin or {}), {})


def check_traits_output(folder: Path, file_format: str) -> None:
    """Raise `ArgumentError` or `OutputError` if traits cannot be written in a format into a folder."""
    if file_format not in FILE_FORMATS:
        raise ArgumentError("format", f"must be {' or '.join(FILE_FORMATS)}, not {file_format!r}")
    check_can_write(folder, [f"{name}.{file_format}" for name in TABLES])


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
    import pyarrow

    check_traits_output(Path(folder), file_format)
    files = {}
    for name in TABLES:
        stream = pyarrow.BufferOutputStream()
        _encode(getattr(traits, name), file_format, stream)
        files[f"{name}.{file_format}"] = stream.getvalue().to_pybytes()
    return write_files(Path(folder), files)


def _encode(table: pyarrow.Table, file_format: str, stream: Any) -> None:
    if file_format == "csv":
        from pyarrow import csv

        csv.write_csv(table, stream, csv.WriteOptions(quoting_style="needed"))
        return
    from pyarrow import parquet

    parquet.write_table(table, stream, compression="zstd")


def _twins(recipe: Recipe, spec: FrameSpec) -> Iterator[FrameSpec]:
    """The frames of all twins at a frame's moment, of the same camera."""
    plan = recipe.plan
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


def _measured(scene: Scene, ground_area_m2: float, origin: Mapping[str, Any]) -> Rows:
    """The rows of all tables for a scene."""
    skeleton = scene.skeleton
    if skeleton is None:
        raise ArgumentError("scene", "needs a skeleton, which scenes of recipes have")
    skeleton.check_mesh(scene.mesh)
    rows: Rows = {name: [] for name in TABLES}
    for number, plant in enumerate(skeleton.plants):
        organs = _PlantOrgans.of(scene, skeleton, number)
        if organs.is_far:
            continue
        cultivar = plant.grown_from
        date = None if cultivar is None or cultivar.date is None else cultivar.date.isoformat()
        columns = {**origin, "date": date, "plant": number}
        leaves, fruit = ([{**columns, **row} for row in part] for part in (organs.leaves(), organs.fruit()))
        rows["plants"].append(
            {**columns, "cultivar": plant.cultivar, **organs.plant(leaves, fruit, ground_area_m2)}
        )
        rows["leaves"] += leaves
        rows["fruit"] += fruit
    return rows


@dataclass(frozen=True, eq=False)
class _PlantOrgans:
    """The organs of one plant of a scene, and their sizes in the same order."""

    scene: Scene
    skeleton: Skeleton
    base: tuple[float, ...]
    instances: NDArray[np.intp]
    forms: NDArray[np.str_]
    sizes: OrganSizes

    @classmethod
    def of(cls, scene: Scene, skeleton: Skeleton, number: int) -> _PlantOrgans:
        """Measure the organs of a plant of the skeleton."""
        from pepperscene.geometry import organ_sizes

        by_form = {form: skeleton.of_form(form, plant=number) for form in FORMS}
        instances = np.array([index for group in by_form.values() for index in group], dtype=np.intp)
        forms = np.repeat(list(by_form), [len(group) for group in by_form.values()])
        base = tuple(skeleton.bases[number].tolist())
        return cls(scene, skeleton, base, instances, forms, organ_sizes(scene.mesh, instances))

    @property
    def is_far(self) -> bool:
        """Whether it is a plant of the far rows."""
        return self.scene.mesh.instances[int(self.instances[0])].far_row >= 0

    def plant(self, leaves: Sequence[Row], fruit: Sequence[Row], ground_area_m2: float) -> Row:
        """The plant's own columns, from the rows of its leaves and fruit."""
        leaf_area = math.fsum(row["area_m2"] for row in leaves)
        solid = np.isin(self.forms, _SOLIDS)
        return {
            **dict(zip(_POSITION, self.base, strict=True)),
            "height_m": float(self.sizes.top_m.max()) - self.base[2],
            "nodes": int(np.count_nonzero(self.forms == "node")),
            "leaf_count": len(leaves),
            "leaf_area_m2": leaf_area,
            "ground_area_m2": ground_area_m2,
            "leaf_area_index": leaf_area / ground_area_m2,
            "fruit_count": len(fruit),
            "ripe_fruit_count": sum(row["ripeness"] >= RIPE_FROM for row in fruit),
            "fruit_volume_m3": math.fsum(row["volume_m3"] for row in fruit),
            "fresh_volume_m3": math.fsum(self.sizes.volume_m3[solid].tolist()),
        }

    def leaves(self) -> Iterator[Row]:
        """The row of each blade that has triangles, without its origin."""
        for place, row, measures in self._organs("blade"):
            yield {
                **row,
                "branch": self._branch(int(self.instances[place])) + 1,
                "area_m2": float(self.sizes.area_m2[place]),
                "length_m": measures["length_m"],
                "width_m": measures["width_m"],
                "inclination_deg": math.degrees(self.sizes.tilt_rad[place]),
                "leaf_age": measures.get("ageing", 0.0),
                **dict(zip(_POSITION, self.sizes.surface_centre_m[place].tolist(), strict=True)),
            }

    def fruit(self) -> Iterator[Row]:
        """The row of each fruit that has triangles, without its origin."""
        for place, row, measures in self._organs("fruit"):
            yield {
                **row,
                "ripeness": measures.get("ripeness", 0.0),
                "length_m": measures["length_m"],
                "diameter_m": measures["diameter_m"],
                "surface_m2": float(self.sizes.area_m2[place]),
                "volume_m3": float(self.sizes.volume_m3[place]),
                **dict(zip(_POSITION, self.sizes.body_centre_m[place].tolist(), strict=True)),
            }

    def _organs(self, form: OrganForm) -> Iterator[tuple[int, Row, Mapping[str, float]]]:
        """Place, common columns and measures of each organ of a form that has triangles."""
        last = int(np.count_nonzero(self.forms == "internode")) - 1
        for place in np.flatnonzero((self.forms == form) & (self.sizes.area_m2 > 0)).tolist():
            index = int(self.instances[place])
            item = self.scene.mesh.instances[index]
            row = {"instance": index + 1, "kind": item.kind, "phytomer": item.phytomer}
            row["age_phytomers"] = last - item.phytomer
            yield place, row, self.skeleton.measures(index)

    def _branch(self, index: int) -> int:
        """The organ on the main stem that an organ is part of."""
        items = self.scene.mesh.instances
        while (kind := self.skeleton.kind(items[index].parent)) is not None and kind.form not in _STEM:
            index = items[index].parent
        return index


def _tables(rows: Rows, origin: Mapping[str, Any]) -> PlantTraits:
    """All rows as tables, with their origin."""
    metadata = {METADATA_KEY: json.dumps({**origin, "version": __version__}, sort_keys=True)}
    tables = {
        name: rows_table(rows[name], column_types(columns)).replace_schema_metadata(metadata)
        for name, columns in TABLES.items()
    }
    return PlantTraits(**tables)

"""Plant rows beyond the labelled ones: a few coarse plants, repeated many times, as inexpensive scenery.

Their organs are labelled, since a photograph shows them as clearly as those of the nearest row. They are
merged into as many instances as fit into an image of 16 bits: see `FarDetail`. Plants that a camera shows
from near have full meshes in the same places instead, with an instance for each organ.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import FAR_ROW, Instance, OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.scene.greenhouse import FarRowsAs, Greenhouse, RowLine, as_single_instance, row_lines
from pepperscene.scene.lod import cluster_vertices
from pepperscene.scene.row import DoubleRow, rotation_about_z

FAR_ROW_PLANTS: Final = 6
"""Number of different plants in far rows. Chosen: a row of twenty plants shows no pattern."""

_MAX_TURN: Final = np.radians(30.0)  # chosen: small enough that a leaning row keeps its line

_STEPS: Final = {
    OrganClass.LEAF: (4, 6),
    OrganClass.PEPPER: (8, 5),
    OrganClass.STEM: (3, 1),
    OrganClass.SHOOT: (3, 2),
    OrganClass.PEDUNCLE: (3, 2),
}
"""Grid steps of u and v that are left, by class. Chosen: 20 mm are ten pixels at 1 m, and out of focus."""

MAX_INSTANCES: Final = 60_000
"""Chosen: instances of a scene with far rows, below the 65,535 of a 16-bit image."""


class FarDetail(IntEnum):
    """What is one instance in far rows, the finest first.

    Other organs of a class, such as stems and peduncles, are one instance for each plant, or for each row.
    """

    ORGANS = 0  # every fruit, every leaf blade
    FRUIT = 1  # every fruit, and the leaves of a plant
    PLANTS = 2  # all organs of a class of a plant
    ROWS = 3  # all organs of a class of a row


_SEPARATE: Final = {
    FarDetail.ORGANS: (OrganClass.PEPPER, OrganClass.LEAF),
    FarDetail.FRUIT: (OrganClass.PEPPER,),
    FarDetail.PLANTS: (),
    FarDetail.ROWS: (),
}
"""Classes of which every organ is one instance."""


@dataclass(frozen=True, eq=False)
class FarRow:
    """The plants of a far row.

    Attributes:
        number: of the row, 0-based.
        plants: `(n,)` numbers of the plants in the scene; they ascend along the row.
        choice: `(n,)` the model of each plant.
        turns: `(n,)` radians about the vertical, counter-clockwise seen from above.
        bases: `(n, 3)` positions of the stem bases, metres.
    """

    number: int
    plants: NDArray[np.intp]
    choice: NDArray[np.intp]
    turns: NDArray[np.float64]
    bases: NDArray[np.float64]

    def without(self, plants: Container[int]) -> FarRow:
        """The row without some plants."""
        kept = [at for at, plant in enumerate(self.plants.tolist()) if plant not in plants]
        return replace(
            self,
            plants=self.plants[kept],
            choice=self.choice[kept],
            turns=self.turns[kept],
            bases=self.bases[kept],
        )


def coarsen_plant(mesh: Mesh) -> Mesh:
    """Reduce a plant to few triangles; twine, calyces, scars and flowers are left out.

    Raises:
        ValueError: no organ of the plant is left.
    """
    steps = np.array(
        [(0, 0) if part.kind == "calyx" else _STEPS.get(part.organ_class, (0, 0)) for part in mesh.instances]
    )
    closed = np.array([part.organ_class != OrganClass.LEAF for part in mesh.instances])
    owner = mesh.vertex_instance.astype(np.intp)
    coarse = cluster_vertices(mesh.uv, mesh.faces, steps[owner], closed[owner], owner)
    if not coarse.source.size:
        raise ValueError("no organ of the plant is left")
    return coarse.taken_from(mesh)


def draw_far_rows(
    models: int, row: DoubleRow, greenhouse: Greenhouse, rng: np.random.Generator
) -> list[FarRow]:
    """Draw the plants of the neighbouring double rows, and of the labelled rows' continuation to either side.

    `models` is the number of different plants. Positions of the labelled double row stay free, and plants are
    numbered after its own. Rows without plants are left out.
    """
    rows: list[FarRow] = []
    first_plant = row.plants_front + row.plants_back
    for line in row_lines(row, greenhouse):
        x = _free_positions(line, row, greenhouse, rng)
        if greenhouse.far_rows == 0 or not x.size:
            continue
        choice = rng.integers(models, size=x.size).astype(np.intp)
        facing = 0.0 if line.aisle < 0 else np.pi
        turns = facing + rng.uniform(-_MAX_TURN, _MAX_TURN, x.size)
        bases = np.column_stack([x, np.full((x.size, 2), (line.y_m, greenhouse.stem_base_m))])
        plants = first_plant + np.arange(x.size)
        rows.append(FarRow(len(rows), plants, choice, turns, bases))
        first_plant += x.size
    return rows


def far_row_meshes(
    models: Sequence[Mesh],
    rows: Sequence[FarRow],
    labelled_as: FarRowsAs = FarRowsAs.LABELS,
    others: int = 0,
    full: Mapping[int, Mesh] | None = None,
) -> list[Mesh]:
    """The meshes of far rows.

    Vertices, faces and appearances do not depend on how the rows are labelled.

    Args:
        models: coarse plants with their aisle at -y; each is repeated many times.
        rows: their plants, of `draw_far_rows`.
        labelled_as: what they are in labels.
        others: instances of the scene that are not in far rows.
        full: the full mesh of the model of some plants, by the number of the plant.

    Returns:
        One mesh for each row, coarse plants first. With `LABELS`, the instances of coarse plants are organs,
        merged as `far_detail` chooses, and those of full plants are all their organs. Otherwise, all coarse
        plants are one instance "far_row" of `IGNORE_CLASS` or of the background, and so are all full ones.
    """
    full = {} if full is None else full
    coarse = [row.without(full) for row in rows]
    in_full = [_full_row(row, full, labelled_as) for row in rows]
    if labelled_as != FarRowsAs.LABELS:
        rough = [_unlabelled_row(models, drawn, labelled_as) for drawn in coarse]
    else:
        others += sum(len(mesh.instances) for mesh in in_full if mesh is not None)
        rough = _labelled_rows(models, coarse, others)
    meshes = []
    for parts in zip(rough, in_full, strict=True):
        present = [mesh for mesh in parts if mesh is not None]
        meshes.append(present[0] if len(present) == 1 else concatenate_meshes(present))
    return meshes


def coarse_plant_faces(
    models: Sequence[Mesh], rows: Sequence[FarRow], full: Mapping[int, Mesh]
) -> dict[int, range]:
    """The triangles of each coarse plant among those of all meshes of `far_row_meshes`, one after another."""
    faces: dict[int, range] = {}
    first = 0
    for row in rows:
        coarse = row.without(full)
        # As `_row_mesh` places them.
        for at in np.argsort(coarse.choice, kind="stable"):
            count = len(models[coarse.choice[at]].faces)
            faces[int(coarse.plants[at])] = range(first, first + count)
            first += count
        first += sum(len(full[plant].faces) for plant in row.plants.tolist() if plant in full)
    return faces


def far_detail(sizes: dict[FarDetail, list[int]], plants: NDArray[np.intp], others: int) -> FarDetail:
    """The finest detail with which a scene has at most `MAX_INSTANCES`; `ROWS` always fits.

    Args:
        sizes: instances of each model, by detail.
        plants: `(m,)` number of plants of each model.
        others: instances that are not in far rows.
    """
    for detail in (FarDetail.ORGANS, FarDetail.FRUIT, FarDetail.PLANTS):
        if others + int(np.dot(sizes[detail], plants)) <= MAX_INSTANCES:
            return detail
    return FarDetail.ROWS


def _free_positions(
    line: RowLine, row: DoubleRow, greenhouse: Greenhouse, rng: np.random.Generator
) -> NDArray[np.float64]:
    """`(n,)` x of the plants of a row that are not labelled, metres."""
    largest = int(greenhouse.far_reach_m / row.spacing_m) + 1
    number = np.arange(-largest, largest + 1)
    if line.labelled:
        plants = row.plants_front if line.aisle < 0 else row.plants_back
        number = number[(number < -(plants // 2)) | (number >= plants - plants // 2)]
    x = number * row.spacing_m + line.shift_m
    if not line.labelled:
        x = x + rng.uniform(-0.5, 0.5) * row.spacing_m
    x = x + greenhouse.spacing_sd_m * np.clip(rng.standard_normal(x.size), -3.0, 3.0)
    return x[np.abs(x) <= greenhouse.far_reach_m]


def _full_row(row: FarRow, full: Mapping[int, Mesh], labelled_as: FarRowsAs) -> Mesh | None:
    """The plants of a row that are grown in full, or None if there are none."""
    parts: list[Mesh] = []
    for plant, turn, base in zip(row.plants.tolist(), row.turns, row.bases, strict=True):
        if plant in full:
            mesh = full[plant].moved(rotation_about_z(float(turn)), base)
            instances = [replace(item, plant=plant, far_row=row.number, full=True) for item in mesh.instances]
            parts.append(replace(mesh, instances=tuple(instances)))
    if not parts:
        return None
    together = concatenate_meshes(parts)
    return together if labelled_as == FarRowsAs.LABELS else _one_instance(together, row.number, labelled_as)


def _one_instance(mesh: Mesh, row: int, labelled_as: FarRowsAs) -> Mesh:
    """The plants of a row as a single instance, full if all of them are."""
    full = all(item.full for item in mesh.instances)
    mesh = as_single_instance(mesh, FAR_ROW)
    (instance,) = mesh.instances
    if labelled_as == FarRowsAs.IGNORE:
        instance = replace(instance, far_row=row, ignored=True)
    return replace(mesh, instances=(replace(instance, full=full),))


def _unlabelled_row(models: Sequence[Mesh], row: FarRow, labelled_as: FarRowsAs) -> Mesh | None:
    """Coarse plants of a row as a single instance, or None if there are none."""
    if not row.plants.size:
        return None
    mesh = _row_mesh([as_single_instance(model, FAR_ROW) for model in models], row)
    return _one_instance(mesh, row.number, labelled_as)


def _labelled_rows(models: Sequence[Mesh], rows: Sequence[FarRow], others: int) -> list[Mesh | None]:
    """Coarse plants of rows with their organs as instances, as far as there are numbers for them."""
    grouped = {detail: [_group_organs(model, detail) for model in models] for detail in FarDetail}
    none = np.zeros(len(models), np.intp)
    counts = sum((np.bincount(row.choice, minlength=len(models)) for row in rows), none)
    sizes = {detail: [len(model.instances) for model in grouped[detail]] for detail in FarDetail}
    detail = far_detail(sizes, counts, others)
    return [_labelled_row(grouped[detail], row, detail) if row.plants.size else None for row in rows]


def _labelled_row(models: Sequence[Mesh], row: FarRow, detail: FarDetail) -> Mesh:
    """A row with the instances of its plants, whose numbers ascend along the row."""
    mesh = _row_mesh(models, row)
    if detail == FarDetail.ROWS:
        # The organs of a row belong to no single plant.
        classes, group = np.unique(mesh.instance_class, return_inverse=True)
        whole = [replace(_group_instance(OrganClass(one)), far_row=row.number) for one in classes.tolist()]
        mesh = replace(
            mesh, face_instance=group.astype(np.uint32)[mesh.face_instance], instances=tuple(whole)
        )
    return mesh


def _row_mesh(models: Sequence[Mesh], row: FarRow) -> Mesh:
    """The coarse plants of a row; those of one model are placed together."""
    parts: list[Mesh] = []
    instances: list[Instance] = []
    for number in np.unique(row.choice):
        model, members = models[number], np.flatnonzero(row.choice == number)
        rotations = np.stack([rotation_about_z(turn) for turn in row.turns[members]])
        parts.append(_repeated_plant(model, rotations, row.bases[members]))
        for plant in row.plants[members].tolist():
            first = len(instances)
            instances += [
                item.numbered(plant, item.parent + first if item.parent >= 0 else -1, row.number)
                for item in model.instances
            ]
    # Each instance is made once, with its final numbers, because a row has thousands.
    return replace(concatenate_meshes(parts), instances=tuple(instances))


def _repeated_plant(plant: Mesh, rotations: NDArray[np.float64], bases: NDArray[np.float64]) -> Mesh:
    """A plant repeated with rotations `(n, 3, 3)` at stem bases `(n, 3)`; its instances have no names yet."""
    n, count, organs = len(bases), len(plant.vertices), len(plant.instances)
    rotation = np.swapaxes(rotations, 1, 2).astype(np.float32)
    copy = np.arange(n, dtype=np.uint32)[:, None]
    return Mesh(
        vertices=(plant.vertices @ rotation + bases[:, None].astype(np.float32)).reshape(-1, 3),
        normals=(plant.normals @ rotation).reshape(-1, 3),
        uv=np.tile(plant.uv, (n, 1)),
        state=np.tile(plant.state, n),
        faces=(plant.faces[None] + count * copy[..., None]).reshape(-1, 3),
        face_instance=(plant.face_instance[None] + organs * copy).ravel(),
        face_surface=np.tile(plant.face_surface, n),
        face_appearance=np.tile(plant.face_appearance, n),
        surfaces=plant.surfaces,
        instances=(Instance(OrganClass.BACKGROUND, ""),) * (n * organs),
        appearances=plant.appearances,
        colour=None if plant.colour is None else np.tile(plant.colour, (n, 1)),
        cultivars=plant.cultivars,
    )


def _group_organs(plant: Mesh, detail: FarDetail) -> Mesh:
    """The plant with one instance for each organ that is separate at a detail, and one for each other class.

    Organs without a triangle are left out; the parent of an organ is then the next one below it.
    """
    has_faces = np.bincount(plant.face_instance, minlength=len(plant.instances)) > 0
    group = np.full(len(plant.instances), -1)
    of_class: dict[int, int] = {}
    instances: list[Instance] = []
    for organ, item in enumerate(plant.instances):
        if not has_faces[organ]:
            continue
        is_separate = item.organ_class in _SEPARATE[detail]
        if is_separate or item.organ_class not in of_class:
            of_class.setdefault(item.organ_class, len(instances))
            instances.append(item if is_separate else _group_instance(OrganClass(item.organ_class)))
            group[organ] = len(instances) - 1
        else:
            group[organ] = of_class[item.organ_class]
    for organ in np.flatnonzero(has_faces).tolist():
        item, parent = plant.instances[organ], plant.instances[organ].parent
        if item.organ_class in _SEPARATE[detail]:
            while parent >= 0 and not has_faces[parent]:
                parent = plant.instances[parent].parent
            above = int(group[parent]) if parent >= 0 else -1
            instances[group[organ]] = replace(instances[group[organ]], parent=above)
    return replace(
        plant, face_instance=group[plant.face_instance].astype(np.uint32), instances=tuple(instances)
    )


def _group_instance(organ_class: OrganClass) -> Instance:
    """All organs of a class of a plant or a row, named after the class."""
    return Instance(organ_class, organ_class.name.lower())

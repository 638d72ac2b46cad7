"""Plant rows beyond the labelled ones: a few coarse plants, repeated many times, as inexpensive scenery."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.scene.greenhouse import Greenhouse, RowLine, as_single_instance, row_lines
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


def far_row_meshes(
    models: Sequence[Mesh], row: DoubleRow, greenhouse: Greenhouse, rng: np.random.Generator
) -> list[Mesh]:
    """The neighbouring double rows, and the continuation of the labelled rows to either side.

    Args:
        models: plants with their aisle at -y; each is repeated many times with random turns.
        row: the labelled double row; its positions stay free.
        greenhouse: number, spacing, length and lean of the rows.
        rng: draws plants, turns and positions.

    Returns:
        One mesh for each row; each is a single instance "far_row" of the background class.
    """
    meshes = []
    for line in row_lines(row, greenhouse):
        x = _free_positions(line, row, greenhouse, rng)
        if greenhouse.far_rows > 0 and x.size:
            meshes.append(_row_mesh(models, line, x, greenhouse, rng))
    return meshes


def _free_positions(
    line: RowLine, row: DoubleRow, greenhouse: Greenhouse, rng: np.random.Generator
) -> NDArray[np.float64]:
    """`(n,)` x of the plants of a row that are not labelled, metres."""
    largest = int(greenhouse.far_reach_m / row.spacing_m) + 1
    number = np.arange(-largest, largest + 1)
    if line.labelled:
        plants = row.front if line.aisle < 0 else row.back
        number = number[(number < -(plants // 2)) | (number >= plants - plants // 2)]
    x = number * row.spacing_m + line.shift_m
    if not line.labelled:
        x = x + rng.uniform(-0.5, 0.5) * row.spacing_m
    x = x + greenhouse.spacing_sd_m * np.clip(rng.standard_normal(x.size), -3.0, 3.0)
    return x[np.abs(x) <= greenhouse.far_reach_m]


def _row_mesh(
    models: Sequence[Mesh],
    line: RowLine,
    x: NDArray[np.float64],
    greenhouse: Greenhouse,
    rng: np.random.Generator,
) -> Mesh:
    """A row of randomly chosen plants at x; plants of one model are placed together."""
    choice = rng.integers(len(models), size=x.size)
    facing = 0.0 if line.aisle < 0 else np.pi
    turns = rng.uniform(-_MAX_TURN, _MAX_TURN, x.size)
    rotations = np.stack([rotation_about_z(facing + turn) for turn in turns])
    bases = np.column_stack([x, np.full((x.size, 2), (line.y_m, greenhouse.stem_base_m))])
    parts = [
        _repeated_plant(models[number], rotations[choice == number], bases[choice == number])
        for number in np.unique(choice)
    ]
    return as_single_instance(concatenate_meshes(parts), "far_row")


def _repeated_plant(plant: Mesh, rotations: NDArray[np.float64], bases: NDArray[np.float64]) -> Mesh:
    """A plant repeated with rotations `(n, 3, 3)` at stem bases `(n, 3)`, all as its first instance."""
    n, count = len(bases), len(plant.vertices)
    rotation = np.swapaxes(rotations, 1, 2).astype(np.float32)
    faces = plant.faces[None] + (count * np.arange(n, dtype=np.uint32))[:, None, None]
    return Mesh(
        vertices=(plant.vertices @ rotation + bases[:, None].astype(np.float32)).reshape(-1, 3),
        normals=(plant.normals @ rotation).reshape(-1, 3),
        uv=np.tile(plant.uv, (n, 1)),
        state=np.tile(plant.state, n),
        faces=faces.reshape(-1, 3),
        face_instance=np.zeros(n * len(plant.faces), dtype=np.uint32),
        face_surface=np.tile(plant.face_surface, n),
        surfaces=plant.surfaces,
        instances=plant.instances[:1],
    )

"""Rows beyond those that are labelled: a few coarse plants over and over, as cheap scenery."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.scene.greenhouse import Greenhouse, RowLine, as_one, row_lines
from pepperscene.scene.row import DoubleRow, rotation_about_z

MODELS: Final = 6
"""Different plants that far rows are made of: chosen, a row of twenty shows no pattern."""

_TURN: Final = np.radians(30.0)  # chosen: most turn either way, so that a leaning row keeps its line

_GRID: Final[Mapping[OrganClass, tuple[int, int]]] = MappingProxyType(
    {
        OrganClass.LEAF: (4, 6),
        OrganClass.PEPPER: (8, 5),
        OrganClass.STEM: (3, 1),
        OrganClass.SHOOT: (3, 2),
        OrganClass.PEDUNCLE: (3, 2),
    }
)
"""Steps of u and v that are left of each organ; chosen: 20 mm are ten pixels at 1 m, and out of focus."""


def coarsen_plant(mesh: Mesh) -> Mesh:
    """A plant with few triangles: of each organ's vertices those nearest to the knots of a coarse grid of uv.

    Twine, calyces, scars and flowers are left out. Clustering after Rossignac & Borrel 1993, in the surface's
    own coordinates, so that thin organs stay whole.

    Raises:
        ValueError: nothing of the plant is left.
    """
    count = len(mesh.instances)
    grid = np.zeros((count, 2), dtype=np.int64)
    for number, one in enumerate(mesh.instances):
        grid[number] = (0, 0) if one.kind == "calyx" else _GRID.get(one.organ_class, (0, 0))
    owner = np.zeros(len(mesh.vertices), dtype=np.int64)
    owner[mesh.faces] = mesh.face_instance[:, None]
    steps = grid[owner]

    # Closed bodies go round: their last column of u is their first.
    place = mesh.uv * steps
    knot = np.rint(place).astype(np.int64)
    sheet = np.array([one.organ_class == OrganClass.LEAF for one in mesh.instances])[owner]
    column = np.where(sheet, knot[:, 0], knot[:, 0] % np.maximum(steps[:, 0], 1))
    key = (owner * 16 + column) * 16 + knot[:, 1]
    _, cluster = np.unique(key, return_inverse=True)
    away = ((place - knot) ** 2).sum(axis=1)
    order = np.lexsort((away, cluster))
    nearest = order[np.searchsorted(cluster[order], np.arange(cluster.max() + 1))]

    # Triangles that have shrunk to a line are gone, and of those that lie on one another, all but one.
    faces = cluster[mesh.faces]
    wanted = grid[mesh.face_instance, 0] > 0
    wanted &= (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    kept = np.zeros(len(faces), dtype=bool)
    kept[first] = True
    kept &= wanted
    if not kept.any():
        raise ValueError("nothing of the plant is left")
    used, renumbered = np.unique(faces[kept], return_inverse=True)
    chosen = nearest[used]
    return replace(
        mesh,
        vertices=mesh.vertices[chosen],
        normals=mesh.normals[chosen],
        uv=mesh.uv[chosen],
        state=mesh.state[chosen],
        faces=renumbered.reshape(-1, 3).astype(np.uint32),
        face_instance=mesh.face_instance[kept],
        face_surface=mesh.face_surface[kept],
    )


def far_rows(
    models: Sequence[Mesh], row: DoubleRow, house: Greenhouse, rng: np.random.Generator
) -> list[Mesh]:
    """The rows next to a double row, and what follows it to either side, up to the greenhouse's reach.

    Args:
        models: plants with their aisle at -y; each stands in many places, turned by chance.
        row: the double row, whose own places are left free.
        house: how many rows there are, how they lie and how they lean.
        rng: chooses plants, turns and places.

    Returns:
        One mesh for each row, each one instance "far_row" of the class background.
    """
    made = []
    for line in row_lines(row, house):
        x = _free_places(line, row, house, rng)
        if house.far_rows > 0 and x.size:
            made.append(_row(models, line, x, house, rng))
    return made


def _free_places(
    line: RowLine, row: DoubleRow, house: Greenhouse, rng: np.random.Generator
) -> NDArray[np.float64]:
    """`(n,)` x of the plants of a row within reach, metres."""
    most = int(house.far_reach_m / row.spacing_m) + 1
    number = np.arange(-most, most + 1)
    if line.own:
        plants = row.front if line.aisle < 0 else row.back
        number = number[(number < -(plants // 2)) | (number >= plants - plants // 2)]
    x = number * row.spacing_m + line.shift_m
    if not line.own:
        x = x + rng.uniform(-0.5, 0.5) * row.spacing_m
    x = x + house.spacing_sd_m * np.clip(rng.standard_normal(x.size), -3.0, 3.0)
    return x[np.abs(x) <= house.far_reach_m]


def _row(
    models: Sequence[Mesh],
    line: RowLine,
    x: NDArray[np.float64],
    house: Greenhouse,
    rng: np.random.Generator,
) -> Mesh:
    """Plants at these places, those of one model placed together."""
    which = rng.integers(len(models), size=x.size)
    facing = 0.0 if line.aisle < 0 else np.pi
    turns = np.stack([rotation_about_z(facing + turn) for turn in rng.uniform(-_TURN, _TURN, x.size)])
    feet = np.column_stack([x, np.full((x.size, 2), (line.y_m, house.foot_m))])
    parts = [
        _repeated(models[number], turns[which == number], feet[which == number])
        for number in np.unique(which)
    ]
    return as_one(concatenate_meshes(parts), OrganClass.BACKGROUND, "far_row")


def _repeated(model: Mesh, turns: NDArray[np.float64], feet: NDArray[np.float64]) -> Mesh:
    """A plant at n places: `(n, 3, 3)` turns and `(n, 3)` feet."""
    n, count = len(feet), len(model.vertices)
    turned = np.swapaxes(turns, 1, 2).astype(np.float32)
    faces = model.faces[None] + (count * np.arange(n, dtype=np.uint32))[:, None, None]
    return Mesh(
        vertices=(model.vertices @ turned + feet[:, None].astype(np.float32)).reshape(-1, 3),
        normals=(model.normals @ turned).reshape(-1, 3),
        uv=np.tile(model.uv, (n, 1)),
        state=np.tile(model.state, n),
        faces=faces.reshape(-1, 3),
        face_instance=np.zeros(n * len(model.faces), dtype=np.uint32),
        face_surface=np.tile(model.face_surface, n),
        surfaces=model.surfaces,
        instances=as_one(model, OrganClass.BACKGROUND, "far_row").instances,
    )

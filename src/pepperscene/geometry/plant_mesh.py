"""A plant's organs as one mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry.body import Bodies
from pepperscene.geometry.lamina import laminae
from pepperscene.geometry.mesh import Mesh
from pepperscene.geometry.pericarp import calyces, fruit_walls, fruits
from pepperscene.geometry.tube import cuts, internodes, nodes, peduncles, stalks
from pepperscene.grammar.plant import Organ, OrganKind, Plant

ORGAN_CLASSES: Final[Mapping[OrganKind, OrganClass]] = {
    "internode": OrganClass.STEM,
    "node": OrganClass.STEM,
    "side_shoot": OrganClass.SHOOT,
    "petiole": OrganClass.SHOOT,
    "lamina": OrganClass.LEAF,
    "peduncle": OrganClass.PEDUNCLE,
    "calyx": OrganClass.PEDUNCLE,
    "fruit": OrganClass.PEPPER,
    "cut": OrganClass.CUT,
}
"""The published class of each organ kind."""

ORGAN_SURFACES: Final[Mapping[OrganKind, str]] = {
    "internode": "stem",
    "node": "stem",
    "side_shoot": "petiole",
    "petiole": "petiole",
    "lamina": "leaf",
    "peduncle": "peduncle",
    "calyx": "calyx",
    "fruit": "fruit",
    "cut": "cut",
}
"""The surface that light meets on each organ kind."""

_MAKERS: Final[Mapping[OrganKind, Callable[[Sequence[Organ], float], Bodies]]] = {
    "internode": internodes,
    "node": nodes,
    "side_shoot": stalks,
    "petiole": stalks,
    "lamina": laminae,
    "peduncle": peduncles,
    "cut": cuts,
}


def mesh_plant(plant: Plant, detail: float = 1.0) -> Mesh:
    """Triangles of a plant, with one instance for each organ in the plant's order.

    Args:
        plant: organs with poses and measures.
        detail: fineness; lines of a grid scale with it, so triangles with its square. The shapes stay.

    Raises:
        ValueError: detail is not above zero, the plant is empty, or an organ lacks a measure.
    """
    if not detail > 0.0 or not np.isfinite(detail):
        raise ValueError(f"detail must be above zero, not {detail}")
    if not plant.organs:
        raise ValueError("a plant without organs has no mesh")
    # All organs of one kind share a grid and are shaped together.
    parts: list[tuple[OrganKind, list[int], Bodies]] = []
    for kind, maker in _MAKERS.items():
        where = _where(plant, kind)
        if where:
            parts.append((kind, where, maker([plant.organs[index] for index in where], detail)))
    parts += _fruit_parts(plant, detail)
    surfaces = tuple(dict.fromkeys(ORGAN_SURFACES[kind] for kind, _, _ in parts))
    instances = tuple(
        Instance(ORGAN_CLASSES[organ.kind], organ.kind, phytomer=organ.phytomer, parent=organ.parent)
        for organ in plant.organs
    )
    faces, offset = [], 0
    for _, where, bodies in parts:
        count = bodies.vertices.shape[1]
        first = offset + count * np.arange(len(where))
        faces.append((bodies.faces[None] + first[:, None, None]).reshape(-1, 3))
        offset += count * len(where)
    per_face = [np.repeat(where, len(bodies.faces)) for _, where, bodies in parts]
    surface = [
        np.full(len(where) * len(bodies.faces), surfaces.index(ORGAN_SURFACES[kind]))
        for kind, where, bodies in parts
    ]
    every = [bodies for _, _, bodies in parts]
    return Mesh(
        vertices=np.concatenate([item.vertices.reshape(-1, 3) for item in every]).astype(np.float32),
        normals=np.concatenate([item.normals.reshape(-1, 3) for item in every]).astype(np.float32),
        uv=np.concatenate([item.uv.reshape(-1, 2) for item in every]).astype(np.float32),
        state=np.concatenate([item.state.ravel() for item in every]).astype(np.float32),
        faces=np.concatenate(faces).astype(np.uint32),
        face_instance=np.concatenate(per_face).astype(np.uint32),
        face_surface=np.concatenate(surface).astype(np.uint8),
        surfaces=surfaces,
        instances=instances,
    )


def _fruit_parts(plant: Plant, detail: float) -> list[tuple[OrganKind, list[int], Bodies]]:
    """Fruit and calyces; a calyx takes the shape of the fruit that it sits on."""
    fruit, calyx = _where(plant, "fruit"), _where(plant, "calyx")
    parts: list[tuple[OrganKind, list[int], Bodies]] = []
    walls = fruit_walls([plant.organs[index] for index in fruit], detail) if fruit else None
    if walls is not None:
        parts.append(("fruit", fruit, fruits([plant.organs[index] for index in fruit], walls)))
    if calyx:
        # The fruit grows out of the calyx, or out of the same fruit stalk.
        by_parent = {plant.organs[index].parent: number for number, index in enumerate(fruit)}
        under = [by_parent.get(index, by_parent.get(plant.organs[index].parent, -1)) for index in calyx]
        parts.append(
            ("calyx", calyx, calyces([plant.organs[index] for index in calyx], under, walls, detail))
        )
    return parts


def _where(plant: Plant, kind: OrganKind) -> list[int]:
    """Indices of the organs of one kind."""
    return [index for index, organ in enumerate(plant.organs) if organ.kind == kind]

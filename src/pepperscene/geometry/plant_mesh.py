"""A plant's organs as one mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Instance
from pepperscene.cultivar.organs import OrganForm
from pepperscene.geometry.blade.blades import laminae
from pepperscene.geometry.bodies import MeshBatch
from pepperscene.geometry.fruit.calyx import calyces
from pepperscene.geometry.fruit.crown import crowns, joined, scanned_crowns
from pepperscene.geometry.fruit.fruits import fruit_frames, fruits, scanned_fruits
from pepperscene.geometry.fruit.pericarp import pericarps
from pepperscene.geometry.fruit.scan import load_scan
from pepperscene.geometry.mesh import Mesh
from pepperscene.geometry.tubes.flower import flowers
from pepperscene.geometry.tubes.stalk import cuts, peduncles, stalks
from pepperscene.geometry.tubes.stem import internodes, nodes
from pepperscene.grammar.plant import Organ, Plant

_MAKERS: Final[Mapping[OrganForm, Callable[[Sequence[Organ], float], MeshBatch]]] = {
    "internode": internodes,
    "node": nodes,
    "stalk": stalks,
    "blade": laminae,
    "peduncle": peduncles,
    "cut": cuts,
    "flower": flowers,
}

Part = tuple[NDArray[np.intp], MeshBatch]
"""Which organs of the plant, and their bodies."""


def mesh_plant(plant: Plant, detail: float = 1.0) -> Mesh:
    """Triangles of a plant, with one instance for each organ in the plant's order.

    The vertices of each organ lie together, and so do its faces.

    Args:
        plant: organs with poses and measures, and what each of their kinds is.
        detail: fineness; lines of a grid scale with it, so triangles with its square. The shapes stay.

    Raises:
        ValueError: detail is not above zero, the plant is empty, an organ lacks a measure or its kind is
            not among the plant's.
        InputError: a scanned fruit's file is missing or not one closed body.
    """
    if not detail > 0.0 or not np.isfinite(detail):
        raise ValueError(f"detail must be above zero, not {detail}")
    if not plant.organs:
        raise ValueError("a plant without organs has no mesh")
    unknown = {organ.kind for organ in plant.organs} - set(plant.kinds)
    if unknown:
        raise ValueError(f"the plant does not say what {sorted(unknown)} are")
    # All organs of one form share a grid and are shaped together.
    parts: list[Part] = []
    for form, maker in _MAKERS.items():
        where = _where(plant, form)
        if where.size:
            parts.append((where, maker([plant.organs[index] for index in where], detail)))
    return _assembled(plant, parts + _fruit_parts(plant, detail))


def _assembled(plant: Plant, parts: Sequence[Part]) -> Mesh:
    """The bodies of all organs in one mesh."""
    kinds = [plant.kinds[organ.kind] for organ in plant.organs]
    surfaces = tuple(dict.fromkeys(kind.surface for kind in kinds))
    surface = np.array([surfaces.index(kind.surface) for kind in kinds], dtype=np.uint8)
    vertex_count = sum(bodies.state.size for _, bodies in parts)
    face_count = sum(len(where) * len(bodies.faces) for where, bodies in parts)
    vertices, normals = np.empty((2, vertex_count, 3), dtype=np.float32)
    uv, state = np.empty((vertex_count, 2), dtype=np.float32), np.empty(vertex_count, dtype=np.float32)
    faces = np.empty((face_count, 3), dtype=np.uint32)
    face_instance = np.empty(face_count, dtype=np.uint32)
    vertex, face = 0, 0
    for where, bodies in parts:
        count, each = bodies.state.shape[1], len(bodies.faces)
        mine = slice(vertex, vertex + bodies.state.size)
        for whole, part in ((vertices, bodies.vertices), (normals, bodies.normals), (uv, bodies.uv)):
            whole[mine].reshape(part.shape)[...] = part
        state[mine].reshape(bodies.state.shape)[...] = bodies.state
        # Each organ's faces count on from its first vertex.
        first = (vertex + count * np.arange(len(where))).astype(np.uint32)
        those = slice(face, face + each * len(where))
        np.add(
            bodies.faces.astype(np.uint32),
            first[:, None, None],
            out=faces[those].reshape(len(where), each, 3),
        )
        face_instance[those].reshape(len(where), each)[...] = where[:, None]
        vertex, face = mine.stop, those.stop
    return Mesh(
        vertices=vertices,
        normals=normals,
        uv=uv,
        state=state,
        faces=faces,
        face_instance=face_instance,
        face_surface=surface[face_instance],
        surfaces=surfaces,
        instances=tuple(
            Instance(kind.organ_class, organ.kind, -1, organ.phytomer, organ.parent)
            for organ, kind in zip(plant.organs, kinds, strict=True)
        ),
    )


def _fruit_parts(plant: Plant, detail: float) -> list[Part]:
    """Fruit and calyces; a calyx takes the shape of the fruit that it sits on."""
    fruit, calyx = _where(plant, "fruit"), _where(plant, "calyx")
    parts: list[Part] = []
    seats = None
    if fruit.size:
        # The modelled ones share a grid, and so do those that wear the same scan.
        worn = [plant.kinds[plant.organs[index].kind].scan for index in fruit]
        groups = [np.array([n for n, path in enumerate(worn) if path == one]) for one in dict.fromkeys(worn)]
        faced = []
        for group in groups:
            organs, path = [plant.organs[index] for index in fruit[group]], worn[group[0]]
            if path is None:
                walls = pericarps(organs, detail)
                parts.append((fruit[group], fruits(organs, walls)))
                faced.append(crowns(walls))
            else:
                scan = load_scan(path)
                parts.append((fruit[group], scanned_fruits(organs, scan)))
                faced.append(scanned_crowns(organs, scan))
        order = np.argsort(np.concatenate(groups))
        seats = fruit_frames([plant.organs[index] for index in fruit]), joined(faced, order)
    if calyx.size:
        organs = [plant.organs[index] for index in calyx]
        # The fruit grows out of the calyx, or out of the same fruit stalk.
        by_parent = {plant.organs[index].parent: number for number, index in enumerate(fruit)}
        under = [
            by_parent.get(int(index), by_parent.get(organ.parent, -1))
            for index, organ in zip(calyx, organs, strict=True)
        ]
        stalks = [plant.organs[organ.parent] if organ.parent >= 0 else None for organ in organs]
        parts.append((calyx, calyces(organs, stalks, np.array(under), seats, detail)))
    return parts


def _where(plant: Plant, form: OrganForm) -> NDArray[np.intp]:
    """Indices of the organs of one form."""
    forms = {name: kind.form for name, kind in plant.kinds.items()}
    return np.array([i for i, organ in enumerate(plant.organs) if forms[organ.kind] == form], dtype=np.intp)

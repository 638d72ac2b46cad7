"""The mesh of a plant, built from its organs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.classes import Appearance, Instance
from pepperscene.cultivar import STATE_PER_SD
from pepperscene.cultivar.organs import FruitScans, OrganForm
from pepperscene.geometry.batch import MeshBatch, form_indices
from pepperscene.geometry.blade.blades import mesh_blades
from pepperscene.geometry.fruit.calyx import mesh_calyces
from pepperscene.geometry.fruit.fruits import (
    concatenate_shoulders,
    fruit_frames,
    mesh_fruits,
    pericarp_shoulders,
)
from pepperscene.geometry.fruit.pericarp import build_pericarps
from pepperscene.geometry.fruit.scan import (
    check_unit,
    choose_scans,
    load_scan,
    mesh_scanned_fruits,
    scan_shoulders,
)
from pepperscene.geometry.mesh import FloatArray, IndexArray, Mesh, SingleArray, join_colours
from pepperscene.geometry.triangle_counts import check_detail
from pepperscene.geometry.tubes.flower import mesh_flowers
from pepperscene.geometry.tubes.stalk import mesh_cuts, mesh_peduncles, mesh_stalks
from pepperscene.geometry.tubes.stem import mesh_internodes, mesh_nodes
from pepperscene.grammar.plant import Organ, Plant

_MESHERS: Final[Mapping[OrganForm, Callable[[Sequence[Organ], float], MeshBatch]]] = {
    "internode": mesh_internodes,
    "node": mesh_nodes,
    "stalk": mesh_stalks,
    "blade": mesh_blades,
    "peduncle": mesh_peduncles,
    "cut": mesh_cuts,
    "flower": mesh_flowers,
}

Part = tuple[IndexArray, MeshBatch]
"""Indices of organs of a plant, and their meshes."""


def mesh_plant(plant: Plant, detail: float = 1.0) -> Mesh:
    """Build the triangles of a plant, with one instance for each organ, in the plant's order.

    The vertices of each organ are contiguous, and so are its faces.

    Args:
        plant: organs with poses and measures, and the kinds that they refer to.
        detail: fineness of the mesh; grid lines scale with it, triangles with its square, shapes do not.

    Raises:
        ValueError: detail is not above zero, the plant is empty, an organ lacks a measure, or its kind is
            not among the plant's.
        InputError: the file of a scanned fruit is missing or not one closed body.
    """
    check_detail(detail)
    if not plant.organs:
        raise ValueError("a plant without organs has no mesh")
    unknown = {organ.kind for organ in plant.organs} - set(plant.kinds)
    if unknown:
        raise ValueError(f"the plant has organs of unknown kinds: {', '.join(sorted(unknown))}")
    # All organs of one form share a grid and are built together.
    parts: list[Part] = []
    for form, build in _MESHERS.items():
        indices = form_indices(plant, form)
        if indices.size:
            parts.append((indices, build([plant.organs[index] for index in indices], detail)))
    return _assemble(plant, parts + _fruit_parts(plant, detail))


def _assemble(plant: Plant, parts: Sequence[Part]) -> Mesh:
    """Join the meshes of all organs."""
    kinds = [plant.kinds[organ.kind] for organ in plant.organs]
    surfaces = tuple(dict.fromkeys(kind.surface for kind in kinds))
    surface = np.array([surfaces.index(kind.surface) for kind in kinds], dtype=np.uint8)
    faces, owners, vertex = [], [], 0
    for indices, batch in parts:
        # The faces of each organ count from its first vertex.
        n, count = batch.state.shape
        first = (vertex + count * np.arange(n)).astype(np.uint32)
        faces.append((batch.faces.astype(np.uint32) + first[:, None, None]).reshape(-1, 3))
        owners.append(np.repeat(indices, len(batch.faces)).astype(np.uint32))
        vertex += n * count
    face_instance = np.concatenate(owners)
    # The colours of a scan hold its scars and residue.
    coloured = {index for indices, batch in parts if batch.colour is not None for index in indices.tolist()}
    return Mesh(
        vertices=_join([batch.vertices.reshape(-1, 3) for _, batch in parts]),
        normals=_join([batch.normals.reshape(-1, 3) for _, batch in parts]),
        uv=_join([batch.uv.reshape(-1, 2) for _, batch in parts]),
        state=_join([_states(plant, indices, batch).ravel() for indices, batch in parts]),
        faces=np.concatenate(faces),
        face_instance=face_instance,
        face_surface=surface[face_instance],
        face_appearance=face_instance,
        surfaces=surfaces,
        instances=tuple(
            Instance(kind.organ_class, organ.kind, phytomer=organ.phytomer, parent=organ.parent)
            for organ, kind in zip(plant.organs, kinds, strict=True)
        ),
        appearances=tuple(
            Appearance(
                residue=0.0 if index in coloured else organ.measures.get("residue", 0.0),
                ageing=organ.measures.get("ageing", 0.0),
                variant=int(organ.measures.get("seed", 0.0) * 2.0**16) % 2**16,
            )
            for index, organ in enumerate(plant.organs)
        ),
        colour=join_colours([(batch.colour, batch.state.size) for _, batch in parts]),
        cultivars=() if plant.grown_from is None else (plant.grown_from,),
    )


def _states(plant: Plant, indices: IndexArray, batch: MeshBatch) -> FloatArray:
    """States `(n, v)` of organs: of one with a measured curve, its place among the curves of all organs."""
    measured = () if plant.grown_from is None else plant.grown_from.spectra
    kinds = [plant.kinds[plant.organs[index].kind] for index in indices]
    states = batch.state.copy() if measured else batch.state
    for number, kind in enumerate(kinds):
        if kind.surface in measured:
            from scipy.special import ndtri

            # A stem is one organ; the leading bits of a seed choose textures.
            organ = plant.organs[0 if kind.form in ("internode", "node") else indices[number]]
            place = max(organ.measures.get("seed", 0.5 / 2.0**16) * 2.0**16 % 1.0, 1e-9)
            states[number] = np.clip(0.5 + STATE_PER_SD * ndtri(place), 0.0, 1.0)
    return states


def _join(values: Sequence[FloatArray]) -> SingleArray:
    """Values of all parts in single precision."""
    return np.concatenate(values, dtype=np.float32, casting="same_kind")


def _fruit_parts(plant: Plant, detail: float) -> list[Part]:
    """Fruit and calyces; a calyx follows the shape of the fruit below it."""
    fruit, calyx = form_indices(plant, "fruit"), form_indices(plant, "calyx")
    parts: list[Part] = []
    modelled = None
    if fruit.size:
        # The modelled fruit share a grid, and so do those that use the same scan.
        groups, shoulders = _same_scan(plant, fruit), []
        for (scans, path), group in groups.items():
            organs = [plant.organs[index] for index in fruit[group]]
            if scans is None or path is None:
                pericarps = build_pericarps(organs, detail)
                parts.append((fruit[group], mesh_fruits(organs, pericarps)))
                shoulders.append(pericarp_shoulders(pericarps))
            else:
                scan = load_scan(path, scans.up, colour=scans.colour)
                if scans.unit is not None:
                    check_unit(path, scan, scans.unit, scans.diameter_m)
                parts.append((fruit[group], mesh_scanned_fruits(organs, scan)))
                shoulders.append(scan_shoulders(organs, scan))
        frames = fruit_frames([plant.organs[index] for index in fruit])
        modelled = frames, concatenate_shoulders(shoulders, np.argsort(np.concatenate(list(groups.values()))))
    if calyx.size:
        organs = [plant.organs[index] for index in calyx]
        # The fruit grows out of the calyx, or out of the same fruit stalk.
        by_parent = {plant.organs[index].parent: number for number, index in enumerate(fruit)}
        under = [
            by_parent.get(int(index), by_parent.get(organ.parent, -1))
            for index, organ in zip(calyx, organs, strict=True)
        ]
        stalks = [plant.organs[organ.parent] if organ.parent >= 0 else None for organ in organs]
        parts.append((calyx, mesh_calyces(organs, stalks, np.array(under), modelled, detail)))
    return parts


def _same_scan(plant: Plant, fruit: IndexArray) -> dict[tuple[FruitScans | None, Path | None], IndexArray]:
    """Positions in `fruit` of those that share a scan, by the scans of their kind and the chosen file."""
    chosen: list[tuple[FruitScans | None, Path | None]] = []
    for index in fruit:
        organ = plant.organs[index]
        scans = plant.kinds[organ.kind].scans
        chosen.append((scans, None if scans is None else choose_scans([organ], scans)[0]))
    return {used: np.flatnonzero([one == used for one in chosen]) for used in dict.fromkeys(chosen)}

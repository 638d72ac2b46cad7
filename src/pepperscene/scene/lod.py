"""Organs of few triangles in place of many, for soft light: alike in place, area and surface.

Organs of one form share their triangles' pattern, so that the pattern is made simple once, by clustering
vertices in the surface's own coordinates (after Rossignac & Borrel 1993), and serves all of them. The
vertices left are the organ's own: a stand-in stays inside the organ's convex hull.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh

Index = NDArray[np.intp]

_STEPS: Final[Mapping[OrganClass, tuple[int, int]]] = MappingProxyType(
    {
        OrganClass.LEAF: (4, 6),
        OrganClass.PEPPER: (6, 5),
        OrganClass.STEM: (4, 1),
        OrganClass.SHOOT: (4, 3),
        OrganClass.PEDUNCLE: (4, 3),
        OrganClass.CUT: (4, 2),
    }
)
"""Steps of u and v that are left, by class; chosen: areas change by a few per cent."""


@dataclass(frozen=True, eq=False)
class Pattern:
    """How the triangles of a form are made few.

    Attributes:
        vertices: `(k,)` which of the organ's vertices are left.
        faces: `(m, 3)` triangles of them.
        source: `(m,)` the organ's face that each came of.
    """

    vertices: Index
    faces: Index
    source: Index


def pattern(uv: NDArray[np.float32], faces: Index, steps: tuple[int, int], closed: bool) -> Pattern:
    """A pattern for the organs of a form.

    Args:
        uv: `(v, 2)` surface coordinates of one of them.
        faces: `(f, 3)` of its triangles.
        steps: of u and v that are left.
        closed: whether u goes round, so that its last column is its first.
    """
    place = uv * np.asarray(steps, dtype=float)
    knot = np.rint(place).astype(np.intp)
    column = knot[:, 0] % steps[0] if closed else knot[:, 0]
    key = column * (steps[1] + 1) + knot[:, 1]
    _, cluster = np.unique(key, return_inverse=True)
    # Of each cluster the vertex that lies nearest to its knot.
    away = ((place - knot) ** 2).sum(axis=1)
    order = np.lexsort((np.arange(len(away)), away, cluster))
    nearest = order[np.searchsorted(cluster[order], np.arange(cluster.max() + 1))]

    # Triangles that have shrunk to a line are gone, and of those that lie on one another, all but one.
    small = cluster[faces]
    whole = (small[:, 0] != small[:, 1]) & (small[:, 1] != small[:, 2]) & (small[:, 2] != small[:, 0])
    _, first = np.unique(np.sort(small, axis=1), axis=0, return_index=True)
    source = np.sort(first[whole[first]])
    used, renumbered = np.unique(small[source], return_inverse=True)
    return Pattern(nearest[used], renumbered.reshape(-1, 3), source)


def stand_ins(mesh: Mesh, faces: Index, vertices: Index) -> tuple[Mesh, NDArray[np.bool_]]:
    """Few triangles for some organs of a mesh.

    Args:
        mesh: with the organs; its instances and surfaces are kept.
        faces: `(n, 2)` first face of each organ and the one after its last.
        vertices: `(n, 2)` first vertex of each and the one after its last.

    Returns:
        A mesh of those organs alone that have a stand-in, and `(n,)` which they are.
    """
    done = np.zeros(len(faces), dtype=bool)
    count = 0
    corners, sources, points = [np.empty((0, 3), np.intp)], [np.empty(0, np.intp)], [np.empty(0, np.intp)]
    for steps, closed, members in _forms(mesh, faces, vertices):
        # One of them tells the pattern; organs of the same size may still have another.
        first, start = faces[members, 0], vertices[members, 0]
        base = mesh.faces[slice(*faces[members[0]])].astype(np.intp) - start[0]
        made = pattern(mesh.uv[slice(*vertices[members[0]])], base, steps, closed)
        replaced = mesh.faces[first[:, None] + made.source].astype(np.intp) - start[:, None, None]
        alike = (replaced == base[made.source]).all(axis=(1, 2))
        if not 0 < len(made.source) < len(base):
            continue
        members, first, start = members[alike], first[alike], start[alike]
        done[members] = True
        begin = count + len(made.vertices) * np.arange(len(members))
        corners.append((begin[:, None, None] + made.faces).reshape(-1, 3))
        sources.append((first[:, None] + made.source).ravel())
        points.append((start[:, None] + made.vertices).ravel())
        count += len(points[-1])
    chosen, source = np.concatenate(points), np.concatenate(sources)
    few = replace(
        mesh,
        vertices=mesh.vertices[chosen],
        normals=mesh.normals[chosen],
        uv=mesh.uv[chosen],
        state=mesh.state[chosen],
        faces=np.concatenate(corners).astype(np.uint32),
        face_instance=mesh.face_instance[source],
        face_surface=mesh.face_surface[source],
    )
    return few, done


def _forms(mesh: Mesh, faces: Index, vertices: Index) -> Iterator[tuple[tuple[int, int], bool, Index]]:
    """Steps, whether u goes round, and which organs they are, for each kind and size of organ."""
    members: dict[tuple[OrganClass, str, int, int], list[int]] = {}
    sizes = zip((faces[:, 1] - faces[:, 0]).tolist(), (vertices[:, 1] - vertices[:, 0]).tolist(), strict=True)
    for place, (owner, size) in enumerate(zip(mesh.face_instance[faces[:, 0]].tolist(), sizes, strict=True)):
        one = mesh.instances[owner]
        members.setdefault((OrganClass(one.organ_class), one.kind, *size), []).append(place)
    for (organ_class, *_), places in members.items():
        if organ_class in _STEPS:
            yield _STEPS[organ_class], organ_class != OrganClass.LEAF, np.array(places)

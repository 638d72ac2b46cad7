"""The organs of a mesh as nodes of a file: their names, their poses, and their triangles by surface."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.mesh import Mesh

if TYPE_CHECKING:
    from trimesh import Trimesh

Pose = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OrganNodes:
    """The nodes of the instances of a mesh.

    Attributes:
        root: name of the node above all others.
        names: of the instances, each once.
        extras: what a file says of each instance.
        poses: `(i, 4, 4)` of the instances in the mesh's axes; None for the mesh's own axes.
        plants: poses `(4, 4)` of plants by number; organs of others are below the root.
    """

    root: str
    names: Sequence[str]
    extras: Sequence[Mapping[str, Any]]
    poses: NDArray[np.float64] | None = None
    plants: Mapping[int, Pose] = field(default_factory=dict)

    def pose(self, index: int) -> Pose:
        """`(4, 4)` the pose of an instance in the mesh's axes."""
        return np.eye(4) if self.poses is None else self.poses[index]


@dataclass(frozen=True, eq=False)
class OrganPart:
    """The triangles of an instance that have one surface.

    Attributes:
        index: of the instance.
        name: of the instance, for its first part; others have that of the surface added.
        is_first: whether it is the first part.
        surface: its name.
        vertices: `(n,)` indices into the mesh's vertices.
        faces: `(m, 3)` indices into those.
        rows: of the faces in the mesh.
    """

    index: int
    name: str
    is_first: bool
    surface: str
    vertices: NDArray[np.uint32]
    faces: NDArray[np.intp]
    rows: NDArray[np.intp]

    def local(self, mesh: Mesh, pose: Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`(n, 3)` vertices and normals in the axes of a pose `(4, 4)`."""
        points = (mesh.vertices[self.vertices] - pose[:3, 3]) @ pose[:3, :3]
        return points, mesh.normals[self.vertices] @ pose[:3, :3]

    def body(self, mesh: Mesh, pose: Pose | None = None) -> Trimesh:
        """The triangles for trimesh, in the axes of a pose; None for those of the mesh."""
        import trimesh

        own = mesh.vertices[self.vertices], mesh.normals[self.vertices]
        points, normals = own if pose is None else self.local(mesh, pose)
        return trimesh.Trimesh(points, self.faces, vertex_normals=normals, process=False)


def organ_names(mesh: Mesh) -> tuple[str, ...]:
    """Name each instance, uniquely in the mesh: `fruit_12_node_7` is the 13th fruit, at the 8th node.

    Both count from 0. If there are several plants, the plant's number comes first: `plant_3_stem_0`.
    """
    several = len({item.plant for item in mesh.instances}) > 1
    seen: Counter[tuple[int, str]] = Counter()
    names = []
    for item in mesh.instances:
        plant = f"plant_{item.plant}_" if several and item.plant >= 0 else ""
        node = f"_node_{item.phytomer}" if item.phytomer >= 0 else ""
        names.append(f"{plant}{word(item.kind)}_{seen[item.plant, item.kind]}{node}")
        seen[item.plant, item.kind] += 1
    return tuple(names)


def organ_nodes(mesh: Mesh) -> OrganNodes:
    """The nodes of a mesh whose organs have no poses: a plant at the origin."""
    extras = [
        {
            "class": item.organ_class.name.lower(),
            "class_id": int(item.organ_class),
            "kind": item.kind,
            "plant": item.plant,
            "phytomer": item.phytomer,
            "instance": index,
            "parent": item.parent,
        }
        for index, item in enumerate(mesh.instances)
    ]
    return OrganNodes("plant", organ_names(mesh), extras)


def organ_parts(mesh: Mesh, names: Sequence[str]) -> Iterator[OrganPart]:
    """The parts of all instances with triangles, in order."""
    for index, name in enumerate(names):
        run = mesh.face_runs.rows(index)
        rows = np.arange(run.start, run.stop) if isinstance(run, slice) else run
        numbers = mesh.face_surface[rows]
        first = numbers[0] if len(numbers) else -1
        for number in dict.fromkeys(numbers.tolist()):
            chosen = rows[numbers == number]
            surface = mesh.surfaces[number]
            vertices, faces = np.unique(mesh.faces[chosen], return_inverse=True)
            part_name = name if number == first else f"{name}_{word(surface)}"
            yield OrganPart(
                index, part_name, number == first, surface, vertices, faces.reshape(-1, 3), chosen
            )


def parent_with_triangles(mesh: Mesh, organ: int) -> int:
    """An organ, or else the nearest above it that has triangles, as only those have nodes; -1 for none."""
    while organ >= 0 and not mesh.face_runs.count[organ]:
        organ = mesh.instances[organ].parent
    return organ


def word(text: str) -> str:
    """A name without spaces, which would end a name in OBJ files."""
    return "_".join(text.split()) or "organ"

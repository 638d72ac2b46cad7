"""The objects of a living scene at one moment: triangles in parts, and organs with their motions.

A state is never changed: an edit makes another one, which shares all parts that the edit does not touch.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.plants import GrownPlant
from pepperscene.building.scenes.scene_builder import BuiltScene
from pepperscene.classes import Appearance, Instance
from pepperscene.errors import ArgumentError
from pepperscene.geometry import Mesh
from pepperscene.geometry.mesh import PIGMENTS
from pepperscene.live.cut import cut_tube
from pepperscene.live.queries import ScenePart
from pepperscene.materials import Surface
from pepperscene.render.aov.harvest import find_fruit_stalk, organ_ancestors
from pepperscene.render.arrays import LocalCoordinates, local_coordinates
from pepperscene.render.kernel.split_scene import SplitScene, join_parts
from pepperscene.scene import FarRow, Skeleton, far_row_meshes, turned_parts
from pepperscene.scene.far_rows import MAX_INSTANCES, coarse_plant_faces
from pepperscene.scene.greenhouse import FarRowsAs

FloatArray = NDArray[np.float64]

GROUPS: Final = 8
"""Parts of what edits usually touch, by the number of the plant. Chosen: with more of them an edit rebuilds
less, and every ray takes longer."""
_EDITED_FORMS: Final = ("fruit", "calyx", "peduncle")
"""Forms of organs that are in these parts from the beginning."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Instances that edits can change, each a mesh of its own with the numbers of the scene.

    Attributes:
        meshes: by index of the instance.
        empty: a mesh without triangles, for when there are none.
        coordinates: of the scene in the kernel.
    """

    meshes: Mapping[int, Mesh]
    empty: Mesh
    coordinates: LocalCoordinates

    @cached_property
    def part(self) -> ScenePart:
        """All pieces in the kernel, in the order of their numbers."""
        meshes = [self.meshes[index] for index in sorted(self.meshes)]
        if not meshes:
            return ScenePart(self.empty, self.coordinates)
        # Objects that were added later are at the end of longer lists.
        instances = max((mesh.instances for mesh in meshes), key=len)
        return ScenePart(replace(join_parts(meshes), instances=instances), self.coordinates)

    def changed(self, changes: Mapping[int, Mesh | None]) -> Pieces:
        """With some pieces replaced, added, or removed where the change is None."""
        kept = {index: mesh for index, mesh in self.meshes.items() if index not in changes}
        added = {index: mesh for index, mesh in changes.items() if mesh is not None}
        return replace(self, meshes=kept | added)


@dataclass(frozen=True, eq=False)
class FarPlants:
    """The coarse plants of far rows.

    Attributes:
        part: their triangles, plant after plant.
        counts: number of triangles of each, by the number of the plant.
    """

    part: ScenePart
    counts: Mapping[int, int]

    def without(self, numbers: Collection[int]) -> FarPlants:
        """Without some plants."""
        owner = np.repeat(list(self.counts), list(self.counts.values()))
        kept = np.flatnonzero(~np.isin(owner, list(numbers)))
        counts = {plant: count for plant, count in self.counts.items() if plant not in numbers}
        return FarPlants(replace(self.part, mesh=self.part.mesh.select_faces(kept)), counts)


@dataclass(frozen=True, eq=False)
class SceneState:
    """The objects of a scene.

    Attributes:
        fixed: triangles that no edit has touched.
        groups: the other triangles, in `GROUPS` parts.
        skeleton: of the plants, with the motions of the edits.
        instances, surfaces, appearances: as of a `Mesh`, of all objects.
        far: the coarse plants of far rows.
        objects: `(4, 4)` pose of each added object, by index.
        materials: surfaces of added objects that the scene did not have, by name.
    """

    fixed: ScenePart
    groups: tuple[Pieces, ...]
    skeleton: Skeleton
    instances: tuple[Instance, ...]
    surfaces: tuple[str, ...]
    appearances: tuple[Appearance, ...]
    far: FarPlants
    objects: Mapping[int, FloatArray] = field(default_factory=dict)
    materials: Mapping[str, Surface] = field(default_factory=dict)

    @cached_property
    def mesh(self) -> Mesh:
        """All triangles."""
        joined = join_parts([part.mesh for part in self.parts])
        return replace(joined, instances=self.instances, surfaces=self.surfaces, appearances=self.appearances)

    @property
    def parts(self) -> list[ScenePart]:
        """All parts, in the order of their triangles in the mesh."""
        return [self.fixed, self.far.part, *(group.part for group in self.groups)]

    @cached_property
    def geometry(self) -> SplitScene:
        """All triangles in the kernel."""
        return SplitScene(self.parts)

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """`(i,)` whether an instance has triangles."""
        present = np.zeros(len(self.instances), dtype=bool)
        for part in (self.fixed, self.far.part):
            count = part.mesh.face_runs.count
            present[: len(count)] |= count > 0
        for group in self.groups:
            present[list(group.meshes)] = True
        return present

    def index(self, instance: object) -> int:
        """The index of an instance by its number in images.

        Raises:
            ArgumentError: it is no such number, or the instance is gone.
        """
        if not isinstance(instance, int | np.integer) or isinstance(instance, bool):
            raise ArgumentError("instance", "must be a number of the instance image", value=instance)
        if not 1 <= instance <= len(self.instances):
            raise ArgumentError("instance", f"must be from 1 to {len(self.instances)}, not {instance}")
        index = int(instance) - 1
        if not self.present[index]:
            kind = self.instances[index].kind
            raise ArgumentError("instance", f"{instance}, a {kind}, is not in the scene any more")
        return index

    def branch(self, index: int) -> tuple[int, ...]:
        """An added object, or an organ with all that grows on it.

        Raises:
            ArgumentError: the instance is neither, or a fixed part of the scene.
        """
        if index in self.objects:
            return (index,)
        if self.skeleton.kind(index) is None:
            kind = self.instances[index].kind
            problem = f"{index + 1} is a {kind}, neither an organ of a plant nor an added object"
            raise ArgumentError("instance", problem)
        return tuple(one for one in self.skeleton.branch(index) if self.present[one])

    def body(self, index: int) -> int:
        """What moves with an organ: for fruit the stalk that it hangs on, if there is one, else itself."""
        kind = self.skeleton.kind(index)
        if kind is None or kind.form != "fruit":
            return index
        lineage = organ_ancestors(self.skeleton, index)
        stalk = find_fruit_stalk(self.skeleton, lineage)
        if stalk is not None and self.present[stalk.instance]:
            return stalk.instance
        return self._with_calyx(lineage)

    def without(self, indices: Iterable[int]) -> SceneState:
        """Without some instances."""
        gone = dict.fromkeys(indices)
        objects = {index: pose for index, pose in self.objects.items() if index not in gone}
        return replace(self._changed(gone), objects=objects)

    def picked(self, index: int) -> SceneState:
        """Without a fruit, its calyx, and the part of its stalk beyond the cut.

        Raises:
            ArgumentError: it is no fruit of a plant.
        """
        kind = self.skeleton.kind(index)
        if kind is None or kind.form != "fruit":
            problem = f"{index + 1} is a {self.instances[index].kind}, not a fruit of a plant"
            raise ArgumentError("instance", problem)
        lineage = organ_ancestors(self.skeleton, index)
        stalk = find_fruit_stalk(self.skeleton, lineage)
        if stalk is None or not self.present[stalk.instance]:
            return self.without(self.branch(self._with_calyx(lineage)))
        state = self._loosened([stalk.instance])
        beyond = [one for one in self.branch(stalk.instance) if one != stalk.instance]
        rest = cut_tube(state._piece(stalk.instance), stalk.cut, stalk.tangent, stalk.radius_m)
        return state._changed({**dict.fromkeys(beyond), stalk.instance: rest if len(rest.faces) else None})

    def moved(self, index: int, motion: FloatArray) -> SceneState:
        """With an object or an organ and all that grows on it moved by a motion `(4, 4)` in the world."""
        members = self.branch(index)
        state = self._loosened(members)
        changes = {one: state._piece(one).moved(motion[:3, :3], motion[:3, 3]) for one in members}
        state = state._changed(changes)
        if index in self.objects:
            return replace(state, objects={**self.objects, index: motion @ self.objects[index]})
        skeleton = replace(state.skeleton, edits=(*state.skeleton.edits, (index, motion)))
        return replace(state, skeleton=skeleton)

    def turned(self, staying: int, angle_rad: float) -> SceneState:
        """With what stays when a plant turns, the last instances of the scene as it was grown, turned."""
        if not staying or not angle_rad:
            return self
        mesh = turned_parts(self.fixed.mesh, staying, angle_rad)
        return replace(self, fixed=replace(self.fixed, mesh=mesh))

    def added(self, mesh: Mesh, pose: FloatArray, instance: Instance, surface: str | Surface) -> SceneState:
        """With an object at a pose; its number is that after the last instance.

        Raises:
            ArgumentError: there is another surface of that name, or there are too many instances.
        """
        index = len(self.instances)
        if index >= MAX_INSTANCES:
            raise ArgumentError("mesh", f"does not fit into the image's {MAX_INSTANCES:,} instances")
        name, materials = surface if isinstance(surface, str) else surface.name, dict(self.materials)
        if isinstance(surface, Surface):
            is_of_scene = name in self.surfaces and name not in materials
            if is_of_scene or materials.setdefault(name, surface) is not surface:
                raise ArgumentError("surface", f"the scene has another surface named {name!r}")
        surfaces = self.surfaces if name in self.surfaces else (*self.surfaces, name)
        looks = self.appearances if Appearance() in self.appearances else (*self.appearances, Appearance())
        count = len(mesh.faces)
        piece = replace(
            mesh.moved(pose[:3, :3], pose[:3, 3]),
            instances=(*self.instances, instance),
            face_instance=np.full(count, index, np.uint32),
            face_surface=np.full(count, surfaces.index(name), np.uint8),
            face_appearance=np.full(count, looks.index(Appearance()), np.uint32),
            colour=self._colours(mesh),
        )
        state = replace(
            self,
            instances=(*self.instances, instance),
            surfaces=surfaces,
            appearances=looks,
            objects={**self.objects, index: pose},
            materials=materials,
        )
        return state._changed({index: piece})

    def with_full_plant(
        self, plant: int, grown: GrownPlant, row: FarRow, labelled_as: FarRowsAs
    ) -> SceneState:
        """With a plant of a far row in full instead of its coarse triangles; its instances are new.

        Args:
            plant: its number.
            grown: the plant, in its own coordinates.
            row: that plant alone.
            labelled_as: what plants of far rows are in labels.
        """
        first = len(self.instances)
        (mesh,) = far_row_meshes([], [row], labelled_as, 0, {plant: grown.mesh})
        instances = tuple(
            item.numbered(plant, item.parent + first if item.parent >= 0 else -1, item.far_row)
            for item in mesh.instances
        )
        skeleton = self.skeleton
        if labelled_as == FarRowsAs.LABELS:
            starts = skeleton.starts or tuple(accumulate(skeleton.sizes, initial=0))[:-1]
            skeleton = replace(
                skeleton,
                plants=(*skeleton.plants, grown.plant),
                sizes=(*skeleton.sizes, len(instances)),
                bases=np.concatenate([skeleton.bases, row.bases]),
                turns=np.concatenate([skeleton.turns, row.turns]),
                starts=(*starts, first),
            )
        surfaces = tuple(dict.fromkeys((*self.surfaces, *mesh.surfaces)))
        looks = tuple(dict.fromkeys((*self.appearances, *mesh.appearances)))
        look_of = np.array([looks.index(item) for item in mesh.appearances], np.uint32)
        surface_of = np.array([surfaces.index(name) for name in mesh.surfaces], np.uint8)
        mesh = replace(
            mesh,
            instances=(*self.instances, *instances),
            face_instance=mesh.face_instance + np.uint32(first),
            face_surface=surface_of[mesh.face_surface],
            face_appearance=look_of[mesh.face_appearance],
            colour=self._colours(mesh),
        )
        state = replace(
            self,
            far=self.far.without([plant]),
            skeleton=skeleton,
            instances=mesh.instances,
            surfaces=surfaces,
            appearances=looks,
        )
        used = np.flatnonzero(mesh.face_runs.count)
        return state._changed({index: cut_out(mesh, index) for index in used.tolist()})

    def _colours(self, mesh: Mesh) -> NDArray[np.float32] | None:
        """Colours of vertices of a mesh that comes into the scene."""
        if mesh.colour is not None or self.fixed.mesh.colour is None:
            return mesh.colour if self.fixed.mesh.colour is not None else None
        return np.full((len(mesh.vertices), 3), PIGMENTS, np.float32)

    def _with_calyx(self, lineage: tuple[int, ...]) -> int:
        """A fruit without a stalk, or the calyx that it grows on."""
        kind = self.skeleton.kind(lineage[1]) if len(lineage) > 1 else None
        return lineage[1] if kind is not None and kind.form == "calyx" else lineage[0]

    def _piece(self, index: int) -> Mesh:
        """The triangles of an instance that is not among the fixed ones."""
        return self.groups[self._group(index)].meshes[index]

    def _group(self, index: int) -> int:
        return self.instances[index].plant % GROUPS

    def _loosened(self, indices: Iterable[int]) -> SceneState:
        """With some instances in groups instead of the fixed part, which is made anew for this."""
        fixed = [index for index in indices if index not in self.groups[self._group(index)].meshes]
        if not fixed:
            return self
        rest = replace(self.fixed, mesh=self.fixed.mesh.without_triangles(np.array(fixed)))
        pieces = {index: cut_out(self.fixed.mesh, index) for index in fixed}
        return replace(self, fixed=rest)._changed(pieces)

    def _changed(self, changes: Mapping[int, Mesh | None]) -> SceneState:
        """With pieces changed, in the groups that they belong to."""
        state = self._loosened([index for index, mesh in changes.items() if mesh is None])
        groups = list(state.groups)
        for number in {self._group(index) for index in changes}:
            own = {index: mesh for index, mesh in changes.items() if self._group(index) == number}
            groups[number] = groups[number].changed(own)
        return replace(state, groups=tuple(groups))


def open_state(built: BuiltScene, models: Sequence[Mesh], full: Mapping[int, Mesh]) -> SceneState:
    """The state of a scene as it was grown.

    Args:
        built: its objects.
        models: the coarse plants of far rows.
        full: the meshes of plants of far rows that are grown in full, by number.
    """
    mesh, skeleton, coordinates = built.mesh, built.skeleton, local_coordinates(built.mesh)
    edited = [index for index in skeleton.of_form(*_EDITED_FORMS) if mesh.face_runs.count[index]]
    empty = mesh.select_faces(np.zeros(0, np.intp))
    groups: list[dict[int, Mesh]] = [{} for _ in range(GROUPS)]
    for index in edited:
        groups[mesh.instances[index].plant % GROUPS][index] = cut_out(mesh, index)
    # Coarse plants are apart, because a view from near replaces them.
    faces, count = coarse_plant_faces(models, built.far_rows, full), built.begin[1]
    rows = np.array([count + number for numbers in faces.values() for number in numbers], np.intp)
    kept = np.ones(len(mesh.faces), dtype=bool)
    kept[rows] = False
    kept &= ~np.isin(mesh.face_instance, edited)
    counts = {plant: len(numbers) for plant, numbers in faces.items()}
    far = FarPlants(ScenePart(mesh.select_faces(rows), coordinates), counts)
    return SceneState(
        ScenePart(mesh.select_faces(np.flatnonzero(kept)), coordinates),
        tuple(Pieces(meshes, empty, coordinates) for meshes in groups),
        skeleton,
        mesh.instances,
        mesh.surfaces,
        mesh.appearances,
        far,
    )


_OF_VERTICES: Final = ("vertices", "normals", "uv", "state")
_OF_FACES: Final = ("faces", "face_instance", "face_surface", "face_appearance")


def cut_out(mesh: Mesh, index: int) -> Mesh:
    """The triangles of one instance, with the numbers of the mesh."""
    rows = mesh.face_runs.rows(index)
    faces = mesh.faces[rows]
    # The vertices of an instance follow each other.
    used = slice(int(faces.min()), int(faces.max()) + 1)
    vertices = {name: getattr(mesh, name)[used] for name in _OF_VERTICES}
    own = {name: getattr(mesh, name)[rows] for name in _OF_FACES[1:]}
    return replace(mesh, **vertices, **own, faces=faces - np.uint32(used.start), colour=mesh.colours_of(used))

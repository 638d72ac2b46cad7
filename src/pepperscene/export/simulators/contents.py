"""What a file of a scene holds, in any format: organs with poses and truth, plants, bodies, camera, light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry.fruit.fruits import axis_frames
from pepperscene.geometry.natural_colours import BakedColours, bake_colours, natural_surfaces
from pepperscene.geometry.organ_parts import OrganNodes, organ_names
from pepperscene.render.aov.harvest import SceneHarvest
from pepperscene.render.aov.isolated import IsolatedOrgans
from pepperscene.scene import rotation_about_z
from pepperscene.scene.placement import organ_poses
from pepperscene.version import __version__

if TYPE_CHECKING:
    from trimesh import Trimesh

    from pepperscene.camera import Camera
    from pepperscene.geometry import Mesh
    from pepperscene.materials import Surface
    from pepperscene.scene import Scene, Skeleton, Sky
    from pepperscene.truth.harvest import FruitTruth


Pose = NDArray[np.float64]

FORMAT: Final = "pepperscene scene 1"


@dataclass(frozen=True, eq=False)
class HarvestBody:
    """What comes off the plant when a fruit is cut: its stalk beyond the cut, the calyx and the fruit.

    Attributes:
        fruit: index of the fruit's node.
        members: indices of all its nodes.
        pose: `(4, 4)` body to world: at the cut point with z along the stalk; at the fruit without a stalk.
        plant: number of its plant.
    """

    fruit: int
    members: tuple[int, ...]
    pose: Pose
    plant: int


@dataclass(frozen=True, eq=False)
class SceneContents:
    """The content of a file. Its nodes are the instances of `mesh`.

    Organs of plants that are coarse, in far rows, are joined: one node for each plant and class.

    Attributes:
        mesh: in world metres.
        nodes: names, poses, and what each file says of a node; instance numbers are those of images.
        truths: of the fruit, by node.
        camera: of the frame, or None.
        sky: daylight, or None.
        about: recipe and frame, for the JSON.
        surfaces: further surfaces by name, those of a stand.
    """

    mesh: Mesh
    nodes: OrganNodes
    truths: Mapping[int, FruitTruth]
    camera: Camera | None
    sky: Sky | None
    about: Mapping[str, Any]
    surfaces: Mapping[str, Surface] = field(default_factory=dict)

    @cached_property
    def colours(self) -> BakedColours:
        """The natural colours of the mesh."""
        return bake_colours(self.mesh, {**natural_surfaces(self.mesh), **self.surfaces})

    @cached_property
    def bodies(self) -> tuple[HarvestBody, ...]:
        """The bodies of all fruit; fruit that share a stalk are one, of the first of them."""
        children: dict[int, list[int]] = {}
        for index, item in enumerate(self.mesh.instances):
            children.setdefault(item.parent, []).append(index)
        numbers = [entry.get("instance", 0) for entry in self.nodes.extras]
        node_of = {number: index for index, number in enumerate(numbers)}
        bodies, cut = [], set[int]()
        for index, truth in self.truths.items():
            stalk, pose, members = truth.stalk, truth.pose, [index]
            if stalk is not None and stalk.instance in cut:
                continue
            if stalk is not None:
                cut.add(stalk.instance)
                pose = np.eye(4)
                pose[:3, :3] = axis_frames(stalk.tangent[None], truth.pose[None, :3, 0])[0].T
                pose[:3, 3] = stalk.cut
                members = [node_of[stalk.instance + 1]]
                for member in members:
                    members += children.get(member, [])
            bodies.append(HarvestBody(index, tuple(members), pose, self.mesh.instances[index].plant))
        return tuple(bodies)

    def to_json(self) -> dict[str, Any]:
        """The content without its triangles."""
        organs = [
            {"name": name, **entry, "pose": _rounded(self.nodes.pose(index), 9)}
            for index, (name, entry) in enumerate(zip(self.nodes.names, self.nodes.extras, strict=True))
        ]
        return {
            "format": FORMAT,
            "version": __version__,
            **self.about,
            "axes": "metres, z up, x along the row, y into the crop; poses are local to world, (4, 4)",
            "camera": None if self.camera is None else self.camera.to_metadata(),
            "plants": [
                {"plant": number, "name": f"plant_{number}", "pose": _rounded(pose, 9)}
                for number, pose in self.nodes.plants.items()
            ],
            "organs": organs,
        }


def scene_contents(
    scene: Scene, camera: Camera | None = None, sky: Sky | None = None, about: Mapping[str, Any] | None = None
) -> SceneContents:
    """The content of the files of a scene.

    Args:
        scene: with or without a skeleton; without one organs have the pose of the world, and no truth.
        camera: of a view of it.
        sky: None for the scene's own.
        about: further entries of the JSON.

    Raises:
        ArgumentError: triangles were moved since the scene was assembled.
    """
    mesh, numbers = _join_coarse_plants(scene.mesh)
    skeleton = scene.skeleton
    first = np.array([chosen[0] for chosen in numbers])
    node_of = {int(number): index for index, number in enumerate(first)}
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    plants: dict[int, Pose] = {}
    truths: dict[int, FruitTruth] = {}
    if skeleton is not None:
        harvest = SceneHarvest(scene, IsolatedOrgans(scene.mesh))
        truths = {node_of[truth.index]: truth for truth in harvest.truths()}
        plants = _plant_poses(skeleton, scene.mesh)
        organs = [index for index, number in enumerate(first) if skeleton.kind(int(number)) is not None]
        poses[organs] = organ_poses([skeleton.organ(int(number)) for number in first[organs]])
    for index, item in enumerate(mesh.instances):
        if item.plant >= 0 and item.plant not in plants:
            plants[item.plant] = _place_of(mesh, index)
        if skeleton is None or skeleton.kind(int(first[index])) is None:
            # Twine, and the organs of coarse plants.
            poses[index] = plants.get(item.plant, np.eye(4))
    extras = [_entry(item, numbers[index], first) for index, item in enumerate(mesh.instances)]
    for index, truth in truths.items():
        extras[index] |= _fruit_entry(truth)
    nodes = OrganNodes("scene", organ_names(mesh), extras, poses, dict(sorted(plants.items())))
    return SceneContents(mesh, nodes, truths, camera, sky or scene.sky, about or {})


def join_instances(
    mesh: Mesh, groups: NDArray[np.intp], instances: Sequence[Instance]
) -> tuple[Mesh, list[NDArray[np.intp]]]:
    """The mesh with its instances joined into groups, and the former indices of the instances of each.

    Args:
        mesh: its triangles stay.
        groups: `(i,)` number of the group of each instance; each number up to the largest occurs.
        instances: of the groups.
    """
    order = np.argsort(groups, kind="stable")
    members = np.split(order, np.flatnonzero(np.diff(groups[order])) + 1)
    joined = replace(
        mesh, face_instance=groups[mesh.face_instance].astype(np.uint32), instances=tuple(instances)
    )
    return joined, members


def _join_coarse_plants(mesh: Mesh) -> tuple[Mesh, list[NDArray[np.intp]]]:
    """The mesh with one instance for each class of a coarse plant, and the former indices of each."""
    number: dict[object, int] = {}
    groups = np.zeros(len(mesh.instances), np.intp)
    instances: list[Instance] = []
    for index, item in enumerate(mesh.instances):
        is_coarse = item.far_row >= 0 and not item.full
        key = (item.plant, item.far_row, item.class_id) if is_coarse else index
        groups[index] = number.setdefault(key, len(number))
        if groups[index] == len(instances):
            kind = item.organ_class.name.lower() if is_coarse else item.kind
            instances.append(replace(item, kind=kind, phytomer=-1, parent=-1) if is_coarse else item)
    instances = [
        item.numbered(item.plant, int(groups[item.parent]) if item.parent >= 0 else -1, item.far_row)
        for item in instances
    ]
    return join_instances(mesh, groups, instances)


def _plant_poses(skeleton: Skeleton, mesh: Mesh) -> dict[int, Pose]:
    """Plant to world, by the plant's number in the mesh."""
    poses: dict[int, Pose] = {}
    starts = skeleton.starts or (0, *np.cumsum(skeleton.sizes)[:-1].tolist())
    for start, base, turn in zip(starts, skeleton.bases, skeleton.turns, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation_about_z(float(turn)), base
        poses[mesh.instances[start].plant] = pose
    return poses


def _place_of(mesh: Mesh, index: int) -> Pose:
    """The pose of a plant without a skeleton, below the middle of one of its nodes."""
    pose, corners = np.eye(4), mesh.vertices[mesh.faces[mesh.face_runs.rows(index)].ravel()].astype(float)
    if len(corners):
        low, high = corners.min(axis=0), corners.max(axis=0)
        pose[:3, 3] = [*(0.5 * (low + high))[:2], low[2]]
    return pose


def _entry(item: Instance, numbers: NDArray[np.intp], first: NDArray[np.intp]) -> dict[str, Any]:
    """What files say of a node; `numbers` are the indices of its instances in the scene."""
    which: dict[str, Any] = {"instance": int(numbers[0]) + 1}
    if item.far_row >= 0 and not item.full:
        which = {"instances": (numbers + 1).tolist(), "far_row": item.far_row}
    is_object = item.plant < 0 and item.organ_class == OrganClass.BACKGROUND
    return {
        **which,
        "class": "background" if is_object else item.organ_class.name.lower(),
        "class_id": item.class_id,
        "kind": item.kind,
        "plant": item.plant,
        "phytomer": item.phytomer,
        "parent": int(first[item.parent]) + 1 if item.parent >= 0 else 0,
    }


def _fruit_entry(truth: FruitTruth) -> dict[str, Any]:
    """What files add for a fruit, in world metres."""
    stalk, approach = truth.stalk, truth.approach
    inverse = np.linalg.inv(truth.pose)
    return {
        **{name: round(value, 6) for name, value in truth.measures.items()},
        "size_m": _rounded(truth.high - truth.low),
        "blossom_end_m": _rounded(truth.blossom_end),
        "stalk": 0 if stalk is None else stalk.instance + 1,
        "stalk_length_m": None if stalk is None else round(stalk.length_m, 6),
        "stalk_radius_m": None if stalk is None else round(stalk.radius_m, 6),
        "cut_point_m": None if stalk is None else _rounded(stalk.cut),
        "cut_point_local_m": None if stalk is None else _rounded((inverse @ [*stalk.cut, 1.0])[:3]),
        "cut_tangent": None if stalk is None else _rounded(stalk.tangent, 9),
        "approach": None if approach is None else _rounded(approach.direction, 9),
    }


def _rounded(values: ArrayLike, digits: int = 6) -> list[Any]:
    return list((np.round(np.asarray(values, dtype=float), digits) + 0.0).tolist())


FRUIT_DENSITY: Final = 500.0  # kg m-3 of the outer volume; chosen: peppers are hollow
BREAK_FORCE_N: Final = 30.0  # chosen: fifteen times the weight of a fruit of 200 g
BREAK_TORQUE_N_M: Final = 1.0  # chosen: that force at a lever of 3 cm
_RIGID: Final = frozenset({OrganClass.STEM, OrganClass.WIRE})


def is_rigid(item: Instance) -> bool:
    """Whether a gripper collides with what is not a fruit: stems, twine and objects; other organs yield."""
    return item.organ_class in _RIGID or item.plant < 0


def fruit_hull(contents: SceneContents, body: HarvestBody) -> Trimesh:
    """The convex hull of a fruit in the axes of its body, metres."""
    import trimesh

    mesh = contents.mesh
    corners = mesh.vertices[mesh.faces[mesh.face_runs.rows(body.fruit)].ravel()]
    return trimesh.convex.convex_hull((corners - body.pose[:3, 3]) @ body.pose[:3, :3])


def fruit_mass_kg(hull: Trimesh) -> float:
    """Mass of a fruit with a convex hull."""
    return FRUIT_DENSITY * float(hull.volume)

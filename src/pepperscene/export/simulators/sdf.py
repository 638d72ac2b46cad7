"""A model of a scene for Gazebo: SDF with visual and collision meshes, labels, and joints that can be cut.

Format: SDFormat 1.9 (sdformat.org/spec). The systems Label and DetachableJoint are those of Gazebo Sim 7 and
later (gazebosim.org/api/sim). Gazebo takes the coordinates of glTF, which has y up, as they are: visuals are
turned back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Instance
from pepperscene.export.simulators.contents import (
    FRUIT_DENSITY,
    HarvestBody,
    Pose,
    SceneContents,
    fruit_hull,
    is_rigid,
    join_instances,
)
from pepperscene.geometry.glb import encode_glb
from pepperscene.geometry.organ_parts import OrganNodes, organ_parts, word

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from trimesh import Trimesh

    from pepperscene.geometry import Mesh

_VERSION: Final = "1.9"
_VISUALS: Final = "meshes/scene.glb"
_CROP: Final = "crop"
_Z_UP: Final = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


def write_model(contents: SceneContents, folder: Path, name: str) -> tuple[str, ...]:
    """Write a model into an empty folder.

    What stands is one link, with a visual for each plant and class. What falls when a fruit is cut is a link
    of its own, on a joint that a message to the topic `/model/NAME/LINK/detach` removes.

    Returns:
        Names of the files, `model.sdf` first.
    """
    (folder / "meshes").mkdir()
    mesh, nodes, body_of = _joined(contents)
    (folder / _VISUALS).write_bytes(encode_glb(mesh, nodes, baked=contents.colours))

    root = ElementTree.Element("sdf", version=_VERSION)
    model = _add(root, "model", name=name)
    crop = _add(model, "link", name=_CROP)
    links: dict[int, Element] = {}
    for body in contents.bodies:
        links[body.fruit] = _add(model, "link", name=f"body_{contents.nodes.names[body.fruit]}")
        _add(links[body.fruit], "pose", _pose(body.pose))
    for part in organ_parts(mesh, nodes.names):
        owner = body_of.get(part.index)
        link, base = (crop, np.eye(4)) if owner is None else (links[owner.fruit], owner.pose)
        _add_visual(link, part.name, mesh.instances[part.index], base)

    # Shapes that collide: what does not yield, and the hulls of fruit.
    files = ["model.sdf", "model.config", _VISUALS]
    for part in organ_parts(mesh, nodes.names):
        if part.index not in body_of and is_rigid(mesh.instances[part.index]):
            files.append(_add_collision(crop, folder, part.name, part.body(mesh)))
    for body in contents.bodies:
        hull, link = fruit_hull(contents, body), links[body.fruit]
        files.append(_add_collision(link, folder, contents.nodes.names[body.fruit], hull))
        _add_inertia(link, hull)
        _add_joint(model, name, link.get("name", ""))
    joint = _add(model, "joint", name="ground", type="fixed")
    _add(joint, "parent", "world")
    _add(joint, "child", _CROP)
    _write(root, folder / "model.sdf")
    _write(_config(name), folder / "model.config")
    return tuple(files)


def _joined(contents: SceneContents) -> tuple[Mesh, OrganNodes, Mapping[int, HarvestBody]]:
    """The mesh with what stands joined by plant and class, its nodes, and the body of those that fall."""
    falls = {member: body for body in contents.bodies for member in body.members}
    number: dict[object, int] = {}
    groups = np.zeros(len(contents.mesh.instances), np.intp)
    instances: list[Instance] = []
    names: list[str] = []
    body_of: dict[int, HarvestBody] = {}
    for index, item in enumerate(contents.mesh.instances):
        key = index if index in falls else (item.plant, item.class_id)
        groups[index] = number.setdefault(key, len(number))
        if groups[index] < len(names):
            continue
        organ_class = item.organ_class.name.lower()
        joined = f"plant_{item.plant}_{organ_class}" if item.plant >= 0 else f"objects_{organ_class}"
        names.append(contents.nodes.names[index] if index in falls else joined)
        instances.append(replace(item, parent=-1))
        if index in falls:
            body_of[len(names) - 1] = falls[index]
    mesh, members = join_instances(contents.mesh, groups, instances)
    extras = [contents.nodes.extras[chosen[0]] if len(chosen) == 1 else {} for chosen in members]
    return mesh, OrganNodes("scene", names, extras), body_of


def _add(parent: Element, tag: str, text: str | None = None, **attributes: str) -> Element:
    element = ElementTree.SubElement(parent, tag, attributes)
    element.text = text
    return element


def _pose(pose: Pose) -> str:
    """Translation, and roll, pitch and yaw about the fixed axes."""
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    return _numbers(np.concatenate([pose[:3, 3], angles]))


def _numbers(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.9g}" for value in values + 0.0)


def _add_visual(link: Element, name: str, item: Instance, base: Pose) -> None:
    """A visual with the label of its class; `base` is the pose of its link."""
    visual = _add(link, "visual", name=name)
    _add(visual, "pose", _pose(np.linalg.inv(base) @ _Z_UP))
    mesh = _add(_add(visual, "geometry"), "mesh")
    _add(mesh, "uri", _VISUALS)
    submesh = _add(mesh, "submesh")
    _add(submesh, "name", name)
    _add(submesh, "center", "false")
    plugin = _add(visual, "plugin", filename="gz-sim-label-system", name="gz::sim::systems::Label")
    _add(plugin, "label", str(item.class_id))


def _add_collision(link: Element, folder: Path, name: str, body: Trimesh) -> str:
    """A collision with a mesh in the axes of its link; returns the name of its file."""
    file = f"meshes/{word(name)}_collision.stl"
    (folder / file).write_bytes(bytes(body.export(file_type="stl")))
    collision = _add(link, "collision", name=f"{name}_collision")
    _add(_add(_add(collision, "geometry"), "mesh"), "uri", file)
    return file


def _add_inertia(link: Element, hull: Trimesh) -> None:
    """Mass and inertia of a fruit with a convex hull in the axes of its link."""
    hull.density = FRUIT_DENSITY
    inertial = _add(link, "inertial")
    _add(inertial, "pose", _numbers(np.array([*hull.center_mass, 0.0, 0.0, 0.0])))
    _add(inertial, "mass", f"{hull.mass:.6g}")
    inertia, axes = _add(inertial, "inertia"), "xyz"
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        _add(inertia, f"i{axes[row]}{axes[column]}", f"{hull.moment_inertia[row, column]:.6g}")


def _add_joint(model: Element, name: str, link: str) -> None:
    """A fixed joint to the crop, which a message removes."""
    system = {"filename": "gz-sim-detachable-joint-system", "name": "gz::sim::systems::DetachableJoint"}
    plugin = _add(model, "plugin", **system)
    _add(plugin, "parent_link", _CROP)
    _add(plugin, "child_model", "__model__")
    _add(plugin, "child_link", link)
    for action in ("detach", "attach"):
        _add(plugin, f"{action}_topic", f"/model/{name}/{link}/{action}")


def _config(name: str) -> Element:
    """The description by which Gazebo finds the model."""
    root = ElementTree.Element("model")
    _add(root, "name", name)
    _add(root, "version", "1.0")
    _add(root, "sdf", "model.sdf", version=_VERSION)
    _add(root, "description", "A crop of pepperscene: plants, fruit that can be cut, and the greenhouse.")
    return root


def _write(root: Element, path: Path) -> None:
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)

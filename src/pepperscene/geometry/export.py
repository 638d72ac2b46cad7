"""Meshes as files that other programs read: GLB, OBJ, PLY and STL, through trimesh."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.errors import InputError
from pepperscene.geometry.mesh import Mesh

if TYPE_CHECKING:
    from trimesh import Trimesh


FORMATS: Final = (".glb", ".obj", ".ply", ".stl")
STATE_STEPS: Final = 20
"""Steps of pigment state that a GLB's materials tell apart: chosen, each too small to be seen."""

_ROUGH: Final[Mapping[str, float]] = {"fruit": 0.3, "peduncle": 0.45}  # chosen for looks
_MATT: Final = 0.7
# glTF has y up and looks at what faces +z: there the plant's aisle side is.
_Y_UP: Final = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])


def check_mesh_format(path: str | Path) -> str:
    """The ending of a mesh file's name, in small letters.

    Raises:
        InputError: it is none of `FORMATS`.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise InputError(path, f"must end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")
    return suffix


def organ_names(mesh: Mesh) -> tuple[str, ...]:
    """A name for each instance, unique in the mesh: `fruit_12_node_7` is the 13th fruit, at the 8th node.

    Both count from 0. Where there are several plants, the plant's number stands first: `plant_3_stem_0`.
    """
    several = len({one.plant for one in mesh.instances}) > 1
    seen: Counter[tuple[int, str]] = Counter()
    names = []
    for one in mesh.instances:
        plant = f"plant_{one.plant}_" if several and one.plant >= 0 else ""
        node = f"_node_{one.phytomer}" if one.phytomer >= 0 else ""
        names.append(f"{plant}{_word(one.kind)}_{seen[one.plant, one.kind]}{node}")
        seen[one.plant, one.kind] += 1
    return tuple(names)


def mesh_files(
    mesh: Mesh, name: str, colours: Mapping[str, NDArray[np.floating[Any]]] | None = None
) -> dict[str, bytes]:
    """The content of a mesh file, and of what belongs beside it.

    - `.glb`: a node for each organ below the node of the organ that it grows out of, with its class, kind,
      surface, place on the stem and mean pigment state as extras; y up, as glTF wants it.
    - `.obj`: a group for each organ, a material for each class and surface in the class's colour; z up. The
      materials are a second file, `.mtl`.
    - `.ply`: class colours, surface coordinates and pigment state at the vertices; class and instance of the
      faces; z up.
    - `.stl`: bare triangles, z up.

    Args:
        mesh: metres.
        name: the file's; its ending tells the format.
        colours: `(k, 3)` linear sRGB of surfaces by name, at `linspace(0, 1, k)` of their pigment state; for
            the materials of a GLB. Surfaces without have their class's colour.

    Returns:
        Bytes by file name, that of `name` first; the same mesh gives the same bytes.

    Raises:
        InputError: the ending is none of `FORMATS`.
    """
    suffix = check_mesh_format(name)
    if suffix == ".glb":
        return {name: _glb(mesh, colours or {})}
    if suffix == ".obj":
        return _obj(mesh, name)
    return {name: _whole(mesh, suffix)}


def write_mesh(
    mesh: Mesh, path: str | Path, colours: Mapping[str, NDArray[np.floating[Any]]] | None = None
) -> tuple[Path, ...]:
    """Write a mesh to a file of the format that its ending tells; see `mesh_files`.

    Returns:
        The files written, `path` first.

    Raises:
        InputError: the ending is none of `FORMATS`.
        OSError: a file cannot be written.
    """
    out = Path(path)
    written = []
    for name, content in mesh_files(mesh, out.name, colours).items():
        (out.parent / name).write_bytes(content)
        written.append(out.parent / name)
    return tuple(written)


def _glb(mesh: Mesh, colours: Mapping[str, NDArray[np.floating[Any]]]) -> bytes:
    """A tree of organs, each a node with a mesh of its own."""
    import trimesh
    from trimesh.visual.material import PBRMaterial

    names, scene = organ_names(mesh), trimesh.Scene(base_frame="world")
    scene.graph.update(frame_from="world", frame_to="plant", matrix=_Y_UP)
    materials: dict[str, Any] = {}
    factors: dict[str, list[float]] = {}
    for part in _parts(mesh):
        one, surface = mesh.instances[part.instance], mesh.surfaces[part.surface]
        # Organs that look alike share a material.
        step = round(STATE_STEPS * part.state)
        called = f"{_word(surface)}_{step}"
        if called not in materials:
            factors[called] = _base_colour(one.organ_class, step, colours.get(surface))
            materials[called] = PBRMaterial(
                name=called,
                baseColorFactor=factors[called],
                metallicFactor=0.0,
                roughnessFactor=_ROUGH.get(surface, _MATT),
                doubleSided=True,
            )
        body = part.trimesh()
        body.visual = trimesh.visual.TextureVisuals(uv=part.uv, material=materials[called])
        scene.add_geometry(
            body,
            node_name=names[part.instance],
            geom_name=names[part.instance],
            parent_node_name=names[one.parent] if one.parent >= 0 else "plant",
            metadata={
                "class": one.organ_class.name.lower(),
                "class_id": int(one.organ_class),
                "kind": one.kind,
                "surface": surface,
                "plant": one.plant,
                "phytomer": one.phytomer,
                "instance": part.instance,
                "parent": one.parent,
                "state": round(part.state, 4),
            },
        )

    def in_full(tree: dict[str, Any]) -> None:
        # trimesh keeps colours in 8 bits, too few for the dark end of a linear scale.
        for made in tree["materials"]:
            made["pbrMetallicRoughness"]["baseColorFactor"] = factors[made["name"]]

    return bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=True, tree_postprocessor=in_full))


def _base_colour(organ_class: OrganClass, step: int, colours: NDArray[Any] | None) -> list[float]:
    """Linear RGBA of a surface at a step of its state, or of its class."""
    if colours is None:
        rgb = _linear(np.array(CLASS_COLOURS[organ_class]) / 255.0)
    else:
        table = np.asarray(colours, dtype=float)
        place = np.linspace(0.0, 1.0, len(table))
        rgb = np.array([np.interp(step / STATE_STEPS, place, table[:, channel]) for channel in range(3)])
    return [*(round(float(value), 6) for value in np.clip(rgb, 0.0, 1.0)), 1.0]


def _obj(mesh: Mesh, name: str) -> dict[str, bytes]:
    """Groups with materials; trimesh writes them as objects, which other programs tell from groups."""
    import trimesh
    from trimesh.visual.material import SimpleMaterial

    names, scene = organ_names(mesh), trimesh.Scene()
    materials: dict[str, Any] = {}
    for part in _parts(mesh):
        organ_class = mesh.instances[part.instance].organ_class
        called = f"{organ_class.name.lower()}_{_word(mesh.surfaces[part.surface])}"
        if called not in materials:
            colour, black = [*CLASS_COLOURS[organ_class], 255], [0, 0, 0, 255]
            # trimesh takes materials of equal content for one: a gloss of nothing makes them differ.
            materials[called] = SimpleMaterial(
                diffuse=colour, ambient=colour, specular=black, glossiness=1.0 + len(materials), name=called
            )
        body = part.trimesh()
        body.visual = trimesh.visual.TextureVisuals(uv=part.uv, material=materials[called])
        scene.add_geometry(body, node_name=names[part.instance], geom_name=names[part.instance])
    library = Path(name).with_suffix(".mtl").name
    text, beside = trimesh.exchange.obj.export_obj(
        scene, include_normals=True, return_texture=True, write_texture=False, mtl_name=library,
        header="metres, z up; a group for each organ",
    )  # fmt: skip
    return {name: text.replace("\no ", "\ng ").encode(), library: beside[library]}


def _whole(mesh: Mesh, suffix: str) -> bytes:
    """All triangles as one body."""
    import trimesh

    classes = np.array([one.organ_class for one in mesh.instances], dtype=np.uint8)[mesh.face_instance]
    colours = np.zeros((len(mesh.vertices), 4), dtype=np.uint8)
    # No two organs share a vertex.
    colours[mesh.faces] = np.array([(*rgb, 255) for rgb in CLASS_COLOURS], dtype=np.uint8)[classes][:, None]
    body = trimesh.Trimesh(
        mesh.vertices,
        mesh.faces.astype(np.int64),
        vertex_normals=mesh.normals,
        vertex_colors=colours,
        vertex_attributes={"s": mesh.uv[:, 0], "t": mesh.uv[:, 1], "state": mesh.state},
        face_attributes={"class": classes, "instance": mesh.face_instance.astype(np.int32)},
        process=False,
    )
    if suffix == ".stl":
        return bytes(trimesh.exchange.stl.export_stl(body))
    return bytes(trimesh.exchange.ply.export_ply(body, vertex_normal=True))


class _Part:
    """The triangles of one instance, with vertices numbered anew; one surface."""

    def __init__(self, mesh: Mesh, instance: int, faces: NDArray[np.intp]) -> None:
        self.instance, self.surface = instance, int(mesh.face_surface[faces[0]])
        used, local = np.unique(mesh.faces[faces], return_inverse=True)
        self.vertices, self.normals, self.uv = mesh.vertices[used], mesh.normals[used], mesh.uv[used]
        self.state = float(mesh.state[used].mean(dtype=float))
        self.faces = local.reshape(-1, 3)

    def trimesh(self) -> Trimesh:
        """As trimesh knows it, vertices and triangles untouched."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, vertex_normals=self.normals, process=False)


def _parts(mesh: Mesh) -> list[_Part]:
    """The instances that have triangles, in order."""
    order = np.argsort(mesh.face_instance, kind="stable")
    edges = np.searchsorted(mesh.face_instance[order], np.arange(len(mesh.instances) + 1))
    spans = pairwise(edges)
    return [_Part(mesh, index, order[a:b]) for index, (a, b) in enumerate(spans) if b > a]


def _linear(srgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear values of sRGB ones in [0, 1] (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _word(text: str) -> str:
    """A name without spaces, which end a name in OBJ files."""
    return "_".join(text.split()) or "organ"

"""Mesh files for other programs, written through trimesh: GLB, OBJ, PLY and STL."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.image.colorimetry import srgb_decode
from pepperscene.classes import CLASS_COLOURS, Instance, OrganClass
from pepperscene.errors import ArgumentError, InputError
from pepperscene.geometry.mesh import PIGMENTS, Mesh

if TYPE_CHECKING:
    from trimesh import Trimesh

    from pepperscene.materials import Surface

FORMATS: Final = (".glb", ".obj", ".ply", ".stl")
Colours = Literal["natural", "class"] | Mapping[str, NDArray[np.floating[Any]]]
"""Of the materials of a GLB."""

STATE_STEPS: Final = 20
"""Steps of pigment state for which a GLB has separate materials: chosen, each too small to be seen."""

_NM: Final = np.arange(380.0, 781.0, 5.0)
_ROUGHNESS: Final[Mapping[str, float]] = {"fruit": 0.3, "peduncle": 0.45}  # chosen
_OTHER_ROUGHNESS: Final = 0.7
# glTF has y up and its viewer on +z: the plant's aisle side (-y) faces the viewer.
_Y_UP: Final = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])


def check_mesh_format(path: str | Path) -> str:
    """Return the suffix of a mesh file's name, in lower case.

    Raises:
        InputError: it is not one of `FORMATS`.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise InputError(path, f"must end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")
    return suffix


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
        names.append(f"{plant}{_word(item.kind)}_{seen[item.plant, item.kind]}{node}")
        seen[item.plant, item.kind] += 1
    return tuple(names)


def mesh_files(mesh: Mesh, name: str, colours: Colours = "natural") -> dict[str, bytes]:
    """Encode a mesh as a file, and as a second one for the materials of an OBJ.

    - `.glb`: a node for each organ with triangles below that of its parent, or of the next one above that has
      triangles, with its class, kind, surface, phytomer and mean pigment state as extras, and the colours of
      a scan at its points; y up, as glTF requires.
    - `.obj`: a group for each organ, a material for each class and surface in the colour of the class, in a
      second file, `.mtl`; z up.
    - `.ply`: class colours, uv and pigment state at the vertices; class and instance of the faces; z up.
    - `.stl`: bare triangles, z up.

    Args:
        mesh: in metres.
        name: of the file; its suffix selects the format.
        colours: as for `write_mesh`.

    Returns:
        Content by file name, that of `name` first; the same mesh gives the same bytes.

    Raises:
        InputError: the suffix is not one of `FORMATS`.
        ArgumentError: the colours are another word, or natural ones of plants of several cultivars.
    """
    suffix = check_mesh_format(name)
    if isinstance(colours, str) and colours not in ("natural", "class"):
        raise ArgumentError("colours", f'must be "natural", "class" or a table by surface, not {colours!r}')
    if suffix == ".glb":
        tables = {} if colours == "class" else _natural_colours(mesh) if colours == "natural" else colours
        return {name: _encode_glb(mesh, tables)}
    return _encode_obj(mesh, name) if suffix == ".obj" else {name: _single_body(mesh, suffix)}


def write_mesh(mesh: Mesh, path: str | Path, colours: Colours = "natural") -> tuple[Path, ...]:
    """Write a mesh to a file in the format that its suffix selects.

    Args:
        mesh: in metres.
        path: its suffix is the format: `.glb`, `.obj`, `.ply` or `.stl`.
        colours: of the materials of a GLB: "natural" for those of the mesh's cultivar and of a greenhouse in
            daylight, as `pepperscene plant` writes them, "class" for those of the classes, or `(k, 3)` linear
            sRGB of surfaces by name, at `linspace(0, 1, k)` of their pigment state. Other surfaces, and the
            other formats, get the colours of the classes.

    Returns:
        The files written, `path` first.

    Raises:
        InputError: the suffix is not one of `FORMATS`.
        ArgumentError: the colours are another word, or natural ones of plants of several cultivars.
        OSError: a file cannot be written.
    """
    path = Path(path)
    files = {path.parent / name: content for name, content in mesh_files(mesh, path.name, colours).items()}
    for file, content in files.items():
        file.write_bytes(content)
    return tuple(files)


def _natural_colours(mesh: Mesh) -> dict[str, NDArray[np.float64]]:
    """`(s, 3)` linear sRGB by surface, one row per tabulated pigment state.

    It is the diffuse reflectance of the front in D65, for the CIE 1931 observer; a perfect diffuser is 1, 1,
    1. Surfaces that are neither of the mesh's cultivar nor of the greenhouse have none.

    Raises:
        ArgumentError: the mesh has plants of several cultivars, whose surfaces have the same names.
    """
    from pepperscene.materials import greenhouse_surfaces, organ_surfaces
    from pepperscene.spectra import colour_science

    if len(mesh.cultivars) > 1:
        names = ", ".join(cultivar.name for cultivar in mesh.cultivars)
        problem = f'must be "class" or a table for a mesh with plants of several cultivars ({names})'
        raise ArgumentError("colours", problem)
    surfaces: dict[str, Surface] = {}
    for cultivar in mesh.cultivars:
        surfaces |= organ_surfaces(cultivar, _NM)
    if not set(mesh.surfaces) <= set(surfaces):
        surfaces = greenhouse_surfaces(_NM) | surfaces
    colour = colour_science()
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    matching = np.stack([np.interp(_NM, observer.wavelengths, column) for column in observer.values.T])
    light = colour.SDS_ILLUMINANTS["D65"]
    weights = matching * np.interp(_NM, light.wavelengths, light.values)
    weights /= weights[1].sum()
    colours = {}
    for name in set(mesh.surfaces) & set(surfaces):
        spectra = surfaces[name].reflectance[:, 0]  # at the wavelengths `_NM`
        rgb = colour.XYZ_to_RGB(spectra @ weights.T, "sRGB", apply_cctf_encoding=False)
        colours[name] = np.clip(np.asarray(rgb, dtype=float), 0.0, 1.0)
    return colours


def _instance_meshes(mesh: Mesh) -> Iterator[tuple[int, Instance, str, float, NDArray[np.uint32], Trimesh]]:
    """Index, instance, surface, mean state, vertices and body of each instance with triangles, in order."""
    import trimesh

    for index, item in enumerate(mesh.instances):
        rows = mesh.face_runs.rows(index)
        if len(mesh.faces[rows]):
            used, faces = np.unique(mesh.faces[rows], return_inverse=True)
            surface = mesh.surfaces[mesh.face_surface[rows][0]]
            state = float(mesh.state[used].mean(dtype=float))
            body = trimesh.Trimesh(
                mesh.vertices[used], faces.reshape(-1, 3), vertex_normals=mesh.normals[used], process=False
            )
            yield index, item, surface, state, used, body


def _encode_glb(mesh: Mesh, colours: Mapping[str, NDArray[np.floating[Any]]]) -> bytes:
    """A tree of organs, each a node with its own mesh."""
    import trimesh
    from trimesh.visual.material import PBRMaterial

    names, scene = organ_names(mesh), trimesh.Scene(base_frame="world")
    scene.graph.update(frame_from="world", frame_to="plant", matrix=_Y_UP)
    nodes = (*names, "plant")  # the last one of organs without a parent
    materials: dict[str, Any] = {}
    factors: dict[str, list[float]] = {}
    for index, item, surface, state, used, body in _instance_meshes(mesh):
        # Organs that look the same share a material. Colours of a scan multiply a white one.
        step, scanned = round(STATE_STEPS * state), mesh.colours_of(used)
        is_scanned = scanned is not None and scanned[0, 0] != PIGMENTS
        material = f"{_word(surface)}_scan" if is_scanned else f"{_word(surface)}_{step}"
        if material not in materials:
            factors[material] = (
                [1.0] * 4 if is_scanned else _base_colour(item.organ_class, step, colours.get(surface))
            )
            materials[material] = PBRMaterial(
                name=material,
                baseColorFactor=factors[material],
                metallicFactor=0.0,
                roughnessFactor=_ROUGHNESS.get(surface, _OTHER_ROUGHNESS),
                doubleSided=True,
            )
        body.visual = trimesh.visual.TextureVisuals(uv=mesh.uv[used], material=materials[material])
        if scanned is not None and is_scanned:
            linear = np.round(255.0 * np.pad(scanned, ((0, 0), (0, 1)), constant_values=1.0))
            body.visual.vertex_attributes["color"] = linear.astype(np.uint8)
        scene.add_geometry(
            body,
            node_name=names[index],
            geom_name=names[index],
            parent_node_name=nodes[_parent_with_triangles(mesh, item.parent)],
            metadata={
                "class": item.organ_class.name.lower(),
                "class_id": int(item.organ_class),
                "kind": item.kind,
                "surface": surface,
                "plant": item.plant,
                "phytomer": item.phytomer,
                "instance": index,
                "parent": item.parent,
                "state": round(state, 4),
            },
        )

    def restore_colours(tree: dict[str, Any]) -> None:
        # trimesh stores colours with 8 bits, too few for the dark end of a linear scale.
        for material in tree["materials"]:
            material["pbrMetallicRoughness"]["baseColorFactor"] = factors[material["name"]]

    return bytes(
        trimesh.exchange.gltf.export_glb(scene, include_normals=True, tree_postprocessor=restore_colours)
    )


def _parent_with_triangles(mesh: Mesh, organ: int) -> int:
    """An organ, or else the nearest above it that has triangles, as only those have nodes; -1 for none."""
    while organ >= 0 and not mesh.face_runs.count[organ]:
        organ = mesh.instances[organ].parent
    return organ


def _base_colour(organ_class: OrganClass, step: int, colours: NDArray[Any] | None) -> list[float]:
    """Linear RGBA of a surface at a step of its state, or of its class."""
    if colours is None:
        rgb = srgb_decode(np.array(CLASS_COLOURS[organ_class]) / 255.0)
    else:
        table = np.asarray(colours, dtype=float)
        states = np.linspace(0.0, 1.0, len(table))
        rgb = np.array([np.interp(step / STATE_STEPS, states, table[:, channel]) for channel in range(3)])
    return [*(round(float(value), 6) for value in np.clip(rgb, 0.0, 1.0)), 1.0]


def _encode_obj(mesh: Mesh, name: str) -> dict[str, bytes]:
    """Groups with materials; trimesh writes objects, which other programs distinguish from groups."""
    import trimesh
    from trimesh.visual.material import SimpleMaterial

    names, scene = organ_names(mesh), trimesh.Scene()
    materials: dict[str, Any] = {}
    for index, item, surface, _, used, body in _instance_meshes(mesh):
        organ_class = item.organ_class
        material = f"{organ_class.name.lower()}_{_word(surface)}"
        if material not in materials:
            colour, black = [*CLASS_COLOURS[organ_class], 255], [0, 0, 0, 255]
            # trimesh merges materials of equal content: a glossiness without effect makes them differ.
            materials[material] = SimpleMaterial(
                diffuse=colour, ambient=colour, specular=black, glossiness=1.0 + len(materials), name=material
            )
        body.visual = trimesh.visual.TextureVisuals(uv=mesh.uv[used], material=materials[material])
        scene.add_geometry(body, node_name=names[index], geom_name=names[index])
    library = Path(name).with_suffix(".mtl").name
    text, others = trimesh.exchange.obj.export_obj(
        scene, include_normals=True, return_texture=True, write_texture=False, mtl_name=library,
        header="metres, z up; a group for each organ",
    )  # fmt: skip
    # The text names the library, whose name may not be UTF-8.
    content = text.replace("\no ", "\ng ").encode(errors="surrogateescape")
    return {name: content, library: others[library]}


def _single_body(mesh: Mesh, suffix: str) -> bytes:
    """All triangles as one body."""
    import trimesh

    colours = np.zeros((len(mesh.vertices), 4), dtype=np.uint8)
    # Organs share no vertices.
    palette = np.array([(*rgb, 255) for rgb in CLASS_COLOURS], dtype=np.uint8)
    colours[mesh.faces] = palette[mesh.face_class][:, None]
    body = trimesh.Trimesh(
        mesh.vertices,
        mesh.faces.astype(np.int64),
        vertex_normals=mesh.normals,
        vertex_colors=colours,
        vertex_attributes={"s": mesh.uv[:, 0], "t": mesh.uv[:, 1], "state": mesh.state},
        face_attributes={"class": mesh.face_class, "instance": mesh.face_instance.astype(np.int32)},
        process=False,
    )
    if suffix == ".stl":
        return bytes(trimesh.exchange.stl.export_stl(body))
    return bytes(trimesh.exchange.ply.export_ply(body, vertex_normal=True))


def _word(text: str) -> str:
    """A name without spaces, which would end a name in OBJ files."""
    return "_".join(text.split()) or "organ"

"""Mesh files for other programs, written through trimesh: GLB, OBJ, PLY and STL."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS
from pepperscene.errors import ArgumentError, InputError
from pepperscene.geometry.glb import encode_glb
from pepperscene.geometry.mesh import Mesh
from pepperscene.geometry.natural_colours import bake_colours, natural_surfaces
from pepperscene.geometry.organ_parts import organ_names, organ_nodes, organ_parts, word

FORMATS: Final = (".glb", ".obj", ".ply", ".stl")
Colours = Literal["natural", "class"] | Mapping[str, NDArray[np.floating[Any]]]
"""Of the materials of a GLB."""


def check_mesh_format(path: str | Path) -> str:
    """Return the suffix of a mesh file's name, in lower case.

    Raises:
        InputError: it is not one of `FORMATS`.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise InputError(path, f"must end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")
    return suffix


def mesh_files(mesh: Mesh, name: str, colours: Colours = "natural") -> dict[str, bytes]:
    """Encode a mesh as a file, and as a second one for the materials of an OBJ.

    - `.glb`: a node for each organ with triangles below that of its parent, or of the next one above that has
      triangles, with its class, kind, surface, phytomer and mean pigment state as extras; its natural colours
      as images, and those of a scan at its points; y up, as glTF requires.
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
        if colours == "natural":
            baked = bake_colours(mesh, natural_surfaces(mesh))
            return {name: encode_glb(mesh, organ_nodes(mesh), baked=baked)}
        return {name: encode_glb(mesh, organ_nodes(mesh), {} if colours == "class" else colours)}
    return _encode_obj(mesh, name) if suffix == ".obj" else {name: _single_body(mesh, suffix)}


def write_mesh(mesh: Mesh, path: str | Path, colours: Colours = "natural") -> tuple[Path, ...]:
    """Write a mesh to a file in the format that its suffix selects.

    Args:
        mesh: in metres.
        path: its suffix is the format: `.glb`, `.obj`, `.ply` or `.stl`.
        colours: of a GLB: "natural" for images with those of the mesh's cultivar and of a greenhouse in
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


def _encode_obj(mesh: Mesh, name: str) -> dict[str, bytes]:
    """Groups with materials; trimesh writes objects, which other programs distinguish from groups."""
    import trimesh
    from trimesh.visual.material import SimpleMaterial

    scene = trimesh.Scene()
    materials: dict[str, Any] = {}
    for part in organ_parts(mesh, organ_names(mesh)):
        organ_class = mesh.instances[part.index].organ_class
        material = f"{organ_class.name.lower()}_{word(part.surface)}"
        if material not in materials:
            colour, black = [*CLASS_COLOURS[organ_class], 255], [0, 0, 0, 255]
            # trimesh merges materials of equal content: a glossiness without effect makes them differ.
            materials[material] = SimpleMaterial(
                diffuse=colour, ambient=colour, specular=black, glossiness=1.0 + len(materials), name=material
            )
        body = part.body(mesh)
        body.visual = trimesh.visual.TextureVisuals(uv=mesh.uv[part.vertices], material=materials[material])
        scene.add_geometry(body, node_name=part.name, geom_name=part.name)
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

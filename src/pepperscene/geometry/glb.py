"""Binary glTF of a mesh, written through trimesh: a tree of its organs with poses, extras and colours."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.image.colorimetry import srgb_decode
from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.geometry.mesh import PIGMENTS, Mesh
from pepperscene.geometry.natural_colours import BakedColours
from pepperscene.geometry.organ_parts import OrganNodes, OrganPart, organ_parts, parent_with_triangles, word

STATE_STEPS: Final = 20
"""Steps of pigment state for which a table of colours gives separate materials: chosen, each too small to be
seen."""

_ROUGHNESS: Final[Mapping[str, float]] = {"fruit": 0.3, "peduncle": 0.45}  # chosen
_OTHER_ROUGHNESS: Final = 0.7
# glTF has y up and its viewer on +z: the plant's aisle side (-y) faces the viewer.
_Y_UP: Final = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])


def roughness(surface: str) -> float:
    """Roughness of a surface in materials of other programs."""
    return _ROUGHNESS.get(surface, _OTHER_ROUGHNESS)


def encode_glb(
    mesh: Mesh,
    nodes: OrganNodes,
    colours: Mapping[str, NDArray[np.floating[Any]]] | None = None,
    baked: BakedColours | None = None,
) -> bytes:
    """A tree of organs, each a node with its own mesh, below the node of its parent or else of its plant.

    Args:
        mesh: in metres.
        nodes: of its instances.
        colours: of surfaces without an image, `(k, 3)` linear sRGB at `linspace(0, 1, k)` of their state;
            those of others are those of their classes.
        baked: images of surfaces.
    """
    import trimesh

    scene = trimesh.Scene(base_frame="world")
    scene.graph.update(frame_from="world", frame_to=nodes.root, matrix=_Y_UP)
    for number, pose in nodes.plants.items():
        extras = {"plant": number}
        scene.graph.update(frame_from=nodes.root, frame_to=f"plant_{number}", matrix=pose, metadata=extras)
    materials = _Materials(mesh, colours or {}, baked)
    has_poses = nodes.poses is not None
    for part in organ_parts(mesh, nodes.names):
        item, pose = mesh.instances[part.index], nodes.pose(part.index)
        body = part.body(mesh, pose if has_poses else None)
        state = float(mesh.state[part.vertices].mean(dtype=float))
        body.visual = materials.visual(part, state)
        above = parent_with_triangles(mesh, item.parent)
        if not part.is_first:
            parent, base = nodes.names[part.index], pose
        elif above >= 0:
            parent, base = nodes.names[above], nodes.pose(above)
        elif item.plant in nodes.plants:
            parent, base = f"plant_{item.plant}", nodes.plants[item.plant]
        else:
            parent, base = nodes.root, np.eye(4)
        scene.add_geometry(
            body,
            node_name=part.name,
            geom_name=part.name,
            parent_node_name=parent,
            transform=np.linalg.inv(base) @ pose if has_poses else None,
            metadata={**nodes.extras[part.index], "surface": part.surface, "state": round(state, 4)},
        )
    return bytes(
        trimesh.exchange.gltf.export_glb(
            scene, include_normals=True, tree_postprocessor=materials.restore_colours
        )
    )


class _Materials:
    """The materials of a file: organs that look the same share one."""

    def __init__(
        self, mesh: Mesh, colours: Mapping[str, NDArray[np.floating[Any]]], baked: BakedColours | None
    ) -> None:
        self._mesh, self._colours, self._baked = mesh, colours, baked
        self._made: dict[str, Any] = {}
        self._factors: dict[str, list[float]] = {}

    def visual(self, part: OrganPart, state: float) -> Any:
        """The colours of a part with a mean state for trimesh."""
        from trimesh.visual import TextureVisuals

        mesh, baked, surface = self._mesh, self._baked, part.surface
        image = -1 if baked is None else int(baked.face_image[part.rows[0]])
        if baked is not None and image >= 0:
            name = list(baked.images)[image]
            return TextureVisuals(
                uv=baked.uv[part.vertices], material=self._material(name, surface, texture=baked.images[name])
            )
        # Colours of a scan multiply a white one.
        scanned = mesh.colours_of(part.vertices)
        if scanned is not None and scanned[0, 0] != PIGMENTS:
            visual = TextureVisuals(
                uv=mesh.uv[part.vertices],
                material=self._material(f"{word(surface)}_scan", surface, [1.0] * 4),
            )
            linear = np.round(255.0 * np.pad(scanned, ((0, 0), (0, 1)), constant_values=1.0))
            visual.vertex_attributes["color"] = linear.astype(np.uint8)
            return visual
        step = round(STATE_STEPS * state)
        organ_class = mesh.instances[part.index].organ_class
        factor = _base_colour(organ_class, step, self._colours.get(surface))
        material = self._material(f"{word(surface)}_{step}", surface, factor)
        return TextureVisuals(uv=mesh.uv[part.vertices], material=material)

    def _material(
        self,
        name: str,
        surface: str,
        factor: list[float] | None = None,
        texture: NDArray[np.uint8] | None = None,
    ) -> Any:
        from PIL import Image

        if name not in self._made:
            if factor is not None:
                self._factors[name] = factor
            self._made[name] = _named_material()(
                name=name,
                baseColorFactor=factor,
                baseColorTexture=None if texture is None else Image.fromarray(texture),
                metallicFactor=0.0,
                roughnessFactor=roughness(surface),
                doubleSided=True,
            )
        return self._made[name]

    def restore_colours(self, tree: dict[str, Any]) -> None:
        """Write the factors again: trimesh stores them with 8 bits, too few for the dark end of a scale."""
        for material in tree["materials"]:
            if material["name"] in self._factors:
                material["pbrMetallicRoughness"]["baseColorFactor"] = self._factors[material["name"]]


@cache
def _named_material() -> type:
    """Materials that differ if their names do: trimesh would read the image again for every organ."""
    from trimesh.visual.material import PBRMaterial

    class NamedMaterial(PBRMaterial):
        def __hash__(self) -> int:
            return hash(self.name)

    return NamedMaterial


def _base_colour(organ_class: OrganClass, step: int, colours: NDArray[Any] | None) -> list[float]:
    """Linear RGBA of a surface at a step of its state, or of its class."""
    if colours is None:
        rgb = srgb_decode(np.array(CLASS_COLOURS[organ_class]) / 255.0)
    else:
        table = np.asarray(colours, dtype=float)
        states = np.linspace(0.0, 1.0, len(table))
        rgb = np.array([np.interp(step / STATE_STEPS, states, table[:, channel]) for channel in range(3)])
    return [*(round(float(value), 6) for value in np.clip(rgb, 0.0, 1.0)), 1.0]

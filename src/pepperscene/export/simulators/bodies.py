"""Mass and collision shapes of what falls and what stands in a simulator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pepperscene.classes import Instance, OrganClass

if TYPE_CHECKING:
    from trimesh import Trimesh

    from pepperscene.export.simulators.contents import HarvestBody, SceneContents

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

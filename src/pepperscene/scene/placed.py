"""A scene: everything placed in world coordinates, with the surfaces that light meets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pepperscene.geometry import Mesh
from pepperscene.materials import Surface
from pepperscene.scene.skeleton import Skeleton
from pepperscene.scene.sky import Sky


@dataclass(frozen=True, eq=False)
class Scene:
    """What the renderer is given.

    World axes: z up, +x along the plant row to the right as seen from the aisle, +y into the crop; metres.

    Attributes:
        mesh: all triangles.
        surfaces: one for each of `mesh.surfaces`, in that order; empty when only ground truth is wanted.
        sky: daylight, or None for a night scene.
        skeleton: the plants whose organs are the first of the mesh's instances; None where nobody can tell
            where a fruit is to be cut.
    """

    mesh: Mesh
    surfaces: tuple[Surface, ...] = ()
    sky: Sky | None = None
    skeleton: Skeleton | None = None

    def __post_init__(self) -> None:
        names = tuple(surface.name for surface in self.surfaces)
        if names and names != self.mesh.surfaces:
            raise ValueError(f"surfaces {names} do not match the mesh's {self.mesh.surfaces}")


def assemble(
    mesh: Mesh,
    surfaces: Mapping[str, Surface] | None = None,
    sky: Sky | None = None,
    skeleton: Skeleton | None = None,
) -> Scene:
    """A scene out of a mesh and the surfaces by name; those that the mesh lacks are left out.

    Args:
        mesh: everything placed.
        surfaces: by surface name; None when only ground truth will be asked for.
        sky: daylight, or None.
        skeleton: of the plants in it, which the output "harvest" needs.

    Raises:
        ValueError: the mesh names a surface that is not given.
    """
    if surfaces is None:
        return Scene(mesh, (), sky, skeleton)
    missing = [name for name in mesh.surfaces if name not in surfaces]
    if missing:
        raise ValueError(f"no surface is given for {', '.join(missing)}")
    return Scene(mesh, tuple(surfaces[name] for name in mesh.surfaces), sky, skeleton)

"""Organs by themselves in front of the camera: which pixels each would have if nothing stood before it.

The rays and the triangles are those of the label images, so that what is seen of an organ is a part of this.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh
from pepperscene.render.kernel import kernel_mesh
from pepperscene.render.region import Region, region_of
from pepperscene.render.upload import device_number
from pepperscene.render.variant import kernel
from pepperscene.render.view import View
from pepperscene.truth.boxes import Box

_MARGIN: Final = 2
"""Pixels around the box of an organ's vertices: chosen, a lens bends the lines between these by less."""


@dataclass(frozen=True, eq=False)
class Alone:
    """One organ of a scene.

    Attributes:
        mesh: its triangles alone.
        region: of the whole scene's mesh.
    """

    mesh: Mesh
    region: Region

    @cached_property
    def scene(self) -> Any:
        """Of Mitsuba, with this organ and nothing else; made when it first comes into view."""
        shape = kernel_mesh(self.mesh, region=self.region)
        return kernel()[0].load_dict({"type": "scene", "organ": shape})

    def box(self, camera: Camera) -> Box | None:
        """The part of a picture outside of which no ray can hit the organ; None where there is none."""
        places = camera.project(self.mesh.vertices)
        good = np.isfinite(places).all(axis=1)
        if not good.any():
            return None
        if not good.all():
            # It reaches behind the camera, or to where the lens shows nothing: anything may be hit.
            return 0, 0, camera.width, camera.height
        low = np.floor(places.min(axis=0)).astype(np.intp) - _MARGIN
        high = np.ceil(places.max(axis=0)).astype(np.intp) + _MARGIN
        x0, y0 = np.maximum(low, 0).tolist()
        x1, y1 = np.minimum(high, [camera.width, camera.height]).tolist()
        return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def alone(mesh: Mesh, instances: Sequence[int]) -> dict[int, Alone]:
    """Organs of a mesh, each by itself; without those that have no triangles.

    Args:
        mesh: of the scene; the vertices of each organ lie together.
        instances: indices of the organs.
    """
    region = region_of(mesh)
    return {instance: Alone(part, region) for instance, part in parts(mesh, instances)}


def parts(mesh: Mesh, instances: Sequence[int]) -> Iterable[tuple[int, Mesh]]:
    """Each organ's own triangles; `Mesh.of_instances` looks at all triangles for each."""
    ends = np.append(1 + np.flatnonzero(mesh.face_instance[1:] != mesh.face_instance[:-1]), len(mesh.faces))
    starts = np.append(0, ends[:-1])
    owner = mesh.face_instance[starts]
    order = np.argsort(owner, kind="stable")
    for instance in instances:
        first, last = np.searchsorted(owner[order], [instance, instance + 1])
        runs = order[first:last]
        if not runs.size:
            continue
        rows = np.concatenate([np.arange(starts[run], ends[run]) for run in runs])
        faces = mesh.faces[rows]
        used = slice(int(faces.min()), int(faces.max()) + 1)
        yield (
            instance,
            replace(
                mesh,
                vertices=mesh.vertices[used],
                normals=mesh.normals[used],
                uv=mesh.uv[used],
                state=mesh.state[used],
                faces=faces - np.uint32(used.start),
                face_instance=np.zeros(len(rows), np.uint32),
                face_surface=mesh.face_surface[rows],
                instances=(mesh.instances[instance],),
            ),
        )


def hit_pixels(organs: Sequence[tuple[Alone, Box]], view: View) -> list[NDArray[np.bool_]]:
    """`(y1 - y0, x1 - x0)` for each organ and box, which pixels' centres it lies behind.

    Args:
        organs: with the parts of the picture to look at.
        view: the camera's rays, in the region of the organs' scene.
    """
    _, dr = kernel()
    # All are begun before the first is waited for.
    begun = [_hits(one, box, view) for one, box in organs]
    dr.eval(begun)
    return [
        np.array(hit).astype(bool).reshape(y1 - y0, x1 - x0)
        for hit, (_, (x0, y0, x1, y1)) in zip(begun, organs, strict=True)
    ]


def _hits(one: Alone, box: Box, view: View) -> Any:
    """1 for each pixel of a box whose ray hits, row by row."""
    mi, dr = kernel()
    x0, y0, x1, y1 = box
    # Numbers that the kernel reads, so that no other box, organ or scene compiles anything anew.
    left, top, across = (device_number(n, whole=True) for n in (x0, y0, x1 - x0))
    lane = dr.arange(mi.UInt32, (x1 - x0) * (y1 - y0))
    row = lane // across
    column = lane - row * across + left
    towards = view.directions(column, row + top, mi.Float(0.5), mi.Float(0.5))
    found = one.scene.ray_intersect_preliminary(mi.Ray3f(view.origin, towards), coherent=True)
    hit = dr.select(found.is_valid(), mi.UInt32(1), mi.UInt32(0))
    dr.schedule(hit)
    return hit

"""The output `harvest`: what is known of every fruit in a picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.errors import ArgumentError
from pepperscene.geometry import Mesh
from pepperscene.geometry.fruit.fruits import fruit_frames
from pepperscene.geometry.spine import spines
from pepperscene.grammar import Organ
from pepperscene.render.aov.labels import Hits
from pepperscene.render.kernel.arrays import LocalCoordinates, device_number, local_coordinates
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.kernel.scene import kernel_mesh
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene, Skeleton
from pepperscene.truth.cut_point import FruitStalk, fruit_stalk, tool_approach
from pepperscene.truth.encodings import Box
from pepperscene.truth.harvest import AmodalMask, FruitTruth, LabelView, harvest_truth

_MARGIN: Final = 2
"""Pixels around the box of an organ's vertices: chosen, a lens bends the lines between these by less."""


@dataclass(frozen=True, eq=False)
class IsolatedOrgan:
    """One organ of a scene.

    Attributes:
        mesh: its triangles alone.
        region: of the whole scene's mesh.
    """

    mesh: Mesh
    region: LocalCoordinates

    @cached_property
    def scene(self) -> Any:
        """Of Mitsuba, with this organ and nothing else; made when it first comes into view."""
        shape = kernel_mesh(self.mesh, region=self.region)
        return mitsuba_modules()[0].load_dict({"type": "scene", "organ": shape})

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


def isolated_organs(mesh: Mesh, instances: Sequence[int]) -> dict[int, IsolatedOrgan]:
    """Organs of a mesh, each by itself; without those that have no triangles.

    Args:
        mesh: of the scene; the vertices of each organ lie together.
        instances: indices of the organs.
    """
    region = local_coordinates(mesh)
    return {instance: IsolatedOrgan(part, region) for instance, part in parts(mesh, instances)}


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


def hit_pixels(organs: Sequence[tuple[IsolatedOrgan, Box]], view: CameraRays) -> list[NDArray[np.bool_]]:
    """`(y1 - y0, x1 - x0)` for each organ and box, which pixels' centres it lies behind.

    Args:
        organs: with the parts of the picture to look at.
        view: the camera's rays, in the region of the organs' scene.
    """
    _, dr = mitsuba_modules()
    # All are begun before the first is waited for.
    begun = [_hits(one, box, view) for one, box in organs]
    dr.eval(begun)
    return [
        np.array(hit).astype(bool).reshape(y1 - y0, x1 - x0)
        for hit, (_, (x0, y0, x1, y1)) in zip(begun, organs, strict=True)
    ]


def _hits(one: IsolatedOrgan, box: Box, view: CameraRays) -> Any:
    """1 for each pixel of a box whose ray hits, row by row."""
    mi, dr = mitsuba_modules()
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


_STEPS: Final = 32
"""Chosen: pieces of a stalk's centreline; its corners then lie within micrometres of the curve."""


class Harvest:
    """The fruit of a scene, each ready to be looked at by itself.

    Args:
        scene: with the skeleton of its plants.

    Raises:
        InputError: nobody has told where the scene's organs are.
    """

    def __init__(self, scene: Scene) -> None:
        if scene.skeleton is None:
            raise ArgumentError(
                "outputs", "harvest needs a scene that was assembled with its plants' skeleton"
            )
        self._scene, self._bones = scene, scene.skeleton
        self._fruit: dict[int, FruitTruth] = {}

    def truth(
        self, camera: Camera, view: CameraRays, hits: Hits, instance: NDArray[np.uint16]
    ) -> dict[str, Any]:
        """The output `harvest` of a view.

        Args:
            camera: that looks.
            view: its rays in the region of the scene.
            hits: behind its pixels.
            instance: `(h, w)` the instance image.
        """
        near = [index for index, here in zip(self._alone, self._in_view(camera), strict=True) if here]
        boxes = {index: box for index in near if (box := self._alone[index].box(camera)) is not None}
        masks = hit_pixels([(self._alone[index], box) for index, box in boxes.items()], view)
        found = []
        for (index, (x, y, *_)), mask in zip(boxes.items(), masks, strict=True):
            amodal = AmodalMask((x, y), mask)
            # Where rays of equal direction disagree at an outline, what is seen is there.
            mask |= amodal.of(instance) == index + 1
            if mask.any():
                found.append((self._known(index), amodal))
        picture = LabelView(camera, instance, hits.distance)
        return harvest_truth(found, picture, self._scene.mesh.instances)

    # --- what is in view --------------------------------------------------------------------------------

    @cached_property
    def _alone(self) -> dict[int, IsolatedOrgan]:
        """The scene's fruit, by index."""
        return isolated_organs(self._scene.mesh, self._bones.of_form("fruit"))

    @cached_property
    def _balls(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`(n, 3)` and `(n,)` metres: balls that hold the fruit."""
        bounds = np.array([one.mesh.bounds for one in self._alone.values()], dtype=float).reshape(-1, 2, 3)
        return bounds.mean(axis=1), 0.5 * np.linalg.norm(bounds[:, 1] - bounds[:, 0], axis=1)

    def _in_view(self, camera: Camera) -> NDArray[np.bool_]:
        """`(n,)` which fruit's balls reach into the field of view."""
        centres, radii = self._balls
        x, y, z = ((centres - camera.pose[:3, 3]) @ camera.pose[:3, :3]).T
        slopes = camera.ray_slopes()
        inside = z > -radii
        # The picture lies between the extreme slopes of its borders.
        for along, axis in ((x, 0), (y, 1)):
            border = np.concatenate([slopes[[0, -1], :, axis].ravel(), slopes[:, [0, -1], axis].ravel()])
            for side, limit in ((1.0, border.max()), (-1.0, -border.min())):
                inside &= side * along - limit * z <= radii * np.hypot(1.0, limit)
        return inside

    # --- what is known of a fruit, whatever looks at it ----------------------------------------------------

    def _known(self, index: int) -> FruitTruth:
        if index not in self._fruit:
            self._fruit[index] = self._made(index)
        return self._fruit[index]

    def _made(self, index: int) -> FruitTruth:
        organ, bones, about = self._bones.organ(index), self._bones, self._scene.mesh.instances[index]
        hung = fruit_frames([organ])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = hung.axes[0].T, hung.foot[0]
        local = (self._alone[index].mesh.vertices - hung.foot[0]) @ hung.axes[0].T
        low, high = local.min(axis=0), local.max(axis=0)
        centre = hung.foot[0] + pose[:3, :3] @ (0.5 * (low + high))
        line = _line(bones, index)
        return FruitTruth(
            index,
            about,
            pose,
            low,
            high,
            {
                name: float(organ.measures.get(name, 0.0))
                for name in ("ripeness", "ripeness_spread", "length_m", "diameter_m")
            },
            line,
            _stalk(bones, line),
            tool_approach(centre, self._stem(about.plant)),
        )

    def _stem(self, plant: int) -> NDArray[np.float64]:
        """`(k, 3)` axis of a plant's main stem."""
        if plant not in self._stems:
            parts = self._bones.of_form("internode", "node", plant=max(plant, 0))
            self._stems[plant] = np.concatenate([self._bones.organ(part).curve for part in parts])
        return self._stems[plant]

    @cached_property
    def _stems(self) -> dict[int, NDArray[np.float64]]:
        return {}


def _line(bones: Skeleton, index: int) -> tuple[int, ...]:
    """Indices from an organ down to the first of the main stem's."""
    found = [index]
    while not _is_stem(bones, found[-1]) and (parent := bones.organ(found[-1]).parent) >= 0:
        found.append(parent)
    return tuple(found)


def _is_stem(bones: Skeleton, index: int) -> bool:
    kind = bones.kind(index)
    return kind is not None and kind.form in ("internode", "node")


def _stalk(bones: Skeleton, line: tuple[int, ...]) -> FruitStalk | None:
    """The stalk that a fruit sits on, with or without a calyx in between; None for one that sits on none."""
    forms = [kind.form if (kind := bones.kind(index)) is not None else None for index in line]
    place = next((step for step in range(1, len(line)) if forms[step] != "calyx"), len(line))
    if place == len(line) or forms[place] != "peduncle":
        return None
    organ = bones.organ(line[place])
    # The very curve that the stalk's body is built around.
    smooth = spines([organ.curve], [organ.up], _STEPS).points[0]
    on = line[place + 1] if place + 1 < len(line) else -1
    return fruit_stalk(
        smooth,
        float(organ.measures["radius_m"]),
        _body(bones.organ(on)) if on >= 0 else None,
        instance=line[place],
        bearer_instance=on,
        on_stalk=on >= 0 and forms[place + 1] == "peduncle",
    )


def _body(organ: Organ) -> tuple[NDArray[np.float64], float, float]:
    """Centreline of a tube and its radii at both ends; a node is as wide as it is at its widest."""
    radius = float(organ.measures.get("radius_m", 0.0))
    return organ.curve, radius, float(organ.measures.get("radius_tip_m", radius))

"""Organs of a scene, each alone: the pixels that they would have if nothing occluded them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh
from pepperscene.render.arrays import LocalCoordinates, device_uint, local_coordinates
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.variant import mitsuba_modules
from pepperscene.truth.amodal import AmodalMask
from pepperscene.truth.encodings import Box

_BOX_MARGIN: Final = 2  # chosen: pixels; a lens bends the lines between projected vertices by less
_BATCH: Final = 1 << 22  # chosen: rays whose kernels are started before the first is waited for, 16 MB
_PROJECTED: Final = 1 << 16  # chosen: vertices that are projected at a time, 8 MB
_MOST_KEPT: Final = 4096
"""Chosen: organs that are kept between frames. Each takes 25 KB, and a row has fewer that come into view."""


@dataclass(frozen=True, eq=False)
class IsolatedOrgan:
    """One organ of a scene."""

    mesh: Mesh  # its triangles alone
    coordinates: LocalCoordinates  # of the whole scene

    @cached_property
    def scene(self) -> Any:
        """The Mitsuba scene of its triangles, without what shading needs; made when it is first used."""
        mi, _ = mitsuba_modules()
        shape = mi.Mesh("organ", len(self.mesh.vertices), len(self.mesh.faces))
        params = mi.traverse(shape)
        vertices = self.coordinates.vertices(self.mesh)
        params["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
        params["faces"] = np.ascontiguousarray(self.mesh.faces, np.uint32).ravel()
        params.update()
        return mi.load_dict({"type": "scene", "organ": shape})


class IsolatedOrgans:
    """The organs of a scene, cut out of its mesh when they are first used, and kept.

    130 times as fast as `Mesh.select_instances` for each fruit of a row.

    Args:
        mesh: with contiguous vertices of each instance.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._organs: dict[int, IsolatedOrgan | None] = {}

    def of(self, instances: Iterable[int]) -> dict[int, IsolatedOrgan]:
        """The organs of some instances, by index; those without triangles are left out."""
        found = {}
        for index in instances:
            if index not in self._organs:
                self._organs[index] = self._isolate(index)
            organ = self._organs[index]
            if organ is not None:
                found[index] = organ
        return found

    def amodal_masks(
        self, instances: Iterable[int], camera: Camera, rays: CameraRays, instance: NDArray[np.uint16]
    ) -> Iterator[tuple[int, AmodalMask]]:
        """Yield index and mask of those instances that have a pixel if nothing occludes them.

        Args:
            instances: indices of organs.
            camera: of the image.
            rays: of its labels.
            instance: `(h, w)` its instance image.
        """
        organs = self.of(instances)
        if len(self._organs) > _MOST_KEPT:
            # Forget those of other views.
            self._organs = {**organs}
        boxes = dict(_find_boxes(organs, camera))
        pixels = {index: (x1 - x0) * (y1 - y0) for index, (x0, y0, x1, y1) in boxes.items()}
        for batch in _batches(pixels, _BATCH):
            masks = hit_masks([(organs[index], boxes[index]) for index in batch], rays)
            for index, mask in zip(batch, masks, strict=True):
                amodal = AmodalMask(boxes[index][:2], mask)
                # Rays with equal directions can disagree at an outline; visible pixels always count.
                mask |= amodal.crop(instance) == index + 1
                if mask.any():
                    yield index, amodal

    @cached_property
    def _coordinates(self) -> LocalCoordinates:
        return local_coordinates(self._mesh)

    def _isolate(self, instance: int) -> IsolatedOrgan | None:
        """Cut one instance out; None if it has no triangles."""
        mesh, rows = self._mesh, self._mesh.face_runs.rows(instance)
        faces = mesh.faces[rows]
        if not len(faces):
            return None
        used = slice(int(faces.min()), int(faces.max()) + 1)
        part = replace(
            mesh,
            vertices=mesh.vertices[used],
            normals=mesh.normals[used],
            uv=mesh.uv[used],
            state=mesh.state[used],
            colour=None,
            faces=faces - np.uint32(used.start),
            face_instance=np.zeros(len(faces), np.uint32),
            face_surface=mesh.face_surface[rows],
            face_appearance=mesh.face_appearance[rows],
            instances=(mesh.instances[instance],),
        )
        return IsolatedOrgan(part, self._coordinates)


def _find_boxes(organs: Mapping[int, IsolatedOrgan], camera: Camera) -> Iterator[tuple[int, Box]]:
    """Yield each organ with the part of the image that contains all rays that can hit it, if there is any."""
    sizes = {index: len(organ.mesh.vertices) for index, organ in organs.items()}
    for batch in _batches(sizes, _PROJECTED):
        # Many organs in one call, which costs as much as its points only if there are many.
        pixels = camera.project(np.concatenate([organs[index].mesh.vertices for index in batch]))
        first = np.cumsum([0, *(sizes[index] for index in batch)])[:-1]
        # Extremes are nan where a vertex has no pixel.
        lows, highs = (extreme.reduceat(pixels, first, axis=0) for extreme in (np.minimum, np.maximum))
        is_seen = np.logical_or.reduceat(np.isfinite(pixels).all(axis=1), first)
        for index, low, high, seen in zip(batch, lows, highs, is_seen, strict=True):
            if not np.isfinite([low, high]).all():
                # It reaches behind the camera or beyond the field of the lens: any ray may hit it.
                if seen:
                    yield index, (0, 0, camera.width, camera.height)
                continue
            x0, y0 = np.maximum(np.floor(low).astype(np.intp) - _BOX_MARGIN, 0).tolist()
            x1, y1 = np.minimum(
                np.ceil(high).astype(np.intp) + _BOX_MARGIN, [camera.width, camera.height]
            ).tolist()
            if x0 < x1 and y0 < y1:
                yield index, (x0, y0, x1, y1)


def _batches(sizes: Mapping[int, int], most: int) -> Iterator[list[int]]:
    """The keys of sizes, in order, in groups with a sum of at most `most`, or of one."""
    group: list[int] = []
    total = 0
    for index, size in sizes.items():
        if group and total + size > most:
            yield group
            group, total = [], 0
        group.append(index)
        total += size
    if group:
        yield group


def hit_masks(organs: Sequence[tuple[IsolatedOrgan, Box]], rays: CameraRays) -> list[NDArray[np.bool_]]:
    """`(y1 - y0, x1 - x0)` for each organ and box: whether rays through the pixels' centres hit the organ."""
    # The first is waited for when all kernels are started.
    hits = [_hits_in_box(organ, box, rays) for organ, box in organs]
    return [
        np.array(hit).astype(bool).reshape(y1 - y0, x1 - x0)
        for hit, (_, (x0, y0, x1, y1)) in zip(hits, organs, strict=True)
    ]


def _hits_in_box(organ: IsolatedOrgan, box: Box, rays: CameraRays) -> Any:
    """1 for each pixel of a box whose ray hits the organ, row by row."""
    mi, dr = mitsuba_modules()
    x0, y0, x1, y1 = box
    # Kernel data, so that no other box, organ or scene compiles anything.
    left, top, width = (device_uint(n) for n in (x0, y0, x1 - x0))
    lane = dr.arange(mi.UInt32, (x1 - x0) * (y1 - y0))
    row = lane // width
    column = lane - row * width + left
    origin, direction = rays.centre_rays(column, row + top, mi.Float(0.5), mi.Float(0.5))
    hit = organ.scene.ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=True)
    is_hit = dr.select(hit.is_valid(), mi.UInt32(1), mi.UInt32(0))
    # One by one: boxes of equal size would become one kernel, which is compiled for each number of them.
    dr.eval(is_hit)
    return is_hit

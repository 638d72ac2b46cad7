"""What any number of cameras see of the fruit of a scene, without rendering images."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera
from pepperscene.camera.poses.generators import as_poses, check_poses
from pepperscene.errors import ArgumentError
from pepperscene.render.arrays import local_coordinates
from pepperscene.render.kernel.scene import truth_scene
from pepperscene.render.viewpoints.fruit_parts import (
    PEDUNCLE_SAMPLES,
    FruitPart,
    FruitSamples,
    sample_fruit,
    scene_fruit,
)
from pepperscene.render.viewpoints.shadow_rays import PointState, PointTracer, TracedPoints, image_map
from pepperscene.scene import Scene
from pepperscene.truth.fruit_visibility import (
    ROW_ARRAYS,
    SAMPLES,
    FruitVisibility,
    Occluders,
    check_samples,
)

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

_LANES: Final = 1 << 21  # chosen: points that are traced together, in about 100 MB
_POSES: Final = 1024  # chosen: poses whose fruit in view are found together

Progress = Callable[[int, int], None]
"""Called with the number of poses that are done, and of all."""


def fruit_visibility(
    scene: Scene, camera: Camera, poses: ArrayLike, *, samples: int = SAMPLES, occluders: bool = False
) -> FruitVisibility:
    """What a camera sees of the fruit of a scene at some poses; for several calls keep a `FruitObserver`.

    Args:
        scene: with all triangles, and the skeleton of its plants.
        camera: lens and sensor; its own pose and motion do not matter.
        poses: `(n, 4, 4)` camera to world, metres.
        samples: number of points on each fruit, a multiple of 64.
        occluders: whether to list what hides each fruit.

    Raises:
        ArgumentError: as `FruitObserver` and its `observe`.
        SetupError: no JIT variant of Mitsuba runs on this machine.
    """
    return FruitObserver(scene, samples).observe(camera, poses, occluders=occluders)


class FruitObserver:
    """Computes what cameras see of the fruit of a scene; the scene stays in the kernel.

    Points at equal steps of area stand for the surface of each fruit. A ray is traced from the camera to each
    point that faces it and is in its image; it shows whether the point is visible, and what hides it. A
    second ray, to the fruit alone, shows whether the fruit itself hides a point as well. Each point counts
    with the size of its part of the surface in the image, so fractions are those of label images whose pixels
    are infinitely small. The result does not depend on the number of threads.

    Args:
        scene: with all triangles; one that was culled for other views lacks surfaces that hide fruit.
        samples: number of points on each fruit, a multiple of 64.
        fruit: to observe; None for all of the scene's labelled plants.

    Attributes:
        points: on the surfaces.

    Raises:
        ArgumentError: the number of samples is not allowed, the scene has no skeleton, or it has no fruit.
        SetupError: no JIT variant of Mitsuba runs on this machine.
    """

    def __init__(
        self, scene: Scene, samples: int = SAMPLES, fruit: Sequence[FruitPart] | None = None
    ) -> None:
        check_samples(samples)
        self.points = sample_fruit(scene.mesh, scene_fruit(scene) if fruit is None else fruit, samples)
        coordinates = local_coordinates(scene.mesh)
        self._tracer = PointTracer(truth_scene(scene), scene.mesh, coordinates, self.points)

    def observe(
        self,
        camera: Camera,
        poses: ArrayLike,
        *,
        occluders: bool = False,
        on_progress: Progress | None = None,
    ) -> FruitVisibility:
        """What a camera sees at some poses.

        Args:
            camera: lens and sensor; its own pose and motion do not matter.
            poses: `(n, 4, 4)` camera to world, metres.
            occluders: whether to list what hides each fruit.
            on_progress: called after each part of the poses.

        Raises:
            ArgumentError: there are no poses, they have another shape, or one is not a rotation and a
                translation.
        """
        poses = as_poses(poses)
        try:
            check_poses(poses)
        except ValueError as error:
            raise ArgumentError("poses", str(error)) from None
        if not len(poses):
            raise ArgumentError("poses", "must be at least one")
        image, device_poses = image_map(camera), self._tracer.device_poses(poses)
        parts = []
        for first in range(0, len(poses), _POSES):
            block = poses[first : first + _POSES]
            pose_index, fruit_index = fruit_in_view(camera, block, self.points)
            pose_index += first
            for rows in _portions(len(pose_index), _LANES // self.points.block):
                pairs = pose_index[rows], fruit_index[rows]
                traced = self._tracer.trace(image, device_poses, *pairs)
                parts.append(_rows(traced, *pairs, poses, self.points, occluders))
            if on_progress is not None:
                on_progress(first + len(block), len(poses))
        if not parts:
            empty, shape = np.zeros(0, np.intp), (0, self.points.block)
            traced = TracedPoints(np.zeros(shape, np.uint32), np.zeros(shape, np.float32))
            parts = [_rows(traced, empty, empty, poses, self.points, occluders)]
        return _joined(parts)


def fruit_in_view(camera: Camera, poses: FloatArray, samples: FruitSamples) -> tuple[IndexArray, IndexArray]:
    """Pairs of a pose and a fruit whose ball reaches into the camera's field of view, in their order."""
    position, turn = poses[:, :3, 3], poses[:, :3, :3]
    local = np.einsum("pfi,pij->pfj", samples.centres - position[:, None], turn)
    x, y, z = np.moveaxis(local, 2, 0)
    radii = samples.radii
    borders = np.concatenate(camera.border_slopes())
    inside = z > -radii
    # The image is between the extreme slopes of its borders.
    for along, axis in ((x, 0), (y, 1)):
        border = borders[:, axis]
        for side, limit in ((1.0, border.max()), (-1.0, -border.min())):
            inside &= side * along - limit * z <= radii * np.hypot(1.0, limit)
    pose_index, fruit_index = np.nonzero(inside)
    return pose_index, fruit_index


def _portions(count: int, size: int) -> Iterator[slice]:
    """Slices of at most a size."""
    for start in range(0, count, max(size, 1)):
        yield slice(start, min(start + max(size, 1), count))


def _rows(
    traced: TracedPoints,
    pose_index: IndexArray,
    fruit_index: IndexArray,
    poses: FloatArray,
    samples: FruitSamples,
    wants_occluders: bool,
) -> FruitVisibility:
    """The rows of some pairs whose fruit or peduncle is in the image."""
    in_image = traced.has(PointState.ALONE).any(axis=1)
    traced = TracedPoints(traced.state[in_image], traced.weight[in_image])
    pose_index, fruit_index = pose_index[in_image], fruit_index[in_image]
    skin, cut = samples.skin, samples.skin + PEDUNCLE_SAMPLES
    facing, visible, alone = (traced.has(flag) for flag in PointState)
    seen_area = traced.weight.astype(np.float64) * visible
    alone_area = traced.weight.astype(np.float64) * alone

    def fraction(part: slice, missing: float) -> FloatArray:
        whole = alone_area[:, part].sum(axis=1)
        share = seen_area[:, part].sum(axis=1) / np.where(whole > 0.0, whole, 1.0)
        return np.where(whole > 0.0, share, missing)

    seen_points, facing_points = (points[:, :skin].sum(axis=1) for points in (visible, facing))
    return FruitVisibility(
        poses=poses,
        fruit=samples.fruit,
        peduncle=samples.peduncle,
        pose_index=pose_index,
        fruit_index=fruit_index,
        visible_fraction=fraction(slice(0, skin), 0.0),
        facing_fraction=seen_points / np.maximum(facing_points, 1),
        surface_fraction=seen_points / skin,
        visible_pixels=seen_area[:, :skin].sum(axis=1) * samples.area_m2[fruit_index] / skin,
        peduncle_visible_fraction=fraction(slice(skin, cut), np.nan),
        cut_visible_fraction=fraction(slice(cut, None), np.nan),
        seen=np.packbits(visible[:, :skin], axis=1),
        occluders=_occluders(traced, alone_area, skin) if wants_occluders else None,
    )


def _occluders(traced: TracedPoints, alone_area: FloatArray, skin: int) -> Occluders:
    """What hides the fruit of each row."""
    occluder = traced.occluder[:, :skin]
    row, point = np.nonzero(occluder)
    area, whole = alone_area[row, point], alone_area[:, :skin].sum(axis=1)
    # Add up the points of each row and occluder.
    key, entry = np.unique((row.astype(np.int64) << 32) | occluder[row, point], return_inverse=True)
    row, instance = (key >> 32).astype(np.intp), ((key & 0xFFFFFFFF) - 1).astype(np.intp)
    fraction = np.bincount(entry, weights=area, minlength=len(key)) / whole[row]
    order = np.lexsort([instance, -fraction, row])
    return Occluders(row[order], instance[order], fraction[order])


def _joined(parts: Sequence[FruitVisibility]) -> FruitVisibility:
    """The rows of all parts."""
    first = parts[0]

    def column(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(part, name) for part in parts])

    occluders = None
    if first.occluders is not None:
        lists = [part.occluders for part in parts if part.occluders is not None]
        offsets = np.cumsum([0, *(len(part) for part in parts)])
        occluders = Occluders(
            np.concatenate([one.row + offset for one, offset in zip(lists, offsets, strict=False)]),
            np.concatenate([one.instance for one in lists]),
            np.concatenate([one.fraction for one in lists]),
        )
    columns: dict[str, Any] = {name: column(name) for name in ROW_ARRAYS}
    return FruitVisibility(
        poses=first.poses, fruit=first.fruit, peduncle=first.peduncle, occluders=occluders, **columns
    )

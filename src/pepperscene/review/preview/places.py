"""Where the cameras of a plan are: of the frames of one scene, and of all selected frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.errors import ArgumentError
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.resolve.frame_setups import camera_name
from pepperscene.recipe.views.targets import organ_centroid, target_instances
from pepperscene.recipe.views_tables import PathViews, RandomViews

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.camera.pose_files.formats import PoseFormat
    from pepperscene.scene import Scene

Array = NDArray[np.float64]

MOST_PLACES: Final = 500
"""Chosen: camera places in a picture, and targets; more would cover each other."""

_FORMATS: Final[dict[str, PoseFormat]] = {".json": "nerfstudio", ".txt": "tum", ".csv": "csv", "": "colmap"}


@dataclass(frozen=True, eq=False)
class CameraPlaces:
    """Camera places of one scene.

    Attributes:
        spec: the first selected frame, which is of this scene.
        poses: `(n, 4, 4)` camera to world, metres; none if they depend on plants that were not grown.
        cameras: names of the cameras of the rig.
        camera: `(n,)` number of each on the rig.
        selected: `(n,)` whether its frame is selected.
        targets: `(m, 3)` what the views can look at, metres.
        target_name: of the targets.
        limits: of random views, or None.
    """

    spec: FrameSpec
    poses: Array
    cameras: tuple[str, ...]
    camera: NDArray[np.intp]
    selected: NDArray[np.bool_]
    targets: Array
    target_name: str = ""
    limits: RandomViews | None = None


def scene_places(renderer: FrameRenderer, indices: Sequence[int], *, grown: bool) -> CameraPlaces:
    """The camera places of the scene of the first selected frame, evenly chosen if they are many.

    The indices are ascending; `grown` is whether plants may be grown for views that depend on them.
    """
    recipe, plan = renderer.recipe, renderer.recipe.plan
    spec = plan.frame(indices[0])
    setup = renderer.setups.at(spec)
    specs = [plan.frame(index) for index in _shown_indices(plan.scene_indices(spec), indices)]
    if renderer.views.depends_on_scene:
        # One scene is built at most.
        same = [one for one in specs if renderer.setups.at(one).plants == setup.plants]
        specs = same if grown else []
    poses = [renderer.camera(one, traced=False).pose for one in specs]
    table, limits = setup.recipe.views, None
    targets, target_name = np.zeros((0, 3)), ""
    if isinstance(table, RandomViews):
        limits = table
        if not isinstance(limits.target, str):
            targets, target_name = np.array([limits.target]), "target"
        elif renderer.current_scene is not None:
            targets, target_name = _organ_targets(renderer, specs, renderer.current_scene)
    elif isinstance(table, PathViews) and table.look_at_m is not None:
        targets, target_name = np.array([table.look_at_m]), "target"
    return CameraPlaces(
        spec=spec,
        poses=np.array(poses).reshape(-1, 4, 4),
        cameras=tuple(camera_name(recipe, replace(spec, camera=number)) for number in range(plan.cameras)),
        camera=np.array([one.camera for one in specs], dtype=np.intp),
        selected=np.isin([one.index for one in specs], indices),
        targets=targets,
        target_name=target_name,
        limits=limits,
    )


def _shown_indices(of_scene: range, selected: Sequence[int]) -> list[int]:
    """The indices of a scene, or at most `MOST_PLACES` of them, half of which are selected where possible."""
    if len(of_scene) <= MOST_PLACES:
        return list(of_scene)
    inside = [index for index in selected if index in of_scene]
    half = MOST_PLACES // 2
    return sorted({*_evenly(inside, half), *_evenly(of_scene, half)})


def _evenly(values: Sequence[int], most: int) -> list[int]:
    """At most `most` of some values, evenly spaced."""
    if len(values) <= most:
        return list(values)
    return [values[int(position)] for position in np.linspace(0, len(values) - 1, most)]


def pose_format(path: Path) -> PoseFormat:
    """The format of a file of poses by its suffix; a path without one is the folder of a COLMAP model.

    Raises:
        ArgumentError: there is no such format.
    """
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        allowed = ".json (nerfstudio), .txt (TUM), .csv, or be a folder without a suffix (COLMAP)"
        raise ArgumentError("poses", f"{str(path)!r} must end in {allowed}")
    return _FORMATS[suffix]


def check_can_write_poses(renderer: FrameRenderer, indices: Sequence[int], *, grown: bool) -> None:
    """Check that the poses of selected frames can be computed and written, without computing them.

    Raises:
        ArgumentError: the views depend on plants that must not be grown, or the frames are too many for a
            file.
    """
    from pepperscene.camera.poses.generators import MAX_POSES

    if renderer.views.depends_on_scene and not grown:
        kind = renderer.recipe.views.kind
        raise ArgumentError(
            "poses", f"views of the kind {kind} depend on the plants, which are grown only for a probe"
        )
    if len(indices) > MAX_POSES:
        raise ArgumentError(
            "poses", f"{len(indices):,} frames are selected, and a file has at most {MAX_POSES:,}"
        )


def write_selected_poses(path: Path, renderer: FrameRenderer, indices: Sequence[int]) -> None:
    """Write the poses of the selected frames, named as their images ("000110.png").

    A TUM file must have times; they are the indices of the frames. Intrinsics are written if the format has
    them and they are the same for all frames.

    The suffix of the path sets the format; `check_can_write_poses` has checked the indices.

    Raises:
        PepperError: a frame has no view, or the file cannot be written.
    """
    from pepperscene.camera.pose_files.formats import write_poses
    from pepperscene.camera.poses.pose_list import PoseList

    file_format = pose_format(path)
    cameras = [renderer.camera(renderer.recipe.plan.frame(index), traced=False) for index in indices]
    times = np.array(indices, dtype=float) if file_format == "tum" else None
    names = tuple(f"{index:06d}.png" for index in indices)
    poses = PoseList(np.array([camera.pose for camera in cameras]), times, names)
    has_intrinsics = file_format in ("nerfstudio", "colmap") and _have_same_intrinsics(cameras)
    write_poses(path, poses, file_format, cameras[0] if has_intrinsics else None)


def _have_same_intrinsics(cameras: Sequence[Camera]) -> bool:
    """Whether all cameras project points in camera axes to the same pixels of images of the same size."""
    first = cameras[0]
    size, matrix, distortion = (first.width, first.height), first.intrinsics, first.lens.distortion
    return all(
        (camera.width, camera.height) == size
        and camera.lens.distortion == distortion
        and np.array_equal(camera.intrinsics, matrix)
        for camera in cameras
    )


def _organ_targets(renderer: FrameRenderer, specs: Sequence[FrameSpec], scene: Scene) -> tuple[Array, str]:
    """The centroids of all organs that the views of some frames of a scene can look at, and their names."""
    tables = [renderer.setups.at(spec).recipe.views for spec in specs]
    targets = {table.target for table in tables if isinstance(table, RandomViews)}
    names = sorted(name for name in targets if isinstance(name, str))
    found = {int(one) for name in names for one in target_instances(scene, name, renderer.recipe.name)}
    centroids = [organ_centroid(scene.mesh, instance) for instance in _evenly(sorted(found), MOST_PLACES)]
    return np.array(centroids).reshape(-1, 3), ", ".join(names)

"""Where the cameras of a plan are: of the frames of one scene, and of all selected frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.recipe.frame_values import camera_name
from pepperscene.dataset.recipe.plan import FrameSpec
from pepperscene.dataset.recipe.views_tables import PathViews, RandomViews
from pepperscene.dataset.scenes import frame_renderer
from pepperscene.dataset.scenes.frame_renderer import FrameRenderer, RendererFactory, SceneRenderer
from pepperscene.dataset.views.targets import target_instances
from pepperscene.errors import ArgumentError

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.camera.pose_files import PoseFormat
    from pepperscene.scene import Scene

Array = NDArray[np.float64]

MOST_PLACES: Final = 500
"""Chosen: camera places in a picture, and targets; more would cover each other."""

_FORMATS: Final[dict[str, PoseFormat]] = {".json": "nerfstudio", ".txt": "tum", ".csv": "csv", "": "colmap"}


class SceneKeeper:
    """Makes renderers of scenes, and keeps the last scene.

    Attributes:
        scene: the last one, or None.

    Args:
        renderer: makes them; None for Mitsuba.
    """

    def __init__(self, renderer: RendererFactory | None) -> None:
        self._renderer = renderer
        self.scene: Scene | None = None

    def __call__(self, scene: Scene) -> SceneRenderer:
        """The renderer of a scene."""
        self.scene = scene
        return (self._renderer or frame_renderer.mitsuba_renderer)(scene)


@dataclass(frozen=True, eq=False)
class ViewLimits:
    """The limits of random views around a target, in metres and radians.

    Attributes:
        around: `(3,)` the target if it is a point; None for organs.
        distance_m, azimuth_rad, elevation_rad: ranges.
        volume_m: ranges of x, y and z, or None.
    """

    around: Array | None
    distance_m: tuple[float, float]
    azimuth_rad: tuple[float, float]
    elevation_rad: tuple[float, float]
    volume_m: Array | None


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
    limits: ViewLimits | None = None


def scene_places(
    renderer: FrameRenderer, indices: Sequence[int], keeper: SceneKeeper, *, grown: bool
) -> CameraPlaces:
    """The camera places of the scene of the first selected frame, evenly chosen if they are many.

    Args:
        renderer: of the recipe.
        indices: selected frames, ascending.
        keeper: of the renderer's scenes.
        grown: whether the plants may be grown, for views that depend on them.
    """
    recipe, plan = renderer.recipe, renderer.recipe.plan
    spec = plan.frame(indices[0])
    setup = renderer.setups.at(spec)
    specs = [plan.frame(index) for index in _shown_indices(plan.scene_indices(spec), indices)]
    if renderer.views.depends_on_scene:
        # One scene is built at most.
        same = [one for one in specs if renderer.setups.at(one).plants == setup.plants]
        specs = same if grown else []
    poses = [renderer.camera(one).pose for one in specs]
    table, limits = setup.recipe.views, None
    targets, target_name = np.zeros((0, 3)), ""
    if isinstance(table, RandomViews):
        limits = _limits(table)
        if limits.around is not None:
            targets, target_name = limits.around[None], "target"
        elif keeper.scene is not None:
            targets, target_name = _organ_targets(renderer, specs, keeper.scene)
    elif isinstance(table, PathViews) and table.look_at_mm is not None:
        targets, target_name = np.array([table.look_at_mm]) / 1e3, "target"
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


def check_poses_known(renderer: FrameRenderer, *, grown: bool) -> None:
    """Raise `ArgumentError` if the poses of a recipe depend on plants that must not be grown."""
    if renderer.views.depends_on_scene and not grown:
        kind = renderer.recipe.views.kind
        raise ArgumentError("poses", f"views of the kind {kind} depend on the plants, so --no-probe has none")


def write_selected_poses(path: Path, renderer: FrameRenderer, indices: Sequence[int]) -> None:
    """Write the poses of the selected frames, named as their images ("000110.png").

    The times of a TUM file, which needs some, are the indices of the frames. Intrinsics are written if the
    format has them and all frames have the same camera.

    Raises:
        PepperError: there are too many frames for such a file, or it cannot be written.
    """
    from pepperscene.camera.pose_files import write_poses
    from pepperscene.camera.pose_list import PoseList
    from pepperscene.camera.poses import MOST_POSES

    if len(indices) > MOST_POSES:
        raise ArgumentError(
            "poses", f"{len(indices):,} frames are selected, and a file has at most {MOST_POSES:,}"
        )
    file_format = pose_format(path)
    cameras = [renderer.camera(renderer.recipe.plan.frame(index)) for index in indices]
    times = np.array(indices, dtype=float) if file_format == "tum" else None
    names = tuple(f"{index:06d}.png" for index in indices)
    poses = PoseList(np.array([camera.pose for camera in cameras]), times, names)
    write_poses(
        path, poses, file_format, _common_camera(cameras) if file_format in ("nerfstudio", "colmap") else None
    )


def _common_camera(cameras: Sequence[Camera]) -> Camera | None:
    """The camera of all frames apart from their poses; None if lenses or sensors differ."""
    first = cameras[0]
    same = all(camera.lens is first.lens and camera.sensor is first.sensor for camera in cameras)
    return first if same else None


def _limits(table: RandomViews) -> ViewLimits:
    azimuth, elevation = np.radians(table.azimuth_deg), np.radians(table.elevation_deg)
    return ViewLimits(
        around=None if isinstance(table.target, str) else np.array(table.target) / 1e3,
        distance_m=(table.distance_mm[0] / 1e3, table.distance_mm[1] / 1e3),
        azimuth_rad=(float(azimuth[0]), float(azimuth[1])),
        elevation_rad=(float(elevation[0]), float(elevation[1])),
        volume_m=None if table.volume_mm is None else np.array(table.volume_mm) / 1e3,
    )


def _organ_targets(renderer: FrameRenderer, specs: Sequence[FrameSpec], scene: Scene) -> tuple[Array, str]:
    """The centroids of all organs that the views of some frames of a scene can look at, and their names."""
    tables = [renderer.setups.at(spec).recipe.views for spec in specs]
    targets = {table.target for table in tables if isinstance(table, RandomViews)}
    names = sorted(name for name in targets if isinstance(name, str))
    where = renderer.recipe.name
    found = {int(one) for name in names for one in target_instances(scene, name, where, "views.target")}
    instances = _evenly(sorted(found), MOST_PLACES)
    return np.array([_centroid(scene, instance) for instance in instances]).reshape(-1, 3), ", ".join(names)


def _centroid(scene: Scene, instance: int) -> Array:
    """`(3,)` centroid of an organ's surface."""
    mesh = scene.mesh
    first, second, third = (
        mesh.vertices[mesh.faces[mesh.face_runs.rows(instance)]].astype(float).transpose(1, 0, 2)
    )
    areas = np.linalg.norm(np.cross(second - first, third - first), axis=1)
    centres = (first + second + third) / 3
    return np.asarray(np.average(centres, axis=0, weights=areas) if areas.sum() > 0 else centres.mean(axis=0))

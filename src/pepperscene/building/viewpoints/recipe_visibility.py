"""The visibility of a recipe's fruit: from the cameras of its frames, or from other poses in its scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.errors import ArgumentError
from pepperscene.recipe.plan import FrameSpec, Stream, random_generator
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.recipe.views.workspace import ReachTest, Workspace, lattice_poses, random_poses
from pepperscene.truth.fruit_visibility import SAMPLES, FruitVisibility, check_samples
from pepperscene.truth.view_planning import ViewSequence, greedy_views

if TYPE_CHECKING:
    from pepperscene.camera import PoseList
    from pepperscene.classes import Instance
    from pepperscene.scene import Scene

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class ViewpointOptions:
    """The poses to observe a scene from, and what to compute.

    Without `poses`, `random` and `spacing_m`, the poses are those of the recipe's frames.

    Attributes:
        poses: file of poses, in the coordinates of the recipe; see `read_poses`.
        random: number of random positions in the workspace.
        spacing_m: of a lattice of positions in the workspace.
        workspace: where the camera can be; None for everywhere.
        clearance_m: no surface is nearer to the projection centre of a reachable pose.
        views: number of next best views.
        samples: points on each fruit.
        occluders: whether to list what hides each fruit.
    """

    poses: Path | None = None
    random: int | None = None
    spacing_m: float | None = None
    workspace: Workspace | None = None
    clearance_m: float = 0.0
    views: int = 0
    samples: int = SAMPLES
    occluders: bool = True

    def __post_init__(self) -> None:
        given = {"poses": self.poses, "random": self.random, "spacing": self.spacing_m}
        names = [name for name, value in given.items() if value is not None]
        if len(names) > 1:
            raise ArgumentError(names[1], f"cannot be combined with {names[0]}")
        if names and names[0] != "poses" and self.workspace is None:
            raise ArgumentError(names[0], "needs a workspace: a box or a sphere")
        check_samples(self.samples)
        if self.views < 0:
            raise ArgumentError("views", f"must be at least 0, not {self.views}")


@dataclass(frozen=True, eq=False)
class SceneVisibility:
    """What cameras see of the fruit of one scene.

    Attributes:
        spec: a frame of the scene.
        visibility: from all poses.
        instances: of the scene, which the numbers of fruit and occluders refer to.
        centres_m: `(f, 3)` centre of each fruit.
        frames: index of the frame of each pose; None for other poses.
        names: of the poses in their file, or None.
        reachable: `(n,)` whether a pose is in the workspace and away from surfaces; None without a workspace.
        best: `(f,)` the reachable pose that sees most of each fruit, -1 for none.
        views: the next best reachable views; None if none were wanted.
    """

    spec: FrameSpec
    visibility: FruitVisibility
    instances: Sequence[Instance]
    centres_m: FloatArray
    frames: tuple[int, ...] | None
    names: tuple[str, ...] | None
    reachable: NDArray[np.bool_] | None
    best: NDArray[np.intp]
    views: ViewSequence | None


def recipe_visibility(
    recipe: ResolvedRecipe,
    options: ViewpointOptions,
    frames: str | Sequence[int] | None = None,
    *,
    on_stage: Callable[[str], None] | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Iterator[SceneVisibility]:
    """Compute the visibility of fruit, scene by scene.

    Args:
        recipe: with its files.
        options: poses and what to compute.
        frames: "A:B", indices, or None for those that the recipe selects. With poses from elsewhere, the
            scene is that of the first frame.
        on_stage: called with the name of each stage that takes long.
        on_progress: called with the number of poses of a scene that are done, and of all.

    Raises:
        InputError: an option, the recipe or a file is not valid; or next best views are wanted of several
            scenes.
        SetupError: no JIT variant of Mitsuba runs on this machine.
    """
    from pepperscene.camera import read_poses

    notify = on_stage or (lambda _: None)
    indices = recipe.recipe.plan.select_indices(frames)
    from_file = None if options.poses is None else read_poses(options.poses)
    source = _PoseSource(FrameRenderer(recipe, culled=False), options, from_file)
    if source.of_frames:
        recipe.check_code()
    groups = source.groups(indices)
    if options.views and len(groups) > 1:
        raise ArgumentError("views", f"needs frames of one scene and camera, not of {len(groups)}")
    for specs in groups:
        notify("growing plants")
        yield _observe(source, specs, notify, on_progress)


def _observe(
    source: _PoseSource,
    specs: Sequence[FrameSpec],
    notify: Callable[[str], None],
    on_progress: Callable[[int, int], None] | None,
) -> SceneVisibility:
    """What the cameras of one scene see."""
    from pepperscene.render.viewpoints.observer import FruitObserver

    options, workspace = source.options, source.options.workspace
    poses = None
    if source.of_frames:
        # Views that depend on the plants assemble the scene.
        poses = np.array([source.renderer.camera(spec, traced=False).pose for spec in specs])
    scene, camera = source.scene(specs[0]), source.renderer.setups.at(specs[0]).camera
    observer = FruitObserver(scene, options.samples)
    reach = None if workspace is None else ReachTest(workspace, scene.mesh, options.clearance_m)
    if poses is None:
        poses = source.other_poses(specs[0], observer.points.skin_centres, reach)
    notify(f"observing {len(observer.points.fruit)} fruit from {len(poses):,} poses")
    visibility = observer.observe(camera, poses, occluders=options.occluders, on_progress=on_progress)
    reachable = None if reach is None else reach(poses[:, :3, 3])
    candidates = visibility if reachable is None else visibility.of_poses(reachable)
    return SceneVisibility(
        spec=specs[0],
        visibility=visibility,
        instances=scene.mesh.instances,
        centres_m=observer.points.skin_centres,
        frames=tuple(spec.index for spec in specs) if source.of_frames else None,
        names=None if source.from_file is None else source.from_file.names,
        reachable=reachable,
        best=candidates.best_poses(),
        views=greedy_views(candidates, options.views) if options.views else None,
    )


@dataclass(frozen=True, eq=False)
class _PoseSource:
    """Scenes and poses of a recipe, or poses from elsewhere."""

    renderer: FrameRenderer  # its scenes are not culled
    options: ViewpointOptions
    from_file: PoseList | None

    @property
    def of_frames(self) -> bool:
        """Whether the poses are those of the recipe's frames."""
        return self.from_file is None and self.options.random is None and self.options.spacing_m is None

    def groups(self, indices: Sequence[int]) -> list[list[FrameSpec]]:
        """Frames that share a scene and a camera; with poses from elsewhere the first frame alone."""
        setups = self.renderer.setups

        def key(spec: FrameSpec) -> tuple[int, str, str]:
            setup = setups.at(spec)
            return spec.scene, setup.plants, setup.optics

        specs = [self.renderer.recipe.plan.frame(index) for index in indices]
        if not self.of_frames:
            return [specs[:1]]
        return [list(group) for _, group in groupby(sorted(specs, key=key), key)]

    def scene(self, spec: FrameSpec) -> Scene:
        """The scene of a frame with all its triangles."""
        # Views that depend on the plants have assembled it already.
        has_scene = self.of_frames and self.renderer.views.depends_on_scene
        held = self.renderer.current_scene if has_scene else None
        return held or self.renderer.scene(spec, traced=False)

    def other_poses(self, spec: FrameSpec, targets: FloatArray, reach: ReachTest | None) -> FloatArray:
        """`(n, 4, 4)` the poses of the file, or those in the workspace, which face the nearest target."""
        if self.from_file is not None:
            return self.from_file.poses
        assert reach is not None  # checked by the options
        if self.options.spacing_m is not None:
            return lattice_poses(reach, targets, self.options.spacing_m)
        rng = random_generator(self.renderer.recipe.seed, Stream.VIEW, spec.scene, 1)
        return random_poses(reach, targets, self.options.random or 0, rng)

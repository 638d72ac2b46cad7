"""Scenes for planners of views: where the camera may be, where fruit counts, and the views to choose from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import arc_path, look_at
from pepperscene.errors import ArgumentError, InputError
from pepperscene.recipe.plan import FrameSpec, Stream, frame_seed, random_generator
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.recipe.views.workspace import BoxWorkspace, ReachTest
from pepperscene.truth.fruit_visibility import FruitVisibility, check_samples
from pepperscene.truth.view_planning import view_coverage

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.frame import Frame
    from pepperscene.render import Renderer
    from pepperscene.render.viewpoints.observer import FruitObserver
    from pepperscene.scene import Scene

FloatArray = NDArray[np.float64]

OBSERVED: Final = ("class", "depth_z")
"""Outputs of the frames that planners see."""

_ROW_DEPTH_M: Final = 0.35
"""Chosen: half the depth of the box with the fruit that counts, around the middle of the row: a double row of
0.2 m with its leaves."""
_ARC_RAD: Final = float(np.pi / 4)  # chosen: the robot's protocol (section 2.1 of Barth et al. 2018)
_TRIES: Final = 50  # chosen: as for random poses of a workspace


_BOX: Final = BoxWorkspace((-0.5, -0.7, 1.0), (0.5, -0.3, 1.8))


@dataclass(frozen=True)
class ViewTask:
    """The conditions of the task; all lengths in metres.

    Attributes:
        box: workspace of the camera, in the aisle. Chosen: the reach of an arm on a cart.
        clearance_m: least distance of the camera from any surface. Chosen: half the width of a small camera.
        candidates: number of random views to choose from, besides the arc. Chosen: as many as a planner can
            try in a second.
        views: number of views, the start included. Chosen: after ten, a view adds 1 %.
        samples: points on each fruit. Chosen: coverage is right to 1 %.

    Raises:
        ArgumentError: a value is not allowed.
    """

    box: BoxWorkspace = _BOX
    clearance_m: float = 0.05
    candidates: int = 300
    views: int = 10
    samples: int = 1024

    def __post_init__(self) -> None:
        if self.views < 2:
            raise ArgumentError("views", f"must be at least 2, not {self.views}")
        if self.candidates < 1:
            raise ArgumentError("candidates", f"must be at least 1, not {self.candidates}")
        if self.box.high_m[1] >= 0.0:
            raise ArgumentError(
                "box", f"must be in the aisle, at y below 0, not up to {self.box.high_m[1]:g} m"
            )
        check_samples(self.samples)

    @property
    def target(self) -> BoxWorkspace:
        """The box with the fruit that counts: the part of the row opposite the workspace."""
        low, high = self.box.low_m, self.box.high_m
        return BoxWorkspace((low[0], -_ROW_DEPTH_M, low[2]), (high[0], _ROW_DEPTH_M, high[2]))


@dataclass(frozen=True, eq=False)
class ViewScene:
    """One scene of the task.

    Attributes:
        spec: a frame of the scene.
        candidates: `(n, 4, 4)` views to choose from, all reachable: an arc, then random ones.
        arc: numbers of the candidates on the arc, from one end to the other.
    """

    task: ViewTask
    spec: FrameSpec
    scene: Scene
    camera: Camera
    candidates: FloatArray
    arc: tuple[int, ...]
    seed: int

    @property
    def start(self) -> int:
        """The first view of all planners: the middle of the arc."""
        return self.arc[len(self.arc) // 2]

    @cached_property
    def fruit(self) -> NDArray[np.intp]:
        """Numbers in `visibility.fruit` of those whose centre is in the target box."""
        return np.flatnonzero(self.task.target.contains(self._observer.points.skin_centres))

    @cached_property
    def visibility(self) -> FruitVisibility:
        """What the candidates really see."""
        return self._observer.observe(self.camera, self.candidates)

    def observe(self, number: int) -> Frame:
        """The labels that the camera sees from a candidate, without noise."""
        camera = self.camera.at_pose(self.candidates[number])
        return self._renderer.render(camera, OBSERVED, seed=frame_seed(self.seed, self.spec.index))

    def rng(self, *address: int) -> np.random.Generator:
        """Random numbers of a planner."""
        return random_generator(self.seed, Stream.VIEW, self.spec.scene, 3, *address)

    @cached_property
    def _observer(self) -> FruitObserver:
        from pepperscene.render.viewpoints.observer import FruitObserver

        return FruitObserver(self.scene, self.task.samples)

    @cached_property
    def _renderer(self) -> Renderer:
        from pepperscene.render import Renderer

        return Renderer(self.scene)


def view_scenes(
    recipe: ResolvedRecipe, task: ViewTask, on_stage: Callable[[str], None] | None = None
) -> Iterator[ViewScene]:
    """The first scene of each set of plants; `on_stage` is called with each stage that takes long.

    Raises:
        InputError: no position of the arc is reachable, or hardly any of the workspace.
    """
    frames = FrameRenderer(recipe, culled=False)
    plan = recipe.recipe.plan
    for number in range(plan.sets):
        spec = plan.frame(number * plan.rotations * plan.scene_frames)
        if on_stage is not None:
            on_stage("growing plants")
        scene = frames.scene(spec, traced=False)
        camera = frames.setups.at(spec).camera
        reach = ReachTest(task.box, scene.mesh, task.clearance_m)
        arc = arc_poses(task, reach)
        if not len(arc):
            raise InputError(recipe.recipe.name, f"has no reachable view on the arc in scene {spec.scene}")
        rng = random_generator(recipe.recipe.seed, Stream.VIEW, spec.scene, 2)
        others = random_views(task, reach, rng)
        candidates = np.concatenate([arc, others])
        yield ViewScene(task, spec, scene, camera, candidates, tuple(range(len(arc))), recipe.recipe.seed)


def arc_poses(task: ViewTask, reach: ReachTest) -> FloatArray:
    """The reachable poses of an arc around the row's middle line, across the workspace's heights."""
    low, high = task.box.bounds_m
    distance = -0.5 * (low[1] + high[1])
    # Steep enough that neither end is outside the box.
    azimuth = min(_ARC_RAD, float(np.arcsin(min(1.0, 0.5 * (high[0] - low[0]) / distance))))
    azimuth = min(azimuth, float(np.arccos(min(1.0, -high[1] / distance))))
    margin = 0.1 * (high[2] - low[2])
    centre = (0.5 * float(low[0] + high[0]), 0.0)
    heights = (float(low[2] + margin), float(high[2] - margin))
    poses = arc_path(task.views, float(distance), (-azimuth, azimuth), heights, 0.0, centre)
    return poses[reach(poses[:, :3, 3])]


def random_views(task: ViewTask, reach: ReachTest, rng: np.random.Generator) -> FloatArray:
    """`(n, 4, 4)` poses at random reachable positions, each facing a random point of the target box.

    They know nothing of fruit, as a planner must not.
    """
    found: list[FloatArray] = []
    missing = task.candidates
    for _ in range(_TRIES):
        positions = _uniform(task.box, task.candidates, rng)
        targets = _uniform(task.target, task.candidates, rng)
        kept = np.flatnonzero(reach(positions))[:missing]
        found += [look_at(positions[row], targets[row]) for row in kept]
        missing -= len(kept)
        if missing == 0:
            return np.array(found)
    problem = f"has {task.candidates - missing} reachable positions of {task.candidates} in {_TRIES} attempts"
    raise ArgumentError("box", problem)


def _uniform(box: BoxWorkspace, count: int, rng: np.random.Generator) -> FloatArray:
    low, high = box.bounds_m
    return np.asarray(low + rng.random((count, 3)) * (high - low))


def covered_fraction(scene: ViewScene, views: Sequence[int]) -> FloatArray:
    """`(k,)` mean over the fruit of the fraction of their surface that was seen after each view."""
    return view_coverage(scene.visibility, list(views), fruit=scene.fruit)

"""Next best view: which views see most of the fruit's surface, chosen one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.learning.tasks.result import Score, TaskMeasure, TaskResult
from pepperscene.learning.tasks.view_planners import (
    Planner,
    PlanningState,
    VoxelPlanner,
    arc_planner,
    oracle_views,
    random_planner,
)
from pepperscene.learning.tasks.view_scenes import ViewScene, ViewTask, covered_fraction, view_scenes
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.user_code import user_errors

FloatArray = NDArray[np.float64]

ORACLE: Final = "oracle"
"""Line of the table of the views that see most of what was not seen before, which no planner knows."""

PLANNERS: Final[Mapping[str, Planner]] = {
    "random": random_planner,
    "arc": arc_planner,
    "voxels": VoxelPlanner(),
}
"""Baselines by name."""

_RANDOM_RUNS: Final = 20  # chosen: the mean is known to a quarter of a run's spread

OnStage = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class PlannedViews:
    """What a planner reached.

    Attributes:
        coverage: `(s, k)` mean over the fruit of the seen fraction of their surface, of each scene after each
            view; of a random planner the mean of its runs.
        views: of each scene, the numbers of the views of its last run.
    """

    coverage: FloatArray
    views: tuple[tuple[int, ...], ...]


def evaluate_planners(
    recipe: str | Path | Recipe | ResolvedRecipe,
    planners: Mapping[str, Planner] | None = None,
    task: ViewTask | None = None,
    *,
    on_stage: OnStage | None = None,
) -> TaskResult:
    """Score planners of views by the fruit surface that was seen after each view.

    Args:
        recipe: a recipe, its name or its file; the first scene of each of its sets of plants is used.
        planners: by name; None for all `PLANNERS`. An own planner is a function of a `PlanningState`.
        task: conditions; None for the default.
        on_stage: called with the name of each stage that takes long.

    Raises:
        InputError: the recipe is not valid, no fruit is in reach, or a planner returns no candidate.
    """
    resolved = resolve_recipe(recipe)
    planned, most = plan_views(resolved, planners, task, on_stage=on_stage)
    views = next(iter(planned.values())).coverage.shape[1]
    shown = sorted({1, 2, 3, 5, views} & set(range(1, views + 1)))
    measures = (
        *(
            TaskMeasure(f"coverage_{view}", f"{view} view{'s' if view > 1 else ''}, %", 1, 100.0)
            for view in shown
        ),
        TaskMeasure("mean", "mean, %", 1, 100.0),
    )
    scores = []
    for name, result in planned.items():
        mean = result.coverage.mean(axis=0)
        values = {f"coverage_{view}": float(mean[view - 1]) for view in range(1, views + 1)}
        scores.append(Score(name, "", {**values, "mean": float(mean.mean())}))
    scenes = f"{len(most)} scene{'' if len(most) == 1 else 's'}"
    notes = (
        f"all candidates together: {100 * float(np.mean(most)):.1f} %",
        "mean: over the numbers of views",
    )
    title = f"Next best view: {resolved.recipe.name}, {scenes}, fruit surface seen"
    return TaskResult("next_best_view", title, measures, tuple(scores), notes=notes)


def plan_views(
    recipe: ResolvedRecipe,
    planners: Mapping[str, Planner] | None = None,
    task: ViewTask | None = None,
    *,
    on_stage: OnStage | None = None,
) -> tuple[dict[str, PlannedViews], FloatArray]:
    """What planners reach in each scene, and `(s,)` what all candidates see together.

    Other arguments and errors are those of `evaluate_planners`.
    """
    notify = on_stage or (lambda _: None)
    used = PLANNERS if planners is None else planners
    names = (*used, ORACLE)
    coverage: dict[str, list[FloatArray]] = {name: [] for name in names}
    views: dict[str, list[tuple[int, ...]]] = {name: [] for name in names}
    most = []
    for scene in view_scenes(recipe, task or ViewTask(), on_stage):
        notify(f"observing scene {scene.spec.scene} from {len(scene.candidates)} views")
        if not len(scene.fruit):
            raise InputError(
                recipe.recipe.name, f"has no fruit opposite the workspace in scene {scene.spec.scene}"
            )
        most.append(covered_fraction(scene, range(len(scene.candidates)))[-1])
        for name in names:
            notify(f"planning views of scene {scene.spec.scene}: {name}")
            runs = [oracle_views(scene)]
            if (planner := used.get(name)) is not None:
                count = _RANDOM_RUNS if planner is random_planner else 1
                runs = [_run(name, planner, scene, run) for run in range(count)]
            coverage[name].append(np.mean([covered_fraction(scene, run) for run in runs], axis=0))
            views[name].append(tuple(runs[-1]))
    planned = {name: PlannedViews(np.array(coverage[name]), tuple(views[name])) for name in names}
    return planned, np.array(most)


def _run(name: str, planner: Planner, scene: ViewScene, run: int) -> list[int]:
    """The views of a planner in a scene, the start first."""
    taken = [scene.start]
    rng = scene.rng(run)
    while len(taken) < scene.task.views:
        state = PlanningState(
            scene.candidates, scene.camera, scene.task.target, tuple(taken), scene.task.views, scene.arc, rng,
            scene.observe,
        )  # fmt: skip
        taken.append(_choose(name, planner, state))
    return taken


def _choose(name: str, planner: Planner, state: PlanningState) -> int:
    with user_errors(name):
        number = planner(state)
    count = len(state.candidates)
    if isinstance(number, bool) or not isinstance(number, Integral) or not 0 <= int(number) < count:
        raise InputError(
            name, f"must return the number of a candidate, from 0 to {count - 1}, not {number!r}"
        )
    return int(number)

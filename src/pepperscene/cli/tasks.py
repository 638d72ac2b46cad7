"""The command `task`: benchmark tasks, their baselines, and the predictions of users."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

import typer

from pepperscene.cli.application import JsonOption, command, print_json, print_tables
from pepperscene.cli.progress import echo_progress, image_progress
from pepperscene.errors import ArgumentError, InputError
from pepperscene.options import Option

if TYPE_CHECKING:
    from pepperscene.learning.tasks.result import TaskResult

Found = TypeVar("Found")


@dataclass(frozen=True)
class TaskOptions:
    """What is scored in a task, and under which conditions; each task has some of them."""

    baseline: Annotated[tuple[str, ...], Option("Baseline to score; repeatable. Default: all.", "NAME")] = ()
    predictions: Annotated[
        tuple[Path, ...],
        Option("Folder of predictions to score, a file for each frame; repeatable.", "DIR"),
    ] = ()
    method: Annotated[
        tuple[str, ...],
        Option("Python function to score: of depth or of views; repeatable.", "MODULE:NAME"),
    ] = ()
    allow_code: Annotated[bool, Option("Allow the code of --method to run.")] = False
    split: Annotated[str | None, Option("Splits, as for `export`. Default: train=.8,test=.2.", "TEXT")] = None
    out: Annotated[Path | None, Option("Folder of the networks that cross_sensor trains.", "DIR")] = None
    steps: Annotated[int | None, Option("Steps of their training. Default: 300.", "N")] = None
    twin: Annotated[int | None, Option("Twin that methods of cross_sensor learn from. Default: 0.", "N")] = (
        None
    )
    views: Annotated[int | None, Option("Views of next_best_view. Default: 10.", "N")] = None
    candidates: Annotated[int | None, Option("Random views that it chooses from. Default: 300.", "N")] = None
    box: Annotated[
        str | None,
        Option(
            "Workspace of its camera, in millimetres. Default: -500,500,-700,-300,1000,1800.",
            "X0,X1,Y0,Y1,Z0,Z1",
        ),
    ] = None
    set: Annotated[
        tuple[str, ...],
        Option("Change one value of the recipe (camera.flash=none); can be repeated.", "KEY=VALUE"),
    ] = ()

    def check(self, *allowed: str) -> None:
        """Raise `ArgumentError` if an option is given that the task does not have."""
        for name, value in vars(self).items():
            if name not in ("baseline", "allow_code", *allowed) and value not in (None, ()):
                raise ArgumentError(name, "does not apply to this task")

    @property
    def needs_baselines(self) -> bool:
        """Whether all baselines are scored, as nothing is named."""
        return not (self.baseline or self.predictions or self.method)

    def select(self, known: Mapping[str, Found]) -> dict[str, Found]:
        """The baselines to score, by name."""
        unknown = [name for name in self.baseline if name not in known]
        if unknown:
            raise ArgumentError("baseline", f"must be one of {', '.join(known)}, not {unknown[0]!r}")
        return dict(known) if self.needs_baselines else {name: known[name] for name in self.baseline}

    def load_methods(self) -> dict[str, Callable[..., Any]]:
        """The functions of the user, by their text."""
        from pepperscene.user_code import import_callable

        for text in self.method:
            module, _, name = text.partition(":")
            if not module or not name:
                raise ArgumentError("method", f"must be module:function, not {text!r}")
        return {text: import_callable(text, "method", allow_code=self.allow_code) for text in self.method}


@command
def task(
    name: Annotated[
        str,
        typer.Argument(
            metavar="TASK", help="depth_completion, next_best_view, cross_sensor, ripeness or chlorophyll."
        ),
    ],
    source: Annotated[
        str, typer.Argument(metavar="SOURCE", help="Folder of a data set; of next_best_view, a recipe.")
    ],
    options: TaskOptions,
    json: JsonOption = False,
) -> None:
    """Score methods in a benchmark task: its baselines, folders of predictions, or Python functions."""
    if name not in _TASKS:
        raise InputError("task", f"must be one of {', '.join(_TASKS)}, not {name!r}")
    result = _TASKS[name](source, options)
    if json:
        print_json(result.to_json())
    else:
        print_tables([result.table()])


def _depth(source: str, options: TaskOptions) -> TaskResult:
    from pepperscene.learning.tasks.depth_baselines import BASELINES
    from pepperscene.learning.tasks.depth_task import evaluate_depth

    options.check("predictions", "method", "split")
    methods = {**options.select(BASELINES), **options.load_methods()}
    with image_progress("scored", "frames") as on_progress:
        return evaluate_depth(
            source, methods, options.predictions, split=options.split, on_progress=on_progress
        )


def _views(source: str, options: TaskOptions) -> TaskResult:
    from pepperscene.cli.viewpoints import parse_box
    from pepperscene.learning.tasks.view_scenes import ViewTask
    from pepperscene.learning.tasks.view_task import PLANNERS, evaluate_planners
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    options.check("method", "views", "candidates", "box", "set")
    planners = {**options.select(PLANNERS), **options.load_methods()}
    given: dict[str, Any] = {"views": options.views, "candidates": options.candidates}
    given["box"] = None if options.box is None else parse_box(options.box)
    conditions = ViewTask(**{key: value for key, value in given.items() if value is not None})
    recipe = resolve_recipe(source, parse_changes(options.set))
    return evaluate_planners(recipe, planners, conditions, on_stage=echo_progress)


def _sensors(source: str, options: TaskOptions) -> TaskResult:
    from pepperscene.cli.learning import require_torch
    from pepperscene.cli.progress import training_progress
    from pepperscene.learning.tasks.sensor_task import SENSOR_BASELINES, TRAINING, evaluate_sensors

    options.check("predictions", "split", "out", "steps", "twin")
    names = tuple(options.select(SENSOR_BASELINES))
    if names:
        require_torch()
    training = TRAINING if options.steps is None else replace(TRAINING, steps=options.steps)
    training.completed()
    with training_progress() as on_progress:
        return evaluate_sensors(
            source,
            names,
            options.predictions,
            out=options.out,
            twin=options.twin or 0,
            split=options.split,
            options=training,
            on_training=lambda _, progress: on_progress(progress),
        )


def _trait(name: str, source: str, options: TaskOptions) -> TaskResult:
    from pepperscene.learning.tasks.trait_regression import REGRESSIONS
    from pepperscene.learning.tasks.trait_task import evaluate_trait

    options.check("predictions", "split")
    # Not all baselines suit all bands.
    methods = None if options.needs_baselines else options.select(REGRESSIONS)
    with image_progress("read", "frames") as on_progress:
        return evaluate_trait(
            name, source, methods, options.predictions, split=options.split, on_progress=on_progress
        )


_TASKS: Final[Mapping[str, Callable[[str, TaskOptions], TaskResult]]] = {
    "depth_completion": _depth,
    "next_best_view": _views,
    "cross_sensor": _sensors,
    "ripeness": partial(_trait, "ripeness"),
    "chlorophyll": partial(_trait, "chlorophyll"),
}

"""The command `task`: benchmark tasks, their baselines, and the predictions of users."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

import typer

from pepperscene.cli.application import JsonOption, SetOption, app, handle_errors, print_ruled_table
from pepperscene.cli.progress import echo_progress, image_progress
from pepperscene.errors import ArgumentError, InputError

if TYPE_CHECKING:
    from pepperscene.learning.tasks.result import TaskResult

Found = TypeVar("Found")


@dataclass(frozen=True)
class _Request:
    """The options of the command, without its task."""

    source: str
    baselines: tuple[str, ...]
    predictions: tuple[Path, ...]
    methods: tuple[str, ...]
    split: str | None
    out: Path | None
    steps: int | None
    twin: int | None
    views: int | None
    candidates: int | None
    box: str | None
    changes: tuple[str, ...]
    allow_code: bool

    def check(self, *allowed: str) -> None:
        """Raise `ArgumentError` if an option is given that the task does not have."""
        for name, value in vars(self).items():
            if name not in ("source", "baselines", "allow_code", *allowed) and value not in (None, ()):
                option = {"changes": "set"}.get(name, name.removesuffix("s") if name == "methods" else name)
                raise ArgumentError(option, "does not apply to this task")

    @property
    def needs_baselines(self) -> bool:
        """Whether all baselines are scored, as nothing is named."""
        return not (self.baselines or self.predictions or self.methods)

    def select(self, known: Mapping[str, Found]) -> dict[str, Found]:
        """The baselines to score, by name."""
        unknown = [name for name in self.baselines if name not in known]
        if unknown:
            raise ArgumentError("baseline", f"must be one of {', '.join(known)}, not {unknown[0]!r}")
        return dict(known) if self.needs_baselines else {name: known[name] for name in self.baselines}

    def load_methods(self) -> dict[str, Callable[..., Any]]:
        """The functions of the user, by their text."""
        from pepperscene.learning.user_callable import import_callable

        for text in self.methods:
            module, _, name = text.partition(":")
            if not module or not name:
                raise ArgumentError("method", f"must be module:function, not {text!r}")
        return {text: import_callable(text, "method", allow_code=self.allow_code) for text in self.methods}


@app.command()
@handle_errors
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
    baseline: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Baseline to score; repeatable. Default: all.")
    ] = None,
    predictions: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DIR", help="Folder of predictions to score, a file for each frame; repeatable."
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            metavar="MODULE:NAME", help="Python function to score: of depth or of views; repeatable."
        ),
    ] = None,
    allow_code: Annotated[
        bool, typer.Option("--allow-code", help="Allow the code of --method to run.")
    ] = False,
    split: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Splits, as for `export`. Default: train=.8,test=.2."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the networks that cross_sensor trains.")
    ] = None,
    steps: Annotated[
        int | None, typer.Option(metavar="N", help="Steps of their training. Default: 300.")
    ] = None,
    twin: Annotated[
        int | None,
        typer.Option(metavar="N", help="Twin that methods of cross_sensor learn from. Default: 0."),
    ] = None,
    views: Annotated[
        int | None, typer.Option(metavar="N", help="Views of next_best_view. Default: 10.")
    ] = None,
    candidates: Annotated[
        int | None, typer.Option(metavar="N", help="Random views that it chooses from. Default: 300.")
    ] = None,
    box: Annotated[
        str | None,
        typer.Option(
            metavar="X0,X1,Y0,Y1,Z0,Z1",
            help="Workspace of its camera, in millimetres. Default: -500,500,-700,-300,1000,1800.",
        ),
    ] = None,
    set: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Score methods in a benchmark task: its baselines, folders of predictions, or Python functions."""
    if name not in _TASKS:
        raise InputError("task", f"must be one of {', '.join(_TASKS)}, not {name!r}")
    request = _Request(
        source, tuple(baseline or ()), tuple(predictions or ()), tuple(method or ()), split, out, steps, twin,
        views, candidates, box, tuple(set or ()), allow_code,
    )  # fmt: skip
    result = _TASKS[name](request)
    if json:
        typer.echo(json_text.dumps(result.to_json(), indent=1, allow_nan=False))
        return
    _print(result)


def _print(result: TaskResult) -> None:
    from pepperscene.colour.comparison.tables import format_tables

    table = result.table()
    if sys.stdout.isatty():
        print_ruled_table(table.heads, table.rows, table.title, table.notes)
    else:
        typer.echo(format_tables([table]))


def _depth(request: _Request) -> TaskResult:
    from pepperscene.learning.tasks.depth_baselines import BASELINES
    from pepperscene.learning.tasks.depth_task import evaluate_depth

    request.check("predictions", "methods", "split")
    methods = {**request.select(BASELINES), **request.load_methods()}
    with image_progress("scored", "frames") as on_progress:
        return evaluate_depth(
            request.source, methods, request.predictions, split=request.split, on_progress=on_progress
        )


def _views(request: _Request) -> TaskResult:
    from pepperscene.cli.viewpoints import parse_box
    from pepperscene.learning.tasks.view_scenes import ViewTask
    from pepperscene.learning.tasks.view_task import PLANNERS, evaluate_planners
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    request.check("methods", "views", "candidates", "box", "changes")
    planners = {**request.select(PLANNERS), **request.load_methods()}
    given: dict[str, Any] = {"views": request.views, "candidates": request.candidates}
    given["box"] = None if request.box is None else parse_box(request.box)
    conditions = ViewTask(**{key: value for key, value in given.items() if value is not None})
    recipe = resolve_recipe(request.source, parse_changes(request.changes))
    return evaluate_planners(recipe, planners, conditions, on_stage=echo_progress)


def _sensors(request: _Request) -> TaskResult:
    from pepperscene.cli.learning import require_torch
    from pepperscene.cli.training_progress import training_progress
    from pepperscene.learning.tasks.sensor_task import SENSOR_BASELINES, TRAINING, evaluate_sensors

    request.check("predictions", "split", "out", "steps", "twin")
    names = tuple(request.select(SENSOR_BASELINES))
    if names:
        require_torch()
    options = TRAINING if request.steps is None else replace(TRAINING, steps=request.steps)
    options.completed()
    with training_progress() as on_progress:
        return evaluate_sensors(
            request.source,
            names,
            request.predictions,
            out=request.out,
            twin=request.twin or 0,
            split=request.split,
            options=options,
            on_training=lambda _, progress: on_progress(progress),
        )


def _trait(name: str, request: _Request) -> TaskResult:
    from pepperscene.learning.tasks.trait_regression import REGRESSIONS
    from pepperscene.learning.tasks.trait_task import evaluate_trait

    request.check("predictions", "split")
    # Not all baselines suit all bands.
    methods = None if request.needs_baselines else request.select(REGRESSIONS)
    with image_progress("read", "frames") as on_progress:
        return evaluate_trait(
            name, request.source, methods, request.predictions, split=request.split, on_progress=on_progress
        )


_TASKS: Final[Mapping[str, Callable[[_Request], TaskResult]]] = {
    "depth_completion": _depth,
    "next_best_view": _views,
    "cross_sensor": _sensors,
    "ripeness": partial(_trait, "ripeness"),
    "chlorophyll": partial(_trait, "chlorophyll"),
}

"""Commands for networks: train, evaluate, predict and experiments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pepperscene.cli.application import JsonOption, LabelOptions, command, print_json, print_tables
from pepperscene.cli.options import Only, parse_size
from pepperscene.cli.progress import Throttle, echo_progress, image_progress, training_progress
from pepperscene.errors import ArgumentError, InputError, SetupError
from pepperscene.learning.class_table import ClassTable, parse_shares
from pepperscene.learning.options import (
    DECIDED_SCORE,
    MEASURES,
    ExperimentOptions,
    TrainingOptions,
    is_built_in,
    parse_classes,
)
from pepperscene.options import Option, check_options

if TYPE_CHECKING:
    from pepperscene.learning.evaluation.detection import DetectionEvaluation
    from pepperscene.learning.evaluation.evaluation import Evaluation
    from pepperscene.learning.models.trained_model import TrainedModel

SetsArgument = Annotated[
    list[Path], typer.Argument(metavar="SET...", help="Folders of labelled images, in any layout.")
]
ModelArgument = Annotated[Path, typer.Argument(metavar="MODEL", help="File of a trained model.")]


@command
def train(
    *,
    context: typer.Context,
    sets: SetsArgument,
    out: Annotated[Path, typer.Option(metavar="MODEL", help="New or empty folder for the model.")],
    validation: Annotated[
        list[Path] | None,
        typer.Option(metavar="SET", help="Images that choose the best state of the network; repeatable."),
    ] = None,
    start: Annotated[
        Path | None, typer.Option(metavar="MODEL", help="Trained model whose weights are adapted.")
    ] = None,
    match: Annotated[
        list[Path] | None,
        typer.Option(metavar="FOLDER", help="Unlabelled images whose colours are imitated; repeatable."),
    ] = None,
    options: TrainingOptions,
    resume: Annotated[bool, typer.Option("--resume", help="Resume the training in the folder.")] = False,
    meaning: LabelOptions,
) -> None:
    """Train a network to separate the classes of labelled images, or to find objects (--task detect)."""
    from pepperscene.dataset.readers.open import open_image_sets

    # Find errors in the arguments before torch is imported, which takes seconds.
    names_model = _is_given(context, "model")
    if names_model and start is not None and is_built_in(options.model):
        raise InputError("--model", "cannot be combined with --start, which has a model")
    options.completed()
    opened = open_image_sets([*sets, *(validation or [])], **vars(meaning))
    matched = open_image_sets(match or [])
    require_torch()
    from pepperscene.learning.models.trained_model import load_model
    from pepperscene.learning.training.run import train as train_model

    origin = None
    if start is not None:
        factory = options.model if names_model else None
        origin = load_model(start, factory=factory, allow_code=options.allow_code)
        if names_model and is_built_in(origin.model):
            raise InputError("--model", "cannot be combined with --start, which has a model")
        if not _is_given(context, "width"):
            options = replace(options, width=origin.width)
        if not _is_given(context, "task"):
            options = replace(options, task=origin.task)
    try:
        with training_progress() as on_progress:
            network = train_model(
                opened[: len(sets)],
                out,
                options,
                validation=opened[len(sets) :],
                start=origin,
                match=matched,
                resume=resume,
                on_progress=on_progress,
            )
    except KeyboardInterrupt as error:
        error.add_note("the last checkpoint is kept; run the same command with --resume to continue")
        raise
    found = network.training[f"validation_{MEASURES[network.task]}"]
    title = "AP50" if network.task == "detect" else "mean IoU"
    quality = "" if found is None else f", {title} {found:.3f} of the validation"
    typer.echo(f"trained, step {network.training['step']:,}{quality}: {out}")


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


@dataclass(frozen=True)
class ModelUse:
    """How a trained model is applied."""

    factory: Annotated[
        str | None,
        Option(
            "Function that makes the model's network, with options, if it was trained with one.",
            "MODULE:NAME",
        ),
    ] = None
    allow_code: Annotated[bool, Option("Allow the code of --factory to run.")] = False
    classes: Annotated[
        str | None,
        Option(
            "Classes that the model's are merged to (fruit=pepper,other=leaf+stem). Default: the model's.",
            "TEXT",
        ),
    ] = None
    score: Annotated[
        float | None,
        Option(
            "Least score of a detector's objects: those that precision and recall count, or that are drawn. "
            "Default: 0.3.",
            "F",
            minimum=0,
            maximum=1,
        ),
    ] = None
    least_area: Annotated[
        int,
        Option(
            "Least pixels of a region of fruit and peduncles; smaller ones are left out.", "PX", minimum=0
        ),
    ] = 0
    grow: Annotated[
        int,
        Option("Pixels by which regions of fruit and peduncles are enlarged.", "PX", minimum=0, maximum=50),
    ] = 0
    prior: Annotated[
        str | None,
        Option(
            "Shares of classes in the pixels of the images (fruit=0.04,peduncle=0.003), or a folder of "
            "unlabelled images, in which they are estimated. Default: as in the training.",
            "TEXT|FOLDER",
        ),
    ] = None

    def table(self, task: str) -> ClassTable | None:
        """The classes of a model for a task."""
        return None if self.classes is None else parse_classes(task, self.classes)

    def load(self, path: Path) -> TrainedModel:
        """The model of a file."""
        check_options(self)
        require_torch()
        from pepperscene.learning.models.trained_model import load_model

        try:
            network = load_model(path, factory=self.factory, allow_code=self.allow_code)
        except ArgumentError as error:
            # The text of a model is the option --model elsewhere.
            where = "factory" if error.where == "model" else error.where
            raise ArgumentError(where, error.problem, key=error.key, value=error.value) from None
        if self.factory is not None and is_built_in(network.model):
            raise ArgumentError("factory", f"does not apply to {network.model}, a model of this package")
        if self.score is not None and network.task != "detect":
            raise ArgumentError(
                "score", "applies to the objects of a detector, and the model has classes of pixels"
            )
        if self.prior is not None:
            network = self._with_prior(network, self.prior)
        return network.with_regions(self.least_area, self.grow) if self.least_area or self.grow else network

    def _with_prior(self, network: TrainedModel, prior: str) -> TrainedModel:
        """The network for images with other shares of classes."""
        from pepperscene.dataset.readers.open import open_images
        from pepperscene.learning.evaluation.evaluate import with_shares

        if network.task == "detect":
            raise ArgumentError("prior", "applies to pixels, and not to the objects of a detector")
        table = self.table(network.task)
        if "=" in prior and not Path(prior).exists():
            return with_shares(network, parse_shares(prior), table)
        return with_shares(network, [open_images(prior)], table)


@command
def evaluate(
    model: ModelArgument,
    sets: SetsArgument,
    use: ModelUse,
    meaning: LabelOptions,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write evaluation.json and evaluation.html there.")
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Evaluate at most this many images of each set.")
    ] = None,
    regions: Annotated[
        bool, typer.Option("--regions", help="Without instances, connected regions are a detector's objects.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Compare a model's predictions with the masks of images: IoU, precision, recall and confusion.

    The objects of a detector are compared by COCO's average precision.
    """
    from pepperscene.atomic import check_can_write
    from pepperscene.dataset.readers.open import open_image_sets
    from pepperscene.learning.evaluation.evaluate import evaluate as evaluate_model
    from pepperscene.learning.evaluation.page import JSON_NAME, PAGE_NAME, write_evaluation

    # Find errors before the first image is predicted: an evaluation can take hours.
    images = open_image_sets(sets, **vars(meaning))
    if out is not None:
        check_can_write(out, (JSON_NAME, PAGE_NAME))
    network = use.load(model)
    table = use.table(network.task)

    with image_progress("evaluated") as on_progress:
        options: dict[str, Any] = {"classes": table, "limit": limit, "on_progress": on_progress}
        result: Evaluation | DetectionEvaluation
        if network.task == "detect":
            from pepperscene.learning.evaluation.detection import evaluate_detector

            score = DECIDED_SCORE if use.score is None else use.score
            result = evaluate_detector(network, images, least_score=score, regions=regions, **options)
        else:
            result = evaluate_model(network, images, **options)
    files = None if out is None else write_evaluation(result, network, images, out)
    if json:
        print_json(result.to_json())
        return
    print_tables(result.tables())
    if files is not None:
        typer.echo(f"\n{files.data}\n{files.page}")


@command
def predict(
    model: ModelArgument,
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGES...", help="Pictures, or folders of images in any layout.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New or empty folder for the class images.")],
    use: ModelUse,
    meaning: Annotated[LabelOptions, Only("half")],
) -> None:
    """Write the classes that a model predicts for images: class ids and class colours as PNG.

    The objects of a detector are written as pictures with outlines, and as COCO's results.
    """
    from pepperscene.learning.evaluation.predict import predict as predict_images

    network = use.load(model)
    table = use.table(network.task)
    score = DECIDED_SCORE if use.score is None else use.score
    with image_progress("predicted") as on_progress:
        result = predict_images(
            network, images, out, classes=table, half=meaning.half, least_score=score, on_progress=on_progress
        )
    count = len(result.names)
    typer.echo(f"{count:,} image{'' if count == 1 else 's'} predicted: {result.folder}")


@command
def export_model(
    model: ModelArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="File to write, such as model.onnx.")],
    use: Annotated[ModelUse, Only("factory", "allow_code")],
    size: Annotated[
        str | None,
        typer.Option(
            metavar="WxH", help="Size of the images that it takes. Default: the model's width, 4 to 3."
        ),
    ] = None,
) -> None:
    """Write a model as an ONNX file, which runs without torch, and compare it with torch."""
    chosen = None if size is None else parse_size(size)
    network = use.load(model)
    from pepperscene.learning.models.onnx_export import export_model as export

    written = export(network, out, chosen)
    height, width = written.size
    typer.echo(f"{written.file}: images of {width}x{height}, at most {written.difference:.1e} from torch")


@command
def experiments(
    *,
    recipes: Annotated[
        list[str],
        typer.Argument(metavar="RECIPES...", help="Recipes to build, or folders of synthetic sets."),
    ],
    real: Annotated[Path, typer.Option(metavar="FOLDER", help="Photographs with masks, in any layout.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the results; created if missing.")],
    other: Annotated[
        Path | None,
        typer.Option(metavar="SET", help="Unrelated set or trained model, which experiment D starts from."),
    ] = None,
    meaning: Annotated[LabelOptions, Only("labels")],
    options: ExperimentOptions,
) -> None:
    """Train networks on synthetic and on real images, and compare them on photographs.

    Run the same command again to resume.
    """
    require_torch()
    from pepperscene.learning.experiments.run import run_experiments

    try:
        files = run_experiments(
            recipes, real, out, options, other=other, labels=meaning.labels, on_message=_message_printer()
        )
    except KeyboardInterrupt as error:
        error.add_note("run the same command again to resume")
        raise
    for item in files.content["experiments"]:
        typer.echo(_format_result(item))
    typer.echo(f"\n{files.data}\n{files.page}")


def _message_printer() -> Callable[[str, bool], None]:
    """Function that prints messages to standard error, frequent ones every few seconds."""
    throttle = Throttle()

    def show(text: str, is_frequent: bool) -> None:
        if throttle.allows(not is_frequent):
            echo_progress(text)

    return show


def _format_result(item: dict[str, object]) -> str:
    """One line of an experiment's mean IoU."""
    from pepperscene.learning.experiments.page import format_measure

    heading = f"{item['key']}: {item['title']}"
    if not item["ran"]:
        return f"{heading}: not run, {item['why']}"
    measures = item["measures"]
    assert isinstance(measures, list)
    values = ", ".join(f"{measure['name']} {format_measure(measure)}" for measure in measures)
    return f"{heading}: IoU in %: {values}"


def require_torch() -> None:
    """Raise `SetupError` if torch is not installed."""
    from importlib.util import find_spec

    if find_spec("torch") is None:
        raise SetupError("torch is not installed; install it with `pip install 'pepperscene[learn]'`")

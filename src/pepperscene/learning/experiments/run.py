"""The experiments of the paper (section 2.8): from recipes and photographs to a page."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pepperscene.atomic import canonical_json, check_can_write, write_files, write_json
from pepperscene.colour.comparison.bootstrap import LEVEL, REPLICATES
from pepperscene.document import parse_json
from pepperscene.errors import InputError, OutputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.experiments.jobs import (
    MERGED,
    NO_OTHER,
    TITLES,
    JobRunner,
    NetworkJob,
    schedule_jobs,
)
from pepperscene.learning.experiments.page import experiments_page, picture_rows
from pepperscene.learning.experiments.results import ExperimentResult, collect_result, compare_results
from pepperscene.learning.experiments.sets import (
    ExperimentSets,
    Sources,
    find_sources,
    make_sets,
)
from pepperscene.learning.models.registry import build_model
from pepperscene.learning.models.trained_model import load_model
from pepperscene.learning.options import ExperimentOptions, is_built_in
from pepperscene.learning.training.checkpoint import first_difference
from pepperscene.learning.training.run import describe_images, used_versions
from pepperscene.user_files import read_file

JSON_NAME: Final = "experiments.json"
PAGE_NAME: Final = "experiments.html"
SETTINGS: Final = "settings.json"
FORMAT: Final = "pepperscene experiments 1"

_DIFFERENCES: Final = (("E", "C"), ("B", "C"), ("E", "B"), ("D", "C"), ("E", "D"))


@dataclass(frozen=True)
class ExperimentFiles:
    """Files of the experiments: JSON and HTML, and the content of the JSON file."""

    data: Path
    page: Path
    content: Mapping[str, Any]


def run_experiments(
    recipes: Sequence[str | Path],
    real: str | Path,
    out: str | Path,
    options: ExperimentOptions | None = None,
    *,
    other: str | Path | None = None,
    labels: str | None = None,
    on_message: Callable[[str, bool], None] | None = None,
) -> ExperimentFiles:
    """Run experiments A to E of the paper, and write their results into a folder.

    Frames, trainings and tests that the folder holds already are not repeated, so that the same call resumes
    after an interruption.

    Args:
        recipes: names or files of recipes, whose frames are built, or folders of sets that exist.
        real: folder of photographs with masks, in any layout.
        out: the folder; new, empty, or of the same experiments.
        options: see `ExperimentOptions`.
        other: trained model, or folder of a set, that is not related, for experiment D; None to leave it out.
        labels: meaning of the masks of folders of images without a `classes.toml`.
        on_message: called with a line about what is being done, and whether it is one of many that can be
            left out.

    Raises:
        InputError: an argument, a recipe or a set is not valid.
        OutputError: the folder holds something else, or cannot be written to.
    """
    chosen, folder = (options or ExperimentOptions()).completed(), Path(out)
    show = on_message or (lambda _text, _is_frequent: None)
    check_can_write(folder, (JSON_NAME, PAGE_NAME, SETTINGS))
    sources = find_sources(recipes, real, chosen, other, labels)
    _check_model(sources, chosen)
    _claim_folder(folder, {"format": FORMAT, "options": chosen.as_record(), **sources.describe()})

    # Build, train and test what is missing.
    sets = make_sets(sources, folder, chosen, lambda text: show(text, True))
    jobs = schedule_jobs(sets, chosen, sources.other)
    runner = JobRunner(folder, jobs, chosen.training, show)
    runner.run()

    # Write the results.
    results = _collect(jobs, runner)
    content = _content(chosen, sources, sets, jobs, runner, results)
    pictures = picture_rows(results, jobs, runner, sets.real, ClassTable.parse(chosen.classes))
    page = experiments_page(content, pictures, runner.times())
    data, page_file = write_files(
        folder, {JSON_NAME: canonical_json(content), PAGE_NAME: page.encode("utf-8", "replace")}
    )
    return ExperimentFiles(data, page_file, content)


def _check_model(sources: Sources, options: ExperimentOptions) -> None:
    """Raise `InputError` before the first frame is built if a model cannot be used.

    The unrelated one must know the classes, and that of the trainings may need to run code.
    """
    model, allow_code = options.training.model, options.training.allow_code
    if not is_built_in(model):
        build_model(model, len(ClassTable.parse(options.classes)), allow_code=allow_code)
    if isinstance(sources.other, Path):
        other = load_model(sources.other, factory=model, allow_code=allow_code)
        ClassTable.parse(options.classes).merging(other.classes, "--other")


def _claim_folder(folder: Path, settings: Mapping[str, Any]) -> None:
    """Note the settings in a new folder, or check that they are those of the folder."""
    file = folder / SETTINGS
    current = json.loads(canonical_json(settings))
    if not file.is_file():
        if folder.is_dir() and any(folder.iterdir()):
            raise OutputError(f"{folder}: is not empty and holds no experiments; choose another folder")
        folder.mkdir(parents=True, exist_ok=True)
        write_json(file, current)
        return
    content = read_file(file, "json")
    try:
        found = parse_json(content)
    except ValueError:
        raise InputError(file, "is damaged; choose another folder") from None
    if difference := first_difference(found, current):
        raise InputError(file, f"is of other experiments: {difference}; choose another folder")


def _collect(jobs: Sequence[NetworkJob], runner: JobRunner) -> dict[str, ExperimentResult]:
    """Results by key of the experiment."""
    evaluations: dict[str, dict[int, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    for job in jobs:
        for test in job.tests:
            evaluations[test.experiment][job.seed].append(runner.result(job, test))
    return {key: collect_result(key, evaluations[key]) for key in TITLES if key in evaluations}


def _content(
    options: ExperimentOptions,
    sources: Sources,
    sets: ExperimentSets,
    jobs: Sequence[NetworkJob],
    runner: JobRunner,
    results: Mapping[str, ExperimentResult],
) -> dict[str, Any]:
    """All results as JSON values; they do not depend on interruptions or on times."""
    experiments = [
        results[key].to_json(title)
        if key in results
        else {"key": key, "title": title, "ran": False, "why": NO_OTHER}
        for key, title in TITLES.items()
        if key in results or key != MERGED
    ]
    differences = [
        compare_results(results[first], results[second]).to_json()
        for first, second in _DIFFERENCES
        if first in results and second in results
    ]
    return {
        "format": FORMAT,
        "options": options.as_record(),
        "classes": options.classes,
        "interval": {"level": LEVEL, "replicates": REPLICATES},
        "experiments": experiments,
        "differences": differences,
        "synthetic": [
            {**describe_images(item.images), "split": item.split.rule, "parts": _sizes(item.split)}
            for item in sets.synthetic
        ],
        "real": {
            **describe_images(sets.real),
            "unlabelled": sources.unlabelled,
            "split": sets.folds[0].rule,
            "folds": [_sizes(fold) for fold in sets.folds],
        },
        "other": sources.describe()["other"],
        "trainings": [_training_json(job, runner) for job in jobs],
        "versions": used_versions(),
    }


def _sizes(split: Any) -> dict[str, int]:
    return {name: len(getattr(split, name)) for name in ("train", "validation", "test")}


def _training_json(job: NetworkJob, runner: JobRunner) -> dict[str, Any]:
    """What a training was, which state of its network was used, and its curves."""
    description = runner.load(job).training
    return {
        "name": job.name,
        "experiment": job.experiment,
        "seed": job.seed,
        "fold": job.fold,
        "steps": job.options.steps,
        "learning_rate": job.options.learning_rate,
        "start": None if job.start is None else job.start if isinstance(job.start, str) else job.start.name,
        "used_step": description["step"],
        "validation_mean_iou": description["validation_mean_iou"],
        "log": runner.log(job),
    }

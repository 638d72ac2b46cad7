"""Export of a data set to one of the formats."""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pepperscene.atomic import (
    SYSTEM_FILES,
    check_can_create,
    make_folder,
    remove,
    remove_temporary_files,
    temporary_path,
)
from pepperscene.classes import RIPE_FROM
from pepperscene.dataset.selection import Selection, parse_categories
from pepperscene.dataset.splits import Splits as Splits
from pepperscene.dataset.splits import read_splits, shared_plants
from pepperscene.dataset.splits import split_by_sets as split_by_sets
from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.dataset.store.fields import frame_indices, read_info
from pepperscene.dataset.store.recorded_values import fruit_name, recorded_values
from pepperscene.errors import ArgumentError, InputError, OutputError
from pepperscene.export.formats import FORMATS, ExportFormat
from pepperscene.export.job import ExportJob, ImageOptions, OnFrame, parse_foreground
from pepperscene.libraries import import_library
from pepperscene.recipe.plan import Plan
from pepperscene.shipped import is_file, shipped_folder


@dataclass(frozen=True)
class ExportResult:
    """Result of an export.

    Attributes:
        folder: of the export.
        frames: number of frames in it.
        files: number of files in it.
        splits: number of frames of each split.
        warnings: which splits show the same plants, and what separates them; which fruit has no label.
    """

    folder: Path
    frames: int
    files: int
    splits: Mapping[str, int]
    warnings: tuple[str, ...] = ()


KEEP: Final = "keep"
DROP: Final = "drop"
"""What is done with organs that the image border may cut."""

_FRAME_RATES: Final = (0.001, 10_000.0)  # as in a recipe
_DEFAULT_QUALITY: Final = "standard"  # of a build


def export_dataset(
    folder: str | Path,
    format_name: str,
    out: str | Path,
    split: str | None = None,
    frames: str | None = None,
    on_frame: OnFrame | None = None,
    smallest_px: int | None = None,
    *,
    classes: str | None = None,
    least_visible: float | None = None,
    ripe_from: float | None = None,
    truncated: str = "keep",
    frame_rate_hz: float | None = None,
    mask: str | None = None,
    alpha: bool = False,
    undistort: bool = False,
) -> ExportResult:
    """Write a data set in another format.

    Args:
        folder: of the data set.
        format_name: a name in `FORMATS`.
        out: a new or an empty folder.
        split: fractions, "train=.8,val=.1,test=.1", or ranges, "train=0:8750,val=8750:8800"; None for all
            frames as "train". With fractions, no plant is in two splits if the number of sets allows.
        frames: "A:B", indices A to B - 1; None for all existing frames.
        on_frame: called after every frame with its index, the number of frames done, and that of all.
        smallest_px: visible pixels below which an organ is not a separate object; None for the default.
        classes: "fruit=pepper,stalk=peduncle+stem,leaf", the classes that are exported as objects, in their
            order; see `parse_categories`. None for all organ classes; for yolo_pose, fruit.
        least_visible: visible fraction below which a fruit is not a separate object; needs the output
            harvest.
        ripe_from: least ripeness of ripe fruit. If it is given, a class of all fruit becomes two, such as
            "ripe pepper" and "unripe pepper". None for one class, and for 0.5 if `classes` has `pepper.ripe`
            or `pepper.unripe`. Ripeness needs the output harvest.
        frame_rate_hz: of the frames of a bag; None for the speed of the recipe's path or arc, or one second
            for each step of views without a speed.
        truncated: "keep", or "drop": an organ that the image border may cut is not a separate object.
        mask: "plant", "fruit" or classes such as "leaf+stem": what masks of images show, and the only points
            and depths. None for all that is not ignored.
        alpha: whether pictures have a fourth channel with the share of each pixel that shows the mask's
            classes, or else plants.
        undistort: whether images are resampled to those of a pinhole camera with its principal point in the
            middle.

    Raises:
        InputError: there is no data set or frame, an argument is invalid, an output missing, a file damaged.
        OutputError: the folder is not empty or cannot be written to.
        SetupError: a library that the format needs is not installed.
    """
    if format_name not in FORMATS:
        raise ArgumentError("format", f"unknown format {format_name!r}; allowed are {', '.join(FORMATS)}")
    export_format = FORMATS[format_name]
    options = {"smallest_px": smallest_px, "classes": classes, "least_visible": least_visible}
    options |= {"ripe_from": ripe_from, "truncated": None if truncated == KEEP else truncated}
    _check_options(options, export_format)
    _check_frame_rate(frame_rate_hz, export_format)
    images = _image_options(export_format, mask, alpha, undistort)
    dataset = open_dataset(folder)
    read_info(dataset)
    selection = _make_selection(options, export_format, dataset.info)
    indices = _select_frames(dataset, frames)
    members = read_splits(split, dataset.info["recipe"]["plan"], indices).members(indices)
    for name in members:
        if name in export_format.reserved:
            problem = f"{name} is not allowed in the format {format_name}, which uses the name otherwise"
            raise ArgumentError("split", problem)
    job = ExportJob(dataset, members, selection, on_frame, frame_rate_hz, images)
    if export_format.library:
        import_library(export_format.library, export_format.extra)
    required = export_format.required
    if selection.needs_harvest:
        required = (*required, ("harvest",))
    if selection.needs_organs:
        required = (*required, ("instance",))
    if (export_format.has_masks and job.has_ignored_pixels) or images.foreground is not None:
        required = (*required, ("class",))
    if images.cut_out is not None:
        required = (*required, ("class", "coverage"))
    _check_outputs(dataset, list(job.split_of), required)
    with new_folder(Path(out), dataset.folder) as temporary:
        export_format.write(job, temporary)
        files = sum(path.is_file() for path in temporary.rglob("*"))
    counts = {name: len(members) for name, members in job.splits.items()}
    shared = shared_plants(job.splits, dataset.info["recipe"]["plan"])
    unlabelled = _fruit_without_label(export_format, selection, dataset.info)
    warnings = tuple(text for text in (shared, unlabelled) if text)
    return ExportResult(Path(out), len(job.split_of), files, counts, warnings)


def _fruit_without_label(export_format: ExportFormat, selection: Selection, info: Mapping[str, Any]) -> str:
    """Warn of fruit in the images that a format leaves out, because its ripeness is not known; "" of none."""
    is_labelled = "labels" in recorded_values(info, "greenhouse.far_rows_as")
    if export_format.has_crowds or not selection.is_divided or not is_labelled:
        return ""
    if not any(recorded_values(info, "greenhouse.far_rows")):
        return ""
    return (
        "fruit of far rows has no label, because its ripeness is not known: a detector may learn that it is "
        "no fruit. Export all fruit as one class (fruit=pepper), or build with greenhouse.far_rows = 0"
    )


def _check_options(options: Mapping[str, Any], export_format: ExportFormat) -> None:
    """Raise `ArgumentError` if an option is not valid or does not apply to a format."""
    smallest_px = options["smallest_px"]
    if smallest_px is not None and smallest_px < 1:
        raise ArgumentError("smallest_px", f"{smallest_px} must be at least 1")
    if options["truncated"] not in (None, DROP):
        raise ArgumentError("truncated", f"{options['truncated']!r} must be {KEEP} or {DROP}")
    for name, value in options.items():
        if value is not None and export_format.smallest_px is None:
            raise ArgumentError(name, f"{value} does not apply: {export_format.name} has no objects")
    for name in ("least_visible", "ripe_from"):
        if options[name] is not None and not 0 <= options[name] <= 1:
            raise ArgumentError(name, f"{options[name]:g} must be 0 to 1")


def _check_frame_rate(frame_rate_hz: float | None, export_format: ExportFormat) -> None:
    low, high = _FRAME_RATES
    if frame_rate_hz is not None and not export_format.has_clock:
        raise ArgumentError("frame_rate", f"does not apply: frames of {export_format.name} have no times")
    if frame_rate_hz is not None and not low <= frame_rate_hz <= high:
        raise ArgumentError("frame_rate", f"{frame_rate_hz:g} must be {low:g} to {high:g} a second")


def _image_options(
    export_format: ExportFormat, mask: str | None, alpha: bool, undistort: bool
) -> ImageOptions:
    """The options of images; raises `ArgumentError` if one is not valid or does not apply to a format."""
    for name, value in (("mask", mask), ("alpha", alpha), ("undistort", undistort)):
        if value and name not in export_format.image_options:
            formats = [one.name for one in FORMATS.values() if name in one.image_options]
            raise ArgumentError(name, f"does not apply to {export_format.name}, only to {', '.join(formats)}")
    cut_out = parse_foreground(mask or "plant") if alpha else None
    return ImageOptions(None if mask is None else parse_foreground(mask), cut_out, undistort)


def _make_selection(
    options: Mapping[str, Any], export_format: ExportFormat, info: Mapping[str, Any]
) -> Selection:
    """The objects of an export from its valid options and the content of `dataset.json`."""
    if export_format.smallest_px is None:
        return Selection()
    classes, ripe_from = options["classes"], options["ripe_from"]
    classes = export_format.classes if classes is None else classes
    return Selection(
        parse_categories(classes, ripe_from, fruit_name(info), export_format.has_background),
        options["smallest_px"] or export_format.smallest_px,
        options["least_visible"] or 0,
        RIPE_FROM if ripe_from is None else ripe_from,
        options["truncated"] is None,
    )


def _select_frames(dataset: Dataset, frames: str | None) -> tuple[int, ...]:
    indices = frame_indices(dataset)
    if frames is None:
        return indices
    selection = set(Plan.model_validate(dataset.info["recipe"]["plan"]).select_indices(frames))
    selected = tuple(index for index in indices if index in selection)
    if not selected:
        raise ArgumentError("frames", f"{frames!r} holds none of the data set's frames")
    return selected


def _check_outputs(dataset: Dataset, indices: Sequence[int], required: tuple[tuple[str, ...], ...]) -> None:
    """Raise `InputError` if a frame lacks a required output, with the command that adds it."""
    for alternatives in required:
        for index in indices:
            if not any(dataset.path(index, output).is_file() for output in alternatives):
                problem = f"frame {index:06d} has no output {alternatives[0]!r}, which the format needs"
                raise InputError(dataset.folder, f"{problem}; {_adding_command(dataset, alternatives[0])}")


def _adding_command(dataset: Dataset, output: str) -> str:
    """The command that adds an output to a data set, as the end of a sentence.

    A data set does not hold the path of a user's recipe, nor the options that changed it.
    """
    info, recipe = dataset.info, str(dataset.info["recipe"]["name"])
    others = ""
    if not _is_shipped_recipe(recipe, info) or info.get("quality") != _DEFAULT_QUALITY:
        recipe, others = "RECIPE", ", with the recipe and the options that the data set was built with"
    command = f"build {recipe} --out {shlex.quote(str(dataset.folder))} --outputs {output}"
    return f"`pepperscene {command}` adds it{others}"


def _is_shipped_recipe(name: str, info: Mapping[str, Any]) -> bool:
    """Whether a data set was built with the shipped recipe of a name, unchanged."""
    from pepperscene.recipe.resolve.load import resolve_recipe

    if not is_file(shipped_folder("recipes") / f"{name}.toml"):
        return False
    return dict(resolve_recipe(name).identity)["recipe"] == info["recipe"]


@contextmanager
def new_folder(out: Path, source: Path | None) -> Iterator[Path]:
    """A temporary folder that becomes `out` if the block succeeds, and is removed if it fails.

    It is next to `out`. If `out` exists already (and is empty), it is inside, and its content moves up: a
    mounted folder can be filled but not replaced. All content is on the disk before the folder has its name.
    It must not be inside the `source`.
    """
    created: list[Path] = []
    try:
        _check_out(out, source)
        sibling = temporary_path(out.absolute().with_name(out.resolve().name))
        temporary = out / sibling.name if out.is_dir() else sibling
        try:
            make_folder(temporary.parent, created)
            remove_temporary_files(temporary.parent, f"{out.resolve().name}.")
            temporary.mkdir()
            yield temporary
            if hasattr(os, "sync"):
                # One call for all files: one for each of 100,000 takes minutes.
                os.sync()
            if out.is_dir():
                for path in sorted(temporary.iterdir()):
                    os.rename(path, out / path.name)
                temporary.rmdir()
            else:
                os.rename(temporary, out)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            remove(created)
            raise
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror or error})") from None


def _check_out(out: Path, source: Path | None) -> None:
    check_can_create(out)
    if source is not None and out.resolve().is_relative_to(source.resolve()):
        raise OutputError(f"{out}: is inside the data set {source}; choose another folder")
    content: list[str] = []
    if out.is_dir():
        # Those of an export that was killed do not count.
        remove_temporary_files(out)
        content = sorted(path.name for path in out.iterdir() if path.name not in SYSTEM_FILES)
    if content:
        raise OutputError(f"{out}: holds {content[0]!r}; choose an empty or a new folder")

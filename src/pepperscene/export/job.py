"""The frames of an export, their groups by scene, and what all writers share."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Final

from pepperscene.classes import PLANT_CLASSES, OrganClass, parse_class_mapping
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.fields import has_ignored_pixels
from pepperscene.errors import ArgumentError
from pepperscene.recipe.plan import FrameSpec, Plan

_PARTS: Final[dict[str, frozenset[int]]] = {
    "plant": frozenset(map(int, PLANT_CLASSES)),
    "fruit": frozenset({int(OrganClass.PEPPER)}),
    **{organ.name.lower(): frozenset({int(organ)}) for organ in OrganClass if organ},
}


@dataclass(frozen=True)
class ImageOptions:
    """How images differ from those of the data set.

    Attributes:
        foreground: class ids of what masks and points have; None for all that is not ignored.
        cut_out: class ids whose share of each pixel is a fourth channel of photographs; None for no such.
        is_undistorted: whether images are those of a pinhole camera whose principal point is in the middle.
    """

    foreground: frozenset[int] | None = None
    cut_out: frozenset[int] | None = None
    is_undistorted: bool = False


def parse_foreground(text: str) -> frozenset[int]:
    """The class ids of "plant", "fruit", or classes such as "leaf+stem".

    Raises:
        ArgumentError: a name is unknown, or occurs twice.
    """
    if "=" in text:
        raise ArgumentError("mask", f"{text!r} must be classes such as leaf+stem, without a name")
    mapping = parse_class_mapping(text.replace("+", ","), _PARTS, "mask")
    return frozenset[int]().union(*(_PARTS[name] for _, own in mapping for name in own))


OnFrame = Callable[[int, int, int], None]
"""Called after every frame with its index, the number of frames done, and the number of all."""


@dataclass(frozen=True, eq=False)
class ExportJob:
    """Input of an export."""

    dataset: Dataset
    splits: Mapping[str, tuple[int, ...]]  # ascending indices of each; none is empty
    selection: Selection = Selection()  # noqa: RUF009 - it is frozen
    on_frame: OnFrame | None = None
    frame_rate_hz: float | None = None  # of formats with a clock; None for that of the views
    images: ImageOptions = ImageOptions()

    @cached_property
    def plan(self) -> Plan:
        """Which frames there are, from the recipe."""
        return Plan.model_validate(self.dataset.info["recipe"]["plan"])

    @property
    def has_ignored_pixels(self) -> bool:
        """Whether frames can have pixels that training and evaluation must ignore."""
        return has_ignored_pixels(self.dataset.info)

    @property
    def has_masks(self) -> bool:
        """Whether images for reconstruction have masks."""
        return self.has_ignored_pixels or self.images.foreground is not None

    @cached_property
    def split_of(self) -> dict[int, str]:
        """The split of each frame, by ascending index."""
        pairs = [(index, name) for name, members in self.splits.items() for index in members]
        return dict(sorted(pairs))

    def frames(self, indices: Sequence[int] | None = None) -> Iterator[DatasetFrame]:
        """The frames in order of their indices, or of `indices`; each is done when the next is requested."""
        order = list(self.split_of) if indices is None else indices
        for done, index in enumerate(order, start=1):
            yield DatasetFrame(self.dataset, index)
            if self.on_frame is not None:
                self.on_frame(index, done, len(order))

    def frames_by_split(
        self, order: Callable[[Sequence[int]], Sequence[int]] = tuple
    ) -> Iterator[tuple[str, Iterator[DatasetFrame]]]:
        """The splits and their frames, in the given order; progress covers all of them."""
        return self.frames_by_group({split: order(indices) for split, indices in self.splits.items()})

    def frames_by_group(
        self, groups: Mapping[str, Sequence[int]]
    ) -> Iterator[tuple[str, Iterator[DatasetFrame]]]:
        """The names of groups of indices, and their frames; progress covers all of them."""
        frames = self.frames([index for indices in groups.values() for index in indices])
        for name, indices in groups.items():
            yield name, islice(frames, len(indices))
        # Report the last frame as done.
        next(frames, None)

    def common_outputs(self, outputs: Sequence[str]) -> tuple[str, ...]:
        """Those of some outputs that all frames have."""
        return tuple(
            output
            for output in outputs
            if all(self.dataset.path(index, output).is_file() for index in self.split_of)
        )


SAMPLE_OUTPUTS: Final = ("colour", "class", "instance", "distance", "harvest")
"""What samples for loaders contain, as far as all frames have it."""


def write_json(path: Path, content: Any) -> None:
    """Write JSON for people to read; raises `ValueError` for numbers that are not finite."""
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a CSV file with some of the values of rows."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def scene_groups(job: ExportJob) -> dict[str, tuple[int, ...]]:
    """The frames of each scene by the name of its folder, which is "." if there is only one.

    A scene is a rotation of a set of plants. Twins, whose images differ in light or camera, are scenes of
    their own.
    """
    plan, names = job.plan, {}
    for index in job.split_of:
        names[index] = _scene_name(plan, plan.frame(index))
    return _grouped(names)


def sequence_groups(job: ExportJob) -> dict[str, tuple[int, ...]]:
    """As `scene_groups`, for the frames of one split and one camera of a rig."""
    plan, names = job.plan, {}
    for index, split in job.split_of.items():
        spec = plan.frame(index)
        camera = f"_camera_{spec.camera}" if plan.cameras > 1 else ""
        names[index] = f"{split}/{_scene_name(plan, spec)}{camera}"
    if len(job.splits) == 1:
        names = {index: name.partition("/")[2] for index, name in names.items()}
    elif all(len({names[index] for index in members}) == 1 for members in job.splits.values()):
        # One sequence in each split.
        names = dict(job.split_of)
    return _grouped(names)


def open_groups(
    job: ExportJob, folder: Path, groups: Mapping[str, Sequence[int]]
) -> Iterator[tuple[Path, Sequence[int], Iterator[DatasetFrame]]]:
    """The folder of each group, which is made, its indices, and its frames, which must all be read."""
    for name, frames in job.frames_by_group(groups):
        (folder / name).mkdir(parents=True, exist_ok=True)
        yield folder / name, groups[name], frames


def scene_splits(job: ExportJob, indices: Sequence[int]) -> dict[str, list[int]]:
    """The splits of the frames of a scene, as readers want them; none if all frames of the export are in one.

    Readers that find the list of any split need those of `train`, `val` and `test`. A missing one is that of
    another split.
    """
    if len(job.splits) == 1:
        return {}
    members = {split: [i for i in indices if job.split_of[i] == split] for split in job.splits}
    members = {split: found for split, found in members.items() if found}
    first = next(iter(members))
    for name, substitute in (("train", first), ("val", "test"), ("test", "val")):
        members.setdefault(name, members.get(substitute, members[first]))
    return members


def training_frames(job: ExportJob, indices: Sequence[int]) -> list[DatasetFrame]:
    """Those of a scene's frames that training may use: of the split `train`, or all if it has none."""
    indices = scene_splits(job, indices).get("train", indices)
    return [DatasetFrame(job.dataset, index) for index in indices]


def _scene_name(plan: Plan, spec: FrameSpec) -> str:
    twin = f"_twin_{spec.twin}" if plan.twins > 1 else ""
    return f"set_{spec.set:03d}_rotation_{spec.rotation:03d}{twin}"


def _grouped(names: Mapping[int, str]) -> dict[str, tuple[int, ...]]:
    groups: dict[str, list[int]] = {}
    for index, name in names.items():
        groups.setdefault(name, []).append(index)
    if len(groups) == 1:
        return {".": tuple(names)}
    return {name: tuple(members) for name, members in groups.items()}

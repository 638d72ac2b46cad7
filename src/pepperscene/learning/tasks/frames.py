"""The frames of a data set that a task uses: those of one split, with the outputs that it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pepperscene.dataset.readers.open import RenderedSet
from pepperscene.dataset.splits import read_splits, shared_plants
from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.dataset.store.fields import frame_indices, read_info, read_output, read_outputs
from pepperscene.dataset.store.frame_json import DIGITS
from pepperscene.errors import ArgumentError, InputError

TRAIN: Final = "train"
TEST: Final = "test"

DEFAULT_SPLIT: Final = "train=.8,test=.2"
"""Chosen: enough plants to learn from. Of two sets of plants, each is one split."""


@dataclass(frozen=True, eq=False)
class TaskFrames:
    """Frames of one split of a data set.

    Attributes:
        dataset: that they belong to.
        split: its name, "train" or "test".
        indices: of the frames, ascending.
    """

    dataset: Dataset
    split: str
    indices: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.indices)

    @property
    def plan(self) -> dict[str, Any]:
        """The plan of the recipe."""
        return dict(self.dataset.info["recipe"]["plan"])

    def read(self, index: int, output: str) -> Any:
        """An output of a frame; raises `InputError` if it cannot be read."""
        return read_output(self.dataset, index, output)

    def images(self) -> RenderedSet:
        """The frames as a set of labelled images."""
        return RenderedSet.from_dataset(self.dataset).take(self._positions())

    def with_indices(self, indices: Sequence[int]) -> TaskFrames:
        """Some of the frames."""
        return TaskFrames(self.dataset, self.split, tuple(indices))

    def _positions(self) -> list[int]:
        places = {index: place for place, index in enumerate(self.dataset.indices())}
        return [places[index] for index in self.indices]


@dataclass(frozen=True, eq=False)
class TaskSplit:
    """The two splits of a data set.

    Attributes:
        train: frames to learn from; none if the user's splits have no such name.
        test: frames that are scored.
        note: a sentence if both show the same plants, else "".
    """

    train: TaskFrames
    test: TaskFrames
    note: str

    @property
    def notes(self) -> tuple[str, ...]:
        """The note as lines below a table."""
        return (f"note: {self.note}",) if self.note else ()


def open_task_frames(folder: str | Path, outputs: Sequence[str], split: str | None = None) -> TaskSplit:
    """Open a data set for a task.

    Args:
        folder: of the data set.
        outputs: that every frame of both splits must have.
        split: as for an export, with a split "test" and, for methods that learn, "train"; None for a fifth of
            the sets of plants as "test".

    Raises:
        InputError: the folder is no data set, a frame lacks an output, or the splits have no "test".
    """
    dataset = open_dataset(folder)
    read_info(dataset)
    indices = frame_indices(dataset)
    plan = dataset.info["recipe"]["plan"]
    members = read_splits(split or DEFAULT_SPLIT, plan, indices).members(indices)
    if TEST not in members:
        raise ArgumentError("split", f"must have a split {TEST!r}, not only {', '.join(members)}")
    used: dict[str, tuple[int, ...]] = {name: members[name] for name in (TRAIN, TEST) if name in members}
    for index in sorted(index for frames in used.values() for index in frames):
        _check_outputs(dataset, index, outputs)
    train, test = (TaskFrames(dataset, name, used.get(name, ())) for name in (TRAIN, TEST))
    return TaskSplit(train, test, shared_plants(used, plan))


def frame_name(index: int) -> str:
    """Name of a frame's files, without the suffix."""
    return f"{index:0{DIGITS}d}"


def count_frames(number: int) -> str:
    """A number of frames in words."""
    return f"{number:,} frame{'' if number == 1 else 's'}"


def _check_outputs(dataset: Dataset, index: int, outputs: Sequence[str]) -> None:
    found = read_outputs(dataset, index)
    missing = [name for name in outputs if name not in found]
    if missing:
        problem = f"lacks the output {missing[0]}; build it with --outputs {','.join(outputs)}"
        raise InputError(dataset.frame_path(index), problem)

"""What a task reads: the frames of a split with the outputs that it needs, and predictions for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.open import RenderedSet
from pepperscene.dataset.readers.pictures import read_mask
from pepperscene.dataset.splits import read_splits, shared_plants
from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.dataset.store.fields import frame_indices, read_info, read_output, read_outputs
from pepperscene.dataset.store.frame_json import DIGITS
from pepperscene.dataset.store.images import read_image
from pepperscene.errors import ArgumentError, InputError
from pepperscene.user_files import open_file

TRAIN: Final = "train"
TEST: Final = "test"

FloatArray = NDArray[np.float64]

MAP_SUFFIXES: Final = (".npy", ".exr", ".png")
CLASS_FOLDER: Final = "class"
"""Folder of the class images that `pepperscene predict` writes."""

DEFAULT_SPLIT: Final = "train=.8,test=.2"
"""Chosen: enough plants to learn from. Of two sets of plants, each is one split."""


@dataclass(frozen=True, eq=False)
class TaskFrames:
    """Frames of the split "train" or "test" of a data set, by their ascending indices."""

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
        places = {index: place for place, index in enumerate(self.dataset.indices())}
        return RenderedSet.from_dataset(self.dataset).take([places[index] for index in self.indices])


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
    def title(self) -> str:
        """Name of the data set and number of its test frames."""
        frames = f"{len(self.test):,} frame{'' if len(self.test) == 1 else 's'}"
        return f"{self.test.dataset.folder.resolve().name}, {frames}"

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


def _check_outputs(dataset: Dataset, index: int, outputs: Sequence[str]) -> None:
    found = read_outputs(dataset, index)
    missing = [name for name in outputs if name not in found]
    if missing:
        problem = f"lacks the output {missing[0]}; build it with --outputs {','.join(outputs)}"
        raise InputError(dataset.frame_path(index), problem)


@dataclass(frozen=True)
class PredictionFolder:
    """A folder of predictions; `000012.npy`, `000012.exr` or `000012.png` belongs to frame 12.

    Raises:
        InputError: it is no folder.
    """

    folder: Path

    def __post_init__(self) -> None:
        if not self.folder.is_dir():
            raise InputError(self.folder, "must be a folder of predictions")

    @property
    def name(self) -> str:
        """Name of the method in a table."""
        return self.folder.resolve().name

    def path(self, index: int, suffixes: tuple[str, ...] = MAP_SUFFIXES) -> Path:
        """The file of a frame; raises `InputError` if there is none."""
        name = f"{index:0{DIGITS}d}"
        for suffix in suffixes:
            if (path := self.folder / f"{name}{suffix}").is_file():
                return path
        allowed = " or ".join(filter(None, (", ".join(suffixes[:-1]), suffixes[-1])))
        raise InputError(self.folder, f"has no prediction for frame {index}: {name} with {allowed}")

    def read_map(
        self, index: int, needed: NDArray[np.bool_], *, png_unit: float = 1.0, positive: bool = False
    ) -> FloatArray:
        """A map of numbers `(h, w)`.

        Args:
            index: of the frame.
            needed: `(h, w)` pixels whose values count, and must be finite.
            png_unit: what a value of 1 in a PNG file of 16 bits stands for.
            positive: whether they must be above 0.

        Raises:
            InputError: the file is missing, cannot be read, has another size, or lacks a needed value.
        """
        path = self.path(index)
        content = read_values(path)
        if content.dtype.kind not in "fiu":
            raise InputError(path, f"must hold numbers, not {content.dtype}")
        _check_size(path, content.shape, needed.shape)
        values = content.astype(np.float64)
        if path.suffix == ".png":
            values = values * png_unit
        missing = needed & ~np.isfinite(values)
        if positive:
            missing |= needed & ~(values > 0)
        if missing.any():
            row, column = np.argwhere(missing)[0]
            allowed = f"a finite value{' above 0' if positive else ''} in each pixel that counts"
            raise InputError(
                path, f"must have {allowed}, not {values[row, column]:g} at row {row}, column {column}"
            )
        return values

    def read_classes(self, index: int, size: tuple[int, int], classes: int) -> NDArray[np.uint8]:
        """Class ids `(h, w)` of a PNG file, here or in the folder `class`.

        Raises:
            InputError: the file is missing, cannot be read, has another size, or holds an id that is none.
        """
        inner = self.folder / CLASS_FOLDER
        folder = PredictionFolder(inner) if inner.is_dir() else self
        path = folder.path(index, (".png",))
        values = read_mask(path).values
        if values is None:
            raise InputError(path, "must hold class ids, not colours")
        ids = np.asarray(values)
        _check_size(path, ids.shape, size)
        if ids.min(initial=0) < 0 or ids.max(initial=0) >= classes:
            raise InputError(
                path, f"must hold class ids from 0 to {classes - 1}, not {int(ids.max(initial=0))}"
            )
        return ids.astype(np.uint8)


def _check_size(path: Path, found: tuple[int, ...], size: tuple[int, ...]) -> None:
    if found != size:
        shape = " x ".join(map(str, found))
        raise InputError(path, f"must be {size[0]} rows x {size[1]} columns as the frame, not {shape}")


def read_values(path: Path) -> NDArray[Any]:
    """The numbers of a file with a suffix of `MAP_SUFFIXES`."""
    if path.suffix == ".exr":
        return np.asarray(read_image(path))
    if path.suffix == ".png":
        values = read_mask(path).values
        if values is None:
            raise InputError(path, "must be a grey image of 16 bits")
        return np.asarray(values)
    try:
        with open_file(path, "values") as file:
            return np.asarray(np.load(file, allow_pickle=False))
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise InputError(path, f"cannot be read as an array ({' '.join(str(error).split())})") from None

"""The frames of an export, and access to their outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Final

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.fields import has_ignored_pixels

OnFrame = Callable[[int, int, int], None]
"""Called after every frame with its index, the number of frames done, and the number of all."""

DEPTH_OUTPUTS: Final = ("distance", "depth_z")
"""Outputs of which formats with depths need one."""


@dataclass(frozen=True, eq=False)
class ExportJob:
    """Input of an export."""

    dataset: Dataset
    splits: Mapping[str, tuple[int, ...]]  # ascending indices of each; none is empty
    selection: Selection = Selection()  # noqa: RUF009 - it is frozen
    on_frame: OnFrame | None = None

    @property
    def has_ignored_pixels(self) -> bool:
        """Whether frames can have pixels that training and evaluation must ignore."""
        return has_ignored_pixels(self.dataset.info)

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

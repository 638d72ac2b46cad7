"""The formats that a data set can be exported to; each one's module is imported when it is chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Protocol

from pepperscene.dataset.export.source import OnFrame
from pepperscene.dataset.export.splits import Splits, read_splits
from pepperscene.dataset.recipe.plan import Plan
from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.errors import ArgumentError, InputError


@dataclass(frozen=True)
class ExportResult:
    """What an export made.

    Attributes:
        folder: that was filled.
        frames: how many frames are in it.
        files: how many files are.
        splits: how many frames each split has, where `export` tells.
    """

    folder: Path
    frames: int
    files: int
    splits: Mapping[str, int] = field(default_factory=dict)


class Exporter(Protocol):
    """Writes the frames that have a split into a new folder.

    Only frames that have a split are written, of `indices` where they are given.
    """

    def __call__(
        self,
        dataset: Dataset,
        out: Path,
        splits: Splits,
        *,
        indices: tuple[int, ...] | None = None,
        on_frame: OnFrame | None = None,
    ) -> ExportResult:
        """Raises InputError where an output is missing, OutputError where the folder cannot be written."""


@dataclass(frozen=True)
class ExportFormat:
    """One format, which is called like its exporter.

    Attributes:
        name: as on the command line; its module has that name and its exporter that name after `export_`.
        meaning: one line for help texts.
        smallest_px: fewest visible pixels of an organ that is an object of its own, unless another number is
            asked for; None for formats that know no objects.
    """

    name: str
    meaning: str
    smallest_px: int | None = None

    def __call__(self, *arguments: Any, **options: Any) -> ExportResult:
        """Write a data set; see `Exporter`."""
        module = import_module(f"pepperscene.dataset.export.{self.name}")
        exporter: Exporter = getattr(module, f"export_{self.name}")
        return exporter(*arguments, **options)


FORMATS: Final = MappingProxyType(
    {
        one.name: one
        for one in (
            ExportFormat("published", "folders, names and codes of the published data set"),
            ExportFormat("coco", "COCO instances and panoptic", smallest_px=1),
            ExportFormat("yolo", "YOLO segmentation: a polygon a line", smallest_px=12),
            ExportFormat("webdataset", "shards of samples, for webdataset"),
            ExportFormat("huggingface", "Parquet with pictures and a card, for Hugging Face's datasets"),
        )
    }
)
"""All formats by name."""


def export_dataset(
    folder: str | Path,
    form: str,
    out: str | Path,
    split: str | None = None,
    frames: str | None = None,
    on_frame: OnFrame | None = None,
    smallest_px: int | None = None,
) -> ExportResult:
    """Write a data set in another format.

    Args:
        folder: of the data set.
        form: a name out of `FORMATS`.
        out: a new or an empty folder.
        split: shares, "train=.8,val=.1,test=.1", or ranges, "train=0:8750,val=8750:8800"; None for all frames
            as "train". Shares keep the plants of a set together, as far as the number of sets allows.
        frames: "A:B", indices A to B - 1; None for all that are there.
        on_frame: called after every frame with its index, how many are done, and how many there are.
        smallest_px: organs of which fewer pixels are seen are no objects of their own; None for the format's
            own number.

    Raises:
        InputError: there is no data set or no frame in it, an argument is wrong, an output is missing, or a
            file is damaged.
        OutputError: the folder holds something, or cannot be written to.
        SetupError: a library that the format needs is not installed.
    """
    if form not in FORMATS:
        raise ArgumentError("format", f"unknown format {form!r}; allowed are {', '.join(FORMATS)}")
    own = FORMATS[form].smallest_px
    if smallest_px is not None and (own is None or smallest_px < 1):
        allowed = "must be at least 1" if own is not None else f"is for objects, which {form} does not tell"
        raise ArgumentError("smallest", f"{smallest_px} {allowed}")
    dataset = open_dataset(folder)
    there = dataset.indices()
    if not there:
        raise InputError(folder, "holds no frames yet; build some first")
    plan = dataset.info["recipe"]["plan"]
    if frames is not None:
        wanted = set(Plan.model_validate(plan).select_indices(frames))
        there = tuple(index for index in there if index in wanted)
        if not there:
            raise ArgumentError("frames", f"{frames!r} holds none of the data set's frames")
    splits = read_splits(split, plan, there)
    indices = tuple(index for index in there if splits.named(index))
    options = {} if own is None else {"smallest_px": smallest_px or own}
    done = FORMATS[form](dataset, Path(out), splits, indices=indices, on_frame=on_frame, **options)
    return replace(done, splits={name: len(of) for name, of in splits.members(indices).items()})

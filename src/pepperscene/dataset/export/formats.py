"""The formats that a data set can be exported to; each one's module is imported when it is chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Protocol

from pepperscene.dataset.export.source import OnFrame
from pepperscene.dataset.export.splits import Splits
from pepperscene.dataset.store import Dataset


@dataclass(frozen=True)
class Exported:
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
    ) -> Exported:
        """Raises InputError where an output is missing, OutputError where the folder cannot be written."""


@dataclass(frozen=True)
class Format:
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

    def __call__(self, *arguments: Any, **options: Any) -> Exported:
        """Write a data set; see `Exporter`."""
        module = import_module(f"pepperscene.dataset.export.{self.name}")
        exporter: Exporter = getattr(module, f"export_{self.name}")
        return exporter(*arguments, **options)


FORMATS: Final = MappingProxyType(
    {
        one.name: one
        for one in (
            Format("published", "folders, names and codes of the published data set"),
            Format("coco", "COCO instances and panoptic", smallest_px=1),
            Format("yolo", "YOLO segmentation: a polygon a line", smallest_px=12),
            Format("webdataset", "shards of samples, for webdataset"),
            Format("huggingface", "Parquet with pictures and a card, for Hugging Face's datasets"),
        )
    }
)
"""All formats by name."""

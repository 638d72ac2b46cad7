"""Hugging Face's `datasets` layout: Parquet files with the pictures inside, and a card.

Format: huggingface.co/docs/datasets and huggingface.co/docs/hub/datasets-cards; the features stand in the
schema's metadata under the key `huggingface`, so that images are decoded without being told.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final, Protocol

from pepperscene.dataset.export.columns import (
    CLASS_NAMES,
    Column,
    arrow_array,
    arrow_type,
    columns,
    yaml_feature,
)
from pepperscene.dataset.export.run import ExportResult
from pepperscene.dataset.export.source import (
    ExportSource,
    OnFrame,
    export_sources,
    in_all,
    new_folder,
    wanted_frames,
)
from pepperscene.dataset.export.splits import Splits
from pepperscene.dataset.store.dataset import MARK, Dataset

_SIZES: Final = (
    (1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"),
)  # fmt: skip
_LARGEST: Final = "1M<n<10M"


class SplitSize(Protocol):
    """How much a split holds: frames, and bytes in memory and in its files."""

    @property
    def frames(self) -> int: ...  # noqa: D102
    @property
    def held(self) -> int: ...  # noqa: D102
    @property
    def packed(self) -> int: ...  # noqa: D102


@dataclass(frozen=True)
class Card:
    """A card.

    Attributes:
        about: `dataset.json` of the data set.
        columns: of the Parquet files.
        splits: what each holds.
        licence: an identifier of Hugging Face's list.
    """

    about: Mapping[str, Any]
    columns: Sequence[Column]
    splits: Mapping[str, SplitSize]
    licence: str

    def text(self) -> str:
        """Front matter, whose values are JSON and therefore YAML too, and a page in Markdown."""
        front = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in self.front().items()]
        return "\n".join(["---", *front, "---", "", *self._page(), ""])

    def front(self) -> dict[str, Any]:
        """What machines read."""
        frames = sum(split.frames for split in self.splits.values())
        names = {column.name for column in self.columns}
        return {
            "license": self.licence,
            "pretty_name": self._title(),
            "task_categories": [
                "image-segmentation",
                *(["depth-estimation"] if "distance" in names else []),
                *(["object-detection"] if "instances" in names else []),
            ],
            "tags": ["agriculture", "capsicum-annuum", "greenhouse", "sweet-pepper", "synthetic"],
            "size_categories": [next((name for most, name in _SIZES if frames < most), _LARGEST)],
            "dataset_info": {
                "features": [
                    {"name": column.name, **yaml_feature(column.feature)} for column in self.columns
                ],
                "splits": [
                    {"name": name, "num_bytes": split.held, "num_examples": split.frames}
                    for name, split in self.splits.items()
                ],
                "download_size": sum(split.packed for split in self.splits.values()),
                "dataset_size": sum(split.held for split in self.splits.values()),
            },
            "configs": [
                {
                    "config_name": "default",
                    "data_files": [{"split": name, "path": f"data/{name}-*"} for name in self.splits],
                }
            ],
        }

    def _title(self) -> str:
        return f"{self.about['recipe']['name']}: rendered sweet-pepper plants"

    def _page(self) -> list[str]:
        recipe, plan = self.about["recipe"], self.about["recipe"]["plan"]
        frames = sum(split.frames for split in self.splits.values())
        classes = ", ".join(f"{number} {name}" for number, name in enumerate(CLASS_NAMES))
        return [
            f"# {self._title()}",
            "",
            f"{frames} images of sweet-pepper plants (*Capsicum annuum*) in a greenhouse row, rendered with"
            " exact labels. Every plant is grown from measured proportions, its organs have spectral"
            " reflectances and transmittances, and the photographs are what the recipe's camera records of"
            " the light.",
            "",
            "| | |",
            "|---|---|",
            f"| recipe | {recipe['name']}, seed {recipe['seed']}, SHA-256 `{self.about['recipe_sha256']}` |",
            f"| cultivar | {recipe['cultivar']} |",
            f"| camera | {recipe['camera']['sensor']} with {recipe['camera']['lens']} |",
            f"| plan | {plan['sets']} sets of plants, {plan['rotations']} rows of each,"
            f" {plan['frames']} steps along the camera's path |",
            f"| quality | {self.about['quality']} |",
            f"| made with | pepperscene {self.about['version']} |",
            *(f"| split `{name}` | {split.frames} images |" for name, split in self.splits.items()),
            "",
            f"Classes: {classes}.",
            "",
            "| column | meaning |",
            "|---|---|",
            *(f"| `{column.name}` | {column.meaning} |" for column in self.columns),
            "",
            "```python",
            "import numpy as np",
            "from datasets import load_dataset",
            "",
            'frames = load_dataset("path/to/this/folder", split="' + next(iter(self.splits), "train") + '")',
            'mask = np.asarray(frames[0]["mask"])  # class ids, (h, w) uint8',
            "```",
            "",
            "The whole recipe is in `dataset.json`: the same recipe and version render the same images again."
            " Classes are those of Barth et al. 2018, *Data synthesis methods for semantic segmentation in"
            " agriculture: A Capsicum annuum dataset* (doi 10.1016/j.compag.2017.12.001).",
        ]


SHARD_BYTES: Final = 500_000_000
"""As `datasets` itself writes them (its default of `max_shard_size`)."""

_REQUIRED: Final = ("colour", "class")
_OPTIONAL: Final = ("instance", "distance", "harvest")
_ROWS: Final = 16
"""Chosen: a group of rows, which is the least that a reader fetches, takes some tens of megabytes."""


@dataclass(frozen=True)
class Split:
    """What was written of a split.

    Attributes:
        files: Parquet files.
        frames: rows in them.
        held: bytes of the columns in memory.
        packed: bytes of the files.
    """

    files: int
    frames: int
    held: int
    packed: int


def export_huggingface(
    dataset: Dataset,
    out: Path,
    splits: Splits,
    *,
    indices: Sequence[int] | None = None,
    on_frame: OnFrame | None = None,
    shard_bytes: int = SHARD_BYTES,
    licence: str = "mit",
) -> ExportResult:
    """Write `data/train-00000-of-00001.parquet` and so on, `README.md` (the card) and `dataset.json`.

    `datasets.load_dataset(folder)` reads it; every column is told on the card.

    Args:
        dataset: with the outputs colour and class; instance, distance and harvest become columns where all
            frames have them.
        out: a new or an empty folder.
        splits: frames in none are left out.
        indices: of the frames wanted; None for all.
        on_frame: called after every frame.
        shard_bytes: size after which the next file is begun.
        licence: an identifier of Hugging Face's list; the images are their maker's, this package's licence is
            only what the card says when nothing else is told.

    Raises:
        InputError: an output is missing, or a file is damaged.
        OutputError: the folder holds something, or cannot be written to.
        ValueError: the size is not positive.
    """
    if shard_bytes <= 0:
        raise ValueError("shard_bytes must be positive")
    found = splits.members(wanted_frames(dataset, splits, indices, _REQUIRED))
    wanted = {name: members for name, members in found.items() if members}
    every = [index for members in wanted.values() for index in members]
    outputs = (*_REQUIRED, *in_all(dataset, every, _OPTIONAL))
    told = columns(outputs, _shape(dataset, every))

    with new_folder(out, dataset.folder) as folder:
        (folder / "data").mkdir()
        # One generator of frames over all splits, so that progress counts through.
        frames = export_sources(dataset, every, on_frame)
        written = {
            name: _write_split(folder / "data", name, islice(frames, len(members)), told, shard_bytes)
            for name, members in wanted.items()
        }
        # The last frame is told as done when one more is asked for.
        next(frames, None)
        (folder / MARK).write_bytes((dataset.folder / MARK).read_bytes())
        (folder / "README.md").write_text(Card(dataset.info, told, written, licence).text(), encoding="utf-8")
    return ExportResult(out, len(every), 2 + sum(split.files for split in written.values()))


def _shape(dataset: Dataset, indices: Sequence[int]) -> tuple[int, int]:
    """Height and width of the frames, which one recipe gives all of them."""
    height, width = ExportSource(dataset, indices[0]).image("class").shape if indices else (0, 0)
    return int(height), int(width)


def _write_split(
    folder: Path, name: str, frames: Iterator[ExportSource], told: Sequence[Column], shard_bytes: int
) -> Split:
    """All files of a split; how many there are is known when the last one is full."""
    import pyarrow.parquet as pq

    features = {column.name: column.feature for column in told}
    schema = _schema(features)
    # Neighbouring distances share their high bytes: byte by byte they pack by half, as wholes hardly.
    floats = [f"{key}.list.element.list.element" for key, one in features.items() if _is_float32(one)]
    made: list[Path] = []
    rows = held = 0
    writer: Any = None
    try:
        while group := list(islice(frames, _ROWS)):
            table = _table(group, told, schema)
            if writer is None:
                made.append(folder / f"{name}-{len(made):05d}.parquet")
                writer = pq.ParquetWriter(
                    made[-1], schema, compression="zstd", use_dictionary=False, use_byte_stream_split=floats
                )
            writer.write_table(table)
            rows, held = rows + len(group), held + table.nbytes
            if made[-1].stat().st_size >= shard_bytes:
                writer.close()
                writer = None
    finally:
        if writer is not None:
            writer.close()
    packed = sum(path.stat().st_size for path in made)
    for number, path in enumerate(made):
        path.rename(folder / f"{name}-{number:05d}-of-{len(made):05d}.parquet")
    return Split(len(made), rows, held, packed)


def _schema(features: Mapping[str, Any]) -> Any:
    import pyarrow as pa

    told = json.dumps({"info": {"features": features}})
    fields = [(name, arrow_type(feature)) for name, feature in features.items()]
    return pa.schema(fields, metadata={"huggingface": told})


def _table(group: Sequence[ExportSource], told: Sequence[Column], schema: Any) -> Any:
    import pyarrow as pa

    arrays = [arrow_array(column.feature, [column.value(source) for source in group]) for column in told]
    return pa.Table.from_arrays(arrays, schema=schema)


def _is_float32(feature: Any) -> bool:
    return isinstance(feature, Mapping) and feature.get("dtype") == "float32"

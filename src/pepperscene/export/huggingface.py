"""Layout of Hugging Face's `datasets`: Parquet files that contain the images, and a card.

Format: huggingface.co/docs/datasets and huggingface.co/docs/hub/datasets-cards. The features are in the
metadata of the schema under the key `huggingface`, so that images are decoded without further arguments.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.dataset import MARK
from pepperscene.dataset.store.recorded_values import recorded_value
from pepperscene.export.columns import (
    CLASS_NAMES,
    Column,
    arrow_array,
    arrow_type,
    frame_columns,
    variation_columns,
    yaml_feature,
)
from pepperscene.export.job import SAMPLE_OUTPUTS, ExportJob
from pepperscene.user_files import read_file

SHARD_BYTES: Final = 500_000_000
"""As `datasets` itself writes them (its default of `max_shard_size`)."""

_ROWS: Final = 16
"""Chosen: a group of rows, the least that a reader fetches, takes some tens of megabytes."""

_SIZE_CATEGORIES: Final = (
    (1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"),
    (10_000_000, "1M<n<10M"),
)  # fmt: skip

_LICENCE: Final = "mit"
"""Of this package, in Hugging Face's list; users who publish their images replace it."""

_YAML_UNPRINTABLE: Final = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")
"""Characters of JSON texts that YAML 1.2 does not allow, or takes for ends of lines, without an escape."""

_MARKDOWN_SYNTAX: Final = re.compile(r"[\\`*_\[\]<>&|~!$#@]|:(?=//)|(?<=www)\.", re.IGNORECASE)
"""Characters with a meaning inside a line of GitHub's Markdown, also of bare links and formulas."""


@dataclass(frozen=True)
class SplitSize:
    """Size of a split."""

    frames: int
    memory_bytes: int = 0  # of the columns in memory
    file_bytes: int = 0  # of the Parquet files


def write_huggingface(job: ExportJob, folder: Path) -> None:
    """Write `data/train-00000-of-00001.parquet` and so on, `README.md` (the card) and `dataset.json`.

    `datasets.load_dataset(folder)` reads it. Instance, distance and harvest become columns if all frames
    have them.
    """
    outputs = job.common_outputs(SAMPLE_OUTPUTS)
    height, width = DatasetFrame(job.dataset, min(job.split_of)).image("class").shape
    columns = (*frame_columns(outputs, (height, width)), *variation_columns(job.dataset.info))
    (folder / "data").mkdir()
    sizes = {
        split: _write_split(folder / "data", split, frames, columns)
        for split, frames in job.frames_by_split()
    }
    (folder / MARK).write_bytes(read_file(job.dataset.folder / MARK, "json", within=job.dataset.folder))
    (folder / "README.md").write_text(_card_text(job.dataset.info, columns, sizes), encoding="utf-8")


def _write_split(
    folder: Path, split: str, frames: Iterator[DatasetFrame], columns: Sequence[Column]
) -> SplitSize:
    """Write the files of a split; their names contain the number of files."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    features = {column.name: column.feature for column in columns}
    fields = [(name, arrow_type(feature)) for name, feature in features.items()]
    schema = pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": features}})})
    # Neighbouring distances share their high bytes: split into bytes they shrink to half, as floats hardly.
    split_columns = [f"{name}.list.element.list.element" for name in features if name == "distance"]
    options = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": split_columns}
    paths: list[Path] = []
    rows = memory_bytes = 0
    groups = iter(lambda: list(islice(frames, _ROWS)), [])
    for first in groups:
        group = first
        paths.append(folder / f"{split}-{len(paths):05d}.parquet")
        # Arrow opens no file whose name is not UTF-8.
        with paths[-1].open("wb") as stream, pq.ParquetWriter(stream, schema, **options) as writer:
            while group:
                values = ([column.value(frame) for frame in group] for column in columns)
                arrays = [arrow_array(one.feature, own) for one, own in zip(columns, values, strict=True)]
                table = pa.Table.from_arrays(arrays, schema=schema)
                writer.write_table(table)
                rows, memory_bytes = rows + len(group), memory_bytes + table.nbytes
                group = next(groups, []) if stream.tell() < SHARD_BYTES else []
    file_bytes = sum(path.stat().st_size for path in paths)
    for number, path in enumerate(paths):
        path.rename(folder / f"{split}-{number:05d}-of-{len(paths):05d}.parquet")
    return SplitSize(rows, memory_bytes, file_bytes)


def _card_text(info: Mapping[str, Any], columns: Sequence[Column], splits: Mapping[str, SplitSize]) -> str:
    """The card: front matter in YAML, and a page in Markdown."""
    title = f"{info['recipe']['name']}: rendered sweet-pepper plants"
    front = card_front_matter(title, columns, splits)
    lines = [f"{key}: {_yaml_value(value)}" for key, value in front.items()]
    # Only texts of users need escapes: in Markdown those of HTML would be shown.
    environment = Environment(
        loader=PackageLoader("pepperscene.export"),
        autoescape=False,
        trim_blocks=True,
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )
    environment.filters["escaped"] = _markdown_text
    page = environment.get_template("card.md").render(
        title=title,
        images=sum(size.frames for size in splits.values()),
        info=info,
        recipe=info["recipe"],
        sensor=recorded_value(info, "camera.sensor"),
        lens=recorded_value(info, "camera.lens"),
        classes=CLASS_NAMES,
        columns=columns,
        splits=splits,
    )
    return "\n".join(["---", *lines, "---", "", page])


def _yaml_value(value: Any) -> str:
    """A value as JSON, which is YAML, too, if a few characters are escaped; it is on one line."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False)
    return _YAML_UNPRINTABLE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def _markdown_text(text: Any) -> str:
    """A text within a line of Markdown, or a cell of a table, that readers see as it is."""
    return _MARKDOWN_SYNTAX.sub(r"\\\g<0>", str(text))


def card_front_matter(
    title: str, columns: Sequence[Column], splits: Mapping[str, SplitSize]
) -> dict[str, Any]:
    """The machine-readable part of the card."""
    sizes = splits.values()
    frames = sum(size.frames for size in sizes)
    names = {column.name for column in columns}
    data_files = [{"split": name, "path": f"data/{name}-*"} for name in splits]
    return {
        "license": _LICENCE,
        "pretty_name": title,
        "task_categories": [
            "image-segmentation",
            *(["depth-estimation"] if "distance" in names else []),
            *(["object-detection"] if "instances" in names else []),
        ],
        "tags": ["agriculture", "capsicum-annuum", "greenhouse", "sweet-pepper", "synthetic"],
        "size_categories": [next(name for limit, name in _SIZE_CATEGORIES if frames < limit)],
        "dataset_info": {
            "features": [{"name": column.name, **yaml_feature(column.feature)} for column in columns],
            "splits": [
                {"name": name, "num_bytes": size.memory_bytes, "num_examples": size.frames}
                for name, size in splits.items()
            ],
            "download_size": sum(size.file_bytes for size in sizes),
            "dataset_size": sum(size.memory_bytes for size in sizes),
        },
        "configs": [{"config_name": "default", "data_files": data_files}],
    }

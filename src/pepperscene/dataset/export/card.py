"""The card of an export: what people and machines read about a data set on Hugging Face's hub."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from pepperscene.dataset.export.columns import CLASS_NAMES, Column, yaml_feature

_SIZES: Final = (
    (1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"),
)  # fmt: skip
_LARGEST: Final = "1M<n<10M"


class Counts(Protocol):
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
    splits: Mapping[str, Counts]
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

"""Shards of samples: tar files that webdataset streams, without a file for every picture.

A sample is a run of members with the same key, the frame's index:

- `006137.colour.png`: the photograph;
- `006137.class.npy.gz`, `006137.instance.npy.gz`, `006137.distance.npy.gz`: arrays as `Frame` holds them;
- `006137.json`: the frame's facts, and `006137.harvest.json`.

Labels are arrays and not pictures, since a loader decodes all PNGs of a sample alike: asked for "rgb" it
makes class ids fractions of 255, and "pil" cuts instances off at 255. webdataset unpacks `.npy.gz` by itself.

Format: the WebDataset convention (github.com/webdataset/webdataset); POSIX.1-1988 tar.
"""

from __future__ import annotations

import gzip
import io
import tarfile
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

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
from pepperscene.dataset.store.atomic import canonical_json
from pepperscene.dataset.store.dataset import Dataset

SHARD_BYTES: Final = 1_000_000_000
"""Chosen: webdataset's own advice is shards of about a gigabyte, read in one go and still many enough."""

LIST: Final = "shards.json"

_REQUIRED: Final = ("colour", "class")
_OPTIONAL: Final = ("instance", "distance", "harvest")
Sample = list[tuple[str, bytes]]
"""Names and contents of the members that belong together."""

_LEVEL: Final = 1
"""Of gzip. Chosen: a label image is 20 times smaller already, and what is measured hardly shrinks at any."""
_BLOCK: Final = 512
_MODE: Final = 0o644


def export_webdataset(
    dataset: Dataset,
    out: Path,
    splits: Splits,
    *,
    indices: Sequence[int] | None = None,
    on_frame: OnFrame | None = None,
    shard_bytes: int = SHARD_BYTES,
) -> ExportResult:
    """Write shards of samples, `train-000000.tar` and so on, and `shards.json` with what they hold.

    The frames of a split are shuffled once, by the recipe's seed: neighbours on the camera's path look alike,
    and a stream can only be shuffled as far as its buffer reaches. The same data set gives the same bytes.

    Args:
        dataset: with the outputs colour and class; instance, distance and harvest are added where all frames
            have them.
        out: a new or an empty folder.
        splits: frames in none are left out.
        indices: of the frames wanted; None for all.
        on_frame: called after every frame.
        shard_bytes: size that a shard must not exceed, but for one sample.

    Raises:
        InputError: an output is missing, or a file is damaged.
        OutputError: the folder holds something, or cannot be written to.
        ValueError: the size is not positive.
    """
    if shard_bytes <= 0:
        raise ValueError("shard_bytes must be positive")
    every = wanted_frames(dataset, splits, indices, _REQUIRED)
    wanted = splits.members(every)
    outputs = (*_REQUIRED, *in_all(dataset, every, _OPTIONAL))
    seed = int(dataset.info["recipe"]["seed"])

    told: dict[str, list[dict[str, Any]]] = {}
    with new_folder(out, dataset.folder) as folder:
        # One generator of frames over all splits, so that progress counts through.
        orders = {name: _shuffled(members, seed) for name, members in wanted.items() if members}
        frames = export_sources(dataset, [index for order in orders.values() for index in order], on_frame)
        for name, order in orders.items():
            samples = (_sample(source, outputs) for source in islice(frames, len(order)))
            told[name] = _write_shards(folder, name, samples, shard_bytes)
        # The last frame is told as done when one more is asked for.
        next(frames, None)
        (folder / LIST).write_bytes(canonical_json({"splits": told, "dataset": dict(dataset.info)}))
    files = 1 + sum(len(shards) for shards in told.values())
    return ExportResult(out, len(every), files)


def _shuffled(indices: Sequence[int], seed: int) -> list[int]:
    return [int(index) for index in np.random.default_rng(seed).permutation(np.asarray(indices))]


def _write_shards(folder: Path, split: str, samples: Iterator[Sample], most: int) -> list[dict[str, Any]]:
    """The shards of a split, each begun when the next sample would make the one before too large.

    Returns:
        File name and number of samples of each.
    """
    told: list[dict[str, Any]] = []
    sample = next(samples, None)
    while sample is not None:
        name = f"{split}-{len(told):06d}.tar"
        count = held = 0
        with tarfile.open(folder / name, "w", format=tarfile.USTAR_FORMAT) as tar:
            while sample is not None and (count == 0 or held + _size(sample) <= most):
                _add(tar, sample)
                count, held = count + 1, held + _size(sample)
                sample = next(samples, None)
        told.append({"file": name, "samples": count})
    return told


def _add(tar: tarfile.TarFile, sample: Sample) -> None:
    """A sample's members, without times and owners: the same samples are the same bytes."""
    for name, content in sample:
        told = tarfile.TarInfo(name)
        told.size, told.mode = len(content), _MODE
        tar.addfile(told, io.BytesIO(content))


def _size(sample: Sample) -> int:
    """Bytes in a tar file: a block for every header, and whole blocks of content."""
    return sum(_BLOCK * (1 + -(-len(content) // _BLOCK)) for _, content in sample)


def _sample(source: ExportSource, outputs: Sequence[str]) -> Sample:
    return [(f"{source.name}.{ending}", content) for ending, content in _contents(source, outputs)]


def _contents(source: ExportSource, outputs: Sequence[str]) -> Iterator[tuple[str, bytes]]:
    for output in outputs:
        if output == "colour":
            yield "colour.png", source.content(output)
        elif output == "harvest":
            yield "harvest.json", source.content(output)
        else:
            yield f"{output}.npy.gz", _packed(source.image(output))
    yield "json", canonical_json(source.facts)


def _packed(image: NDArray[Any]) -> bytes:
    """An array as a compressed .npy file, without the time of day in its header."""
    packed = io.BytesIO()
    with gzip.GzipFile(filename="", fileobj=packed, mode="wb", compresslevel=_LEVEL, mtime=0) as file:
        np.lib.format.write_array(file, np.ascontiguousarray(image), allow_pickle=False)
    return packed.getvalue()

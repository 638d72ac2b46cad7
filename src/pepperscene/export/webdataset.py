"""Shards of samples: tar files that webdataset streams, instead of one file per image.

A sample is a sequence of members with the same key, the frame's index:

- `006137.colour.png`: the photograph;
- `006137.class.npy.gz`, `006137.instance.npy.gz`, `006137.distance.npy.gz`: arrays as `Frame` holds them;
- `006137.json`: the frame's metadata, and `006137.harvest.json`.

Labels are arrays, not images, since a loader decodes all PNGs of a sample in the same way: "rgb" turns class
ids into fractions of 255, and "pil" clips instances at 255. webdataset decompresses `.npy.gz` by itself.

Format: the WebDataset convention (github.com/webdataset/webdataset); POSIX.1-1988 tar.
"""

from __future__ import annotations

import gzip
import io
import tarfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import canonical_json
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.dataset import MARK
from pepperscene.errors import InputError
from pepperscene.export.job import SAMPLE_OUTPUTS, ExportJob

SHARD_BYTES: Final = 1_000_000_000
"""Chosen: webdataset recommends shards of about a gigabyte, large enough to read sequentially."""


Sample = list[tuple[str, bytes]]
"""Names and contents of the members of a sample."""

_COMPRESSION_LEVEL: Final = 1
"""Of gzip. Chosen: a label image shrinks to a twentieth, and measured values hardly shrink at any level."""
_TAR_BLOCK: Final = 512
_FILE_MODE: Final = 0o644


def write_webdataset(job: ExportJob, folder: Path) -> None:
    """Write shards of samples, `train-000000.tar` and so on, and `shards.json`, which lists them.

    The frames of a split are shuffled once, by the recipe's seed: neighbouring frames of the camera's path
    are similar, and a stream is shuffled only within its buffer. Instance, distance and harvest are added if
    all frames have them.
    """
    outputs = job.common_outputs(SAMPLE_OUTPUTS)
    seed = int(job.dataset.info["recipe"]["seed"])

    def shuffle(indices: Sequence[int]) -> list[int]:
        order: list[int] = np.random.default_rng(seed).permutation(np.asarray(indices)).tolist()
        return order

    shards = {
        split: _write_shards(folder, split, (_make_sample(frame, outputs) for frame in frames))
        for split, frames in job.frames_by_split(shuffle)
    }
    content = _json_bytes({"splits": shards, "dataset": dict(job.dataset.info)}, job.dataset.folder / MARK)
    (folder / "shards.json").write_bytes(content)


def _write_shards(folder: Path, split: str, samples: Iterator[Sample]) -> list[dict[str, Any]]:
    """Write shards of up to `SHARD_BYTES`, or one sample; return the file name and samples of each."""
    shards: list[dict[str, Any]] = []
    sample = next(samples, None)
    while sample is not None:
        name = f"{split}-{len(shards):06d}.tar"
        count = size = 0
        with tarfile.open(folder / name, "w", format=tarfile.USTAR_FORMAT) as tar:
            while sample is not None and (count == 0 or size + _tar_size(sample) <= SHARD_BYTES):
                for member_name, content in sample:
                    # Without times and owners, so that the bytes are reproducible.
                    member = tarfile.TarInfo(member_name)
                    member.size, member.mode = len(content), _FILE_MODE
                    tar.addfile(member, io.BytesIO(content))
                count, size = count + 1, size + _tar_size(sample)
                sample = next(samples, None)
        shards.append({"file": name, "samples": count})
    return shards


def _tar_size(sample: Sample) -> int:
    """Bytes in a tar file: a block for every header, and whole blocks of content."""
    return sum(_TAR_BLOCK * (1 + -(-len(content) // _TAR_BLOCK)) for _, content in sample)


def _make_sample(frame: DatasetFrame, outputs: Sequence[str]) -> Sample:
    members = []
    for output in outputs:
        if output == "colour":
            members.append(("colour.png", frame.content(output)))
        elif output == "harvest":
            members.append(("harvest.json", frame.content(output)))
        else:
            members.append((f"{output}.npy.gz", _npy_gz(frame.image(output))))
    members.append(("json", _json_bytes(frame.metadata, frame.dataset.frame_path(frame.index))))
    return [(f"{frame.name}.{suffix}", content) for suffix, content in members]


def _json_bytes(content: Any, file: Path) -> bytes:
    """Canonical JSON of the content of a file; raises `InputError` if that is not JSON to other readers."""
    try:
        return canonical_json(content)
    except (ValueError, RecursionError):
        problem = "must not hold infinite numbers, nan, unpaired surrogates, or lists nested too deeply"
        raise InputError(file, problem) from None


def _npy_gz(image: NDArray[Any]) -> bytes:
    """An array as a compressed .npy file without a time stamp."""
    buffer = io.BytesIO()
    with gzip.GzipFile(
        filename="", fileobj=buffer, mode="wb", compresslevel=_COMPRESSION_LEVEL, mtime=0
    ) as file:
        np.lib.format.write_array(file, np.ascontiguousarray(image), allow_pickle=False)
    return buffer.getvalue()

"""A data set on disk: where its files lie, what of it is there, and how frames are added.

- `dataset.json`: what the data set is: recipe, its digest, version, quality.
- `colour/006137.png` and so on: one folder for each output.
- `frames/006137.json`: one frame's facts; written last, so that a frame counts once this file is there. Its
  `checksum` is the SHA-256 of the rest, that of each image stands under `outputs`.
- `manifest.parquet`, `fruit.parquet`: a row for each frame, or each fruit in it; see `manifest`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from concurrent.futures import Executor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from numpy.typing import NDArray

from pepperscene.dataset.store.atomic import atomic_write, canonical_json, digest, write_json
from pepperscene.dataset.store.images import read_image, write_image
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS

if TYPE_CHECKING:
    import pyarrow


FORMAT: Final = "pepperscene data set 1"
MARK: Final = "dataset.json"
FRAMES: Final = "frames"
DIGITS: Final = 6
CHECKSUM: Final = "checksum"


def file_name(index: int, output: str) -> str:
    """Path of an output's file inside the data set, with forward slashes."""
    return f"{output}/{index:0{DIGITS}d}{OUTPUTS[output].suffix}"


@dataclass(frozen=True)
class FrameStatus:
    """What is there of a frame.

    Attributes:
        facts: its JSON but for `outputs` and `checksum`; empty when there is no frame.
        outputs: the entries of those images that are whole, by output name.
        checksum: of its JSON.
    """

    facts: dict[str, Any] = field(default_factory=dict)
    outputs: dict[str, Any] = field(default_factory=dict)
    checksum: str = ""


@dataclass(frozen=True)
class Dataset:
    """A data set in a folder.

    Attributes:
        folder: where it lies.
        about: what `dataset.json` says.
    """

    folder: Path
    info: Mapping[str, Any]

    def indices(self) -> tuple[int, ...]:
        """The frames that are there, ascending."""
        names = (path.stem for path in (self.folder / FRAMES).glob("*.json"))
        return tuple(sorted(int(name) for name in names if name.isdecimal()))

    def metadata(self, index: int) -> dict[str, Any]:
        """What a frame's JSON says.

        Raises:
            InputError: there is no such frame, or its file is damaged.
        """
        return read_json(self.frame_path(index))

    def image(self, index: int, output: str) -> Any:
        """One output of a frame, as `Frame` holds it: an array, or the object of a JSON file.

        Raises:
            InputError: the frame has no such output.
        """
        return read_image(self.path(index, output))

    def manifest(self) -> pyarrow.Table:
        """A row for each frame, ascending: place in the plan, checksums, timings, errors, pixels of classes.

        Raises:
            OutputError: the table is lost, and the folder cannot be written to.
        """
        from pepperscene.dataset.store.manifest import read_manifest

        return read_manifest(self)

    def fruit(self) -> pyarrow.Table:
        """A row for each fruit of each frame that has the output `harvest`.

        Raises:
            InputError: no frame has it.
            OutputError: the table is lost, and the folder cannot be written to.
        """
        from pepperscene.dataset.store.manifest import read_fruit

        return read_fruit(self)

    def path(self, index: int, output: str) -> Path:
        """Where an output of a frame lies."""
        return self.folder / file_name(index, output)

    def frame_path(self, index: int) -> Path:
        """Where a frame's JSON lies."""
        return self.folder / FRAMES / f"{index:0{DIGITS}d}.json"

    def intact(self, index: int) -> FrameStatus:
        """What is there of a frame, as far as its files are what the build wrote, to the last bit.

        Nothing is when there is no such frame, or its JSON is damaged.
        """
        try:
            facts = self.metadata(index)
            checksum = str(facts.pop(CHECKSUM))
            if checksum != checksum_of(facts) or facts.get("index") != index:
                return FrameStatus()
            outputs = {str(name): entry for name, entry in facts.pop("outputs").items() if name in OUTPUTS}
        except (InputError, KeyError, AttributeError, TypeError):
            return FrameStatus()
        whole = {name: entry for name, entry in outputs.items() if self.is_whole(index, name, entry)}
        return FrameStatus(facts, whole, checksum)

    def is_whole(self, index: int, output: str, entry: Mapping[str, Any]) -> bool:
        """Whether an image is what its entry in the frame's JSON says."""
        path = self.path(index, output)
        try:
            return bool(path.stat().st_size == entry["bytes"] and digest(path) == entry["sha256"])
        except (OSError, KeyError, TypeError):
            return False

    def commit(
        self,
        index: int,
        images: Mapping[str, NDArray[Any]],
        facts: Mapping[str, Any],
        kept: Mapping[str, Any],
        pool: Executor,
    ) -> FrameStatus:
        """Add a frame, or outputs to a frame: first the images, then the JSON that makes them count.

        When that fails, the images written by this call are removed and what stood before still counts.

        Args:
            index: of the frame.
            images: arrays by output name.
            facts: the whole JSON but for its `outputs`.
            kept: entries of the outputs that are there already.
            pool: writes the images, several at a time: what takes long (compressing, hashing, waiting for the
                disk) is done without Python's lock.

        Returns:
            What is there now.

        Raises:
            OSError: a file cannot be written.
        """
        whole = {str(key): value for key, value in facts.items() if key not in (CHECKSUM, "outputs")}
        try:
            written = {
                output: pool.submit(self._write, index, output, image) for output, image in images.items()
            }
            # All must have come to an end before a fault of one is told: nobody writes behind our back.
            wait(written.values())
            new = {output: entry.result() for output, entry in written.items()}
            outputs = {**kept, **new}
            checksum = checksum_of({**whole, "outputs": outputs})
            write_json(self.frame_path(index), {**whole, "outputs": outputs, CHECKSUM: checksum})
            return FrameStatus(whole, outputs, checksum)
        except BaseException:
            for output in images:
                self.path(index, output).unlink(missing_ok=True)
            raise

    def _write(self, index: int, output: str, image: NDArray[Any]) -> dict[str, Any]:
        """Put one image in its place, and tell what the frame's JSON says of it."""
        name = file_name(index, output)
        with atomic_write(self.folder / name) as temporary:
            return written_image(temporary, image, output, name)


def checksum_of(facts: Mapping[str, Any]) -> str:
    """SHA-256 of a frame's JSON as canonical text, hexadecimal, without its own `checksum`."""
    told = {key: value for key, value in facts.items() if key != CHECKSUM}
    return hashlib.sha256(canonical_json(told)).hexdigest()


def written_image(path: Path, image: NDArray[Any], output: str, name: str) -> dict[str, Any]:
    """Write an image and tell of it what a frame's JSON says under `outputs`.

    Args:
        path: where it is written.
        image: of the shape and dtype of its output.
        output: name of the output.
        name: that the file will have.

    Raises:
        OSError: the file cannot be written.
    """
    write_image(path, image, output)
    return {"file": name, "bytes": path.stat().st_size, "sha256": digest(path)}


def open_dataset(folder: str | Path) -> Dataset:
    """The data set in a folder.

    Raises:
        InputError: there is none.
    """
    path = Path(folder) / MARK
    if not path.is_file():
        raise InputError(folder, f"holds no data set: there is no {MARK} in it")
    about = read_json(path)
    if about.get("format") != FORMAT:
        raise InputError(path, f"must be {FORMAT!r}", key="format", value=about.get("format"))
    return Dataset(Path(folder), about)


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        InputError: the file is missing or holds something else.
    """
    try:
        found = json.loads(path.read_bytes())
    except OSError as fault:
        raise InputError(path, f"cannot be read ({fault.strerror})") from None
    except (ValueError, RecursionError):
        raise InputError(path, "is not valid JSON") from None
    if not isinstance(found, dict):
        raise InputError(path, "must hold a JSON object")
    return found

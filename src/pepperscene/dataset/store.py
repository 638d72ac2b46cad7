"""A data set on disk: where its files lie, what of it is there, and how frames are added.

- `dataset.json`: what the data set is: recipe, its digest, version, quality.
- `colour/006137.png` and so on: one folder for each output.
- `frames/006137.json`: one frame's facts; written last, so that a frame counts once this file is there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import Executor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from pepperscene.dataset.atomic import digest, replacing, write_json
from pepperscene.dataset.images import read_image, write_image
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS

FORMAT: Final = "pepperscene data set 1"
MARK: Final = "dataset.json"
FRAMES: Final = "frames"
DIGITS: Final = 6


def file_name(index: int, output: str) -> str:
    """Path of an output's file inside the data set, with forward slashes."""
    return f"{output}/{index:0{DIGITS}d}{OUTPUTS[output].suffix}"


@dataclass(frozen=True)
class Dataset:
    """A data set in a folder.

    Attributes:
        folder: where it lies.
        about: what `dataset.json` says.
    """

    folder: Path
    about: Mapping[str, Any]

    def indices(self) -> tuple[int, ...]:
        """The frames that are there, ascending."""
        names = (path.stem for path in (self.folder / FRAMES).glob("*.json"))
        return tuple(sorted(int(name) for name in names if name.isdecimal()))

    def facts(self, index: int) -> dict[str, Any]:
        """What a frame's JSON says.

        Raises:
            InputError: there is no such frame, or its file is damaged.
        """
        return read_json(self.frame_path(index))

    def image(self, index: int, output: str) -> NDArray[Any]:
        """One image of a frame, as `Frame` holds it.

        Raises:
            InputError: the frame has no such output.
        """
        return read_image(self.folder / file_name(index, output))

    def frame_path(self, index: int) -> Path:
        """Where a frame's JSON lies."""
        return self.folder / FRAMES / f"{index:0{DIGITS}d}.json"

    def intact(self, index: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """What is there of a frame: its facts, and the entries of those outputs whose files are in place.

        Both are empty when there is no such frame or its JSON is damaged.
        """
        try:
            facts = self.facts(index)
            entries = {str(name): entry for name, entry in facts.pop("outputs").items() if name in OUTPUTS}
        except (InputError, KeyError, AttributeError):
            return {}, {}
        if facts.get("index") != index:
            return {}, {}
        return facts, {name: entry for name, entry in entries.items() if self._in_place(index, name, entry)}

    def _in_place(self, index: int, output: str, entry: Any) -> bool:
        path = self.folder / file_name(index, output)
        try:
            return bool(path.stat().st_size == entry["bytes"])
        except (OSError, KeyError, TypeError):
            return False

    def commit(
        self,
        index: int,
        images: Mapping[str, NDArray[Any]],
        facts: Mapping[str, Any],
        kept: Mapping[str, Any],
        pool: Executor,
    ) -> None:
        """Add a frame, or outputs to a frame: first the images, then the JSON that makes them count.

        When that fails, the images written by this call are removed and what stood before still counts.

        Args:
            index: of the frame.
            images: arrays by output name.
            facts: the whole JSON but for its `outputs`.
            kept: entries of the outputs that are there already.
            pool: writes the images, several at a time: what takes long (compressing, hashing, waiting for the
                disk) is done without Python's lock.

        Raises:
            OSError: a file cannot be written.
        """
        try:
            written = {
                output: pool.submit(self._write, index, output, image) for output, image in images.items()
            }
            # All must have come to an end before a fault of one is told: nobody writes behind our back.
            wait(written.values())
            new = {output: entry.result() for output, entry in written.items()}
            write_json(self.frame_path(index), {**facts, "outputs": {**kept, **new}})
        except BaseException:
            for output in images:
                (self.folder / file_name(index, output)).unlink(missing_ok=True)
            raise

    def _write(self, index: int, output: str, image: NDArray[Any]) -> dict[str, Any]:
        """Put one image in its place, and tell what the frame's JSON says of it."""
        name = file_name(index, output)
        with replacing(self.folder / name) as temporary:
            return written_image(temporary, image, output, name)


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
        raise InputError(folder, "", None, f"holds no data set: there is no {MARK} in it")
    about = read_json(path)
    if about.get("format") != FORMAT:
        raise InputError(path, "format", about.get("format"), f"must be {FORMAT!r}")
    return Dataset(Path(folder), about)


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        InputError: the file is missing or holds something else.
    """
    try:
        found = json.loads(path.read_bytes())
    except OSError as fault:
        raise InputError(path, "", None, f"cannot be read ({fault.strerror})") from None
    except (ValueError, RecursionError):
        raise InputError(path, "", None, "is not valid JSON") from None
    if not isinstance(found, dict):
        raise InputError(path, "", None, "must hold a JSON object")
    return found

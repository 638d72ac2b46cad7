"""What an export can add to what its format needs."""

from __future__ import annotations

import hashlib
import io
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pepperscene.dataset.export.splits import Splits
from pepperscene.dataset.store.dataset import Dataset, file_name
from pepperscene.dataset.store.folder import LITTER, check_can_create, make_folder, remove
from pepperscene.errors import InputError, OutputError


def in_all(dataset: Dataset, indices: Sequence[int], outputs: Sequence[str]) -> tuple[str, ...]:
    """Those of some outputs that all frames have."""
    return tuple(
        output for output in outputs if all(dataset.path(index, output).is_file() for index in indices)
    )


OnFrame = Callable[[int, int, int], None]
"""Called after every frame with its index, how many are done, and how many there are in all."""


@dataclass(frozen=True, eq=False)
class ExportSource:
    """One frame of a data set.

    Attributes:
        dataset: that it belongs to.
        index: of the frame.
    """

    dataset: Dataset
    index: int

    @cached_property
    def facts(self) -> dict[str, Any]:
        """What its JSON says."""
        return self.dataset.metadata(self.index)

    @property
    def name(self) -> str:
        """What its files are called, without their endings."""
        return self.dataset.frame_path(self.index).stem

    def has(self, output: str) -> bool:
        """Whether the frame has an output."""
        return output in self.facts.get("outputs", {})

    def path(self, output: str) -> Path:
        """The file of an output."""
        return self.dataset.folder / file_name(self.index, output)

    def content(self, output: str) -> bytes:
        """The bytes of an output's file, as the build wrote them.

        Raises:
            InputError: the file is missing or damaged.
        """
        path = self.path(output)
        try:
            content = path.read_bytes()
        except OSError as fault:
            raise InputError(path, f"cannot be read ({fault.strerror})") from None
        if hashlib.sha256(content).hexdigest() != self.facts["outputs"].get(output, {}).get("sha256"):
            raise InputError(path, "is not what the build wrote; the same build command mends it")
        return content

    def image(self, output: str) -> Any:
        """An output as `Frame` holds it.

        Raises:
            InputError: the file is missing or damaged.
        """
        content = self.content(output)
        if self.path(output).suffix != ".png":
            return self.dataset.image(self.index, output)
        from PIL import Image

        try:
            with Image.open(io.BytesIO(content), formats=["PNG"]) as picture:
                return np.array(picture)
        except (OSError, ValueError, SyntaxError) as fault:
            raise InputError(self.path(output), f"cannot be read as an image ({fault})") from None


def export_sources(
    dataset: Dataset, indices: Sequence[int], on_frame: OnFrame | None = None
) -> Iterator[ExportSource]:
    """The frames one after another; each is told as done when the next is asked for."""
    for done, index in enumerate(indices, start=1):
        yield ExportSource(dataset, index)
        if on_frame is not None:
            on_frame(index, done, len(indices))


def wanted_frames(
    dataset: Dataset,
    splits: Splits,
    indices: Sequence[int] | None,
    outputs: Sequence[str],
    instead: Mapping[str, str] | None = None,
) -> list[int]:
    """The frames that an export writes: those of the indices, or of all, that belong to a split.

    Args:
        dataset: to be exported.
        splits: frames in none are left out.
        indices: of the frames; None for all.
        outputs: that each of them must have.
        instead: by output, another one that it can be made from.

    Raises:
        InputError: a frame lacks an output.
    """
    there = dataset.indices() if indices is None else indices
    wanted = [index for index in there if splits.named(index)]
    require(dataset, wanted, outputs, instead)
    return wanted


def require(
    dataset: Dataset, indices: Sequence[int], outputs: Sequence[str], instead: Mapping[str, str] | None = None
) -> None:
    """Make sure that all frames have what a format needs, before the first is written.

    Args:
        dataset: to be exported.
        indices: of the frames wanted.
        outputs: that are needed.
        instead: by output, another one that it can be made from.

    Raises:
        InputError: a frame lacks one; the message tells how to add it.
    """
    for output in outputs:
        names = {output, (instead or {}).get(output, output)}
        for index in indices:
            if not any((dataset.folder / file_name(index, name)).is_file() for name in names):
                recipe = _recipe(dataset)
                command = f"pepperscene build {recipe} --out {dataset.folder} --outputs {output}"
                raise InputError(
                    dataset.folder,
                    f"frame {index:06d} has no output {output!r}, which is needed; `{command}` adds it",
                )


def _recipe(dataset: Dataset) -> str:
    name = ""
    with suppress(KeyError, TypeError):
        name = str(dataset.info["recipe"]["name"])
    return name or "RECIPE"


@contextmanager
def new_folder(out: Path, source: Path) -> Iterator[Path]:
    """A temporary folder that becomes `out` when the block ends well, and is removed when it does not.

    It lies beside `out`. Where `out` is there already (and empty) it lies inside, and its content moves up: a
    mounted folder can be filled but not replaced. All is on the disk before the name is.

    Args:
        out: a new folder, or an empty one.
        source: of the data set, which takes no foreign folder inside.

    Raises:
        OutputError: `out` holds something, lies inside the data set, or cannot be written to; or there is no
            room left.
    """
    check_can_create(out)
    made: list[Path] = []
    try:
        _examine(out, source)
        name = f".{out.resolve().name}.{os.getpid()}.tmp"
        temporary = out / name if out.is_dir() else out.absolute().with_name(name)
        try:
            make_folder(temporary.parent, made)
            shutil.rmtree(temporary, ignore_errors=True)
            temporary.mkdir()
            yield temporary
            _flush()
            _put(temporary, out)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            remove(made)
            raise
    except OSError as fault:
        raise OutputError(f"{out}: cannot be written ({fault.strerror or fault})") from None


def _examine(out: Path, source: Path) -> None:
    if out.resolve().is_relative_to(source.resolve()):
        raise OutputError(f"{out}: lies inside the data set {source}; choose a folder elsewhere")
    held = sorted(path.name for path in out.iterdir() if path.name not in LITTER) if out.is_dir() else []
    if held:
        raise OutputError(f"{out}: holds {held[0]!r}; choose an empty or a new folder")


def _put(temporary: Path, out: Path) -> None:
    """Give what is finished its name."""
    if not out.is_dir():
        os.rename(temporary, out)
        return
    for path in sorted(temporary.iterdir()):
        os.rename(path, out / path.name)
    temporary.rmdir()


def _flush() -> None:
    """Have the disk hold what has been written, by one call: one for each of 100,000 files takes minutes."""
    if hasattr(os, "sync"):
        os.sync()

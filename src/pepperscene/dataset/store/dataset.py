"""A data set on disk: the layout of its folder, its existing frames, and how frames are added.

- `dataset.json`: what the data set is: recipe, its digest, version, quality; `checksum` as of a frame's JSON.
- `colour/006137.png` and so on: one folder for each output.
- `frames/006137.json`: metadata of one frame; written last, so that a frame counts once this file exists. Its
  `checksum` is the SHA-256 of the rest; `outputs` holds that of each image.
- `manifest.parquet`, `fruit.parquet`: one row per frame, or per fruit in each frame; see `manifest`.
- `journal.jsonl`: timings, and the frames that were requested; see `journal`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, wait
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from numpy.typing import NDArray

from pepperscene.atomic import (
    canonical_json,
    digest,
    exclusive_access,
    write_error,
    write_file,
    write_file_if,
)
from pepperscene.camera.sensor.bands import Band
from pepperscene.dataset.store.band_channels import recorded_bands
from pepperscene.dataset.store.frame_json import (
    CHECKSUM,
    DIGITS,
    FrameStatus,
    checksum_of,
    file_entry,
    frame_index,
    is_as_written,
    read_json,
)
from pepperscene.dataset.store.images import encode_image, read_image
from pepperscene.dataset.store.journal import Journal
from pepperscene.dataset.store.manifest import (
    FRUIT,
    MANIFEST,
    Row,
    fruit_rows,
    open_table_file,
    table_columns,
    write_table,
)
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS
from pepperscene.user_files import FileKind, MissingFileError, open_file

if TYPE_CHECKING:
    import pyarrow


FORMAT: Final = "pepperscene data set 1"
MARK: Final = "dataset.json"
FRAMES: Final = "frames"

_CHECKSUM_LINE: Final = re.compile(rb'^"checksum": "([0-9a-f]{64})"', re.MULTILINE)
_HEAD_BYTES: Final = 8192  # chosen: only the camera comes before the checksum, with one or two thousand bytes
_TABLE_ATTEMPTS: Final = 5  # chosen: without a change meanwhile, the first one is the last


def file_name(index: int, output: str) -> str:
    """Path of an output's file inside the data set, with forward slashes."""
    return f"{output}/{index:0{DIGITS}d}{OUTPUTS[output].suffix}"


@dataclass(frozen=True)
class Dataset:
    """A data set in a folder; `info` is the content of its `dataset.json`."""

    folder: Path
    info: Mapping[str, Any]

    def __repr__(self) -> str:
        recipe, quality = self.info.get("recipe"), self.info.get("quality")
        name = recipe.get("name") if isinstance(recipe, Mapping) else None
        return f"Dataset({str(self.folder)!r}, {len(self.indices())} frames of {name!r}, {quality})"

    def _repr_html_(self) -> str:
        """Some frames, small, for notebooks."""
        from pepperscene.dataset.store.dataset_view import frames_html

        return frames_html(repr(self), self.indices(), self.path)

    def indices(self) -> tuple[int, ...]:
        """The existing frames, ascending."""
        with suppress(FileNotFoundError, NotADirectoryError), os.scandir(self.folder / FRAMES) as entries:
            indices = (frame_index(entry.name, ".json") for entry in entries)
            return tuple(sorted(index for index in indices if index is not None))
        return ()

    def metadata(self, index: int) -> dict[str, Any]:
        """The content of a frame's JSON; raises `InputError` if it is missing or damaged."""
        return read_json(self.frame_path(index), within=self.folder)

    def image(self, index: int, output: str) -> Any:
        """One output of a frame, as `Frame` holds it; raises `InputError` if the frame does not have it."""
        return read_image(self.path(index, output), within=self.folder)

    def path(self, index: int, output: str) -> Path:
        """Path of an output of a frame."""
        return self.folder / file_name(index, output)

    def frame_path(self, index: int) -> Path:
        """Path of a frame's JSON."""
        return self.folder / FRAMES / f"{index:0{DIGITS}d}.json"

    def manifest(self) -> pyarrow.Table:
        """The table of all frames, ascending; its columns are those of `manifest.table_columns`.

        It is written again if it is lost, damaged or older than a frame; raises `OutputError` if that fails.
        """
        return self._read_table(MANIFEST)

    def fruit(self) -> pyarrow.Table:
        """The table of all fruit in all frames; its columns are `manifest.FRUIT_COLUMNS`.

        Raises `InputError` if no frame has the output `harvest`.
        """
        return self._read_table(FRUIT)

    def write_tables(self, journal: Journal | None = None) -> None:
        """Write `manifest.parquet`, and `fruit.parquet` if frames have the output `harvest`.

        Rows come from the journal (None opens it), or else from the frame's own files. Several builds of one
        folder may call this at the same time: the last table holds all frames. Raises `OutputError` if a
        table cannot be written.
        """
        journal = journal or Journal(self.folder)
        try:
            with exclusive_access(self.folder / FRAMES):
                for _ in range(_TABLE_ATTEMPTS):
                    before = self._frames_state()
                    journal.refresh()
                    self._write_tables(journal)
                    # Where the file system has no locks, another build may have added frames meanwhile.
                    if self._frames_state() == before:
                        break
        except OSError as error:
            raise write_error(error, self.folder / MANIFEST) from None

    def _write_tables(self, journal: Journal) -> None:
        indices = self.indices()
        rows = journal.rows((index, self.written_checksum(index)) for index in indices)
        frames = (self.intact(index).row() if row is None else row for index, row in rows)
        known = (row for row in frames if row.get("index") is not None)
        write_table(self.folder, MANIFEST, known, table_columns(MANIFEST, self.info))
        harvested = [index for index in indices if self.path(index, "harvest").is_file()]
        if harvested:
            columns = table_columns(FRUIT, self.info)
            write_table(self.folder, FRUIT, self._fruit_rows(harvested), columns)

    def _frames_state(self) -> dict[str, tuple[int, int]]:
        """Name, file number and time of each frame's JSON; it is another file after every change."""
        state = {}
        with os.scandir(self.folder / FRAMES) as entries:
            for entry in entries:
                with suppress(FileNotFoundError):
                    status = entry.stat()
                    state[entry.name] = (status.st_ino, status.st_mtime_ns)
        return state

    def _read_table(self, name: str) -> pyarrow.Table:
        from pyarrow import ArrowException, parquet

        path = self.folder / name
        with suppress(InputError, OSError, ArrowException, KeyError):
            known = self._open_table(MANIFEST, ["index", "checksum"])
            if self._is_current(known["index"].to_pylist(), known["checksum"].to_pylist()):
                return self._open_table(name)
        self.write_tables()
        if not path.is_file():
            raise InputError(self.folder, "has no frame with the output harvest; build it first")
        with open_table_file(path, self.folder) as file:
            return parquet.read_table(file)

    def _open_table(self, name: str, columns: list[str] | None = None) -> pyarrow.Table:
        """Read a table whose pages have the right checksums."""
        from pyarrow import parquet

        with open_table_file(self.folder / name, self.folder) as file:
            return parquet.read_table(file, columns=columns, page_checksum_verification=True)

    def _is_current(self, indices: list[int], checksums: list[str]) -> bool:
        """Whether the manifest lists all frames as they are."""
        if tuple(indices) != self.indices():
            return False
        # Only a frame that is as new as the table can have changed since.
        written = (self.folder / MANIFEST).stat().st_mtime_ns
        if all(time < written for _, time in self._frames_state().values()):
            return True
        return [self.written_checksum(index) for index in indices] == checksums

    def written_checksum(self, index: int) -> str:
        """The checksum in a frame's JSON, without a look at the rest; empty if there is none.

        Raises `InputError` if the file exists and cannot be read.
        """
        with (
            suppress(MissingFileError),
            open_file(self.frame_path(index), "json", within=self.folder) as file,
        ):
            match = _CHECKSUM_LINE.search(file.read(_HEAD_BYTES)) or _CHECKSUM_LINE.search(file.read())
            return match[1].decode() if match else ""
        return ""

    def _fruit_rows(self, indices: list[int]) -> Iterator[Row]:
        for index in indices:
            # The next build repairs a damaged file.
            with suppress(InputError, LookupError, TypeError, AttributeError):
                yield from list(fruit_rows(index, read_json(self.path(index, "harvest"), within=self.folder)))

    def intact(self, index: int) -> FrameStatus:
        """The files of a frame that are exactly what the build wrote; none if its JSON is damaged."""
        written = self.written_checksum(index)
        try:
            metadata = self.metadata(index)
            if not is_as_written(metadata) or metadata.get("index") != index:
                return FrameStatus(written_checksum=written)
            checksum = str(metadata.pop(CHECKSUM))
            entries = metadata.pop("outputs").items()
            outputs = {
                str(name): entry
                for name, entry in entries
                if name in OUTPUTS
                and _matches_entry(self.path(index, name), entry, OUTPUTS[name].file_kind, self.folder)
            }
        except (InputError, KeyError, AttributeError, TypeError):
            return FrameStatus(written_checksum=written)
        return FrameStatus(metadata, outputs, checksum, written)

    def commit(
        self,
        index: int,
        images: Mapping[str, NDArray[Any]],
        metadata: Mapping[str, Any],
        existing: FrameStatus,
        pool: Executor,
    ) -> FrameStatus:
        """Write further images of a frame and, last and in one step, its JSON, which completes them.

        Another build may have added outputs to the frame since `existing` was read; its outputs stay. On an
        error, the images of this call are removed, and existing outputs stay valid.

        Args:
            index: of the frame.
            images: arrays by output name.
            metadata: the whole JSON without its `outputs`.
            existing: the frame as it was before.
            pool: writes several images at a time; encoding and waiting for the disk release Python's lock.
        """
        metadata = {str(key): value for key, value in metadata.items() if key not in (CHECKSUM, "outputs")}
        try:
            names, bands = {output: file_name(index, output) for output in images}, recorded_bands(metadata)
            entries = {
                output: pool.submit(written_image, self.folder / name, images[output], output, name, bands)
                for output, name in names.items()
            }
            # Wait for all before the first error is raised, so that no image is written after the removal.
            wait(entries.values())
            written = {output: entry.result() for output, entry in entries.items()}
            while (status := self._write_frame(index, written, metadata, existing)) is None:
                existing = self.intact(index)
            return status
        except BaseException:
            self._remove_unnamed(index, images)
            raise

    def _write_frame(
        self, index: int, written: Mapping[str, Any], metadata: Mapping[str, Any], existing: FrameStatus
    ) -> FrameStatus | None:
        """Write a frame's JSON with existing and new outputs; None if it is not the existing one any more."""
        merged = {**existing.metadata, **metadata}
        # Without label outputs the renderer does not list the instances in view; an earlier build may have.
        merged["instances"] = metadata.get("instances") or existing.metadata.get("instances", {})
        outputs = {**existing.outputs, **written}
        checksum = checksum_of({**merged, "outputs": outputs})
        content = canonical_json({**merged, "outputs": outputs, CHECKSUM: checksum})
        is_unchanged = write_file_if(
            self.frame_path(index), content, lambda: self.written_checksum(index) == existing.written_checksum
        )
        return FrameStatus(merged, outputs, checksum, checksum) if is_unchanged else None

    def _remove_unnamed(self, index: int, outputs: Iterable[str]) -> None:
        """Remove images of a frame, except those that its JSON names, as another build may have made them."""
        named = self.intact(index).outputs
        for output in outputs:
            if output not in named:
                self.path(index, output).unlink(missing_ok=True)


def _matches_entry(path: Path, entry: Mapping[str, Any], kind: FileKind, folder: Path) -> bool:
    """Whether a file of a data set has the size and the checksum of its entry in the frame's JSON."""
    try:
        is_as_long = path.stat().st_size == entry["bytes"]
        return bool(is_as_long and digest(path, kind, within=folder) == entry["sha256"])
    except (InputError, OSError, KeyError, TypeError):
        return False


def written_image(
    path: Path, image: Any, output: str, name: str, bands: Sequence[Band] = ()
) -> dict[str, Any]:
    """Write an image of an output atomically; returns its entry, under this name, in the frame's JSON."""
    content = encode_image(image, output, bands)
    write_file(path, content)
    return file_entry(name, content)


def open_dataset(folder: str | Path) -> Dataset:
    """Open the data set in a folder; raises `InputError` if there is none."""
    path = Path(folder) / MARK
    if not path.is_file():
        raise InputError(folder, f"holds no data set: there is no {MARK} in it")
    info = read_json(path, within=Path(folder))
    if info.get("format") != FORMAT:
        raise InputError(path, f"must be {FORMAT!r}", key="format", value=info.get("format"))
    return Dataset(Path(folder), info)

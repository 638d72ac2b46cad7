"""A data set on disk: the layout of its folder, its existing frames, and how frames are added.

- `dataset.json`: what the data set is: recipe, its digest, version, quality; `checksum` as of a frame's JSON.
- `colour/006137.png` and so on: one folder for each output.
- `frames/006137.json`: metadata of one frame; written last, so that a frame counts once this file exists. Its
  `checksum` is the SHA-256 of the rest; `outputs` holds that of each image.
- `manifest.parquet`, `fruit.parquet`: one row per frame, or per fruit in each; see `manifest`.
- `journal.jsonl`: a log of timings.
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

from pepperscene.atomic import canonical_json, digest, exclusive_access, write_errors, write_file
from pepperscene.camera.sensor.bands import Band
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
from pepperscene.dataset.store.images import NO_PHOTO, encode_image, read_image, recorded_bands
from pepperscene.dataset.store.journal import read_timings
from pepperscene.dataset.store.manifest import (
    FRUIT,
    FRUIT_COLUMNS,
    MANIFEST,
    Row,
    frame_row,
    fruit_rows,
    open_table_file,
    rows_table,
    table_columns,
    table_schema,
    write_table,
)
from pepperscene.errors import InputError
from pepperscene.notebook_view import frames_html
from pepperscene.outputs import OUTPUTS
from pepperscene.user_files import FileKind, MissingFileError, open_file

if TYPE_CHECKING:
    import pyarrow


FORMAT: Final = "pepperscene data set 1"
MARK: Final = "dataset.json"
FRAMES: Final = "frames"

_CHECKSUM_LINE: Final = re.compile(rb'^"checksum": "([0-9a-f]{64})"', re.MULTILINE)
_HEAD_BYTES: Final = 8192  # chosen: only the camera comes before the checksum, with one or two thousand bytes


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

    def write_tables(self, rows: Mapping[int, Row] | None = None) -> None:
        """Write `manifest.parquet`, and `fruit.parquet` if frames have the output `harvest`.

        Several builds of one folder may call this at the same time: the last table holds all frames. `rows`
        of frames that the caller has just written, by index, need not be read again. Raises `OutputError` if
        a table cannot be written.
        """
        # No frame is added meanwhile.
        with write_errors(self.folder / MANIFEST), exclusive_access(self.folder / FRAMES):
            self._write_manifest(rows or {})
            harvested = [index for index in self.indices() if self.path(index, "harvest").is_file()]
            if harvested:
                write_table(self.folder / FRUIT, rows_table(self._fruit_rows(harvested), FRUIT_COLUMNS))

    def _write_manifest(self, rows: Mapping[int, Row]) -> None:
        """Write one row for each frame: of the manifest so far if the frame is the same, or a new one."""
        import pyarrow

        columns = table_columns(MANIFEST, self.info)
        checksums = {index: self.written_checksum(index) for index in self.indices()}
        tables = []
        with suppress(InputError, OSError, pyarrow.ArrowException):
            existing = self._open_table(MANIFEST)
            if existing.schema.equals(table_schema(columns)):
                pairs = zip(existing["index"].to_pylist(), existing["checksum"].to_pylist(), strict=True)
                kept = [index not in rows and checksums.get(index) == checksum for index, checksum in pairs]
                tables = [existing.filter(kept)]
                for index in tables[0]["index"].to_pylist():
                    del checksums[index]

        # Frames without a row: by this build, or read again.
        timings = read_timings(self.folder, set(checksums.values()))
        added = (
            row
            if (row := rows.get(index, {})).get("checksum") == checksum
            else frame_row(self._content(index)) | timings.get(checksum, {})
            for index, checksum in checksums.items()
        )
        tables.append(rows_table((row for row in added if row["index"] is not None), columns))
        write_table(self.folder / MANIFEST, pyarrow.concat_tables(tables).sort_by("index"))

    def _fruit_rows(self, indices: list[int]) -> Iterator[Row]:
        for index in indices:
            # The next build repairs a damaged file.
            with suppress(InputError, LookupError, TypeError, AttributeError):
                yield from list(fruit_rows(index, read_json(self.path(index, "harvest"), within=self.folder)))

    def _read_table(self, name: str) -> pyarrow.Table:
        from pyarrow import ArrowException

        with suppress(InputError, OSError, ArrowException, KeyError):
            known = self._open_table(MANIFEST, ["index", "checksum"])
            if self._is_current(known["index"].to_pylist(), known["checksum"].to_pylist()):
                return self._open_table(name)
        self.write_tables()
        if not (self.folder / name).is_file():
            raise InputError(self.folder, "has no frame with the output harvest; build it first")
        return self._open_table(name)

    def _open_table(self, name: str, columns: list[str] | None = None) -> pyarrow.Table:
        """Read a table whose pages have the right checksums."""
        from pyarrow import parquet

        with open_table_file(self.folder / name, self.folder) as file:
            return parquet.read_table(file, columns=columns, page_checksum_verification=True)

    def _is_current(self, indices: list[int], checksums: list[str]) -> bool:
        """Whether the manifest lists all frames as they are."""
        # Only a frame that is as new as the table can have changed since.
        written = (self.folder / MANIFEST).stat().st_mtime_ns
        return tuple(indices) == self.indices() and all(
            self.frame_path(index).stat().st_mtime_ns < written or self.written_checksum(index) == checksum
            for index, checksum in zip(indices, checksums, strict=True)
        )

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

    def _content(self, index: int) -> dict[str, Any]:
        """The content of a frame's JSON; empty if it is not what a build wrote."""
        with suppress(InputError):
            metadata = self.metadata(index)
            is_complete = metadata.get("index") == index and isinstance(metadata.get("outputs"), dict)
            if is_complete and is_as_written(metadata):
                return metadata
        return {}

    def intact(self, index: int) -> FrameStatus:
        """The files of a frame that are exactly what the build wrote; none if its JSON is damaged."""
        written = self.written_checksum(index)
        metadata = self._content(index)
        checksum, entries = metadata.pop(CHECKSUM, ""), metadata.pop("outputs", {})
        outputs = {
            name: entry
            for name, entry in entries.items()
            if name in OUTPUTS
            and _matches_entry(self.path(index, name), entry, OUTPUTS[name].file_kind, self.folder)
        }
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
            details = recorded_bands(metadata), metadata.get("photo", NO_PHOTO)
            entries = {
                output: pool.submit(self._write_image, index, output, image, *details)
                for output, image in images.items()
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

    def _write_image(
        self, index: int, output: str, image: Any, bands: Sequence[Band], photo: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Write an image; returns its entry in the frame's JSON."""
        content = encode_image(image, output, bands, photo)
        write_file(self.path(index, output), content)
        return file_entry(file_name(index, output), content)

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
        is_unchanged = write_file(
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


def open_dataset(folder: str | Path) -> Dataset:
    """Open the data set in a folder; raises `InputError` if there is none."""
    path = Path(folder) / MARK
    if not path.is_file():
        raise InputError(folder, f"holds no data set: there is no {MARK} in it")
    info = read_json(path, within=Path(folder))
    if info.get("format") != FORMAT:
        raise InputError(path, f"must be {FORMAT!r}", key="format", value=info.get("format"))
    return Dataset(Path(folder), info)

"""The JSON of a frame or a data set: reading it, its checksum, and the parts of a frame that exist."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pepperscene.atomic import canonical_json
from pepperscene.dataset.store.manifest import Row, frame_row
from pepperscene.document import parse_json
from pepperscene.errors import InputError
from pepperscene.user_files import FileKind, read_file

DIGITS: Final = 6
"""Of a frame's index in file names."""
CHECKSUM: Final = "checksum"
"""Key of the SHA-256 of the rest."""


def frame_index(name: str, suffix: str) -> int | None:
    """Index of the frame of a file with this name, None if it is not a frame's."""
    stem = name.removesuffix(suffix)
    is_frame = name.endswith(suffix) and len(stem) == DIGITS and stem.isascii() and stem.isdecimal()
    return int(stem) if is_frame else None


@dataclass(frozen=True)
class FrameStatus:
    """Existing parts of a frame: JSON without `outputs` and `checksum`, intact images, and checksum.

    `written_checksum` is that in the JSON before it was read, even if it does not fit the rest.
    """

    metadata: dict[str, Any] = field(default_factory=dict)
    outputs: dict[str, Any] = field(default_factory=dict)
    checksum: str = ""
    written_checksum: str = ""

    def row(self) -> Row:
        """The frame's row in the manifest, without timings."""
        return frame_row({**self.metadata, "outputs": self.outputs, CHECKSUM: self.checksum})


def checksum_of(metadata: Mapping[str, Any]) -> str:
    """SHA-256 of a frame's JSON as canonical text, hexadecimal, without its own `checksum`."""
    content = {key: value for key, value in metadata.items() if key != CHECKSUM}
    return hashlib.sha256(canonical_json(content)).hexdigest()


def is_as_written(content: Mapping[str, Any]) -> bool:
    """Whether a JSON object with a `checksum` is what a build wrote."""
    try:
        return bool(content.get(CHECKSUM) == checksum_of(content))
    except (ValueError, RecursionError):
        # Numbers that JSON does not have, and halves of characters.
        return False


def file_entry(name: str, content: bytes) -> dict[str, Any]:
    """Entry of a file in a frame's JSON."""
    return {"file": name, "bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def read_json(path: Path, kind: FileKind = "json", *, within: Path | None = None) -> dict[str, Any]:
    """Read the object in a JSON file; `within` is the folder of the data set that it belongs to, if any.

    Raises:
        InputError: the file cannot be read, or holds something else.
    """
    content = read_file(path, kind, within=within)
    try:
        value = parse_json(content, kind)
    except ValueError:
        raise InputError(path, "is not valid JSON") from None
    if not isinstance(value, dict):
        raise InputError(path, "must hold a JSON object")
    return value

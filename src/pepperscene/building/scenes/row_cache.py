"""Grown plants and rows in a folder, so that the next process need not grow them again.

A file is named by the digest of everything that its content depends on, the code included, and ends with its
checksum. It appears complete or not at all, and any process may remove it. It holds JSON and arrays: nothing
in it is run or imported by name.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from enum import IntEnum
from functools import cache
from importlib.metadata import version
from itertools import accumulate, chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import atomic_write, digest, remove_temporary_files
from pepperscene.errors import PepperError
from pepperscene.user_files import open_file
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar

Content = TypeVar("Content")

CACHE: Final = "PEPPERSCENE_CACHE"
"""Environment variable: the folder of grown rows, or "none" for none."""
MOST_BYTES: Final = 2_000_000_000
"""Of all files in the folder; the oldest go first. Chosen: ten rows of `barth2018` with their plants."""

_SUFFIX: Final = ".row"
_CHECKSUM: Final = 32  # bytes
_PLAIN: Final = frozenset({type(None), bool, int, float, str})  # types that JSON has
_GROWING: Final = (
    "classes.py", "units.py", "recipe/plan.py", "building/scenes", "cultivar", "geometry", "grammar", "scene",
)  # fmt: skip
"""Code that rows depend on."""
_LIBRARIES: Final = ("numpy", "scipy", "numba", "trimesh", "pydantic")


def cache_folder() -> Path | None:
    """The folder of grown rows: `CACHE`, or that of the system for caches; None for none."""
    text = os.environ.get(CACHE, "").strip()
    if text:
        return None if text.lower() == "none" else Path(text)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA", "")
    elif sys.platform == "darwin":
        base = str(Path.home() / "Library" / "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME", "") or str(Path.home() / ".cache")
    return Path(base) / "pepperscene" / "rows" if base else None


class RowCache:
    """What a builder has grown.

    Args:
        cultivar: of the plants; files refer to it, and do not contain it.
        inputs: what else everything depends on.
        classes: the dataclasses and enumerations that contents consist of.
    """

    def __init__(self, cultivar: Cultivar, inputs: tuple[object, ...], classes: tuple[type, ...]) -> None:
        self._cultivar, self._inputs = cultivar, inputs
        self._classes = {one.__name__: one for one in classes}

    def get(self, make: Callable[[], Content], *address: object) -> Content:
        """What `make` returns, from the folder if it is there, else made and stored."""
        path = self._path(address)
        if path is None:
            return make()
        # Whatever a damaged file raises, its content is made anew.
        with suppress(Exception):
            return cast(Content, self._read(path))
        content = make()
        # A full disk, or a folder of others, is no reason to stop.
        with suppress(PepperError, OSError, ValueError):
            self._write(path, content)
        return content

    def has(self, *address: object) -> bool:
        """Whether the folder has a content."""
        path = self._path(address)
        return path is not None and path.is_file()

    def _path(self, address: tuple[object, ...]) -> Path | None:
        """The file of a content, or None for none."""
        # A scan that cannot be read fails where it is needed; and not every user has a home.
        with suppress(PepperError, OSError, RuntimeError):
            if (folder := cache_folder()) is not None:
                return folder / f"{self._key(address)}{_SUFFIX}"
        return None

    def _key(self, address: tuple[object, ...]) -> str:
        """Digest of everything that a content depends on."""
        scans = {path for organ in self._cultivar.organs.values() for path in getattr(organ, "scan", ())}
        parts = [_code_digest(), repr(self._cultivar), repr(self._inputs), repr(address)]
        parts += [digest(Path(path), "mesh") for path in sorted(scans)]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

    def _read(self, path: Path) -> Any:
        with open_file(path, "cache") as file:
            content = memoryview(file.read())
        body = content[:-_CHECKSUM]
        if hashlib.blake2b(body, digest_size=_CHECKSUM).digest() != content[-_CHECKSUM:]:
            raise ValueError("a damaged file")
        # The length of the JSON text, the text, and the arrays.
        start = 8 + int.from_bytes(body[:8], "little")
        decoder = _Decoder(body[start:], self._classes, self._cultivar)
        (loaded,) = decoder.column(json.loads(bytes(body[8:start])))
        os.utime(path)  # what is used last goes last
        return loaded

    def _write(self, path: Path, content: object) -> None:
        arrays: list[NDArray[Any]] = []
        text = json.dumps(self._column([content], arrays), separators=(",", ":"), allow_nan=False).encode()
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        remove_temporary_files(path.parent)
        checksum = hashlib.blake2b(digest_size=_CHECKSUM)
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            for part in (len(text).to_bytes(8, "little"), text, *(array.tobytes() for array in arrays)):
                checksum.update(part)
                file.write(part)
            file.write(checksum.digest())
        _remove_oldest(path.parent)

    def _column(self, values: Sequence[Any], arrays: list[NDArray[Any]]) -> list[Any]:
        """Values for JSON, as a list that begins with their kind; their arrays are appended to `arrays`.

        Fields of dataclasses become columns, because a row has many small objects of few classes.
        """
        if _PLAIN.issuperset(map(type, values)):
            return ["values", *values]
        kinds = [self._kind(value) for value in values]
        kind, *others = dict.fromkeys(kinds)
        if others:
            parts: dict[str, list[Any]] = {name: [] for name in (kind, *others)}
            for name, value in zip(kinds, values, strict=True):
                parts[name].append(value)
            numbers = {name: number for number, name in enumerate(parts)}
            order = [numbers[name] for name in kinds]
            return ["mixed", order, *(self._column(part, arrays) for part in parts.values())]
        if kind == "number":
            return ["values", *(value.item() for value in values)]
        if kind.startswith("array "):
            arrays.append(np.concatenate([array.ravel() for array in values]) if values[1:] else values[0])
            return ["arrays", values[0].dtype.str, [array.shape for array in values]]
        if kind == "cultivar":
            return [kind, len(values)]
        if kind == "path":
            return [kind, *map(str, values)]
        if kind in ("tuple", "list", "dict"):
            items = [list(chain.from_iterable(values))]
            if kind == "dict":
                items.append([item for value in values for item in value.values()])
            return [kind, list(map(len, values)), *(self._column(column, arrays) for column in items)]
        if issubclass(self._classes[kind], IntEnum):
            return [kind, *map(int, values)]
        names = [field.name for field in fields(cast(Any, values[0]))]
        return [kind, *(self._column([getattr(value, name) for value in values], arrays) for name in names)]

    def _kind(self, value: Any) -> str:
        """What values are stored together with this one."""
        if type(value) in _PLAIN:
            return "values"
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            return f"array {value.dtype.str}"
        if isinstance(value, np.generic):
            return "number"
        if isinstance(value, Mapping):
            return "dict"
        if isinstance(value, Path):
            return "path"
        if type(value) in (tuple, list):
            return type(value).__name__
        if type(value) is type(self._cultivar) and value == self._cultivar:
            return "cultivar"
        name = type(value).__name__
        if self._classes.get(name) is not type(value):
            raise ValueError(f"a row with a {name} cannot be stored")
        return name


class _Decoder:
    """Makes values of what `RowCache` wrote; raises `KeyError` for other kinds."""

    def __init__(self, data: memoryview, classes: Mapping[str, type], cultivar: Cultivar) -> None:
        self._data, self._classes, self._cultivar = data, classes, cultivar
        self._start = 0

    def column(self, encoded: list[Any]) -> list[Any]:
        """The values; arrays follow each other in the data in the same order."""
        kind, *rest = encoded
        if kind == "values":
            return rest
        if kind == "arrays":
            return self._arrays(np.dtype(rest[0]), rest[1])
        if kind == "mixed":
            parts = [iter(self.column(part)) for part in rest[1:]]
            return [next(parts[number]) for number in rest[0]]
        if kind == "cultivar":
            return [self._cultivar] * rest[0]
        if kind == "path":
            return [Path(text) for text in rest]
        if kind in ("tuple", "list", "dict"):
            items: Iterator[Any] = zip(*map(self.column, rest[1:]), strict=True)
            if kind == "dict":
                return [dict(islice(items, length)) for length in rest[0]]
            made = tuple if kind == "tuple" else list
            return [made(item for (item,) in islice(items, length)) for length in rest[0]]
        cls = self._classes[kind]
        if issubclass(cls, IntEnum):
            return [cls(number) for number in rest]
        return [cls(*values) for values in zip(*map(self.column, rest), strict=True)]

    def _arrays(self, dtype: np.dtype[Any], shapes: list[list[int]]) -> list[NDArray[Any]]:
        ends = list(accumulate(math.prod(shape) for shape in shapes))
        start, self._start = self._start, self._start + dtype.itemsize * ends[-1]
        # A copy, which can be written to and does not hold the rest of the file.
        joined = np.frombuffer(self._data[start : self._start], dtype).copy()
        starts = (0, *ends[:-1])
        return [joined[a:b].reshape(shape) for a, b, shape in zip(starts, ends, shapes, strict=True)]


def _remove_oldest(folder: Path) -> None:
    """Remove files, the oldest first, until the folder is within its limit."""
    files = [(path, path.stat()) for path in folder.glob(f"*{_SUFFIX}")]
    total = sum(status.st_size for _, status in files)
    for path, status in sorted(files, key=lambda file: file[1].st_mtime):
        if total <= MOST_BYTES:
            break
        path.unlink(missing_ok=True)
        total -= status.st_size


@cache
def _code_digest() -> str:
    """Digest of the code that grows rows, of the libraries' versions, and of the processor's kind."""
    package = Path(__file__).parents[2]
    sources = [path for name in _GROWING for path in [package / name, *(package / name).rglob("*.py")]]
    parts = [__version__, platform.machine(), str(sys.version_info), *map(version, _LIBRARIES)]
    parts += [digest(path, "text") for path in sorted(sources) if path.is_file()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()

"""Grown plants and rows in a folder, so that the next process need not grow them again.

A file is named by the digest of everything that its content depends on, the code included, and ends with its
checksum. It appears complete or not at all, and any process may remove it. It holds a pickle, read with a
fixed list of classes: a file can make numbers and organs, but runs no code.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import platform
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

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
_GROWING: Final = (
    "classes.py", "units.py", "recipe/plan.py", "building/scenes", "cultivar", "geometry", "grammar", "scene",
)  # fmt: skip
"""Code that rows depend on."""
_LIBRARIES: Final = ("numpy", "scipy", "numba", "trimesh", "pydantic")
_CLASSES: Final[Mapping[str, tuple[str, ...]]] = {
    "pepperscene.building.scenes.plants": ("GrownPlant", "PlacedPlant"),
    "pepperscene.building.scenes.scene_builder": ("BuiltScene",),
    "pepperscene.classes": ("Appearance", "Instance", "OrganClass"),
    "pepperscene.cultivar.organs": ("FruitScans", "OrganKind"),
    "pepperscene.geometry.contacts.detect": ("ContactCounts",),
    "pepperscene.geometry.contacts.joints": ("JointRotation",),
    "pepperscene.geometry.mesh": ("Mesh",),
    "pepperscene.grammar.plant": ("Organ", "Plant"),
    "pepperscene.scene.far_rows": ("FarRow",),
    "pepperscene.scene.greenhouse": ("Posture",),
    "pepperscene.scene.placement": ("Skeleton",),
    "pathlib": ("PosixPath", "WindowsPath"),
    "pathlib._local": ("PosixPath", "WindowsPath"),
    "numpy": ("dtype", "ndarray"),
    "numpy._core.multiarray": ("_reconstruct", "scalar"),
    "numpy._core.numeric": ("_frombuffer",),
}
"""What files may contain, by module."""


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
    """

    def __init__(self, cultivar: Cultivar, *inputs: object) -> None:
        self._cultivar, self._inputs = cultivar, inputs

    def get(self, make: Callable[[], Content], *address: object) -> Content:
        """What `make` returns, from the folder if it is there, else made and stored."""
        try:
            folder = cache_folder()
            path = None if folder is None else folder / f"{self._key(address)}{_SUFFIX}"
        except (PepperError, OSError, RuntimeError):
            path = None  # a scan that cannot be read fails where it is needed; or there is no home
        if path is None:
            return make()
        # Whatever a damaged file raises, its content is made anew.
        with suppress(Exception):
            return cast(Content, self._read(path))
        content = make()
        # A full disk, or a folder of others, is no reason to stop.
        with suppress(PepperError, OSError, pickle.PicklingError):
            self._write(path, content)
        return content

    def _key(self, address: tuple[object, ...]) -> str:
        """Digest of everything that a content depends on."""
        scans = {path for organ in self._cultivar.organs.values() for path in getattr(organ, "scan", ())}
        parts = [_code_digest(), repr(self._cultivar), *map(repr, self._inputs), repr(address)]
        parts += [digest(Path(path), "mesh") for path in sorted(scans)]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

    def _read(self, path: Path) -> Any:
        with open_file(path, "cache") as file:
            content = memoryview(file.read())
        if hashlib.blake2b(content[:-_CHECKSUM], digest_size=_CHECKSUM).digest() != content[-_CHECKSUM:]:
            raise ValueError("a damaged file")
        loaded = _Reader(io.BytesIO(content[:-_CHECKSUM]), self._cultivar).load()
        os.utime(path)  # what is used last goes last
        return loaded

    def _write(self, path: Path, content: object) -> None:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        remove_temporary_files(path.parent)
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            hashing = _HashingFile(file)
            _Writer(cast(Any, hashing), self._cultivar).dump(content)
            file.write(hashing.hash.digest())
        _remove_oldest(path.parent)


class _HashingFile:
    """A file that hashes what is written into it."""

    def __init__(self, file: io.BufferedWriter) -> None:
        self._file, self.hash = file, hashlib.blake2b(digest_size=_CHECKSUM)

    def write(self, data: bytes) -> int:
        self.hash.update(data)
        return self._file.write(data)


class _Writer(pickle.Pickler):
    """Writes the cultivar as a reference."""

    def __init__(self, file: Any, cultivar: Cultivar) -> None:
        super().__init__(file, protocol=5)
        self._cultivar = cultivar

    def persistent_id(self, obj: Any) -> str | None:
        return "cultivar" if obj is self._cultivar or _is_equal(obj, self._cultivar) else None


class _Reader(pickle.Unpickler):
    """Reads numbers, and the classes that a row consists of."""

    def __init__(self, file: Any, cultivar: Cultivar) -> None:
        super().__init__(file)
        self._cultivar = cultivar

    def persistent_load(self, pid: Any) -> Cultivar:
        return self._cultivar

    def find_class(self, module: str, name: str) -> Any:
        if name not in _CLASSES.get(module, ()):
            raise pickle.UnpicklingError(f"{module}.{name} is not part of a row")
        return super().find_class(module, name)


def _is_equal(value: object, cultivar: Cultivar) -> bool:
    """Whether a value is an equal cultivar, of another process."""
    return type(value) is type(cultivar) and value == cultivar


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
    found = hashlib.sha256("".join(map(version, _LIBRARIES)).encode())
    found.update(f"{__version__} {platform.machine()} {sys.version_info}".encode())
    for path in sorted(set(sources)):
        if path.is_file():
            found.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return found.hexdigest()

"""Predictions of a user's method: a folder with one file for each frame of the split "test"."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.pictures import read_mask
from pepperscene.dataset.store.images import read_image
from pepperscene.errors import InputError
from pepperscene.learning.tasks.frames import frame_name
from pepperscene.user_files import open_file

FloatArray = NDArray[np.float64]

MAP_SUFFIXES: Final = (".npy", ".exr", ".png")
CLASS_FOLDER: Final = "class"
"""Folder of the class images that `pepperscene predict` writes."""


@dataclass(frozen=True)
class PredictionFolder:
    """A folder of predictions; `000012.npy`, `000012.exr` or `000012.png` belongs to frame 12.

    Attributes:
        folder: the folder.

    Raises:
        InputError: it is none.
    """

    folder: Path

    def __post_init__(self) -> None:
        if not self.folder.is_dir():
            raise InputError(self.folder, "must be a folder of predictions")

    @property
    def name(self) -> str:
        """Name of the method in a table."""
        return self.folder.resolve().name

    def path(self, index: int, suffixes: tuple[str, ...] = MAP_SUFFIXES) -> Path:
        """The file of a frame; raises `InputError` if there is none."""
        for suffix in suffixes:
            path = self.folder / f"{frame_name(index)}{suffix}"
            if path.is_file():
                return path
        allowed = ", ".join(suffixes[:-1]) + (f" or {suffixes[-1]}" if len(suffixes) > 1 else suffixes[-1])
        raise InputError(
            self.folder, f"has no prediction for frame {index}: {frame_name(index)} with {allowed}"
        )

    def read_map(
        self,
        index: int,
        needed: NDArray[np.bool_],
        *,
        png_unit: float,
        positive: bool = False,
    ) -> FloatArray:
        """A map of numbers `(h, w)`.

        Args:
            index: of the frame.
            needed: `(h, w)` pixels whose values count, and must be finite.
            png_unit: what a value of 1 in a PNG file of 16 bits stands for.
            positive: whether they must be above 0.

        Raises:
            InputError: the file is missing, cannot be read, has another size, or lacks a needed value.
        """
        path = self.path(index)
        values = _check_map(path, READERS[path.suffix](path), needed.shape)
        if path.suffix == ".png":
            values = values * png_unit
        missing = needed & ~np.isfinite(values)
        if positive:
            missing |= needed & ~(values > 0)
        if missing.any():
            row, column = np.argwhere(missing)[0]
            allowed = f"a finite value{' above 0' if positive else ''} in each pixel that counts"
            raise InputError(
                path, f"must have {allowed}, not {values[row, column]:g} at row {row}, column {column}"
            )
        return values

    def read_classes(self, index: int, size: tuple[int, int], classes: int) -> NDArray[np.uint8]:
        """Class ids `(h, w)` of a PNG file, here or in the folder `class`.

        Raises:
            InputError: the file is missing, cannot be read, has another size, or holds an id that is none.
        """
        inner = self.folder / CLASS_FOLDER
        folder = PredictionFolder(inner) if inner.is_dir() else self
        path = folder.path(index, (".png",))
        values = read_mask(path).values
        if values is None:
            raise InputError(path, "must hold class ids, not colours")
        ids = np.asarray(values)
        if ids.shape != size:
            raise InputError(path, _size_problem(ids.shape, size))
        if ids.min(initial=0) < 0 or ids.max(initial=0) >= classes:
            raise InputError(
                path, f"must hold class ids from 0 to {classes - 1}, not {int(ids.max(initial=0))}"
            )
        return ids.astype(np.uint8)


def _check_map(path: Path, values: NDArray[Any], size: tuple[int, ...]) -> FloatArray:
    if values.dtype.kind not in "fiu":
        raise InputError(path, f"must hold numbers, not {values.dtype}")
    if values.shape != size:
        raise InputError(path, _size_problem(values.shape, size))
    return values.astype(np.float64)


def _size_problem(found: tuple[int, ...], size: tuple[int, ...]) -> str:
    return f"must be {size[0]} rows x {size[1]} columns as the frame, not {' x '.join(map(str, found))}"


def _read_npy(path: Path) -> NDArray[Any]:
    try:
        with open_file(path, "values") as file:
            values = np.load(file, allow_pickle=False)
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise InputError(path, f"cannot be read as an array ({' '.join(str(error).split())})") from None
    return np.asarray(values)


def _read_exr(path: Path) -> NDArray[Any]:
    return np.asarray(read_image(path))


def _read_png(path: Path) -> NDArray[Any]:
    values = read_mask(path).values
    if values is None:
        raise InputError(path, "must be a grey image of 16 bits")
    return np.asarray(values)


READERS: Final[dict[str, Callable[[Path], NDArray[Any]]]] = {
    ".npy": _read_npy,
    ".exr": _read_exr,
    ".png": _read_png,
}

"""Pictures that are kept for the next bench: a file of arrays is whole, or counts as not there."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.atomic import replacing


def read_arrays(path: Path) -> dict[str, NDArray[Any]] | None:
    """The arrays of a file by name; None where there is no such file or it is damaged."""
    try:
        with path.open("rb") as file, np.load(file) as kept:
            return dict(kept)
    except (OSError, ValueError, EOFError, BadZipFile):
        return None


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write arrays and numbers by name; the folder is made when missing.

    Raises:
        OSError: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)

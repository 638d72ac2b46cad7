"""The shipped data: cultivars in `plants`, spectra and devices in `materials`, recipes in `recipes`.

In a wheel the three folders are inside the package; in a checkout they are at the top of the repository.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pepperscene.errors import InputError

ShippedFolder = Literal["plants", "materials", "recipes"]


def shipped_folder(name: ShippedFolder) -> Path:
    """The folder of the shipped files of one kind."""
    package = Path(__file__).resolve().parent
    inside = package / "shipped" / name
    return inside if inside.is_dir() else package.parents[1] / name


def is_file(path: Path) -> bool:
    """Whether the file exists; False too for names that no file system accepts."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find_file(folder: ShippedFolder, name_or_path: str | Path, *, suffix: str = ".toml") -> Path:
    """Find a file by its path, or a shipped one by its name without suffix.

    Raises:
        InputError: neither a file nor a shipped name; the message lists the shipped names.
    """
    path = Path(name_or_path)
    if (path.suffix == suffix or path.parent != Path(".")) and is_file(path):
        return path
    shipped = shipped_folder(folder) / f"{name_or_path}{suffix}"
    if path.parent == Path(".") and is_file(shipped):
        return shipped
    names = ", ".join(sorted(p.stem for p in shipped_folder(folder).glob(f"*{suffix}")))
    # A bare name could be that of a shipped file, so a file in the working folder needs its suffix.
    problem = f"is a file without the suffix {suffix}" if is_file(path) else "no such file"
    raise InputError(str(name_or_path), f"{problem}, nor one of the shipped {folder}: {names}")

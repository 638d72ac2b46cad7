"""Where the shipped data lies: cultivars in `plants`, spectra in `materials`, recipes in `recipes`.

In a wheel the three folders lie inside the package; in a checkout they are at the top of the repository.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pepperscene.errors import InputError

ShippedFolder = Literal["plants", "materials", "recipes"]


def shipped_folder(name: ShippedFolder) -> Path:
    """The folder that holds the shipped files of one kind."""
    package = Path(__file__).resolve().parent
    inside = package / "shipped" / name
    return inside if inside.is_dir() else package.parents[1] / name


def is_file(path: Path) -> bool:
    """Whether there is such a file; False too for names that no file system takes."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find_file(folder: ShippedFolder, wanted: str | Path, *, suffix: str = ".toml") -> Path:
    """The path of a file given by its own path or by the bare name of a shipped one.

    Raises:
        InputError: neither a file nor a shipped name; the message lists the shipped names.
    """
    path = Path(wanted)
    if (path.suffix == suffix or path.parent != Path(".")) and is_file(path):
        return path
    shipped = shipped_folder(folder) / f"{wanted}{suffix}"
    if path.parent == Path(".") and is_file(shipped):
        return shipped
    names = ", ".join(sorted(p.stem for p in shipped_folder(folder).glob(f"*{suffix}")))
    # A file that is there is passed over where its name alone could be that of a shipped one.
    missing = f"is a file without the ending {suffix}" if is_file(path) else "no such file"
    raise InputError(str(wanted), f"{missing}, nor one of the shipped {folder}: {names}")

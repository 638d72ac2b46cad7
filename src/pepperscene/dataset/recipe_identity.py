"""Fingerprints of the files that a recipe names, and of the spectra that those name in turn."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pepperscene.dataset import atomic
from pepperscene.document import read_toml
from pepperscene.spectra import read_spectra

_REFERENCE = "file"
"""The key whose value is the path of a CSV file of spectra, seen from the file that says it."""


def fingerprints(part: str, file: Path) -> dict[str, dict[str, str]]:
    """Name and digest of a TOML file's values, and of those of every spectra file that it refers to.

    Values count, comments and layout do not; the folders that files lie in do not either.

    Args:
        part: what the file describes ("sensor"), the key of its fingerprint; those of its spectra have the
            keys of the tables that name them behind it ("sensor.quantum_efficiency").
        file: the TOML file.

    Raises:
        InputError: a file is missing or cannot be read.
    """
    tables = read_toml(file)
    found = {part: _fingerprint(file, tables)}
    for table, reference in _references(tables):
        beside = file.parent / reference
        curves = read_spectra(beside)
        content = {name: [c.wavelength_nm.tolist(), c.values.tolist()] for name, c in curves.items()}
        found[".".join((part, *table))] = _fingerprint(beside, content)
    return found


def cultivar_fingerprints(part: str, wanted: str | Path) -> dict[str, dict[str, str]]:
    """Name and digest of a cultivar's file, of those that it extends, and of the scans of its fruit.

    Args:
        part: the key of the cultivar's own file ("cultivar"); the others' have a number behind it.
        wanted: shipped name or path.

    Raises:
        InputError: a file is missing or cannot be read.
    """
    from pepperscene.cultivar import files_of

    found: dict[str, dict[str, str]] = {}
    for number, file in enumerate(files_of(wanted)):
        key = f"{part}.{number}" if number else part
        if file.suffix == ".toml":
            found[key] = _fingerprint(file, read_toml(file))
        else:
            found[key] = {"name": file.stem, "sha256": atomic.digest(file)}
    return found


def digest(values: Any) -> str:
    """SHA-256 of values as canonical JSON, hexadecimal."""
    text = json.dumps(values, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _fingerprint(file: Path, values: Any) -> dict[str, str]:
    return {"name": file.stem, "sha256": digest(values)}


def _references(table: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """Keys of each table that refers to a file, and the path that it says."""
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in items:
        if key == _REFERENCE and isinstance(value, str):
            yield above, value
        else:
            yield from _references(value, (*above, str(key)))

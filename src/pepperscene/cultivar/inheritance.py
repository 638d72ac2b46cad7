"""Inheritance of cultivar files: from other files by `extends`, from other organ kinds by `like`."""

from __future__ import annotations

import copy
import itertools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pepperscene.cultivar.organs import SCAN_SUFFIXES
from pepperscene.document import extends_chain
from pepperscene.errors import InputError
from pepperscene.shipped import find_file, is_file

Tables = dict[str, Any]
Chain = list[tuple[Path, Tables]]

_MERGED_DEPTH: Final = {"stem": 2, "pigments": 2, "spectra": 2, "organs": 3}
"""Tables that are merged with those of the extended file, and the number of parts in a key replaced there."""


def read_chain(name_or_path: str | Path) -> Chain:
    """Read a cultivar file, the file that it extends, and so on, with their tables.

    Paths of scans and of measured curves become absolute.

    Raises:
        InputError: a file or a scan is missing or unreadable, or `extends` forms a cycle or is too long.
    """
    files = extends_chain(find_file("plants", name_or_path), "plants")
    for path, tables in files:
        _resolve_scans(path, tables)
        resolve_curves(tables, path.parent)
    return files


def cultivar_files(name_or_path: str | Path) -> tuple[Path, ...]:
    """Find all files that a cultivar depends on.

    They are its own, those that it extends, scans of its fruit, and measured curves with their descriptions.

    Raises:
        InputError: as `read_chain`.
    """
    files = read_chain(name_or_path)
    tables = merge_chain(files)
    scans = [Path(scan) for organ in _subtables(tables.get("organs")).values() for scan in _scans(organ)]
    spectra = _subtables(tables.get("spectra")).values()
    curves = [Path(curve["file"]) for curve in spectra if isinstance(curve.get("file"), str)]
    described = [toml for file in curves if is_file(toml := file.with_suffix(".toml"))]
    return tuple(dict.fromkeys([*(file for file, _ in files), *scans, *curves, *described]))


def resolve_curves(tables: Tables, folder: Path) -> None:
    """Make the paths of a cultivar's measured curves absolute; those of a wrong type are refused later."""
    for curve in _subtables(tables.get("spectra")).values():
        if isinstance(curve.get("file"), str):
            curve["file"] = os.path.normpath(folder.absolute() / curve["file"])


def merge_chain(files: Chain) -> Tables:
    """Merge the tables of all files; each file overrides the file that it extends.

    Raises:
        InputError: a kind is `like` one that does not exist, or like itself.
    """
    tables: Tables = {}
    for _, table in reversed(files):
        tables = _merge_tables(tables, table)
    organs = tables.get("organs")
    if isinstance(organs, Mapping):
        tables = tables | {"organs": {name: _resolve_like(name, organs, files) for name in organs}}
    return tables


def defining_file(files: Chain, tables: Tables, key: str) -> Path:
    """Find the file to name in an error about a dotted key of the merged tables: the file with its value.

    A key that is missing belongs to the nearest file that holds the table around it. Which keys an organ
    must and can have follows from its form, so a file that changes the form is named for the keys that it
    inherits.
    """
    parts = key.split(".")
    # What a file replaces as a whole: an entry of a merged table or of a slot, and everything below it.
    depth = _MERGED_DEPTH.get(parts[0], 1)
    replaced = parts[: 5 if parts[0] == "organs" and parts[2:3] == ["bears"] else depth]
    matches = [_matching_parts(own, tables, replaced) for _, own in files]
    nearest = matches.index(max(matches))
    if parts[0] == "organs" and len(parts) > 2:
        form = _form_file(files, parts[1])
        if form is not None and (form < nearest or max(matches) < 3):
            nearest = form
    return files[nearest][0]


def _form_file(files: Chain, kind: str) -> int | None:
    """Index of the file that gave a kind its form; nearer files that repeat the form do not count."""
    organs = [_subtables(own.get("organs")).get(kind, {}) for _, own in files]
    forms = [(number, organ["form"]) for number, organ in enumerate(organs) if "form" in organ]
    same = itertools.takewhile(lambda item: item[1] == forms[0][1], forms)
    return max((number for number, _ in same), default=None)


def _resolve_scans(path: Path, tables: Tables) -> None:
    """Replace the paths of all scans by absolute ones."""
    for name, organ in _subtables(tables.get("organs")).items():
        if not (scans := _scans(organ)):
            continue
        key, files = f"organs.{name}.scan", []
        for scan in scans:
            if not scan.lower().endswith(SCAN_SUFFIXES):
                problem = f"must be a mesh file: {', '.join(SCAN_SUFFIXES)}"
                raise InputError(path, problem, key=key, value=scan)
            if not is_file(file := path.parent / scan):
                raise InputError(path, "is not a file, relative to this one", key=key, value=scan)
            files.append(str(file.resolve()))
        organ["scan"] = files


def _scans(organ: Tables) -> list[str]:
    """Paths of a kind's scans; none if the value is not one or several texts, which is refused later."""
    scan = organ.get("scan")
    scans = [scan] if isinstance(scan, str) else scan
    return scans if isinstance(scans, list) and all(isinstance(item, str) for item in scans) else []


def check_no_scans(where: str, tables: Mapping[str, Any]) -> None:
    """Raise `InputError` if tables that are in no file name a scan, whose path is relative to a file."""
    for name, organ in _subtables(tables.get("organs")).items():
        if "scan" in organ:
            problem = "must be in a cultivar file, because its path is relative to that file"
            raise InputError(where, problem, key=f"organs.{name}.scan", value=organ["scan"])


def _merge_tables(base: Tables, override: Tables) -> Tables:
    """Merge a file's tables into its parent's; distributions, choices, pigments and lists are replaced."""
    merged = copy.copy(base)
    for key, value in override.items():
        known = base.get(key)
        if not (isinstance(known, dict) and isinstance(value, dict)):
            merged[key] = value
        elif key == "organs":
            organs = {name: _merge_organ(known.get(name), organ) for name, organ in value.items()}
            merged[key] = known | organs
        else:
            merged[key] = known | value if key in ("stem", "pigments", "spectra") else value
    return merged


def _merge_organ(base: Any, override: Any) -> Any:
    """Merge a kind's table into that of its parent; slots of the same name are merged.

    An empty list removes all slots.
    """
    if not (isinstance(base, dict) and isinstance(override, dict)):
        return override
    merged = base | override
    if override.get("bears") and _are_slots(base.get("bears")) and _are_slots(override["bears"]):
        slots = {slot["name"]: slot for slot in base["bears"]}
        for slot in override["bears"]:
            slots[slot["name"]] = slots.get(slot["name"], {}) | slot
        merged["bears"] = list(slots.values())
    return merged


def _are_slots(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(slot, dict) and isinstance(slot.get("name"), str) for slot in value
    )


def _resolve_like(name: str, organs: Mapping[str, Any], files: Chain) -> Any:
    """A kind's table merged into that of the kind that it is like, and so on."""
    chain, table = [name], organs[name]
    while isinstance(table, dict) and "like" in table:
        like = table["like"]
        if not isinstance(like, str) or like not in organs or like in chain:
            key = f"organs.{chain[-1]}.like"
            allowed = "must be another of the organs" + (", and not form a cycle" if like in chain else "")
            raise InputError(defining_file(files, {"organs": organs}, key), allowed, key=key, value=like)
        chain.append(like)
        # The merged table has the `like` of the other kind, if any.
        table = _merge_organ(organs[like], {key: value for key, value in table.items() if key != "like"})
    return table


def _matching_parts(value: Any, tables: Any, parts: list[str]) -> int:
    """Number of leading parts of a key that a file's own tables have; slots match by name."""
    for depth, part in enumerate(parts):
        if isinstance(tables, list) and part.isdigit() and int(part) < len(tables):
            tables = tables[int(part)]
            name = tables.get("name") if isinstance(tables, dict) else None
            slots = value if isinstance(value, list) else []
            value = next(
                (slot for slot in slots if isinstance(slot, dict) and slot.get("name") == name), None
            )
        else:
            tables = tables.get(part) if isinstance(tables, dict) else None
            value = value.get(part) if isinstance(value, dict) else None
        if value is None:
            return depth
    return len(parts)


def _subtables(value: Any) -> dict[str, Tables]:
    """Entries of a table that are tables themselves."""
    entries = value.items() if isinstance(value, Mapping) else ()
    return {name: entry for name, entry in entries if isinstance(entry, dict)}

"""A cultivar file with all that it inherits: from other files by `extends`, from other kinds by `like`."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.shipped import find_file, is_file

Tables = dict[str, Any]
Lineage = list[tuple[Path, Tables]]

SCANS: Final = (".obj", ".ply", ".stl")


def lineage(name_or_path: str | Path) -> Lineage:
    """The files that make a cultivar, with their tables: itself, the file that it extends, and so on.

    Scans are paths that can be opened from anywhere.

    Raises:
        InputError: a file or a scan is missing or unreadable, or the files extend each other in a circle.
    """
    path = find_file("plants", name_or_path)
    files: Lineage = []
    while True:
        tables = read_toml(path)
        _find_scans(path, tables)
        files.append((path, tables))
        parent = tables.pop("extends", None)
        if parent is None:
            return files
        if not isinstance(parent, str):
            raise InputError(path, "must be the name of a cultivar or a path", key="extends", value=parent)
        path = _parent(path, parent)
        if path.resolve() in {file.resolve() for file, _ in files}:
            raise InputError(
                files[-1][0],
                "must not lead back to a file that extends this one",
                key="extends",
                value=parent,
            )


def cultivar_files(name_or_path: str | Path) -> tuple[Path, ...]:
    """All files that a cultivar depends on: its own, those that it extends, and the scans of its fruit.

    Raises:
        InputError: as `lineage`.
    """
    files = lineage(name_or_path)
    organs = inherited(files).get("organs", {})
    scans = [
        Path(organ["scan"]) for organ in _tables_of(organs).values() if isinstance(organ.get("scan"), str)
    ]
    return tuple(dict.fromkeys([file for file, _ in files] + scans))


def inherited(files: Lineage) -> Tables:
    """All tables of a lineage in one: what a file says goes before what its parents say.

    Raises:
        InputError: a kind is `like` one that does not exist, or like itself.
    """
    tables: Tables = {}
    for _, own in reversed(files):
        tables = _over(tables, own)
    organs = tables.get("organs")
    if isinstance(organs, Mapping):
        alike = {name: _alike(name, organs, files) for name in organs}
        tables = tables | {"organs": alike}
    return tables


def stated_in(files: Lineage, tables: Tables, key: str) -> Path:
    """The file that says what stands at a dotted key of the inherited tables, or comes nearest to it."""
    parts = key.split(".")
    return max(files, key=lambda file: _reach(file[1], tables, parts))[0]


def _parent(path: Path, said: str) -> Path:
    """A path is seen from the file that says it; a bare name is that of a shipped cultivar."""
    beside = path.parent / said
    if not said.endswith(".toml") and Path(said).parent == Path("."):
        try:
            return find_file("plants", said)
        except InputError as fault:
            raise InputError(path, fault.problem, key="extends", value=said) from None
    if not is_file(beside):
        raise InputError(path, "is no file as seen from the file that names it", key="extends", value=said)
    return beside


def _find_scans(path: Path, tables: Tables) -> None:
    for name, organ in _tables_of(tables.get("organs")).items():
        scan = organ.get("scan")
        if not isinstance(scan, str):
            continue
        if not scan.lower().endswith(SCANS):
            raise InputError(
                path, f"must be a mesh file: {', '.join(SCANS)}", key=f"organs.{name}.scan", value=scan
            )
        if not is_file(path.parent / scan):
            raise InputError(
                path, "is no file as seen from the file that names it", key=f"organs.{name}.scan", value=scan
            )
        organ["scan"] = str((path.parent / scan).resolve())


def _over(below: Tables, above: Tables) -> Tables:
    """The tables of a file over those of its parent; laws, choices, pigments and lists are replaced whole."""
    merged = copy.copy(below)
    for key, value in above.items():
        known = below.get(key)
        if key not in ("stem", "organs", "pigments") or not (
            isinstance(known, dict) and isinstance(value, dict)
        ):
            merged[key] = value
        elif key == "organs":
            merged[key] = known | {name: _organ_over(known.get(name), organ) for name, organ in value.items()}
        else:
            merged[key] = known | value
    return merged


def _organ_over(below: Any, above: Any) -> Any:
    """A kind's table over that of the same kind in the parent; its slots are told by their names.

    An empty list takes all of them away.
    """
    if not (isinstance(below, dict) and isinstance(above, dict)):
        return above
    merged = below | above
    if above.get("bears") and _are_slots(below.get("bears")) and _are_slots(above["bears"]):
        slots = {slot["name"]: slot for slot in below["bears"]}
        for slot in above["bears"]:
            slots[slot["name"]] = slots.get(slot["name"], {}) | slot
        merged["bears"] = list(slots.values())
    return merged


def _are_slots(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(slot, dict) and isinstance(slot.get("name"), str) for slot in value
    )


def _alike(name: str, organs: Mapping[str, Any], files: Lineage) -> Any:
    """A kind's table with the keys of the kind that it is like, and of the one that that is like."""
    chain, table = [name], organs[name]
    while isinstance(table, dict) and "like" in table:
        like = table["like"]
        if not isinstance(like, str) or like not in organs or like in chain:
            key = f"organs.{chain[-1]}.like"
            allowed = "must be another of the organs" + (
                ", and not lead back to this one" if like in chain else ""
            )
            raise InputError(stated_in(files, {"organs": organs}, key), allowed, key=key, value=like)
        chain.append(like)
        rest = {key: value for key, value in table.items() if key != "like"}
        # What the other is like in turn is looked up next; `rest` would hide it.
        table = _organ_over(organs[like], rest)
    return table


def _reach(own: Any, tables: Any, parts: list[str]) -> int:
    """How many parts of a key a file's own tables have; slots are told by their names."""
    for depth, part in enumerate(parts):
        if isinstance(tables, list) and part.isdigit() and int(part) < len(tables):
            tables = tables[int(part)]
            name = tables.get("name") if isinstance(tables, dict) else None
            same = [one for one in own if isinstance(one, dict) and one.get("name") == name]
            own = same[0] if isinstance(own, list) and same else None
        else:
            tables = tables.get(part) if isinstance(tables, dict) else None
            own = own.get(part) if isinstance(own, dict) else None
        if own is None:
            return depth
    return len(parts)


def _tables_of(value: Any) -> dict[str, Tables]:
    """Those entries of a table that are tables themselves."""
    entries = value.items() if isinstance(value, Mapping) else ()
    return {name: entry for name, entry in entries if isinstance(entry, dict)}

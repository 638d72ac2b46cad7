"""What a data set is to show, validated."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field

from pepperscene.dataset.recipe.plan import Plan
from pepperscene.dataset.recipe.tables import (
    NONE,
    CameraTable,
    DaylightTable,
    DevelopingTable,
    ExpectTable,
    GreenhouseTable,
    GrowthTable,
    Name,
    PathTable,
    RowTable,
    TwineTable,
)
from pepperscene.dataset.store import atomic
from pepperscene.document import Document, read_toml
from pepperscene.errors import ArgumentError
from pepperscene.spectra import read_spectra
from pepperscene.spectra.files import find_material

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
    from pepperscene.cultivar import cultivar_files

    found: dict[str, dict[str, str]] = {}
    for number, file in enumerate(cultivar_files(wanted)):
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


class Recipe(Document):
    """A data set, fully told: with the version of this package it decides every byte of every frame.

    Attributes:
        name: of the data set.
        seed: of all random numbers.
        cultivar: shipped name or path.
        plan, row, path, camera, developing: the tables.
        daylight: or None for a night scene.
        twine: or None for none.
        growth: a stage between two cultivar files, or None for the cultivar as its file says.
        greenhouse: what surrounds an uneven row, or None for plants alone, evenly spaced and upright.
        expect: what the finished data set is to look like, or None; see `pepperscene check`.
    """

    name: Name
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)]
    cultivar: Name
    plan: Plan
    row: RowTable
    path: PathTable
    camera: CameraTable
    developing: DevelopingTable = DevelopingTable()
    daylight: DaylightTable | None = None
    twine: TwineTable | None = None
    growth: GrowthTable | None = None
    greenhouse: GreenhouseTable | None = None
    expect: ExpectTable | None = None

    def with_seed(self, seed: int | None) -> Recipe:
        """The same recipe with another seed; the same when that is None.

        Raises:
            InputError: the seed is negative or beyond 63 bits.
        """
        if seed is None:
            return self
        if not 0 <= seed < 2**63:
            raise ArgumentError("seed", f"{seed} must lie in 0 to {2**63 - 1}")
        return self.model_copy(update={"seed": int(seed)})

    def identity(self) -> dict[str, Any]:
        """What makes two data sets the same: all values that frames depend on, in whatever file.

        Paths are reduced to names, so that the identity is the same on every machine. The plan's `select` is
        left out, because it says which frames to build, not what they show, and so is `expect`.

        Returns:
            Ready for JSON, the recipe's values under `recipe`, and under `files` a `name` and a `sha256` for
            the cultivar with the files that it extends and its scans, each device, the cover, and each
            spectrum that one of their files refers to.

        Raises:
            InputError: one of these files is missing or cannot be read.
        """
        recipe = self.model_dump(mode="json", exclude={"plan": {"select"}, "expect": True})
        recipe["cultivar"] = Path(self.cultivar).stem
        files = cultivar_fingerprints("cultivar", self.cultivar)
        if self.growth is not None:
            recipe["growth"]["until"] = Path(self.growth.until).stem
            files |= cultivar_fingerprints("growth.until", self.growth.until)
        # A table that came later and is not there says nothing, so that older recipes stay what they are.
        for table in ("growth", "greenhouse"):
            if recipe[table] is None:
                del recipe[table]
        if self.camera.baseline_mm is None:
            del recipe["camera"]["baseline_mm"]
        for table, part, folder in _MATERIALS:
            wanted = (recipe[table] or {}).get(part, NONE)
            if wanted != NONE:
                recipe[table][part] = Path(wanted).stem
                files |= fingerprints(part, find_material(folder, wanted))
        return {"recipe": recipe, "files": files}

    def sha256(self) -> str:
        """SHA-256 of the identity as canonical JSON, hexadecimal."""
        return digest(self.identity())


_MATERIALS: Final = (
    ("camera", "sensor", "sensors"),
    ("camera", "lens", "lenses"),
    ("camera", "flash", "flashes"),
    ("camera", "filter", "filters"),
    ("daylight", "cover", "covers"),
)
"""Table and key of each file out of the materials, and the folder of the shipped ones."""

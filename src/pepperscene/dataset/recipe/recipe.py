"""A validated recipe, and the identity of the data set that it defines."""

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

_REFERENCE: Final = "file"
"""Key whose value is the path of a CSV file of spectra, relative to the file that holds it."""

_MATERIALS: Final = (
    ("camera", "sensor", "sensors"),
    ("camera", "lens", "lenses"),
    ("camera", "flash", "flashes"),
    ("camera", "filter", "filters"),
    ("daylight", "cover", "covers"),
)
"""Table and key of each material file that a recipe names, and the folder of the shipped ones."""


class Recipe(Document):
    """A recipe fully defines a data set: with the version of this package it determines every byte of every
    frame.

    Attributes:
        name: of the data set.
        seed: of all random numbers.
        cultivar: shipped name or path.
        plan, row, path, camera, developing: the tables.
        daylight: or None for a night scene.
        twine: or None for none.
        growth: a stage between two cultivar files, or None for the cultivar as in its file.
        greenhouse: what surrounds an irregular row, or None for plants alone, evenly spaced and upright.
        expect: expected statistics of the finished data set, or None; see `pepperscene check`.
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
        """The recipe with another seed, or itself if that is None.

        Raises:
            ArgumentError: the seed is negative or has more than 63 bits.
        """
        if seed is None:
            return self
        if not 0 <= seed < 2**63:
            raise ArgumentError("seed", f"must be between 0 and {2**63 - 1}, not {seed}")
        return self.model_copy(update={"seed": int(seed)})

    def identity(self) -> dict[str, Any]:
        """All values that frames depend on, from the recipe and the files that it names.

        Paths are reduced to names, so that the identity is the same on every machine. The plan's `select` is
        left out, because it chooses frames but does not change them, and so is `expect`.

        Returns:
            Ready for JSON: the recipe's values under `recipe`, and under `files` a `name` and a `sha256` for
            the cultivar with the files that it extends and its scans, each device, the cover, and each
            spectrum that one of these files refers to.

        Raises:
            InputError: one of these files is missing or cannot be read.
        """
        recipe = self.model_dump(mode="json", exclude={"plan": {"select"}, "expect": True})
        recipe["cultivar"] = Path(self.cultivar).stem
        files = _cultivar_fingerprints("cultivar", self.cultivar)
        if self.growth is not None:
            recipe["growth"]["until"] = Path(self.growth.until).stem
            files |= _cultivar_fingerprints("growth.until", self.growth.until)
        # Tables added later are left out where they are missing, so that older recipes keep their identity.
        for table in ("growth", "greenhouse"):
            if recipe[table] is None:
                del recipe[table]
        if self.camera.baseline_mm is None:
            del recipe["camera"]["baseline_mm"]
        for table, part, folder in _MATERIALS:
            name = (recipe[table] or {}).get(part, NONE)
            if name != NONE:
                recipe[table][part] = Path(name).stem
                files |= _material_fingerprints(part, find_material(folder, name))
        return {"recipe": recipe, "files": files}

    def sha256(self) -> str:
        """SHA-256 of the identity as canonical JSON, hexadecimal."""
        return digest(self.identity())


def _material_fingerprints(part: str, file: Path) -> dict[str, dict[str, str]]:
    """Name and digest of a TOML file, and of every spectra file that it refers to.

    Only values count: comments, layout and folders do not.

    Args:
        part: what the file describes ("sensor"), the key of its fingerprint. A spectrum's key is followed by
            those of the tables that name it ("sensor.quantum_efficiency").
        file: the TOML file.

    Raises:
        InputError: a file is missing or cannot be read.
    """
    tables = read_toml(file)
    fingerprints = {part: _fingerprint(file, tables)}
    for table, reference in _references(tables):
        path = file.parent / reference
        curves = read_spectra(path)
        content = {name: [c.wavelength_nm.tolist(), c.values.tolist()] for name, c in curves.items()}
        fingerprints[".".join((part, *table))] = _fingerprint(path, content)
    return fingerprints


def _cultivar_fingerprints(part: str, cultivar: str) -> dict[str, dict[str, str]]:
    """Name and digest of a cultivar's file, of those that it extends, and of the scans of its fruit.

    Args:
        part: the key of the cultivar's own file ("cultivar"); a number follows in the keys of the others.
        cultivar: shipped name or path.

    Raises:
        InputError: a file is missing or cannot be read.
    """
    from pepperscene.cultivar import cultivar_files

    fingerprints: dict[str, dict[str, str]] = {}
    for number, file in enumerate(cultivar_files(cultivar)):
        key = f"{part}.{number}" if number else part
        if file.suffix == ".toml":
            fingerprints[key] = _fingerprint(file, read_toml(file))
        else:
            fingerprints[key] = {"name": file.stem, "sha256": atomic.digest(file)}
    return fingerprints


def _fingerprint(file: Path, values: Any) -> dict[str, str]:
    return {"name": file.stem, "sha256": digest(values)}


def _references(table: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the keys of each table that refers to a file, and the path."""
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in items:
        if key == _REFERENCE and isinstance(value, str):
            yield above, value
        else:
            yield from _references(value, (*above, str(key)))


def digest(values: Any) -> str:
    """SHA-256 of values as canonical JSON, hexadecimal."""
    text = json.dumps(values, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()

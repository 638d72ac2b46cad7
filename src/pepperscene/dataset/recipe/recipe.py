"""A validated recipe, and the identity of the data set that it defines."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field

from pepperscene.dataset.recipe import tables
from pepperscene.dataset.recipe.plan import Plan, check_seed
from pepperscene.dataset.store import atomic
from pepperscene.document import Document, read_toml
from pepperscene.spectra import read_spectra
from pepperscene.spectra.files import curve_file, find_material

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
    """A recipe fully defines a data set: with the package version it determines every byte of a frame.

    Attributes:
        name: of the data set.
        seed: of all random numbers.
        cultivar: shipped name or path.
        plan, row, path, camera, developing: the tables.
        daylight: or None for a night scene.
        twine: or None for none.
        growth: a stage between two cultivar files, or None for the cultivar as in its file.
        greenhouse: surroundings of an irregular row, or None for evenly spaced, upright plants alone.
        expect: expected statistics of the finished data set, or None; see `pepperscene check`.
    """

    name: tables.Name
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)]
    cultivar: tables.Name
    plan: Plan
    row: tables.RowTable
    path: tables.PathTable
    camera: tables.CameraTable
    developing: tables.DevelopingTable = tables.DevelopingTable()
    daylight: tables.DaylightTable | None = None
    twine: tables.TwineTable | None = None
    growth: tables.GrowthTable | None = None
    greenhouse: tables.GreenhouseTable | None = None
    expect: tables.ExpectTable | None = None

    def with_seed(self, seed: int | None) -> Recipe:
        """The recipe with another seed, or itself if that is None; errors as of `check_seed`."""
        return self if seed is None else self.model_copy(update={"seed": check_seed(seed)})

    def identity(self) -> dict[str, Any]:
        """All values that frames depend on, from the recipe and the files that it names.

        Paths are reduced to names, so that the identity is the same on every machine. `plan.select` and
        `expect` are left out, because they change no frame.

        Returns:
            Ready for JSON: the recipe's values under `recipe`, and under `files` a `name` and a `sha256` of
                each
            file: the cultivar, those that it extends, its scans, devices, the cover, and their spectra.

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
            name = (recipe[table] or {}).get(part, tables.NONE)
            if name != tables.NONE:
                recipe[table][part] = Path(name).stem
                files |= _material_fingerprints(part, find_material(folder, name))
        return {"recipe": recipe, "files": files}

    def sha256(self) -> str:
        """SHA-256 of the identity as canonical JSON, hexadecimal."""
        return digest(self.identity())


def _material_fingerprints(part: str, file: Path) -> dict[str, dict[str, str]]:
    """Name and digest of a material file, under `part`, and of the spectra files that it refers to.

    Only values count: comments, layout and folders do not. A spectrum's key ends with those of the tables
    that name it ("sensor.quantum_efficiency").
    """
    content = read_toml(file)
    fingerprints = {part: _fingerprint(file, content)}
    for table, reference in _references(content):
        path = curve_file(file, reference)
        curves = read_spectra(path)
        values = {name: [c.wavelength_nm.tolist(), c.values.tolist()] for name, c in curves.items()}
        fingerprints[".".join((part, *table))] = _fingerprint(path, values)
    return fingerprints


def _cultivar_fingerprints(part: str, cultivar: str) -> dict[str, dict[str, str]]:
    """Name and digest of a cultivar's file, under `part`, and of those it extends and its scans, numbered."""
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

"""What a data set is to show, validated: one model per table of a recipe file."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from pepperscene.dataset.plan import Plan
from pepperscene.document import Document, read_toml
from pepperscene.errors import InputError
from pepperscene.shipped import shelf

Name = Annotated[str, Field(strict=True, min_length=1, max_length=400, pattern=r"^[^\x00-\x1f]+$")]
"""A shipped name or a path."""

NO_FLASH: Final = "none"

Angle = Annotated[float, Field(strict=True, ge=-180, le=180)]
Height = Annotated[float, Field(strict=True, ge=0, le=10_000)]


class RowTable(Document):
    """The double row of plants: the front row at the aisle and the row behind it."""

    plants_front: Annotated[int, Field(strict=True, ge=1, le=50)]
    plants_back: Annotated[int, Field(strict=True, ge=0, le=50)]
    spacing_mm: Annotated[float, Field(strict=True, ge=50, le=2000)]
    gap_mm: Annotated[float, Field(strict=True, ge=0, le=5000)]
    shift_mm: Annotated[float, Field(strict=True, ge=-2000, le=2000)]


class PathTable(Document):
    """The camera's arc around the middle plant; azimuth and height go from the first to the second value."""

    distance_mm: Annotated[float, Field(strict=True, ge=50, le=10_000)]
    azimuth_deg: tuple[Angle, Angle]
    height_mm: tuple[Height, Height]
    pitch_deg: Annotated[float, Field(strict=True, ge=-89, le=89)]


class CameraTable(Document):
    """Sensor, lens and flash by shipped name or path, and how they are set; the flash may be "none"."""

    sensor: Name
    lens: Name
    flash: Name
    exposure_us: Annotated[float, Field(strict=True, ge=1, le=1_000_000)]
    white_balance: Literal["flash", "daylight"] = "flash"

    @model_validator(mode="after")
    def _balanced(self) -> CameraTable:
        if self.flash == NO_FLASH and self.white_balance == "flash":
            raise ValueError('white_balance must be "daylight" where flash is "none"')
        return self


class DaylightTable(Document):
    """The partly cloudy sky; none where `illuminance_lx` is 0."""

    illuminance_lx: Annotated[float, Field(strict=True, ge=0, le=200_000)]
    sun_azimuth_deg: Annotated[float, Field(strict=True, ge=-360, le=360)] = 90.0
    sun_elevation_deg: Annotated[float, Field(strict=True, ge=1, le=90)] = 45.0
    sun_fraction: Annotated[float, Field(strict=True, ge=0, le=0.95)] = 0.0
    cloud_cover: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.5


class TwineTable(Document):
    """The twine that is wound round every stem; none where `diameter_mm` is 0."""

    diameter_mm: Annotated[float, Field(strict=True, ge=0, le=20)]
    turns_per_m: Annotated[float, Field(strict=True, ge=0, le=50)]


class Recipe(Document):
    """A data set, fully told: with the version of this package it decides every byte of every frame.

    Attributes:
        name: of the data set.
        seed: of all random numbers.
        cultivar: shipped name or path.
        plan, row, path, camera: the tables.
        daylight: or None for a night scene.
        twine: or None for none.
    """

    name: Name
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)]
    cultivar: Name
    plan: Plan
    row: RowTable
    path: PathTable
    camera: CameraTable
    daylight: DaylightTable | None = None
    twine: TwineTable | None = None

    def with_seed(self, seed: int | None, where: str = "--seed") -> Recipe:
        """The same recipe with another seed; the same when that is None.

        Raises:
            InputError: the seed is negative or beyond 63 bits.
        """
        if seed is None:
            return self
        if not 0 <= seed < 2**63:
            raise InputError(where, "", None, f"{seed} must lie in 0 to {2**63 - 1}")
        return self.model_copy(update={"seed": int(seed)})

    def identity(self) -> dict[str, Any]:
        """What makes two data sets the same: all values that frames depend on, and the named files' contents.

        Paths are reduced to names, so that the identity is the same on every machine. The plan's `select` is
        left out, because it says which frames to build, not what they show.

        Returns:
            JSON-ready `{"recipe": ..., "files": {key: {"name": ..., "sha256": ...}}}`.
        """
        recipe = self.model_dump(mode="json", exclude={"plan": {"select"}})
        recipe["cultivar"] = Path(self.cultivar).stem
        files = {"cultivar": _fingerprint(self.cultivar, shelf("plants"))}
        for part, folder in (("sensor", "sensors"), ("lens", "lenses"), ("flash", "flashes")):
            wanted = recipe["camera"][part]
            recipe["camera"][part] = Path(wanted).stem
            if wanted != NO_FLASH:
                files[part] = _fingerprint(wanted, shelf("materials") / folder)
        return {"recipe": recipe, "files": files}

    def sha256(self) -> str:
        """SHA-256 of the identity as canonical JSON, hexadecimal."""
        return _digest(self.identity())


def _fingerprint(wanted: str, shipped: Path) -> dict[str, str]:
    """Name and digest of a file's values; comments and layout do not count."""
    path = Path(wanted) if Path(wanted).suffix == ".toml" else shipped / f"{wanted}.toml"
    return {"name": path.stem, "sha256": _digest(read_toml(path))}


def _digest(values: Any) -> str:
    text = json.dumps(values, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()

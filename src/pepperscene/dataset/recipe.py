"""What a data set is to show, validated: one model per table of a recipe file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from pepperscene.dataset.plan import Plan
from pepperscene.dataset.recipe_identity import digest, fingerprints
from pepperscene.document import Document
from pepperscene.errors import InputError
from pepperscene.shipped import find
from pepperscene.spectra.sourced_file import locate

Name = Annotated[str, Field(strict=True, min_length=1, max_length=400, pattern=r"^[^\x00-\x1f]+$")]
"""A shipped name or a path."""

NONE: Final = "none"
"""Instead of a name: no flash, no filter, no cover, no white balance."""

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
    """The camera's parts by shipped name or path, and how they are set; flash and filter may be "none".

    Where `focus_mm` is missing everything is sharp; where `bits` is missing it is the sensor file's.
    """

    sensor: Name
    lens: Name
    flash: Name
    filter: Name = NONE
    exposure_us: Annotated[float, Field(strict=True, ge=1, le=1_000_000)]
    focus_mm: Annotated[float, Field(strict=True, ge=1, le=1_000_000)] | None = None
    gain: Annotated[float, Field(strict=True, ge=0.01, le=1000)] = 1.0
    bits: Annotated[int, Field(strict=True, ge=1, le=16)] | None = None


Switch = Annotated[bool, Field(strict=True)]


class DevelopingTable(Document):
    """The steps from light to picture, as `pepperscene.camera.Developing`; "none" leaves a balance out."""

    falloff: Switch = True
    shot_noise: Switch = True
    read_noise: Switch = True
    saturation: Switch = True
    quantise: Switch = True
    demosaic: Literal["malvar", "menon", "bilinear"] = "malvar"
    white_balance: Literal["flash", "daylight", "none"] = "flash"
    colour_matrix: Switch = True
    tone: Literal["srgb", "linear"] = "srgb"


class DaylightTable(Document):
    """The partly cloudy sky above the greenhouse's cover; none where `illuminance_lx` is 0."""

    illuminance_lx: Annotated[float, Field(strict=True, ge=0, le=200_000)]
    sun_azimuth_deg: Annotated[float, Field(strict=True, ge=-360, le=360)] = 90.0
    sun_elevation_deg: Annotated[float, Field(strict=True, ge=1, le=90)] = 45.0
    sun_fraction: Annotated[float, Field(strict=True, ge=0, le=0.95)] = 0.0
    cloud_cover: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.5
    cover: Name = NONE


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
        plan, row, path, camera, developing: the tables.
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
    developing: DevelopingTable = DevelopingTable()
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
        """What makes two data sets the same: all values that frames depend on, in whatever file.

        Paths are reduced to names, so that the identity is the same on every machine. The plan's `select` is
        left out, because it says which frames to build, not what they show.

        Returns:
            Ready for JSON, the recipe's values under `recipe`, and under `files` a `name` and a `sha256` for
            the cultivar, each device, the cover, and each spectrum that one of their files refers to.

        Raises:
            InputError: one of these files is missing or cannot be read.
        """
        recipe = self.model_dump(mode="json", exclude={"plan": {"select"}})
        recipe["cultivar"] = Path(self.cultivar).stem
        files = fingerprints("cultivar", find("plants", self.cultivar))
        for table, part, folder in _MATERIALS:
            wanted = (recipe[table] or {}).get(part, NONE)
            if wanted != NONE:
                recipe[table][part] = Path(wanted).stem
                files |= fingerprints(part, locate(folder, wanted))
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

"""Fine texture of skins: below a pixel at arm's length, and what a stereo matcher needs at close range.

Each surface has a periodic tile: a relative change of its reflectance, a factor of its residue, and slopes
that are part of those that its roughness stands for. The means are those of a surface without fine texture.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from pepperscene.document import Document, read_toml, validate
from pepperscene.materials.patterns import (
    Float32Array,
    named_generator,
    random_cells,
    scatter_discs,
    smooth_noise,
    stamp_discs,
)
from pepperscene.spectra.files import SourcedDocument, find_material
from pepperscene.spectra.spectrum import FloatArray

TILE: Final = 512
"""Texels along a side of a tile: chosen, 4 MB on the device."""
TEXEL_MM: Final = 0.04
"""Size of a texel: chosen, a third of a pixel of a camera of 1000 pixels of focal length at 12 cm."""
_SEED: Final = 405_712  # chosen: any number does; a texture belongs to a skin, not to a frame
_LARGEST_CHANGE: Final = 0.9
"""Of the reflectance, relative. Chosen below 1, so that no tissue becomes black, or reflects all light."""
_WALL: Final = 0.12  # half the width of a wall between cells, over their distance; chosen

Share = Annotated[float, Field(ge=0, le=1)]
Contrast = Annotated[float, Field(ge=-_LARGEST_CHANGE, le=_LARGEST_CHANGE)]
# Chosen: two texels, and an eighth of a tile, so that no tile looks like another by chance.
Length = Annotated[float, Field(ge=2 * TEXEL_MM, le=TILE * TEXEL_MM / 8)]
Density = Annotated[float, Field(ge=0, le=2000)]


class SkinTable(Document):
    """The skin of one kind of organ. Changes are relative to the reflectance where all else is absorbed.

    Attributes:
        speckle: standard deviation of the change in irregular grains.
        grain_mm: width of these grains, four standard deviations of their filter.
        walls: change in the walls between cells; in a leaf, the veins between areoles.
        cell_mm: distance of the cells' centres.
        spots: change in the middle of spots.
        spots_per_cm2: their number.
        spot_mm: least and greatest diameter.
        dust: share of the residue that lies in specks.
        specks_per_cm2: their number.
        speck_mm: least and greatest diameter.
        relief_deg: root mean square of the slopes along each axis.
        relief_mm: width of bumps, as `grain_mm`.
    """

    speckle: Share = 0.0
    grain_mm: Length = 0.5
    walls: Contrast = 0.0
    cell_mm: Length = 0.5
    spots: Contrast = 0.0
    spots_per_cm2: Density = 0.0
    spot_mm: tuple[Length, Length] = (0.2, 0.5)
    dust: Share = 0.0
    specks_per_cm2: Density = 0.0
    speck_mm: tuple[Length, Length] = (0.1, 0.4)
    relief_deg: Annotated[float, Field(ge=0, le=20)] = 0.0
    relief_mm: Length = 0.5

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        for name, (low, high) in (("spot_mm", self.spot_mm), ("speck_mm", self.speck_mm)):
            if low > high:
                raise ValueError(f"{name} = [{low:g}, {high:g}] must be [least, greatest]")
        return self


class Skin(SourcedDocument):
    """A file of `materials/skins`."""

    kind: Literal["measured", "standard", "MODEL"] = "MODEL"
    fruit: SkinTable = SkinTable()
    leaf: SkinTable = SkinTable()
    stem: SkinTable = SkinTable()  # also petioles, peduncles and calyces


def load_skin(name_or_path: str | Path) -> Skin:
    """Load a skin from its file, or a shipped one by its name.

    Raises:
        InputError: the file is missing or invalid; the message names file, key and value.
    """
    path = find_material("skins", name_or_path)
    return validate(Skin, read_toml(path), path)


@dataclass(frozen=True, eq=False)
class SkinTile:
    """One period of a fine texture, in square texels of `TEXEL_MM`.

    Attributes:
        change: `(TILE, TILE)` relative change of the reflectance, of mean 0 and at most 0.9.
        residue: `(TILE, TILE)` factor of the residue, of mean 1.
        slopes: `(TILE, TILE, 2)` of the relief along columns and along rows, each of mean 0.
    """

    change: Float32Array
    residue: Float32Array
    slopes: Float32Array


def skin_tile(table: SkinTable, name: str, roughness: float) -> SkinTile:
    """Draw the fine texture of a surface.

    Args:
        table: of its kind of organ.
        name: of the surface, which decides the random numbers.
        roughness: GGX alpha of its narrowest lobe, which stands for slopes of variance alpha^2 / 2 along each
            axis (LEADR mapping, Dupuy et al. 2013); the relief has half of it at most.
    """
    rng = named_generator(_SEED, name)
    change = table.speckle * _noise(table.grain_mm, rng)
    wall_mm = TEXEL_MM * random_cells(rng, TILE, table.cell_mm / TEXEL_MM)[..., 1]
    change += table.walls * np.exp(-((wall_mm / (_WALL * table.cell_mm)) ** 2))
    change += table.spots * _discs(table.spots_per_cm2, table.spot_mm, rng)
    # Twice: the clipped change has another mean.
    for _ in range(2):
        change = np.clip(change - change.mean(), -_LARGEST_CHANGE, _LARGEST_CHANGE)

    residue = np.ones((TILE, TILE))
    specks = _discs(table.specks_per_cm2, table.speck_mm, rng)
    if specks.any():
        residue += table.dust * (specks / specks.mean() - 1.0)

    height = _noise(table.relief_mm, rng)
    slopes = np.stack([np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (1, 0)], axis=-1)
    steepest = min(np.tan(np.radians(table.relief_deg)), 0.5 * roughness)
    slopes *= steepest / np.sqrt((slopes**2).mean())
    return SkinTile(*(part.astype(np.float32) for part in (change, residue, slopes)))


def _noise(width_mm: float, rng: np.random.Generator) -> FloatArray:
    sigma = 0.25 * width_mm / TEXEL_MM
    return smooth_noise(rng, (TILE, TILE), (sigma, sigma))


def _discs(per_cm2: float, diameter_mm: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """`(TILE, TILE)` 1 in the middle of uneven, soft discs at random places, 0 outside."""
    field = np.zeros((TILE, TILE), np.float32)
    least, greatest = diameter_mm
    discs = scatter_discs(rng, TILE, TEXEL_MM, per_cm2, (0.5 * least, 0.5 * greatest))
    stamp_discs(field, discs, 1.5, lambda r, amount: (0.5 + 0.5 * amount) * np.exp(-(r**4)), np.maximum)
    return field.astype(float)

"""All parameters of a cultivar's plants, and reading them from a TOML file."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from pepperscene.cultivar.branching import Branching
from pepperscene.cultivar.fruiting import CutShape, FruitShape, PeduncleShape
from pepperscene.cultivar.pigments import PigmentPath, PigmentTable
from pepperscene.cultivar.shapes import Around, Blade, LeafShape, NodeShape, PlantShape, ShootShape
from pepperscene.document import Document, read_toml, validated
from pepperscene.shipped import find


class Cultivar(Document):
    """All that is known about a cultivar's plants."""

    name: str
    species: str
    source: str
    plant: PlantShape
    node: NodeShape
    around: Around
    branching: Branching
    leaf: LeafShape
    shoot_leaf: LeafShape
    blade: Blade
    side_shoot: ShootShape
    peduncle: PeduncleShape
    fruit: FruitShape
    cut: CutShape
    pigment: PigmentTable = Field(alias="pigments")

    @property
    def pigments(self) -> dict[str, PigmentPath]:
        """Surface name -> its path through pigment space."""
        return {name: getattr(self.pigment, name) for name in PigmentTable.model_fields}


def load_cultivar(name_or_path: str | Path) -> Cultivar:
    """A shipped cultivar by its name, or one from a TOML file.

    Raises:
        InputError: not found, not TOML, or a parameter is missing, unknown or not allowed.
    """
    path = find("plants", name_or_path)
    return validated(Cultivar, read_toml(path), path)

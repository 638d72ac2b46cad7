"""A cultivar: every parameter of its plants as a distribution with a unit and a source, read from TOML.

The parameters are those of Barth et al. 2018, Table 1 and Fig. 3 to 5, and what else a plant needs to stand,
each with its `source`, or `chosen` and why. Lengths are metres and angles radians.
"""

from pepperscene.cultivar.branching import (
    Branching,
    EndChoice,
    EndCount,
    FruitChoice,
    LeafChoice,
    ShootChoice,
)
from pepperscene.cultivar.choice import Choice, Probability
from pepperscene.cultivar.cultivar import Cultivar, load_cultivar
from pepperscene.cultivar.distribution import Distribution
from pepperscene.cultivar.fruiting import CutShape, FruitShape, LobeChoice, PeduncleShape
from pepperscene.cultivar.notation import Angle, Length, Ratio
from pepperscene.cultivar.origin import Origin
from pepperscene.cultivar.pigments import PigmentPath, Pigments, PigmentTable
from pepperscene.cultivar.shapes import Around, Blade, LeafShape, NodeShape, PlantShape, ShootShape
from pepperscene.cultivar.truncated import truncated_moments

__all__ = [
    "Angle",
    "Around",
    "Blade",
    "Branching",
    "Choice",
    "Cultivar",
    "CutShape",
    "Distribution",
    "EndChoice",
    "EndCount",
    "FruitChoice",
    "FruitShape",
    "LeafChoice",
    "LeafShape",
    "Length",
    "LobeChoice",
    "NodeShape",
    "Origin",
    "PeduncleShape",
    "PigmentPath",
    "PigmentTable",
    "Pigments",
    "PlantShape",
    "Probability",
    "Ratio",
    "ShootChoice",
    "ShootShape",
    "load_cultivar",
    "truncated_moments",
]

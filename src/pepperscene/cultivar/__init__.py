"""A cultivar: organ kinds, what grows on them, and every parameter as a distribution with its source.

Read from TOML. The parameters are those of Barth et al. 2018, Table 1 and Fig. 3 to 5, and what else a plant
needs to stand, each with its `source`, or `chosen` and why. Lengths are metres and angles radians.
"""

from pepperscene.cultivar.cultivar import Cultivar, interpolate_cultivars, load_cultivar
from pepperscene.cultivar.distribution import Distribution, Origin, truncated_moments
from pepperscene.cultivar.inheritance import cultivar_files
from pepperscene.cultivar.notation import Angle, Choice, Length, Number, Probability, Ratio
from pepperscene.cultivar.organs import (
    FORMS,
    USUAL,
    Blade,
    Cut,
    Flower,
    Fruit,
    Internode,
    Node,
    OrganForm,
    OrganKind,
    OrganModel,
    Peduncle,
    Stalk,
)
from pepperscene.cultivar.slot import Descent, Flush, Slot
from pepperscene.cultivar.structure import CALYX, PigmentPath, Pigments, Stem

__all__ = [
    "CALYX",
    "FORMS",
    "USUAL",
    "Angle",
    "Blade",
    "Choice",
    "Cultivar",
    "Cut",
    "Descent",
    "Distribution",
    "Flower",
    "Flush",
    "Fruit",
    "Internode",
    "Length",
    "Node",
    "Number",
    "OrganForm",
    "OrganKind",
    "OrganModel",
    "Origin",
    "Peduncle",
    "PigmentPath",
    "Pigments",
    "Probability",
    "Ratio",
    "Slot",
    "Stalk",
    "Stem",
    "cultivar_files",
    "interpolate_cultivars",
    "load_cultivar",
    "truncated_moments",
]

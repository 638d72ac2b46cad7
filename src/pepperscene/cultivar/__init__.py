"""A cultivar: organ kinds, what grows on them, and every parameter as a distribution with its source.

Read from TOML. The parameters are those of Barth et al. 2018, Table 1 and Fig. 3 to 5, and what else a plant
needs to stand, each with its `source`, or `chosen` and why. Lengths are metres and angles radians.
"""

from pepperscene.cultivar.blending import interpolated
from pepperscene.cultivar.choice import Choice, Number, Probability
from pepperscene.cultivar.cultivar import Cultivar, load_cultivar
from pepperscene.cultivar.distribution import Distribution
from pepperscene.cultivar.forms import FORMS, USUAL, Form, Kind
from pepperscene.cultivar.lineage import files_of
from pepperscene.cultivar.notation import Angle, Length, Ratio
from pepperscene.cultivar.organs import (
    Blade,
    Cut,
    Flower,
    Fruit,
    Internode,
    Node,
    OrganModel,
    Peduncle,
    Stalk,
)
from pepperscene.cultivar.origin import Origin
from pepperscene.cultivar.pigments import PigmentPath, Pigments
from pepperscene.cultivar.slot import Descent, Flush, Slot
from pepperscene.cultivar.stem import Stem
from pepperscene.cultivar.structure import CALYX
from pepperscene.cultivar.truncated import truncated_moments

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
    "Form",
    "Fruit",
    "Internode",
    "Kind",
    "Length",
    "Node",
    "Number",
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
    "files_of",
    "interpolated",
    "load_cultivar",
    "truncated_moments",
]

"""Cultivars: organ kinds, their slots, and every parameter as a distribution with its source.

Read from TOML. The parameters are those of Barth et al. 2018, Table 1 and Fig. 3 to 5, and others that a
plant needs, each with its `source`, or `chosen` with the reason. Lengths are metres and angles radians.
"""

from pepperscene.cultivar.cultivar import Cultivar, interpolate_cultivars, load_cultivar
from pepperscene.cultivar.distribution import Distribution, Origin
from pepperscene.cultivar.inheritance import cultivar_files
from pepperscene.cultivar.notation import Ratio, parse_distribution
from pepperscene.cultivar.organs import DEFAULT_KINDS, FORMS, Blade, Fruit, OrganForm, OrganKind, OrganModel
from pepperscene.cultivar.slot import Slot
from pepperscene.cultivar.structure import CALYX, STATE_PER_SD, MeasuredCurve, PigmentPath, Pigments, Stem

__all__ = [
    "CALYX",
    "DEFAULT_KINDS",
    "FORMS",
    "STATE_PER_SD",
    "Blade",
    "Cultivar",
    "Distribution",
    "Fruit",
    "MeasuredCurve",
    "OrganForm",
    "OrganKind",
    "OrganModel",
    "Origin",
    "PigmentPath",
    "Pigments",
    "Ratio",
    "Slot",
    "Stem",
    "cultivar_files",
    "interpolate_cultivars",
    "load_cultivar",
    "parse_distribution",
]

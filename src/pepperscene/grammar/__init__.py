"""Plants: drawing a cultivar's parameters, and building organs with poses from them; no triangles."""

from pepperscene.cultivar.forms import Form, Kind
from pepperscene.grammar.build import build
from pepperscene.grammar.draw import draw_parameters
from pepperscene.grammar.grow import grow
from pepperscene.grammar.parameters import (
    CutParameters,
    FruitParameters,
    LeafParameters,
    PhytomerParameters,
    PlantParameters,
    ShootParameters,
)
from pepperscene.grammar.plant import ORGAN_KINDS, Organ, OrganKind, Plant
from pepperscene.grammar.settle import touching_fruit

__all__ = [
    "ORGAN_KINDS",
    "CutParameters",
    "Form",
    "FruitParameters",
    "Kind",
    "LeafParameters",
    "Organ",
    "OrganKind",
    "PhytomerParameters",
    "Plant",
    "PlantParameters",
    "ShootParameters",
    "build",
    "draw_parameters",
    "grow",
    "touching_fruit",
]

"""Plants: drawing a cultivar's parameters, and building organs with poses from them; no triangles."""

from pepperscene.cultivar import OrganForm, OrganKind
from pepperscene.grammar.build import build_plant, grow
from pepperscene.grammar.draw import draw_parameters
from pepperscene.grammar.plant import Organ, Plant, PlantParameters

__all__ = [
    "Organ",
    "OrganForm",
    "OrganKind",
    "Plant",
    "PlantParameters",
    "build_plant",
    "draw_parameters",
    "grow",
]

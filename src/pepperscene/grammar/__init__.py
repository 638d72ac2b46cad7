"""Plants: drawing a cultivar's parameters, and building organs with poses from them; no triangles."""

from pepperscene.cultivar import Form, Kind
from pepperscene.grammar.build import build, grow
from pepperscene.grammar.draw import draw_parameters
from pepperscene.grammar.plant import KindParameters, Organ, Plant, PlantParameters

__all__ = [
    "Form",
    "Kind",
    "KindParameters",
    "Organ",
    "Plant",
    "PlantParameters",
    "build",
    "draw_parameters",
    "grow",
]

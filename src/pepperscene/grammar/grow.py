"""Growing one random plant of a cultivar."""

from __future__ import annotations

import numpy as np

from pepperscene.cultivar import Cultivar
from pepperscene.grammar.build import KINDS, build_frame, build_fruit
from pepperscene.grammar.draw import draw_parameters
from pepperscene.grammar.plant import Plant
from pepperscene.grammar.settle import settle


def grow(cultivar: Cultivar, rng: np.random.Generator) -> Plant:
    """A plant whose parameters are drawn from the cultivar's distributions, and whose fruit hangs free.

    The same state of the generator gives the same arrays, bit for bit. Few fruits may find no free pose;
    `touching_fruit` counts them.
    """
    parameters = draw_parameters(cultivar, rng)
    organs, frames = build_frame(parameters)
    fruit = settle(parameters, organs, frames, cultivar, rng)
    return Plant(parameters.cultivar, (*organs, *build_fruit(fruit, frames, len(organs))), KINDS)

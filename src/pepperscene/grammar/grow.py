"""Growing one random plant of a cultivar."""

from __future__ import annotations

import numpy as np

from pepperscene.cultivar import Cultivar
from pepperscene.grammar.build import build
from pepperscene.grammar.draw import draw_parameters
from pepperscene.grammar.plant import Plant


def grow(cultivar: Cultivar, rng: np.random.Generator, lean: float = 0.0) -> Plant:
    """A plant whose parameters are drawn from the cultivar's laws; what touches what is not looked at.

    The same state of the generator gives the same arrays, bit for bit.

    Args:
        cultivar: whose laws they follow.
        rng: gives one number, the plant's key.
        lean: radians, added to the drawn lean of the stem; positive towards the aisle (-y).
    """
    return build(draw_parameters(cultivar, rng, lean))

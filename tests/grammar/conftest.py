"""Plants that many tests measure."""

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar, load_cultivar
from pepperscene.grammar import Plant, grow


@pytest.fixture(scope="session")
def tomato() -> Cultivar:
    return load_cultivar("tomato")


@pytest.fixture(scope="session")
def plants(kaite: Cultivar) -> list[Plant]:
    """Kaite plants with fixed seeds."""
    return [grow(kaite, np.random.default_rng(seed)) for seed in range(200)]


@pytest.fixture(scope="session")
def tomatoes(tomato: Cultivar) -> list[Plant]:
    """Tomato plants with fixed seeds."""
    return [grow(tomato, np.random.default_rng(seed)) for seed in range(40)]

import numpy as np
import pytest

from pepperscene.materials import greenhouse_surfaces, organ_surfaces

NM = np.arange(300.0, 1101.0, 5.0)


@pytest.fixture(scope="session")
def nm():
    """Wavelengths up to the range of near-infrared cameras."""
    return NM


@pytest.fixture(scope="session")
def surfaces(kaite):
    return organ_surfaces(kaite, NM) | greenhouse_surfaces(NM)

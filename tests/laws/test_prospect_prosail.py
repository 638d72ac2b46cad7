"""PROSPECT against PyPI prosail 2.0.5, an implementation by others (J. Gomez-Dans), over random leaves.

Rationale: published values exist for few leaves; a second implementation can be asked for any. 1,000 sets
drawn from the whole range of every parameter leave a region that covers a share p of the range unvisited with
probability (1 - p)^1000: 4e-5 for p = 1 %. prosail (through numba) and the renderer hold different LLVMs,
which get on in one process.
"""

from __future__ import annotations

import numpy as np
import pytest
from prosail import run_prospect, spectral_lib

from pepperscene.spectra import absorption_coefficients, leaf_spectra

NM = np.arange(400, 2501)
TOLERANCE = 1e-6
RANGES = {
    "structure_n": (1.0, 3.5),
    "chlorophyll_ug_cm2": (0.0, 120.0),
    "carotenoid_ug_cm2": (0.0, 40.0),
    "anthocyanin_ug_cm2": (0.0, 20.0),
    "brown": (0.0, 2.0),
    "water_cm": (0.0, 0.06),
    "dry_matter_g_cm2": (0.0, 0.04),
}


def draw(count: int, seed: int, **ranges: tuple[float, float]) -> dict[str, np.ndarray]:
    """Uniform over the ranges; in a fifth of the leaves each content but structure is absent."""
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(low, high, count) for name, (low, high) in ranges.items()}
    present = {name: rng.random(count) > 0.2 for name in ranges if name != "structure_n"}
    return {name: values * present.get(name, 1.0) for name, values in drawn.items()}


def theirs(*contents: float, **more) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and transmittance by prosail, which multiplies infinity by zero on its way."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return run_prospect(*contents, **more)[1:]


def worst(leaf, index: int, reflectance: np.ndarray, transmittance: np.ndarray) -> float:
    differences = leaf.reflectance[index] - reflectance, leaf.transmittance[index] - transmittance
    return float(np.abs(differences).max())


@pytest.mark.parametrize("part", range(10))
def test_a_thousand_leaves_equal_those_of_prosail(part):
    contents = draw(100, part, **RANGES)
    leaf = leaf_spectra(NM, **contents)
    assert leaf.reflectance.shape == (100, NM.size)
    for i in range(100):
        n, cab, car, ant, brown, cw, cm = (contents[name][i] for name in RANGES)
        reflectance, transmittance = theirs(n, cab, car, brown, cw, cm, ant=ant)
        assert worst(leaf, i, reflectance, transmittance) < TOLERANCE, {k: v[i] for k, v in contents.items()}


def test_a_leaf_without_anything_in_it_equals_that_of_prosail():
    """Where prosail, too, must leave out the general formula."""
    for n in (1.0, 1.5, 3.5):
        reflectance, transmittance = theirs(n, 0.0, 0.0, 0.0, 0.0, 0.0)
        leaf = leaf_spectra(NM, structure_n=[n])
        assert worst(leaf, 0, reflectance, transmittance) < TOLERANCE


def test_protein_and_carbon_equal_those_of_prosail():
    """prosail has no PROSPECT-PRO, but takes coefficients: protein and carbon go in as dry matter."""
    specific = absorption_coefficients(NM)
    ranges = {k: v for k, v in RANGES.items() if k != "dry_matter_g_cm2"}
    contents = draw(100, 11, **ranges, protein_g_cm2=(0.0, 0.003), carbon_g_cm2=(0.0, 0.03))
    leaf = leaf_spectra(NM, **contents)
    for i in range(100):
        n, cab, car, ant, brown, cw, protein, carbon = (values[i] for values in contents.values())
        dry = protein * specific["protein"] + carbon * specific["carbon"]
        reflectance, transmittance = theirs(n, cab, car, brown, cw, 1.0, ant=ant, km=dry)
        assert worst(leaf, i, reflectance, transmittance) < TOLERANCE


def test_the_coefficients_are_those_that_prosail_ships():
    specific, table = absorption_coefficients(NM), spectral_lib.prospectd
    ours = ("refractive_index", "chlorophyll", "carotenoid", "anthocyanin", "brown", "water", "dry_matter")
    shipped = (table.nr, table.kab, table.kcar, table.kant, table.kbrown, table.kw, table.km)
    for name, values in zip(ours, shipped, strict=True):
        assert specific[name] == pytest.approx(values, rel=1e-12), name

"""PROSPECT against PyPI prosail 2.0.5, an independent implementation (J. Gomez-Dans), over random leaves.

Rationale: published values exist for few leaves, a second implementation gives any. 300 sets drawn from the full
range of every parameter miss a region that covers a fraction p of the range with probability (1 - p)^300:
5 % for p = 1 %. prosail (through numba) and the renderer load different LLVMs, which work in
one process.
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
    """Uniform over the ranges; each content except structure is absent in a fifth of the leaves."""
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(low, high, count) for name, (low, high) in ranges.items()}
    present = {name: rng.random(count) > 0.2 for name in ranges if name != "structure_n"}
    return {name: values * present.get(name, 1.0) for name, values in drawn.items()}


def prosail(*contents: float, **options) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and transmittance by prosail, which multiplies infinity by zero internally."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return run_prospect(*contents, **options)[1:]


def max_difference(leaf, index: int, reflectance: np.ndarray, transmittance: np.ndarray) -> float:
    differences = leaf.reflectance[index] - reflectance, leaf.transmittance[index] - transmittance
    return float(np.abs(differences).max())


@pytest.mark.parametrize("part", range(3))
def test_random_leaves_match_prosail(part):
    contents = draw(100, part, **RANGES)
    leaf = leaf_spectra(NM, **contents)
    assert leaf.reflectance.shape == (100, NM.size)
    for i in range(100):
        n, cab, car, ant, brown, cw, cm = (contents[name][i] for name in RANGES)
        spectra = prosail(n, cab, car, brown, cw, cm, ant=ant)
        assert max_difference(leaf, i, *spectra) < TOLERANCE, {k: v[i] for k, v in contents.items()}


def test_leaf_without_pigments_matches_prosail():
    """prosail has a special case for it, too."""
    for n in (1.0, 1.5, 3.5):
        leaf = leaf_spectra(NM, structure_n=[n])
        assert max_difference(leaf, 0, *prosail(n, 0.0, 0.0, 0.0, 0.0, 0.0)) < TOLERANCE


def test_protein_and_carbon_match_prosail():
    """prosail has no PROSPECT-PRO, but accepts coefficients: protein and carbon are passed as dry matter."""
    specific = absorption_coefficients(NM)
    ranges = {k: v for k, v in RANGES.items() if k != "dry_matter_g_cm2"}
    contents = draw(100, 11, **ranges, protein_g_cm2=(0.0, 0.003), carbon_g_cm2=(0.0, 0.03))
    leaf = leaf_spectra(NM, **contents)
    for i in range(100):
        n, cab, car, ant, brown, cw, protein, carbon = (values[i] for values in contents.values())
        dry = protein * specific["protein"] + carbon * specific["carbon"]
        spectra = prosail(n, cab, car, brown, cw, 1.0, ant=ant, km=dry)
        assert max_difference(leaf, i, *spectra) < TOLERANCE


def test_coefficients_match_prosail():
    specific, table = absorption_coefficients(NM), spectral_lib.prospectd
    names = ("refractive_index", "chlorophyll", "carotenoid", "anthocyanin", "brown", "water", "dry_matter")
    shipped = (table.nr, table.kab, table.kcar, table.kant, table.kbrown, table.kw, table.km)
    for name, values in zip(names, shipped, strict=True):
        assert specific[name] == pytest.approx(values, rel=1e-12), name

"""Specific absorption coefficients of what a leaf or a pepper is made of."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra.reading import read_spectra, read_spectrum
from pepperscene.spectra.spectrum import Spectrum

LEAF_FILE: Final = "leaf/prospect_pro_sac_400_2500"
PEPPER_FILE: Final = "fruit/pepper_pigment_sac_MODEL"
RED_COLUMN: Final = "capsorubin_MODEL"
"""Of the two models in that file, the one with its maximum at 482 nm; see `absorption_coefficients`."""
_COLUMNS: Final = {
    "chlorophyll": "sac_chl",
    "carotenoid": "sac_car",
    "anthocyanin": "sac_ant",
    "brown": "sac_brown",
    "water": "sac_ewt",
    "dry_matter": "sac_lma",
    "protein": "sac_prot",
    "carbon": "sac_cbc",
    "refractive_index": "nrefrac",
}


def absorption_coefficients(wavelength_nm: ArrayLike) -> Mapping[str, NDArray[np.float64]]:
    """Specific absorption and the refractive index of leaf tissue, each `(n,)`, by constituent.

    chlorophyll (a + b), carotenoid, anthocyanin and capsanthin in cm2 ug-1; brown (relative); water in cm-1;
    dry_matter, protein and carbon (carbon-based constituents) in cm2 g-1; refractive_index.

    From PROSPECT-D/PRO (Feret et al. 2017, 2021). The tables begin at 400 nm: below, the value at 400 nm is
    held, because none was measured there.

    Capsanthin is a MODEL, PROSPECT's carotenoid shifted to the red, with its maximum at 482 nm and zero
    beyond its table's 800 nm. It stands for all red carotenoids of ripe fruit: in the tissue their bands lie
    further to the red than in solvents. A model with its maximum at 470 nm makes no red pepper: CIELAB hue
    44 degrees, where ripe ones have 30 (Molinari et al. 1999, Proc. Fla. State Hort. Soc. 112:143).

    Raises:
        ValueError: a wavelength lies beyond 2500 nm.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    # Surfaces are made of many leaves on few grids of wavelengths.
    return {name: values.copy() for name, values in _on_grid(tuple(nm.tolist())).items()}


@lru_cache(maxsize=8)
def _on_grid(wavelength_nm: tuple[float, ...]) -> Mapping[str, NDArray[np.float64]]:
    nm, table = np.array(wavelength_nm), _coefficients()
    first, last = table["chlorophyll"].wavelength_nm[[0, -1]]
    if nm.max() > last:
        raise ValueError(f"{nm.max():g} nm lies beyond the coefficients' {last:g} nm")
    held = np.maximum(nm, first)
    return {name: spectrum.at(held) for name, spectrum in table.items()}


@lru_cache(maxsize=1)
def _coefficients() -> Mapping[str, Spectrum]:
    leaf = read_spectra(LEAF_FILE, outside="error")
    capsanthin = read_spectrum(PEPPER_FILE, RED_COLUMN, outside="zero")
    return {name: leaf[column] for name, column in _COLUMNS.items()} | {"capsanthin": capsanthin}

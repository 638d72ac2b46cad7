"""What fruit, stems and stalks have in common: a pigmented rind on a pale, watery body."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials.gloss import cone_gloss
from pepperscene.materials.states import enough_states
from pepperscene.materials.surface import Surface
from pepperscene.spectra import absorption_coefficients, leaf_spectra, over_body

if TYPE_CHECKING:
    from pepperscene.cultivar import PigmentPath

Array = NDArray[np.float64]

SCATTERING_PER_CM: Final = 10.0
"""Reduced scattering coefficient of fruit flesh: 9.5 to 12.5 cm-1 between 1000 and 500 nm in pears (Hu, Fu &
Ying 2017, J. Food Meas. Charact., doi 10.1007/s11694-017-9465-x). Stems are taken to be alike."""
WATER_SHARE: Final = 0.9
"""Of the flesh's volume: chosen, sweet pepper is 92 to 94 % water by weight and holds some air."""


def flesh_reflectance(dry_reflectance: float, wavelength_nm: ArrayLike) -> Array:
    """Reflectance `(n,)` of a thick, diffuse body of parenchyma under diffuse light, 300 to 1100 nm: a MODEL.

    Kubelka & Munk 1931: K/S = (1 - R)^2 / (2 R). What the body absorbs without water gives
    `dry_reflectance` at every wavelength; its water adds K = 2 mu_a to that, with S = 3/4 mu_s'
    (Mudgett & Richards 1971, Appl. Opt. 10:1485). Below 700 nm water takes nothing, at 970 nm its band is
    seen, as in measured fruit.

    Args:
        dry_reflectance: where water does not absorb, in [0, 1).
        wavelength_nm: `(n,)`.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    if dry_reflectance == 0.0:
        return np.zeros(nm.size)
    water_per_cm = absorption_coefficients(nm)["water"]
    dry = (1.0 - dry_reflectance) ** 2 / (2.0 * dry_reflectance)
    wet = dry + 2.0 * WATER_SHARE * water_per_cm / (0.75 * SCATTERING_PER_CM)
    return np.asarray(1.0 + wet - np.sqrt(wet**2 + 2.0 * wet))


def rind_reflectance(path: PigmentPath, wavelength_nm: Array, states: ArrayLike) -> Array:
    """Reflectance `(s, n)` under the cuticle of a pigmented rind on its flesh, at states `(s,)`.

    The pigments are mixed at each state and then the spectrum is computed (PROSPECT's layer on a diffuse
    body): the colour half-way is not the mean of the ends' colours.
    """
    rind = leaf_spectra(wavelength_nm, **path.at(np.atleast_1d(np.asarray(states, dtype=float))))
    flesh = flesh_reflectance(path.flesh_reflectance or 0.0, wavelength_nm)
    reflectance, _ = over_body(rind, flesh).under_gloss(cone_gloss(path.ior, path.roughness[0]))
    return reflectance


def rind_surface(
    name: str,
    path: PigmentPath,
    wavelength_nm: Array,
    pattern: Array,
    relief_mm: Array | None = None,
) -> Surface:
    """An opaque surface of rind on flesh, the same from both sides, tabulated finely enough."""
    states = enough_states(lambda nm, asked: rind_reflectance(path, nm, asked))
    rows = rind_reflectance(path, wavelength_nm, states)
    return Surface(
        name,
        wavelength_nm,
        np.repeat(rows[:, None, :], 2, axis=1),
        np.zeros_like(rows),
        ior=path.ior,
        roughness=path.roughness,
        pattern=pattern.astype(np.float32),
        relief_mm=None if relief_mm is None else relief_mm.astype(np.float32),
    )

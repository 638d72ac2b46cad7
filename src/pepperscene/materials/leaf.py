"""The leaf's blade: translucent, different above and below, with veins."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials.gloss import cone_gloss
from pepperscene.materials.states import enough_states
from pepperscene.materials.surface import Surface
from pepperscene.materials.venation import grow_veins, vein_pattern, vein_relief
from pepperscene.spectra import leaf_spectra

if TYPE_CHECKING:
    from pepperscene.cultivar import PigmentPath

Array = NDArray[np.float64]

ABAXIAL_SHARE: Final = 0.5
"""Share of the pigments that light from below meets before it turns back: chosen.

PROSPECT's leaf is the same on both sides; a real one keeps most of its chlorophyll in the palisade below its
upper side, so that the lower side reflects more in the visible and as much in the near infrared (Woolley
1971, Plant Physiology 47:656). The lower side's reflectance is that of a leaf with this share of the pigments
and the same structure, water and dry matter; the transmittance is that of the whole leaf both ways, as
reciprocity asks. Since transmittance falls with pigment, the sum can never exceed 1.
"""

PIGMENTS: Final = (
    "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2", "brown"
)  # fmt: skip


def leaf_surface(
    path: PigmentPath, wavelength_nm: Array, size_mm: tuple[float, float], rng: np.random.Generator
) -> Surface:
    """A leaf's blade: PROSPECT on both sides, its gloss left to the cuticle, with veins.

    Args:
        path: pigments from a vein's (state 0) over a pale blade's to a dark blade's (state 1).
        wavelength_nm: `(n,)`.
        size_mm: width and length of the flat blade.
        rng: draws veins and mottling.
    """
    veins = grow_veins(size_mm, rng)
    pattern, relief = vein_pattern(veins, rng), vein_relief(veins, rng)
    return replace(thin_surface("leaf", path, wavelength_nm), pattern=pattern, relief_mm=relief)


def thin_surface(name: str, path: PigmentPath, wavelength_nm: Array) -> Surface:
    """An even leaf of these pigments, without veins."""
    states = enough_states(lambda nm, asked: np.stack(leaf_body(path, nm, asked), axis=1))
    above, below, through = leaf_body(path, wavelength_nm, states)
    both = np.stack([above, below], axis=1)
    return Surface(name, wavelength_nm, both, through, ior=path.ior, roughness=path.roughness)


def leaf_body(path: PigmentPath, wavelength_nm: Array, states: Array) -> tuple[Array, Array, Array]:
    """Reflectance of the upper and of the lower side and transmittance, each `(s, n)`, under the cuticle."""
    contents = path.at(states)
    upper, lower = (cone_gloss(path.ior, alpha) for alpha in path.roughness)
    above, through = leaf_spectra(wavelength_nm, **contents).under_gloss(upper)
    below, _ = leaf_spectra(wavelength_nm, **_thinned(contents, ABAXIAL_SHARE)).under_gloss(lower)
    return above, below, np.minimum(through, 1.0 - below)


def _thinned(contents: dict[str, Array], share: float) -> dict[str, Array]:
    return {name: amount * share if name in PIGMENTS else amount for name, amount in contents.items()}

"""PROSPECT: reflectance and transmittance of a leaf from its structure and constituents.

Everything here takes numbers, NumPy arrays or torch tensors; with a tensor among the parameters all results
are tensors of float64, differentiable in every one of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra.files import read_spectra, read_spectrum
from pepperscene.spectra.plates import Array, cone_transmissivity, floats, pile, plate
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


INCIDENCE_CONE_RAD: Final = np.radians(40.0)
"""Half-angle of the cone in which light meets the rough leaf surface (Jacquemoud & Baret 1990)."""


@dataclass(frozen=True, eq=False)
class LeafOptics:
    """What a leaf does to light.

    Attributes:
        reflectance: `(..., n)` directional-hemispherical, the gloss of the surface included: PROSPECT's R.
        transmittance: `(..., n)` directional-hemispherical: PROSPECT's T, the same from either side.
        diffuse_reflectance: `(..., n)` of the same pile of plates under wholly diffuse light.
        diffuse_transmittance: `(..., n)` likewise.
    """

    reflectance: Array
    transmittance: Array
    diffuse_reflectance: Array
    diffuse_transmittance: Array

    def under_cuticle(self, ior: Array) -> tuple[Array, Array]:
        """Reflectance and transmittance `(..., n)` of the body under a smooth cuticle; see `under_gloss`.

        Args:
            ior: refractive index of the cuticle, >= 1; broadcasts to `(...)`, one per leaf.
        """
        return self.under_gloss(cuticle_gloss(ior))

    def under_gloss(self, gloss: Array) -> tuple[Array, Array]:
        """Reflectance and transmittance `(..., n)` of the body under a surface that mirrors light itself.

        They are shares of the light that the surface lets in, so that gloss g and body together give
        PROSPECT's values: R = g + (1 - g) R_body, T = (1 - g) T_body. Never negative: where pigments absorb
        all the rest, a cuticle of a higher index than the tissue's (1.43 to 1.52) alone exceeds PROSPECT's R.

        Args:
            gloss: share of the light in PROSPECT's cone of incidence that the surface mirrors, in [0, 1);
                broadcasts to `(...)`, one per leaf.
        """
        xp, (reflectance, transmittance, mirrored) = floats(self.reflectance, self.transmittance, gloss)
        inside = 1.0 - mirrored[..., None]
        body = xp.clip(1.0 - (1.0 - reflectance) / inside, 0.0, 1.0)
        return body, xp.minimum(transmittance / inside, 1.0 - body)


def cuticle_gloss(ior: Array) -> Array:
    """Reflectance of a smooth surface of this refractive index for light in PROSPECT's cone of incidence."""
    gloss = 1.0 - cone_transmissivity(INCIDENCE_CONE_RAD, ior)
    return float(gloss) if isinstance(ior, (int, float)) else gloss


def leaf_spectra(
    wavelength_nm: ArrayLike,
    *,
    structure_n: Array,
    chlorophyll_ug_cm2: Array = 0.0,
    carotenoid_ug_cm2: Array = 0.0,
    anthocyanin_ug_cm2: Array = 0.0,
    capsanthin_ug_cm2: Array = 0.0,
    brown: Array = 0.0,
    water_cm: Array = 0.0,
    dry_matter_g_cm2: Array = 0.0,
    protein_g_cm2: Array = 0.0,
    carbon_g_cm2: Array = 0.0,
) -> LeafOptics:
    """PROSPECT-D (Feret et al. 2017) or, with protein and carbon for dry matter, -PRO (Feret et al. 2021).

    Args:
        wavelength_nm: `(n,)` up to 2500 nm; below 400 nm the coefficients of 400 nm hold.
        structure_n: N, number of plates, >= 1. This and all that follow broadcast to `(...)`, one per leaf.
        chlorophyll_ug_cm2: a and b, per leaf area, as all contents.
        carotenoid_ug_cm2: carotenoids of green leaves.
        anthocyanin_ug_cm2: anthocyanins.
        capsanthin_ug_cm2: the red carotenoid of peppers (a MODEL coefficient; not part of PROSPECT).
        brown: brown pigments, relative.
        water_cm: equivalent water thickness.
        dry_matter_g_cm2: dry matter as one (PROSPECT-D).
        protein_g_cm2: its nitrogen-based part (PROSPECT-PRO).
        carbon_g_cm2: its carbon-based part (PROSPECT-PRO).

    Raises:
        ValueError: N < 1, a negative or infinite content, or dry matter given both as one and in parts.
    """
    contents = {
        "chlorophyll": chlorophyll_ug_cm2,
        "carotenoid": carotenoid_ug_cm2,
        "anthocyanin": anthocyanin_ug_cm2,
        "capsanthin": capsanthin_ug_cm2,
        "brown": brown,
        "water": water_cm,
        "dry_matter": dry_matter_g_cm2,
        "protein": protein_g_cm2,
        "carbon": carbon_g_cm2,
    }
    # Constituents and plates of each leaf, with an axis for wavelengths behind; coefficients by wavelength.
    specific = absorption_coefficients(wavelength_nm)
    coefficients = [specific[name] for name in (*contents, "refractive_index")]
    _, given = floats(structure_n, *contents.values(), *coefficients)
    plates, *values = (x[..., None] for x in given[: 1 + len(contents)])
    *per_unit, ior = given[1 + len(contents) :]
    amounts = dict(zip(contents, values, strict=True))
    _check(plates, amounts)

    # The constituents are spread evenly over the plates.
    with np.errstate(over="ignore"):
        absorbance = sum(amount * k for amount, k in zip(values, per_unit, strict=True)) / plates
    diffuse_r, diffuse_t = pile(*plate(absorbance, ior), plates)

    # Light in a cone enters more easily than diffuse light; below the interface both fare alike.
    into_cone = cone_transmissivity(INCIDENCE_CONE_RAD, ior)
    into_diffuse = cone_transmissivity(np.pi / 2, ior)
    easier = into_cone / into_diffuse
    reflectance = 1.0 - into_cone + easier * (diffuse_r - (1.0 - into_diffuse))
    return LeafOptics(reflectance, easier * diffuse_t, diffuse_r, diffuse_t)


def _check(plates: Array, amounts: Mapping[str, Array]) -> None:
    """Refuse what no leaf can be."""
    # Comparisons are false for what is not a number.
    possible = [bool(((x >= 0.0) & (x < np.inf)).all()) for x in amounts.values()]
    if not (all(possible) and bool(((plates >= 1.0) & (plates < np.inf)).all())):
        raise ValueError("a leaf has at least one plate and no negative or infinite contents")
    whole, *parts = (bool((amounts[x] > 0.0).any()) for x in ("dry_matter", "protein", "carbon"))
    if whole and any(parts):
        raise ValueError("dry matter is either one content or protein and carbon, not both")


def layer_over_body(layer: LeafOptics, body_reflectance: Array) -> LeafOptics:
    """A pigmented layer on a diffuse, opaque body: skin on flesh, rind on pith.

    Light that comes through the layer goes to and fro between body and layer (a geometric series):
    R = R_layer + T T_diffuse rho / (1 - R_diffuse rho).

    Args:
        layer: skin or rind.
        body_reflectance: rho of the body, in [0, 1), broadcasts to `(..., n)`.
    """
    xp, (rho, reflectance, transmittance, diffuse_r, diffuse_t) = floats(
        body_reflectance,
        layer.reflectance,
        layer.transmittance,
        layer.diffuse_reflectance,
        layer.diffuse_transmittance,
    )
    returned = diffuse_t * rho / (1.0 - diffuse_r * rho)
    nothing = xp.zeros_like(transmittance)
    return LeafOptics(
        reflectance + transmittance * returned, nothing, diffuse_r + diffuse_t * returned, nothing
    )

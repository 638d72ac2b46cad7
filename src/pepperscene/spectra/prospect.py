"""PROSPECT: reflectance and transmittance of a leaf from its structure and constituents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra.pigments import absorption_coefficients
from pepperscene.spectra.plates import cone_transmissivity, pile, plate

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

    reflectance: NDArray[np.float64]
    transmittance: NDArray[np.float64]
    diffuse_reflectance: NDArray[np.float64]
    diffuse_transmittance: NDArray[np.float64]

    def under_cuticle(self, ior: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Reflectance and transmittance `(..., n)` of the body under a glossy cuticle of this index.

        They are shares of the light that the cuticle lets in, so that gloss g and body together give
        PROSPECT's values: R = g + (1 - g) R_body, T = (1 - g) T_body. Never negative: where pigments absorb
        all the rest, a cuticle of a higher index than the tissue's (1.43 to 1.52) alone exceeds PROSPECT's R.
        """
        gloss = cuticle_gloss(ior)
        reflectance = np.maximum(self.reflectance - gloss, 0.0) / (1.0 - gloss)
        return reflectance, np.minimum(self.transmittance / (1.0 - gloss), 1.0 - reflectance)


def cuticle_gloss(ior: float) -> float:
    """Reflectance of a surface of this refractive index for light in PROSPECT's cone of incidence."""
    return 0.0 if ior == 1.0 else 1.0 - float(cone_transmissivity(INCIDENCE_CONE_RAD, ior))


def leaf_spectra(
    wavelength_nm: ArrayLike,
    *,
    structure_n: ArrayLike,
    chlorophyll_ug_cm2: ArrayLike = 0.0,
    carotenoid_ug_cm2: ArrayLike = 0.0,
    anthocyanin_ug_cm2: ArrayLike = 0.0,
    capsanthin_ug_cm2: ArrayLike = 0.0,
    brown: ArrayLike = 0.0,
    water_cm: ArrayLike = 0.0,
    dry_matter_g_cm2: ArrayLike = 0.0,
    protein_g_cm2: ArrayLike = 0.0,
    carbon_g_cm2: ArrayLike = 0.0,
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
        ValueError: N < 1, a negative content, or dry matter given both as one and in parts.
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
    amounts = {name: np.asarray(amount, dtype=float)[..., None] for name, amount in contents.items()}
    plates = np.asarray(structure_n, dtype=float)[..., None]
    if not np.all(plates >= 1.0) or any(np.any(amount < 0.0) for amount in amounts.values()):
        raise ValueError("a leaf has at least one plate and no negative contents")
    if np.any(amounts["dry_matter"] > 0) and np.any(amounts["protein"] + amounts["carbon"] > 0):
        raise ValueError("dry matter is either one content or protein and carbon, not both")

    # The constituents are spread evenly over the plates.
    specific = absorption_coefficients(wavelength_nm)
    ior = specific["refractive_index"]
    absorbance = np.asarray(sum(amounts[name] * specific[name] for name in amounts))
    diffuse_r, diffuse_t = pile(*plate(absorbance / plates, ior), plates)

    # Light in a cone enters more easily than diffuse light; below the interface both fare alike.
    into_cone, into_diffuse = (
        cone_transmissivity(INCIDENCE_CONE_RAD, ior),
        cone_transmissivity(np.pi / 2, ior),
    )
    easier = into_cone / into_diffuse
    reflectance = 1.0 - into_cone + easier * (diffuse_r - (1.0 - into_diffuse))
    return LeafOptics(reflectance, easier * diffuse_t, diffuse_r, diffuse_t)


def over_body(layer: LeafOptics, body_reflectance: ArrayLike) -> LeafOptics:
    """A pigmented layer on a diffuse, opaque body: skin on flesh, rind on pith.

    Light that comes through the layer goes to and fro between body and layer (a geometric series):
    R = R_layer + T T_diffuse rho / (1 - R_diffuse rho).

    Args:
        layer: skin or rind.
        body_reflectance: rho of the body, in [0, 1], broadcasts to `(..., n)`.
    """
    rho = np.asarray(body_reflectance, dtype=float)
    returned = layer.diffuse_transmittance * rho / (1.0 - layer.diffuse_reflectance * rho)
    nothing = np.zeros_like(layer.transmittance)
    return LeafOptics(
        layer.reflectance + layer.transmittance * returned,
        nothing,
        layer.diffuse_reflectance + layer.diffuse_transmittance * returned,
        nothing,
    )

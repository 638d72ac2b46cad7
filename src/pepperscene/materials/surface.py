"""Optical description of an organ's surface, as plain arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import PigmentPath
from pepperscene.materials.skin import SkinTile
from pepperscene.spectra.spectrum import FloatArray

AGEING_RANGE: Final = 0.25
"""Ageing of an organ, in [0, 1], over which a place on it goes from healthy to dry: chosen."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Diffuse, possibly translucent body under a glossy cuticle, over a range of pigment states.

    A state in [0, 1] is a point on the surface's path through pigment space (a fruit from unripe to ripe, a
    leaf from pale to dark). Spectra are tabulated at the states `linspace(0, 1, s)` and interpolated
    linearly. Each row comes from a pigment model: pigments are mixed, not spectra.

    Attributes:
        name: unique within a scene ("leaf", "fruit", "stem").
        wavelength_nm: `(n,)` increasing.
        reflectance: `(s, 2, n)` diffuse hemispherical reflectance of the body under the cuticle, as a
            fraction of the light that passes the cuticle; axis 1 is front side (of the normal) and back side.
        transmittance: `(s, n)` diffuse hemispherical transmittance, likewise, equal both ways; 0 for opaque
            bodies. Reflectance and transmittance sum to at most 1.
        ior: refractive index of the cuticle; 1 means a surface without gloss.
        roughness: `(2,)` GGX alpha of the cuticle, front and back.
        wide_roughness: `(2,)` alpha of a second lobe on the fraction `wide_share` of the cuticle, or None.
        wide_share: see `wide_roughness`.
        first_state: state of the first row of the tables, 0, or -1 for a surface that ages: below 0 the rows
            go on from state 0 to dry tissue at -1, evenly spaced over [-1, 1].
        residue_reflectance: of dust or spray residue, equal at all wavelengths.
        residue_behind: cover of the back with residue over that of the front, in [0, 1].
        pattern: `(t, h, w)` offset added to the state over uv (row 0 is v = 0), for example veins, for each
            of t textures, or None.
        relief_mm: `(t, h, w)` height over uv along the normal, for shading only, or None; slopes follow from
            the mesh's own extent in u and v.
        residue_pattern: `(t, h, w)` factor of an organ's residue, of mean 1, or None for 1 everywhere. The
            local cover is the product, at most 0.95.
        ageing_order: `(t, h, w)` ageing of an organ at which the tissue begins to age, 0 or more, or None for
            tissue that does not age before the organ is dry. Tissue that begins at m has aged by
            clip((ageing - m) / `AGEING_RANGE`, 0, 1); a state s then becomes s - aged * (1 + s).
        contents: `(s,)` what the tissue of each row holds, 0 or more, by trait: "chlorophyll" and
            "carotenoids" in ug/cm2, "water" in cm, "ripeness" from 0 to 1. Traits that the surface does not
            have are left out. Between two rows they are linear, as the spectra are.
        is_blade: whether it is the surface of leaf blades, whose ageing is the age of the leaf.
        skin: fine texture, or None.
    """

    name: str
    wavelength_nm: FloatArray
    reflectance: FloatArray
    transmittance: FloatArray
    ior: float = 1.0
    roughness: tuple[float, float] = (0.3, 0.3)
    wide_roughness: tuple[float, float] | None = None
    wide_share: float = 0.5
    first_state: float = 0.0
    residue_reflectance: float = 0.45
    residue_behind: float = 0.0
    pattern: NDArray[np.float32] | None = None
    relief_mm: NDArray[np.float32] | None = None
    residue_pattern: NDArray[np.float32] | None = None
    ageing_order: NDArray[np.float32] | None = None
    contents: Mapping[str, FloatArray] = field(default_factory=dict)
    is_blade: bool = False
    skin: SkinTile | None = None

    def __post_init__(self) -> None:
        s, n = self.reflectance.shape[0], self.wavelength_nm.size
        if self.reflectance.shape != (s, 2, n) or self.transmittance.shape != (s, n):
            raise ValueError(
                f"{self.name}: reflectance (s, 2, n) and transmittance (s, n) do not match n={n}"
            )
        total = self.reflectance + self.transmittance[:, None, :]
        # Comparisons with NaN are false, so NaN is refused too.
        if not (min(self.reflectance.min(), self.transmittance.min()) >= 0 and total.max() <= 1 + 1e-9):
            raise ValueError(f"{self.name}: reflectance and transmittance must be >= 0 and sum to at most 1")
        alphas = (*self.roughness, *(self.wide_roughness or ()))
        if not (1 <= self.ior < np.inf and all(0 <= alpha < np.inf for alpha in alphas)):
            raise ValueError(f"{self.name}: ior must be at least 1 and roughness at least 0, both finite")
        fractions = (self.wide_share, self.residue_reflectance, self.residue_behind)
        if not all(0 <= fraction <= 1 for fraction in fractions):
            raise ValueError(
                f"{self.name}: wide_share, residue_reflectance and residue_behind must be in [0, 1]"
            )
        if self.first_state not in (0.0, -1.0):
            raise ValueError(f"{self.name}: first_state must be 0 or -1, not {self.first_state:g}")
        for name, images in self.textures.items():
            if images.ndim != 3 or not np.isfinite(images).all():
                raise ValueError(f"{self.name}: {name} must be a stack (t, h, w) of finite numbers")
            if name in ("residue_pattern", "ageing_order") and images.min() < 0:
                raise ValueError(f"{self.name}: {name} must not be negative")
        for name, amounts in self.contents.items():
            if amounts.shape != (s,) or not (np.isfinite(amounts) & (amounts >= 0)).all():
                raise ValueError(f"{self.name}: {name} must be {s} finite numbers that are not negative")

    @property
    def states(self) -> FloatArray:
        """`(s,)` the states of the rows."""
        return np.linspace(self.first_state, 1.0, len(self.transmittance))

    @property
    def textures(self) -> dict[str, NDArray[np.float32]]:
        """The stacks of textures that the surface has, by the name of their field."""
        names = ("pattern", "relief_mm", "residue_pattern", "ageing_order")
        return {name: images for name in names if (images := getattr(self, name)) is not None}


def opaque_surface(name: str, nm: FloatArray, rows: FloatArray, **fields: Any) -> Surface:
    """Opaque surface with the same spectra `(s, n)` on both sides, one row for each state."""
    return Surface(name, nm, np.repeat(rows[:, None], 2, axis=1), np.zeros_like(rows), **fields)


def lambertian_surface(name: str, reflectance: float) -> Surface:
    """Ideal matt, opaque, grey surface, for test patches and reference cards."""
    return opaque_surface(name, np.array([300.0, 1100.0]), np.full((1, 2), float(reflectance)))


TOLERANCE: Final = 0.002
"""Largest error of a spectrum between two rows: chosen, half a step of an 8-bit image."""
MIN_STATES, MAX_STATES = 9, 513
CHECKED_NM: Final = np.arange(400.0, 1001.0, 10.0)
"""Wavelengths at which the error is checked: finer than any pigment's band, and independent of the grid."""


def refine_states(spectra: Callable[[FloatArray, FloatArray], FloatArray], first: float = 0.0) -> FloatArray:
    """Choose evenly spaced states in [first, 1] so that linear interpolation follows a pigment model.

    The intervals are halved until the new rows are within `TOLERANCE` of the mean of their neighbours.

    Args:
        spectra: (wavelengths `(n,)`, states `(s,)`) -> `(s, ...)`.
        first: the first state, 0, or -1 for a surface that ages.
    """
    count = MIN_STATES
    rows = spectra(CHECKED_NM, np.linspace(first, 1.0, count))
    while count < MAX_STATES:
        count = 2 * count - 1
        midpoints = spectra(CHECKED_NM, np.linspace(first, 1.0, count)[1::2])
        if np.abs(midpoints - 0.5 * (rows[1:] + rows[:-1])).max() <= TOLERANCE:
            return np.linspace(first, 1.0, (count + 1) // 2)
        rows = np.insert(midpoints, np.arange(len(midpoints) + 1), rows, axis=0)
    return np.linspace(first, 1.0, count)


def rind_contents(path: PigmentPath, states: FloatArray) -> dict[str, FloatArray]:
    """Contents `(s,)` of a rind at states `(s,)`: "chlorophyll" and "carotenoids", ug per cm2 of skin.

    Carotenoids are those of green tissue and the red ones of ripe fruit (`capsanthin_ug_cm2`). The flesh
    below the rind has no pigments. It is as thick as its light goes, so there is no water per area.
    """
    contents = path.at(states)
    return {
        "chlorophyll": contents["chlorophyll_ug_cm2"],
        "carotenoids": contents["carotenoid_ug_cm2"] + contents["capsanthin_ug_cm2"],
    }


def leaf_contents(path: PigmentPath, states: FloatArray) -> dict[str, FloatArray]:
    """Contents `(s,)` of a sheet: those of `rind_contents`, and "water", the equivalent thickness in cm."""
    return {**rind_contents(path, states), "water": path.at(states)["water_cm"]}

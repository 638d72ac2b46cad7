"""What light meets: the optical description of an organ's surface, as plain arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Surface:
    """A diffuse, possibly translucent body under a glossy cuticle, over a range of pigment states.

    A state in [0, 1] is a point on the surface's path through pigment space (a fruit from unripe to ripe, a
    leaf from pale to dark); spectra are tabulated along it and interpolated linearly between the rows, which
    lie at `linspace(0, 1, s)`. The rows come out of a pigment model: pigments are mixed, not spectra.

    Attributes:
        name: unique within a scene ("leaf", "fruit", "stem").
        wavelength_nm: `(n,)` increasing.
        reflectance: `(s, 2, n)` diffuse hemispherical reflectance of the body under the cuticle, as a share
            of the light that the cuticle lets in; axis 1 is the front side (the one the normal points out of)
            and the back side.
        transmittance: `(s, n)` diffuse hemispherical transmittance, likewise, equal both ways; 0 for opaque
            bodies. Reflectance and transmittance sum to at most 1.
        ior: refractive index of the cuticle; 1 means a surface without gloss.
        roughness: `(2,)` GGX alpha of the cuticle, front and back.
        pattern: `(h, w)` offset added to the state over uv (row 0 is v = 0), or None. Veins live here.
        relief_mm: `(h, w)` height over uv along the normal, for shading only, or None; the mesh's own
            extent of u and v makes slopes of it.
    """

    name: str
    wavelength_nm: NDArray[np.float64]
    reflectance: NDArray[np.float64]
    transmittance: NDArray[np.float64]
    ior: float = 1.0
    roughness: tuple[float, float] = (0.3, 0.3)
    pattern: NDArray[np.float32] | None = None
    relief_mm: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        n = self.wavelength_nm.size
        s = self.reflectance.shape[0]
        if self.reflectance.shape != (s, 2, n) or self.transmittance.shape != (s, n):
            raise ValueError(
                f"{self.name}: reflectance (s, 2, n) and transmittance (s, n) do not match n={n}"
            )
        total = self.reflectance + self.transmittance[:, None, :]
        # So asked, what is no number fails as well.
        if not (min(self.reflectance.min(), self.transmittance.min()) >= 0 and total.max() <= 1 + 1e-9):
            raise ValueError(f"{self.name}: reflectance and transmittance must be >= 0 and sum to at most 1")
        if not (1 <= self.ior < np.inf and all(0 <= alpha < np.inf for alpha in self.roughness)):
            raise ValueError(f"{self.name}: an index of at least 1 and roughness of at least 0 are needed")
        for image in (self.pattern, self.relief_mm):
            if image is not None and not np.isfinite(image).all():
                raise ValueError(f"{self.name}: pattern and relief must be finite")


def lambertian_surface(name: str, reflectance: float) -> Surface:
    """An ideal matt, opaque, grey surface; for test patches and reference cards."""
    nm = np.array([300.0, 1100.0])
    return Surface(name, nm, np.full((1, 2, 2), float(reflectance)), np.zeros((1, 2)))


Array = NDArray[np.float64]

TOLERANCE: Final = 0.002
"""Largest error of a spectrum between two rows: chosen, half a step of an 8-bit image."""
FEWEST, MOST = 9, 513
CHECKED_NM: Final = np.arange(400.0, 1001.0, 10.0)
"""Where the error is looked for: finer than any pigment's band, and the same whatever grid is asked for."""


def enough_states(spectra: Callable[[Array, Array], Array]) -> Array:
    """Even states in [0, 1] between which linear interpolation follows a model of pigments.

    The intervals are halved until the new rows lie within `TOLERANCE` of the mean of their neighbours.

    Args:
        spectra: (wavelengths `(n,)`, states `(s,)`) -> `(s, ...)`.
    """
    count = FEWEST
    rows = spectra(CHECKED_NM, np.linspace(0.0, 1.0, count))
    while count < MOST:
        finer = np.linspace(0.0, 1.0, 2 * count - 1)
        middles = spectra(CHECKED_NM, finer[1::2])
        if np.abs(middles - 0.5 * (rows[1:] + rows[:-1])).max() <= TOLERANCE:
            break
        known = rows
        rows = np.empty((finer.size, *known.shape[1:]))
        rows[::2], rows[1::2] = known, middles
        count = finer.size
    return np.linspace(0.0, 1.0, count)

"""What an instrument that leaves the mirror-like part out reads of a plant's surface.

Light from the direction i meets a cuticle of openness A(i) = 1 - E(i), whose cosine-weighted mean is a; the
body below sends back the share R. Towards o the surface has (docs/optics.md, "The cuticle")

    f_r = f_g + A(i) A(o) / a  R / pi,        f_g the gloss, of directional albedo E.

- *8/d*, an integrating sphere whose port lets the gloss escape: light comes in at 8 degrees, and what the
  body sends out is gathered from all directions. A(o) / a has the cosine-weighted mean 1, so the reading is
  A(8) R: (1 - g) R with g the gloss at nearly normal incidence, whatever leaves or returns inside. It is what
  a reflectance that includes the interface becomes when the gloss is taken off. By reciprocity a sphere that
  lights from all sides and looks at 8 degrees (d/8) reads the same.
- *45/0*, light at 45 degrees, seen along the normal and compared with a perfect diffuser: pi f_r. The body's
  part is A(45) A(0) / a R, 1.010 R under a smooth cuticle of index 1.45 and .994 R at a fruit's roughness of
  .1: some per cent above the sphere's .967 R, because what is lost at grazing angles is neither in the light
  nor in the view. A rough gloss reaches the detector too: pi f_g is .005 for such a fruit and .010 for a leaf
  (index 1.28, roughness .45). This instrument does not keep it out, so it counts.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials import leaf_body, rind_reflectance
from pepperscene.materials.gloss import fresnel, gloss_albedo, openness

if TYPE_CHECKING:
    from pepperscene.cultivar import PigmentPath

Array = NDArray[np.float64]
Instrument = Literal["8/d", "45/0"]

SPHERE_RAD: Final = np.radians(8.0)
"""Angle of incidence in an integrating sphere: CIE 15 and ISO 7724 have 8 degrees."""
BIDIRECTIONAL_RAD: Final = np.radians(45.0)


def read_reflectance(
    path: PigmentPath, wavelength_nm: ArrayLike, state: float, *, thin: bool, instrument: Instrument = "8/d"
) -> Array:
    """Reflectance `(n,)` that the instrument reads of a surface's front at a state in [0, 1].

    Args:
        path: its pigments, flesh and cuticle.
        wavelength_nm: `(n,)`, 400 to 1100 nm.
        state: along the path.
        thin: a blade or a petal with nothing behind it (PROSPECT's leaf); else a rind on its flesh.
        instrument: see above.

    Raises:
        ValueError: a wavelength lies beyond the pigments' coefficients.
    """
    nm, states = np.atleast_1d(np.asarray(wavelength_nm, dtype=float)), np.array([float(state)])
    mean_open = [openness(path.ior, alpha)[1] for alpha in path.roughness]
    if thin:
        above, _, through = leaf_body(path, nm, states)
        # What the back's cuticle cannot let out of the light that the front let in comes back.
        body = above + through * (1.0 - min(mean_open) / mean_open[0])
    else:
        body = rind_reflectance(path, nm, states)
    share, gloss = _geometry(path.ior, path.roughness[0], instrument)
    return np.asarray(gloss + share * body[0])


@functools.lru_cache(maxsize=256)
def _geometry(ior: float, alpha: float, instrument: Instrument) -> tuple[float, float]:
    """Share of the body's reflectance that is read, and what is read of the gloss."""
    if instrument == "8/d":
        return float(1.0 - gloss_albedo(np.cos(SPHERE_RAD), ior, alpha)[0]), 0.0
    incidence = np.cos(BIDIRECTIONAL_RAD)
    entering, leaving = 1.0 - gloss_albedo([incidence, 1.0], ior, alpha)
    share = entering * leaving / openness(ior, alpha)[1]
    return float(share), float(np.pi * gloss_along_normal(incidence, ior, alpha))


def gloss_along_normal(cosine: ArrayLike, ior: float, alpha: float) -> Array:
    """BRDF of the gloss alone, per steradian, from these directions to the normal: D F G1 / (4 cos).

    GGX with separable Smith masking (Walter et al. 2007, EGSR); along the normal nothing is masked.

    Args:
        cosine: of the angle of incidence, in (0, 1], any shape.
        ior: of the cuticle.
        alpha: its GGX roughness, above 0.
    """
    incident = np.asarray(cosine, dtype=float)
    half = np.sqrt((1.0 + incident) / 2.0)  # cosine of half the angle: to the normal and to the light alike
    density = alpha**2 / (np.pi * (1.0 + (alpha**2 - 1.0) * half**2) ** 2)
    unmasked = 2.0 * incident / (incident + np.sqrt(incident**2 + alpha**2 * (1.0 - incident**2)))
    return np.asarray(density * fresnel(half, ior) * unmasked / (4.0 * incident))

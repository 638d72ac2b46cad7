"""How much light a rough cuticle mirrors: the directional albedo of its gloss, tabulated for the kernel.

The gloss is the single-scattering lobe of a GGX surface (Walter et al. 2007, EGSR) with separable Smith
masking G = G1(i) G1(o) and the unpolarised Fresnel reflectance F at the half vector. Mirrored at normals h
that are drawn as they are visible from i (Heitz 2018, JCGT 7(4)), its albedo is the mean

    E(i) = < F(i . h) G1(o) [o_z > 0] >,        o = 2 (i . h) h - i,

which is below the mean of F: masked light and light sent below the horizon is lost to the lobe. What a
surface does with the rest, 1 - E, is the body's affair (`pepperscene.render.surface.optics`).
"""

from __future__ import annotations

import functools
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra.prospect import INCIDENCE_CONE_RAD

Array = NDArray[np.float64]

NODES: Final = 96
"""Entries of a table: interpolation errs by less than 4e-4 for every index in [1, 2.5] and alpha in
[0.001, 1]."""

NODE_SCALE: Final = 1e-3
"""Nodes lie evenly in log(1 + cosine / NODE_SCALE): chosen, the least alpha in use, for the albedo falls
from grazing over cosines of about alpha."""

_CAP_STEPS: Final = (48, 32)
"""Quadrature over visible normals, polar and azimuth: within 1e-4 of five times as many steps each way."""


def fresnel(cosine: ArrayLike, ior: float) -> Array:
    """Unpolarised reflectance of a smooth interface seen from the thinner side; 0 where `ior` is 1.

    Args:
        cosine: of the angle of incidence, in [0, 1], any shape.
        ior: relative index of refraction, at least 1.
    """
    c = np.asarray(cosine, dtype=float)
    if ior <= 1.0:
        return np.zeros_like(c)
    t = np.sqrt(ior**2 - 1.0 + c**2)  # ior times the cosine of refraction
    across = (c - t) / (c + t)
    along = (ior**2 * c - t) / (ior**2 * c + t)
    return np.asarray((across**2 + along**2) / 2.0)


def gloss_albedo(cosine: ArrayLike, ior: float, alpha: float, steps: tuple[int, int] = _CAP_STEPS) -> Array:
    """Share of the light from one direction that the gloss sends out, `(n,)`.

    Args:
        cosine: `(n,)` of the direction to the normal, in [0, 1].
        ior: of the cuticle; at 1 there is no gloss.
        alpha: GGX roughness; at 0 the result is the Fresnel reflectance.
        steps: of the quadrature, polar and azimuth.
    """
    z = np.atleast_1d(np.asarray(cosine, dtype=float))[:, None, None]
    x = np.sqrt(1.0 - z**2)

    # Seen by a surface stretched to alpha = 1, visible normals are halfway between the view and a direction
    # spread evenly over the cap z > -view_z of the sphere (Dupuy & Benyoub 2023, CGF 42(8)); half of the cap
    # will do, the other is its mirror image.
    length = np.hypot(alpha * x, z)
    flat = length == 0.0
    view_x = np.where(flat, 1.0, alpha * x) / np.where(flat, 1.0, length)
    view_z = z / np.where(flat, 1.0, length)
    place, weight = np.polynomial.legendre.leggauss(steps[0])
    widest = np.arccos(-view_z)
    polar = (place + 1.0) / 2.0 * widest
    weight = weight / 2.0 * widest * np.sin(polar) / (1.0 + view_z)
    azimuth = (np.arange(steps[1]) + 0.5)[:, None] / steps[1] * np.pi
    h_x = alpha * (np.sin(polar) * np.cos(azimuth) + view_x)
    h_y = alpha * np.sin(polar) * np.sin(azimuth)
    h_z = np.cos(polar) + view_z

    # Mirror the view at them; each carries its Fresnel reflectance and the masking on the way out.
    norm = np.sqrt(h_x**2 + h_y**2 + h_z**2)
    towards = np.clip((x * h_x + z * h_z) / norm, 0.0, 1.0)
    out = np.clip(2.0 * towards * h_z / norm - z, 0.0, 1.0)
    spread = out + np.sqrt(out**2 + alpha**2 * (1.0 - out**2))
    unmasked = np.where(spread > 0.0, 2.0 * out / np.where(spread > 0.0, spread, 1.0), 1.0)
    return np.asarray((fresnel(towards, ior) * unmasked * weight).sum(axis=-1).mean(axis=-1))


def node_cosines() -> Array:
    """`(NODES,)` cosines of the tables' entries, from grazing to normal."""
    return NODE_SCALE * np.expm1(np.linspace(0.0, 1.0, NODES) * np.log1p(1.0 / NODE_SCALE))


def interpolate_table(table: ArrayLike, cosine: ArrayLike) -> Array:
    """A table at any cosine, linear in the nodes' variable: what the kernel does."""
    place = np.log1p(np.asarray(cosine, dtype=float) / NODE_SCALE) / np.log1p(1.0 / NODE_SCALE)
    return np.interp(place * (NODES - 1), np.arange(NODES), np.asarray(table, dtype=float))


def cosine_mean(table: ArrayLike) -> float:
    """Cosine-weighted mean over the hemisphere of a table's interpolant, exact to rounding."""
    return float(_mean_weights() @ np.asarray(table, dtype=float))


@functools.lru_cache(maxsize=256)
def cuticle_transmittance(ior: float, alpha: float) -> tuple[Array, float]:
    """What a cuticle lets in: 1 - E at the nodes, `(NODES,)` read-only, and the mean of its interpolant.

    Args:
        ior: of the cuticle.
        alpha: its GGX roughness.
    """
    table = 1.0 - gloss_albedo(node_cosines(), ior, alpha)
    table.setflags(write=False)
    return table, cosine_mean(table)


@functools.lru_cache(maxsize=256)
def cone_gloss(ior: float, alpha: float) -> float:
    """Cosine-weighted mean of the gloss albedo over PROSPECT's cone of incidence.

    Args:
        ior: of the cuticle.
        alpha: its GGX roughness.
    """
    place, weight = np.polynomial.legendre.leggauss(16)
    sine_squared = (place + 1.0) / 2.0 * np.sin(INCIDENCE_CONE_RAD) ** 2
    return float(gloss_albedo(np.sqrt(1.0 - sine_squared), ior, alpha) @ weight / 2.0)


@functools.cache
def _mean_weights() -> Array:
    """`(NODES,)` integrals of 2 mu over the hat function of each node."""
    place, weight = np.polynomial.legendre.leggauss(8)
    within = (place + 1.0) / 2.0
    rate = np.log1p(1.0 / NODE_SCALE) / (NODES - 1)
    mu = NODE_SCALE * np.expm1(rate * (np.arange(NODES - 1)[:, None] + within))
    density = 2.0 * mu * rate * (mu + NODE_SCALE) * weight / 2.0
    weights = np.zeros(NODES)
    weights[:-1] += (density * (1.0 - within)).sum(axis=1)
    weights[1:] += (density * within).sum(axis=1)
    return weights

"""Directional albedo of the gloss of a rough cuticle, tabulated for the kernel.

The gloss is the single-scattering lobe of a GGX surface (Walter et al. 2007, EGSR) with separable Smith
masking G = G1(i) G1(o) and the unpolarised Fresnel reflectance F at the half vector. With half vectors h
sampled from the normals visible from i (Heitz 2018, JCGT 7(4)), its albedo is the mean

    E(i) = < F(i . h) G1(o) [o_z > 0] >,        o = 2 (i . h) h - i,

which is below the mean of F: the lobe loses light that is masked or reflected below the horizon. The rest,
1 - E, enters the body (`pepperscene.render.surface.optics`).
"""

from __future__ import annotations

import functools
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.spectra.prospect import INCIDENCE_CONE_RAD
from pepperscene.spectra.spectrum import FloatArray

TABLE_SIZE: Final = 96
"""Entries of a table: the interpolation error is below 4e-4 for every index in [1, 2.5] and alpha in
[0.001, 1]."""

TABLE_SCALE: Final = 1e-3
"""Nodes are evenly spaced in log(1 + cosine / NODE_SCALE): chosen, the least alpha in use, since near grazing
the albedo falls over cosines of about alpha."""

_CAP_STEPS: Final = (48, 32)
"""Quadrature over visible normals, polar and azimuth: within 1.4e-4 of five times as many steps each way for
indices up to 1.6, and 2e-4 up to 2.5, for every alpha from 0.001 on. Chosen: less than the interpolation."""


def fresnel(cosine: ArrayLike, ior: float) -> FloatArray:
    """Unpolarised reflectance of a smooth interface seen from the thinner side, by the cosine of incidence.

    It has the shape of the cosine; the relative index of refraction is at least 1, where it is 0.
    """
    c = np.asarray(cosine, dtype=float)
    if ior <= 1.0:
        return np.zeros_like(c)
    t = np.sqrt(ior**2 - 1.0 + c**2)  # ior times the cosine of refraction
    s_amplitude = (c - t) / (c + t)
    p_amplitude = (ior**2 * c - t) / (ior**2 * c + t)
    return np.asarray((s_amplitude**2 + p_amplitude**2) / 2.0)


def gloss_albedo(
    cosine: ArrayLike, ior: float, alpha: float, steps: tuple[int, int] = _CAP_STEPS
) -> FloatArray:
    """Fraction of the light from one direction that the gloss reflects, `(n,)`.

    `cosine` `(n,)` is that between the direction and the normal. With a GGX roughness `alpha` of 0 the result
    is the Fresnel reflectance. The quadrature has polar and azimuthal `steps`.
    """
    z = np.atleast_1d(np.asarray(cosine, dtype=float))[:, None, None]
    x = np.sqrt(1.0 - z**2)

    # On the surface stretched to alpha = 1, visible normals are halfway between the view and a direction
    # distributed uniformly over the cap z > -view_z of the sphere (Dupuy & Benyoub 2023, CGF 42(8)). By
    # symmetry, half of the cap is enough.
    length = np.hypot(alpha * x, z)
    flat = length == 0.0
    view_x = np.where(flat, 1.0, alpha * x) / np.where(flat, 1.0, length)
    view_z = z / np.where(flat, 1.0, length)
    node, weight = np.polynomial.legendre.leggauss(steps[0])
    widest = np.arccos(-view_z)
    polar = (node + 1.0) / 2.0 * widest
    weight = weight / 2.0 * widest * np.sin(polar) / (1.0 + view_z)
    azimuth = (np.arange(steps[1]) + 0.5)[:, None] / steps[1] * np.pi
    h_x = alpha * (np.sin(polar) * np.cos(azimuth) + view_x)
    h_y = alpha * np.sin(polar) * np.sin(azimuth)
    h_z = np.cos(polar) + view_z

    # Reflect the view at each normal, weighted by Fresnel reflectance and masking towards the outside.
    norm = np.sqrt(h_x**2 + h_y**2 + h_z**2)
    i_dot_h = np.clip((x * h_x + z * h_z) / norm, 0.0, 1.0)
    o_z = np.clip(2.0 * i_dot_h * h_z / norm - z, 0.0, 1.0)
    denominator = o_z + np.sqrt(o_z**2 + alpha**2 * (1.0 - o_z**2))
    masking = np.where(denominator > 0.0, 2.0 * o_z / np.where(denominator > 0.0, denominator, 1.0), 1.0)
    return np.asarray((fresnel(i_dot_h, ior) * masking * weight).sum(axis=-1).mean(axis=-1))


def node_cosines() -> FloatArray:
    """`(NODES,)` cosines of the tables' entries, from grazing to normal."""
    return TABLE_SCALE * np.expm1(np.linspace(0.0, 1.0, TABLE_SIZE) * np.log1p(1.0 / TABLE_SCALE))


def interpolate_table(table: ArrayLike, cosine: ArrayLike) -> FloatArray:
    """Interpolate a table at any cosine, linear in the nodes' variable, as the kernel does."""
    position = np.log1p(np.asarray(cosine, dtype=float) / TABLE_SCALE) / np.log1p(1.0 / TABLE_SCALE)
    return np.interp(position * (TABLE_SIZE - 1), np.arange(TABLE_SIZE), np.asarray(table, dtype=float))


@functools.lru_cache(maxsize=1024)
def cuticle_transmittance(
    ior: float, alpha: float, steps: tuple[int, int] = _CAP_STEPS
) -> tuple[FloatArray, float]:
    """Transmittance of a cuticle: 1 - E at the nodes, `(NODES,)` read-only, and its cosine-weighted mean."""
    table = 1.0 - gloss_albedo(node_cosines(), ior, alpha, steps)
    table.setflags(write=False)
    return table, float(_mean_weights() @ table)


BLUR_NODES: Final = 6
"""Slope variances of a filtered relief for which tables are made. Between them the error of a linear
interpolation is below 3e-3 for a roughness of 0.06 and below 5e-4 from 0.25 on."""

LARGEST_BLUR: Final = 0.36
"""Largest 2 s^2 of a filtered relief with the slope variance s^2 per axis; larger ones count as this. Chosen:
a root mean square of 23 degrees for each axis, above that of any relief that is shipped."""

_BLUR_STEPS: Final = (24, 16)
"""Steps of the quadrature for filtered reliefs: chosen; the error is below 6e-4 for indices up to 1.6
and every alpha."""


def blur_nodes(narrowest: float) -> FloatArray:
    """`(BLUR_NODES,)` values of 2 s^2, evenly spaced in log(1 + 2 s^2 / narrowest^2).

    The albedo is nearly linear in that variable, because the lobe's roughness is sqrt(alpha^2 + 2 s^2);
    `narrowest` is the smallest roughness of the surface's lobes.
    """
    nodes = np.linspace(0.0, np.log1p(LARGEST_BLUR / narrowest**2), BLUR_NODES)
    return np.asarray(narrowest**2 * np.expm1(nodes))


def blurred_transmittances(
    ior: float, alphas: tuple[float, float], wide_share: float, blurs: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Transmittances of a cuticle with two lobes: `(b, NODES)` at the nodes, and `(b,)` their means.

    The fraction `wide_share` has the second lobe; `blurs` are `(b,)` values of 2 s^2 of a filtered relief.
    """
    tables, means = np.zeros((len(blurs), TABLE_SIZE)), np.zeros(len(blurs))
    for alpha, share in zip(alphas, (1.0 - wide_share, wide_share), strict=True):
        if share == 0.0:
            continue
        for row, blur in enumerate(blurs.tolist()):
            steps = _BLUR_STEPS if blur else _CAP_STEPS
            table, mean = cuticle_transmittance(ior, float(np.hypot(alpha, np.sqrt(blur))), steps)
            tables[row] += share * table
            means[row] += share * mean
    return tables, means


@functools.lru_cache(maxsize=256)
def cone_gloss(ior: float, alpha: float) -> float:
    """Cosine-weighted mean of the gloss albedo over PROSPECT's cone of incidence."""
    node, weight = np.polynomial.legendre.leggauss(16)
    sine_squared = (node + 1.0) / 2.0 * np.sin(INCIDENCE_CONE_RAD) ** 2
    return float(gloss_albedo(np.sqrt(1.0 - sine_squared), ior, alpha) @ weight / 2.0)


@functools.cache
def _mean_weights() -> FloatArray:
    """`(NODES,)` integrals of 2 mu over the hat function of each node.

    A table times these weights is the cosine-weighted mean of its interpolant, exact to rounding.
    """
    node, weight = np.polynomial.legendre.leggauss(8)
    fraction = (node + 1.0) / 2.0
    rate = np.log1p(1.0 / TABLE_SCALE) / (TABLE_SIZE - 1)
    mu = TABLE_SCALE * np.expm1(rate * (np.arange(TABLE_SIZE - 1)[:, None] + fraction))
    density = 2.0 * mu * rate * (mu + TABLE_SCALE) * weight / 2.0
    weights = np.zeros(TABLE_SIZE)
    weights[:-1] += (density * (1.0 - fraction)).sum(axis=1)
    weights[1:] += (density * fraction).sum(axis=1)
    return weights

"""Light in a pile of plates: interfaces, one absorbing plate, and N of them.

Allen et al. 1969 (J. Opt. Soc. Am. 59:1376) gave the absorbing plate, Stern 1964 (Appl. Opt. 3:111) the
transmissivity of a rough interface, Stokes 1862 the pile of plates; Jacquemoud & Baret 1990 (Remote Sens.
Environ. 34:75) joined them into the leaf model PROSPECT, whose number of plates N need not be whole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

CONSERVATIVE = 1e-12
"""Below this absorptance of a plate the pile's formula is 0/0 and its limit is used: chosen, rounding."""


def cone_transmissivity(max_angle_rad: float, ior: ArrayLike) -> Array:
    """Mean transmissivity of an interface for unpolarised light within a cone of incidence angles.

    Stern 1964, as in Jacquemoud & Baret 1990: the Fresnel transmittance, averaged over the projected solid
    angle of a cone of half-angle `max_angle_rad` (pi/2: diffuse light) from air into a medium of index `ior`.
    """
    n = np.asarray(ior, dtype=float)
    sin2 = np.sin(max_angle_rad) ** 2
    n2 = n**2
    plus, minus = n2 + 1.0, n2 - 1.0
    # b is the lower and a the upper end of the substituted variable.
    a = (n + 1.0) ** 2 / 2.0
    k = -(minus**2) / 4.0
    centre = sin2 - plus / 2.0
    b = np.sqrt(np.maximum(centre**2 + k, 0.0)) - centre

    # Polarised across the plane of incidence.
    s = (k**2 / (6 * b**3) + k / b - b / 2) - (k**2 / (6 * a**3) + k / a - a / 2)
    # Polarised in the plane of incidence: Stern's five terms.
    p = (
        -2 * n2 * (b - a) / plus**2
        - 2 * n2 * plus * np.log(b / a) / minus**2
        + n2 * (1 / b - 1 / a) / 2
        + 16 * n2**2 * (n2**2 + 1) / (plus**3 * minus**2)
        * np.log((2 * plus * b - minus**2) / (2 * plus * a - minus**2))
        + 16 * n2**3 / plus**3 * (1 / (2 * plus * b - minus**2) - 1 / (2 * plus * a - minus**2))
    )  # fmt: skip
    return np.asarray((s + p) / (2.0 * sin2))


def slab_transmission(absorbance: ArrayLike) -> Array:
    """Transmission of diffuse light through a slab without interfaces: 2 E3(k) = (1-k) e^-k + k^2 E1(k)."""
    from scipy.special import exp1

    k = np.asarray(absorbance, dtype=float)
    safe = np.where(k > 0, k, 1.0)
    return np.where(k > 0, (1.0 - safe) * np.exp(-safe) + safe**2 * exp1(safe), 1.0)


def plate(absorbance: ArrayLike, ior: ArrayLike) -> tuple[Array, Array]:
    """Reflectance and transmittance of one plate in air under diffuse light (Allen et al. 1969)."""
    n = np.asarray(ior, dtype=float)
    into = cone_transmissivity(np.pi / 2, n)
    out = into / n**2
    back = 1.0 - out
    through = slab_transmission(absorbance)
    t = into * through * out / (1.0 - (back * through) ** 2)
    return 1.0 - into + back * through * t, t


def pile(r: ArrayLike, t: ArrayLike, count: ArrayLike) -> tuple[Array, Array]:
    """Reflectance and transmittance of `count` equal plates under diffuse light (Stokes 1862).

    Args:
        r: reflectance of one plate, in (0, 1).
        t: its transmittance, r + t <= 1.
        count: number of plates, a positive real; broadcasts against both.
    """
    r, t, count = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (r, t, count)))
    lossless = 1.0 - r - t < CONSERVATIVE
    # An opaque plate would make b infinite; 1e-30 is far below rounding of any result.
    r_safe, t_safe = np.where(lossless, 0.5, r), np.where(lossless, 0.3, np.maximum(t, 1e-30))

    delta = np.sqrt(
        (1 + r_safe + t_safe) * (1 + r_safe - t_safe) * (1 - r_safe + t_safe) * (1 - r_safe - t_safe)
    )
    a = (1 + r_safe**2 - t_safe**2 + delta) / (2 * r_safe)
    # In powers of 1/b, so that thick piles go to zero and not to infinity.
    inverse_b = 2 * t_safe / (1 - r_safe**2 + t_safe**2 + delta)
    fade = inverse_b**count
    whole = a**2 - fade**2
    lossy = a * (1 - fade**2) / whole, fade * (a**2 - 1) / whole

    # Without absorption the pile's transmittance falls as 1 / (1 + count r / t).
    clear = 1.0 / (1.0 + count * r / np.maximum(t, 1e-30))
    return np.where(lossless, 1.0 - clear, lossy[0]), np.where(lossless, clear, lossy[1])

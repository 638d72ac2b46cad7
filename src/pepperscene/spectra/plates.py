"""Light in a pile of plates: interfaces, one absorbing plate, and N of them.

Allen et al. 1969 (J. Opt. Soc. Am. 59:1376) gave the absorbing plate, Stern 1964 (Appl. Opt. 3:111) the
transmissivity of a rough interface, Stokes 1862 the pile of plates; Jacquemoud & Baret 1990 (Remote Sens.
Environ. 34:75) joined them into the leaf model PROSPECT, whose number of plates N need not be whole.

All functions take NumPy arrays or torch tensors and give the same back. They are written so that neither
values nor slopes lose digits where absorption vanishes, nothing gets through, or two media become one.
"""

from __future__ import annotations

import sys
from typing import Any, Final, TypeAlias

import numpy as np

Array: TypeAlias = Any
"""A NumPy array of float64, or a torch tensor of float64 wherever a tensor came in."""


def floats(*inputs: Array) -> tuple[Any, tuple[Array, ...]]:
    """The namespace (`numpy` or `torch`) of the inputs, and all of them as its float64 arrays.

    One tensor among the inputs makes all of them tensors on its device, differentiable as they were. Only the
    names that NumPy and torch share with one meaning may be taken from the namespace. torch is an optional
    package and is not imported here: whoever passes a tensor has done so.
    """
    torch = sys.modules.get("torch")
    tensors = [x for x in inputs if torch is not None and isinstance(x, torch.Tensor)]
    if torch is None or not tensors:
        return np, tuple(np.asarray(x, dtype=float) for x in inputs)
    device = tensors[0].device
    return torch, tuple(torch.as_tensor(x, dtype=torch.float64, device=device) for x in inputs)


def expn(order: int, x: Array) -> Array:
    """Exponential integral E_n(x) of x >= 0, by SciPy; E_n' = -E_(n-1) where a tensor asks for gradients."""
    if isinstance(x, (np.ndarray, np.floating)):
        from scipy.special import expn as scipy_expn

        return scipy_expn(order, x)
    from pepperscene.spectra.torch_integrals import ExponentialIntegral

    return ExponentialIntegral.apply(x, order)


OPAQUE: Final = 1000.0
"""Absorbance of a plate that lets nothing through: exp(-1000) is zero in double precision."""

FAINTEST: Final = 1e-120
"""Transmittance that counts as none: chosen, so that its inverse square is finite in double precision."""

SERIES_BELOW: Final = 1e-3
"""Argument below which power series stand for closed forms that are 0/0 at zero: chosen, so that what the
series cut off and what the closed forms' slopes lose are both about 1e-13."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


def cone_transmissivity(max_angle_rad: float, ior: Array) -> Array:
    """Mean transmissivity of an interface for unpolarised light within a cone of incidence angles.

    The Fresnel transmittance, averaged over the projected solid angle of a cone of half-angle `max_angle_rad`
    (pi/2: diffuse light) from air into a medium of index `ior` >= 1: what Stern 1964 gives in closed form,
    whose terms cancel to nothing for indices near 1. The quadrature's error is below 1e-9 for every index and
    rounding for all above 1.1.
    """
    xp, (n, nodes, weights) = floats(ior, _NODES, _WEIGHTS)
    n = n[..., None]
    # Gauss-Legendre in the root of the cosine: fine steps at grazing, where Fresnel's equations bend sharply.
    root, lowest = (nodes + 1.0) / 2.0, float(np.cos(max_angle_rad))
    cosine = lowest + (1.0 - lowest) * root**2
    refracted = xp.sqrt(n**2 - 1.0 + cosine**2) / n
    across = (cosine - n * refracted) / (cosine + n * refracted)
    within = (n * cosine - refracted) / (n * cosine + refracted)
    share = cosine * root * weights
    return 1.0 - ((across**2 + within**2) / 2.0 * share).sum(-1) / share.sum()


def slab_transmission(absorbance: Array) -> Array:
    """Transmission of diffuse light through a slab without interfaces: 2 E3(k), exponential integral."""
    xp, (k,) = floats(absorbance)
    return 2.0 * expn(3, xp.clip(k, None, OPAQUE))


def plate(absorbance: Array, ior: Array) -> tuple[Array, Array]:
    """Reflectance and transmittance of one plate in air under diffuse light (Allen et al. 1969)."""
    _, (k, n) = floats(absorbance, ior)
    into = cone_transmissivity(np.pi / 2, n)
    out = into / n**2
    back = 1.0 - out
    through = slab_transmission(k)
    t = into * through * out / (1.0 - (back * through) ** 2)
    return 1.0 - into + back * through * t, t


def pile(r: Array, t: Array, count: Array) -> tuple[Array, Array]:
    """Reflectance and transmittance of `count` equal plates under diffuse light (Stokes 1862).

    With d2 = (1+r+t) (1+r-t) (1-r+t) (1-r-t), sinh a = d / 2r and sinh b = d / 2t, N plates have
    R = sinh(N b) / sinh(a + N b) and T = sinh(a) / sinh(a + N b). All are odd in d, so that their ratios are
    smooth functions of d2; without absorption, d2 = 0 and R = N r / (t + N r).

    Args:
        r: reflectance of one plate, in (0, 1).
        t: its transmittance, r + t <= 1 but for rounding.
        count: number N of plates, a positive real; broadcasts against both.
    """
    xp, (r, t, count) = floats(r, t, count)
    t = xp.clip(t, FAINTEST, None)
    d2 = (1.0 + r + t) * (1.0 + r - t) * (1.0 - r + t) * (1.0 - r - t)
    # a and N b, both divided by d.
    a = _arcsinh_ratio(xp, d2 / (4.0 * r**2)) / (2.0 * r)
    nb = count * _arcsinh_ratio(xp, d2 / (4.0 * t**2)) / (2.0 * t)
    total = a + nb
    below = _log_sinh_ratio(xp, d2 * total**2)
    reflectance = nb / total * xp.exp(_log_sinh_ratio(xp, d2 * nb**2) - below)
    transmittance = a / total * xp.exp(_log_sinh_ratio(xp, d2 * a**2) - below)
    return reflectance, transmittance


def _arcsinh_ratio(xp: Any, y: Array) -> Array:
    """arcsinh(x) / x as a function of y = x^2."""
    small, near, x = _split(xp, y)
    series = 1.0 + near * (-1 / 6 + near * (3 / 40 + near * (-5 / 112 + near * 35 / 1152)))
    return xp.where(small, series, xp.arcsinh(x) / x)


def _log_sinh_ratio(xp: Any, y: Array) -> Array:
    """log(sinh(x) / x) as a function of y = x^2."""
    small, near, x = _split(xp, y)
    series = near * (1 / 6 + near * (-1 / 180 + near * (1 / 2835 - near / 37800)))
    return xp.where(small, series, x + xp.log1p(-xp.exp(-2.0 * x)) - xp.log(2.0 * x))


def _split(xp: Any, y: Array) -> tuple[Array, Array, Array]:
    """Whether the series serves, y for it, and the root of y for the closed form.

    Neither may meet what only the other can take: a slope that overflows times zero is not a number. Where
    nothing is absorbed, y may be rounded to below zero; in a thick pile that grows, and is held.
    """
    small = y < SERIES_BELOW
    near = xp.clip(xp.where(small, y, 0.0), -SERIES_BELOW, None)
    return small, near, xp.sqrt(xp.where(small, 1.0, y))

"""PROSPECT: reflectance and transmittance of a leaf from its structure and constituents.

The leaf is a pile of absorbing plates. Allen et al. 1969 (J. Opt. Soc. Am. 59:1376) gave the absorbing plate,
Stern 1964 (Appl. Opt. 3:111) the transmissivity of a rough interface, Stokes 1862 the pile of plates;
Jacquemoud & Baret 1990 (Remote Sens. Environ. 34:75) combined them into PROSPECT, whose number of plates N
need not be an integer. The formulas here are written so that no digits are lost where absorption vanishes,
nothing is transmitted, or two media have the same index.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra.files import read_spectra, read_spectrum
from pepperscene.spectra.spectrum import FloatArray, Spectrum

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

INCIDENCE_CONE_RAD: Final = np.radians(40.0)
"""Half-angle of the cone in which light meets the rough leaf surface (Jacquemoud & Baret 1990)."""

MEAN_LEAF: Final[Mapping[str, float]] = {
    "structure_n": 1.58,
    "chlorophyll_ug_cm2": 43.0,
    "carotenoid_ug_cm2": 10.5,
    "anthocyanin_ug_cm2": 1.3,
    "water_cm": 0.016,
    "dry_matter_g_cm2": 0.0035,
}
"""Arguments of `leaf_spectra` for an average leaf: the model inverted on the tomato leaves of LOPEX (Hosgood
et al. 1995); water and dry matter chosen as typical of thin leaves."""

OPAQUE: Final = 1000.0  # absorbance of an opaque plate: exp(-1000) is zero in double precision
FAINTEST: Final = 1e-120  # least transmittance: chosen, so that its inverse square is finite

SERIES_BELOW: Final = 1e-3
"""Argument below which power series replace closed forms that are 0/0 at zero: chosen, so that the truncation
error of the series and the rounding error of the closed forms' slopes are both about 1e-13."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclass(frozen=True, eq=False)
class LeafOptics:
    """Optical properties of a leaf, each `(..., n)`."""

    reflectance: FloatArray  # directional-hemispherical, including the gloss of the surface: PROSPECT's R
    transmittance: FloatArray  # directional-hemispherical: PROSPECT's T, equal from both sides
    diffuse_reflectance: FloatArray  # of the same pile of plates under diffuse light
    diffuse_transmittance: FloatArray  # likewise

    def under_gloss(self, gloss: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Reflectance and transmittance `(..., n)` of the body under a glossy surface.

        They are fractions of the light that enters through the surface, so that gloss g and body together
        give PROSPECT's values: R = g + (1 - g) R_body, T = (1 - g) T_body. Clipped at 0: where pigments
        absorb all the rest, a cuticle of a higher index than the tissue's (1.43 to 1.52) alone exceeds R.

        Args:
            gloss: fraction of the light in PROSPECT's cone of incidence that the surface reflects, in
                [0, 1); broadcasts to `(...)`, one per leaf.
        """
        entering = 1.0 - np.asarray(gloss, dtype=float)[..., None]
        body = np.clip(1.0 - (1.0 - self.reflectance) / entering, 0.0, 1.0)
        return body, np.minimum(self.transmittance / entering, 1.0 - body)


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
        wavelength_nm: `(n,)` up to 2500 nm; below 400 nm the coefficients of 400 nm apply.
        structure_n: N, number of plates, >= 1. This and all that follow broadcast to `(...)`, one per leaf.
        chlorophyll_ug_cm2: a and b, per leaf area, as all contents.
        carotenoid_ug_cm2: carotenoids of green leaves.
        anthocyanin_ug_cm2: anthocyanins.
        capsanthin_ug_cm2: the red carotenoid of peppers (a MODEL coefficient; not part of PROSPECT).
        brown: brown pigments, relative.
        water_cm: equivalent water thickness.
        dry_matter_g_cm2: total dry matter (PROSPECT-D).
        protein_g_cm2: its nitrogen-based part (PROSPECT-PRO).
        carbon_g_cm2: its carbon-based part (PROSPECT-PRO).

    Raises:
        ValueError: N < 1, a content is negative or infinite, or dry matter is given both ways.
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
    # Constituents and plates of each leaf get a last axis for the wavelengths.
    specific = absorption_coefficients(wavelength_nm)
    ior = specific["refractive_index"]
    plates = np.asarray(structure_n, dtype=float)[..., None]
    amounts = {name: np.asarray(value, dtype=float)[..., None] for name, value in contents.items()}
    _check_leaf(plates, amounts)

    # The constituents are spread evenly over the plates.
    with np.errstate(over="ignore"):
        absorbance = sum(amount * specific[name] for name, amount in amounts.items()) / plates
    diffuse_r, diffuse_t = pile(*plate(absorbance, ior), plates)

    # Light in a cone enters more easily than diffuse light; below the interface both are diffuse.
    into_cone = cone_transmissivity(INCIDENCE_CONE_RAD, ior)
    into_diffuse = cone_transmissivity(np.pi / 2, ior)
    ratio = into_cone / into_diffuse
    reflectance = 1.0 - into_cone + ratio * (diffuse_r - (1.0 - into_diffuse))
    return LeafOptics(reflectance, ratio * diffuse_t, diffuse_r, diffuse_t)


def _check_leaf(plates: FloatArray, amounts: Mapping[str, FloatArray]) -> None:
    """Raise ValueError for impossible contents; comparisons with NaN are false."""
    possible = all(((x >= 0.0) & (x < np.inf)).all() for x in amounts.values())
    if not (possible and ((plates >= 1.0) & (plates < np.inf)).all()):
        raise ValueError("a leaf has at least one plate and no negative or infinite contents")
    total, *parts = (bool((amounts[x] > 0.0).any()) for x in ("dry_matter", "protein", "carbon"))
    if total and any(parts):
        raise ValueError("dry matter is given either in total or as protein and carbon, not both")


def layer_over_body(layer: LeafOptics, body_reflectance: ArrayLike) -> LeafOptics:
    """Pigmented layer on a diffuse, opaque body, such as skin on flesh.

    Light that passes the layer bounces between body and layer (a geometric series):
    R = R_layer + T T_diffuse rho / (1 - R_diffuse rho). The body's rho, in [0, 1), broadcasts to `(..., n)`.
    """
    rho = np.asarray(body_reflectance, dtype=float)
    returned = layer.diffuse_transmittance * rho / (1.0 - layer.diffuse_reflectance * rho)
    opaque = np.zeros_like(layer.transmittance)
    return LeafOptics(
        layer.reflectance + layer.transmittance * returned,
        opaque,
        layer.diffuse_reflectance + layer.diffuse_transmittance * returned,
        opaque,
    )


def absorption_coefficients(wavelength_nm: ArrayLike) -> Mapping[str, FloatArray]:
    """Specific absorption coefficients and the refractive index of leaf tissue, each `(n,)`, by constituent.

    chlorophyll (a + b), carotenoid, anthocyanin and capsanthin in cm2 ug-1; brown (relative); water in cm-1;
    dry_matter, protein and carbon (carbon-based constituents) in cm2 g-1; refractive_index.

    From PROSPECT-D/PRO (Feret et al. 2017, 2021). The tables start at 400 nm; below, the value at 400 nm is
    used, because none was measured there.

    Capsanthin is a MODEL, PROSPECT's carotenoid shifted to the red, with its maximum at 482 nm and zero
    beyond its table's 800 nm. It represents all red carotenoids of ripe fruit: in the tissue their bands are
    further to the red than in solvents. A model with its maximum at 470 nm makes no red pepper: CIELAB hue
    44 degrees, where ripe ones have 30 (Molinari et al. 1999, Proc. Fla. State Hort. Soc. 112:143).

    Raises:
        ValueError: a wavelength is greater than 2500 nm.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    # Cached, since surfaces consist of many leaves on few wavelength grids; copied, since arrays can change.
    return {name: values.copy() for name, values in _coefficients_on_grid(tuple(nm.tolist())).items()}


@lru_cache(maxsize=8)
def _coefficients_on_grid(wavelength_nm: tuple[float, ...]) -> Mapping[str, FloatArray]:
    nm, table = np.array(wavelength_nm), _read_coefficients()
    first, last = table["chlorophyll"].range_nm
    if nm.max() > last:
        raise ValueError(f"{nm.max():g} nm is greater than the coefficients' last wavelength, {last:g} nm")
    nm = np.maximum(nm, first)
    return {name: spectrum.at(nm) for name, spectrum in table.items()}


@lru_cache(maxsize=1)
def _read_coefficients() -> Mapping[str, Spectrum]:
    leaf = read_spectra("leaf/prospect_pro_sac_400_2500", outside="error")
    # Of the two models in the file, the one with its maximum at 482 nm; see `absorption_coefficients`.
    capsanthin = read_spectrum("fruit/pepper_pigment_sac_MODEL", "capsorubin_MODEL")
    return {name: leaf[column] for name, column in _COLUMNS.items()} | {"capsanthin": capsanthin}


def cone_transmissivity(max_angle_rad: float, ior: ArrayLike) -> FloatArray:
    """Mean transmissivity of an interface for unpolarised light within a cone of incidence angles.

    The Fresnel transmittance, averaged over the projected solid angle of a cone of half-angle `max_angle_rad`
    (pi/2: diffuse light) from air into a medium of index `ior` >= 1. Stern 1964 has a closed form, whose
    terms cancel for indices near 1. The quadrature's error is below 1e-9 for every index and at the level of
    rounding for all above 1.1.
    """
    n = np.asarray(ior, dtype=float)[..., None]
    # Gauss-Legendre in the root of the cosine: fine steps at grazing angles, where it is steep.
    root, lowest = (_NODES + 1.0) / 2.0, float(np.cos(max_angle_rad))
    cosine = lowest + (1.0 - lowest) * root**2
    refracted = np.sqrt(n**2 - 1.0 + cosine**2) / n
    s_amplitude = (cosine - n * refracted) / (cosine + n * refracted)
    p_amplitude = (n * cosine - refracted) / (n * cosine + refracted)
    weight = cosine * root * _WEIGHTS
    return np.asarray(1.0 - ((s_amplitude**2 + p_amplitude**2) / 2.0 * weight).sum(-1) / weight.sum())


def slab_transmission(absorbance: ArrayLike) -> FloatArray:
    """Transmission of diffuse light through a slab without interfaces: 2 E3(k), exponential integral."""
    from scipy.special import expn

    return np.asarray(2.0 * expn(3, np.clip(np.asarray(absorbance, dtype=float), None, OPAQUE)))


def plate(absorbance: ArrayLike, ior: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Reflectance and transmittance of one plate in air under diffuse light (Allen et al. 1969)."""
    n = np.asarray(ior, dtype=float)
    into = cone_transmissivity(np.pi / 2, n)
    out = into / n**2
    back = 1.0 - out
    through = slab_transmission(absorbance)
    t = into * through * out / (1.0 - (back * through) ** 2)
    return 1.0 - into + back * through * t, t


def pile(r: FloatArray, t: FloatArray, count: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Reflectance and transmittance of `count` equal plates under diffuse light (Stokes 1862).

    With d2 = (1+r+t) (1+r-t) (1-r+t) (1-r-t), sinh a = d / 2r and sinh b = d / 2t, N plates have
    R = sinh(N b) / sinh(a + N b) and T = sinh(a) / sinh(a + N b). All are odd in d, so their ratios are
    smooth functions of d2; without absorption, d2 = 0 and R = N r / (t + N r).

    Args:
        r: reflectance of one plate, in (0, 1).
        t: its transmittance, r + t <= 1 except for rounding.
        count: number N of plates, a positive real; broadcasts against both.
    """
    t = np.clip(t, FAINTEST, None)
    d2 = (1.0 + r + t) * (1.0 + r - t) * (1.0 - r + t) * (1.0 - r - t)
    # a and N b, both divided by d.
    a = _arcsinh_ratio(d2 / (4.0 * r**2)) / (2.0 * r)
    nb = count * _arcsinh_ratio(d2 / (4.0 * t**2)) / (2.0 * t)
    total = a + nb
    log_total = _log_sinh_ratio(d2 * total**2)
    reflectance = nb / total * np.exp(_log_sinh_ratio(d2 * nb**2) - log_total)
    transmittance = a / total * np.exp(_log_sinh_ratio(d2 * a**2) - log_total)
    return reflectance, transmittance


def _arcsinh_ratio(y: FloatArray) -> FloatArray:
    """arcsinh(x) / x as a function of y = x^2."""
    is_small, small_y, x = _split_at_series(y)
    series = 1.0 + small_y * (-1 / 6 + small_y * (3 / 40 + small_y * (-5 / 112 + small_y * 35 / 1152)))
    return np.where(is_small, series, np.arcsinh(x) / x)


def _log_sinh_ratio(y: FloatArray) -> FloatArray:
    """log(sinh(x) / x) as a function of y = x^2."""
    is_small, small_y, x = _split_at_series(y)
    series = small_y * (1 / 6 + small_y * (-1 / 180 + small_y * (1 / 2835 - small_y / 37800)))
    return np.where(is_small, series, x + np.log1p(-np.exp(-2.0 * x)) - np.log(2.0 * x))


def _split_at_series(y: FloatArray) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    """Mask where the series applies, y for the series, and the root of y for the closed form.

    Where nothing is absorbed, rounding may make y negative; a thick pile amplifies that, so it is clipped.
    """
    is_small = y < SERIES_BELOW
    small_y = np.clip(np.where(is_small, y, 0.0), -SERIES_BELOW, None)
    return is_small, small_y, np.sqrt(np.where(is_small, 1.0, y))

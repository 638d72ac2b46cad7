"""Measured reflectance spectra and the model's prediction of them, without rendering.

Light from the direction i meets a cuticle of openness A(i) = 1 - E(i), whose cosine-weighted mean is a; the
body below reflects the fraction R. Towards o the surface has (docs/explanation/optics.md, "The cuticle")

    f_r = f_g + A(i) A(o) / a  R / pi,        f_g the gloss, of directional albedo E.

The instrument is an integrating sphere with a gloss trap (8/d): light comes in at 8 degrees, and what the
body reflects is gathered from all directions. A(o) / a has the cosine-weighted mean 1, so the reading is
A(8) R = (1 - g) R, with g the gloss at nearly normal incidence. This is what a reflectance that includes the
interface becomes when the gloss is subtracted. By reciprocity a d/8 instrument reads the same.

The trap is modelled as taking the whole narrow lobe, but nothing of a second, wide one: that lobe scatters
into all directions (of roughness .8, less than 1 % of it is within 8 degrees of the mirror's direction) and
counts in the reading.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import OrganClass
from pepperscene.colour import MeasuredSpectrum
from pepperscene.cultivar import Cultivar, PigmentPath
from pepperscene.errors import InputError
from pepperscene.materials import leaf_body, rind_reflectance
from pepperscene.materials.gloss import gloss_albedo
from pepperscene.materials.leaf import gloss_lobes, mean_openness
from pepperscene.tuning.tuned import TunedParts
from pepperscene.tuning.view_model import Entry, Values

Array = NDArray[np.float64]
SPHERE_RAD: Final = np.radians(8.0)  # angle of incidence in an integrating sphere (CIE 15, ISO 7724)
RANGE_NM: Final = (400.0, 730.0)
"""Wavelengths that are compared. PROSPECT's pigments are known from 400 nm on. Beyond 730 nm, where the
shipped measurements of fruit end too, only water and dry matter absorb, which are not fitted."""
MODEL_ERROR: Final = 0.01
"""Standard deviation of the model's own error at one wavelength, in reflectance: 0.010 is the RMSE of a layer
on flesh that was fitted to the measured green pepper, 0.014 the median of PROSPECT's fits to twelve shipped
leaves (Vrhel et al. 1994). The noise of an instrument is small compared with it."""
CORRELATION_NM: Final = 30.0
"""Distance at which the model's errors are independent: the integral of the autocorrelation of the residuals
of those fits, up to its first zero, has a median of 28 nm. Finer sampling adds no information."""
FORMS: Final[Mapping[OrganClass, str]] = {
    OrganClass.LEAF: "blade",
    OrganClass.PEPPER: "fruit",
    OrganClass.PEDUNCLE: "peduncle",
    OrganClass.STEM: "internode",
    OrganClass.SHOOT: "stalk",
}
"""Form of the organs that are measured for a class with several: a peduncle and not its calyx, an internode
and not a node. For plants without that form, the first kind of the class."""
STAGES: Final = ("unripe", "breaker", "ripe")
"""Stages of fruit; also the names of the distributions of their states. Other organs have one, `state`."""
THIN: Final = ("blade", "flower")  # forms that transmit light; all others are a rind on flesh
STEP: Final = 2e-3
"""Finite-difference step in prior standard deviations. Chosen, so that truncation (of the order of its fourth
power) and rounding are both far below 1e-9 of the slope."""


def instrument_reflectance(path: PigmentPath, wavelength_nm: ArrayLike, state: float, *, thin: bool) -> Array:
    """Reflectance `(n,)` that an integrating sphere reads of the front of a surface, 400 to 1100 nm.

    A thin one is a blade or petal with nothing behind it (PROSPECT's leaf), others are a rind on flesh.
    """
    nm, states = np.atleast_1d(np.asarray(wavelength_nm, dtype=float)), np.array([float(state)])
    if thin:
        mean_open = [mean_openness(path, side) for side in (0, 1)]
        reflected, _, transmitted = leaf_body(path, nm, states)
        # Light that entered through the front and cannot leave through the cuticle of the back returns.
        body = reflected + transmitted * (1.0 - min(mean_open) / mean_open[0])
    else:
        body = rind_reflectance(path, nm, states)
    lobes = [(share, _sphere_transmittance(path.ior, alpha)) for share, alpha in gloss_lobes(path, 0)]
    entering = sum(share * entered for share, entered in lobes)
    not_trapped = sum(share * (1.0 - entered) for share, entered in lobes[1:])
    return np.asarray(entering * body[0] + not_trapped)


@functools.lru_cache(maxsize=256)
def _sphere_transmittance(ior: float, alpha: float) -> float:
    """Fraction of the body's reflectance that the sphere reads through a lobe of the cuticle."""
    return float(1.0 - gloss_albedo(np.cos(SPHERE_RAD), ior, alpha)[0])


@dataclass(frozen=True)
class MeasuredSurface:
    """The surface of a plant that a measured spectrum belongs to."""

    surface: str  # name of the surface
    state: float  # state along its path: the mean of the distribution of the organ's states
    thin: bool  # whether it is a blade or petal, seen from above with nothing behind it


def surface_of_kind(cultivar: Cultivar, kind: str) -> MeasuredSurface:
    """Return the surface of a cultivar that a kind of spectra belongs to ("leaf", "pepper.unripe").

    Raises:
        InputError: The plants have no such organ, or the organ has no such stage.
    """
    name, _, stage = kind.partition(".")
    classes = {organ_class.name.lower(): organ_class for organ_class in OrganClass}
    kinds, grown = cultivar.kinds, cultivar.present_kinds
    present = {kinds[organ].organ_class for organ in grown if kinds[organ].surface in cultivar.pigments}
    where = f"cultivar {cultivar.name}"
    if name not in classes or classes[name] not in present:
        allowed = ", ".join(
            organ_class.name.lower() for organ_class in sorted(present - {OrganClass.BACKGROUND})
        )
        raise InputError(where, f"must be one of {allowed}", key="kind", value=kind)

    # The usual form of the class, or the first kind that the plants have.
    of_class = [
        organ for organ in grown if kinds[organ].organ_class == classes[name] and organ in cultivar.organs
    ]
    usual = [organ for organ in of_class if kinds[organ].form == FORMS.get(classes[name])]
    selected = (usual or of_class)[0]

    # Fruit has a distribution of states for each of its stages, other organs have one.
    distributions = cultivar.organs[selected].distributions
    key = stage or "state"
    if key not in distributions or key not in (*STAGES, "state"):
        stages = [f"{name}.{ripe}" for ripe in STAGES if ripe in distributions] or [name]
        raise InputError(where, f"must be one of {', '.join(stages)}", key="kind", value=kind)
    surface = kinds[selected].surface
    forms = {organ_kind.form for organ_kind in kinds.values() if organ_kind.surface == surface}
    return MeasuredSurface(surface, distributions[key].mean, bool(forms & set(THIN)))


@dataclass(frozen=True, eq=False)
class DirectModel:
    """Measured spectra, and their prediction from pigments at a fit's values."""

    spectra: tuple[MeasuredSpectrum, ...]
    surfaces: tuple[MeasuredSurface, ...]  # of each spectrum
    wavelength_nm: tuple[Array, ...]  # (n,) of each spectrum, within `RANGE_NM`
    cultivar: Cultivar  # has the paths of surfaces that the fit does not change
    tuned_parts: Callable[[Values], TunedParts]  # the recipe's parts at values; its pigment paths are used

    @classmethod
    def of(
        cls,
        spectra: Sequence[MeasuredSpectrum],
        cultivar: Cultivar,
        tuned_parts: Callable[[Values], TunedParts],
    ) -> Self:
        """Return the model of some spectra.

        Raises:
            InputError: The cultivar has no organ of a spectrum's kind, or a spectrum has fewer than two
                wavelengths within `RANGE_NM`.
        """
        low, high = RANGE_NM
        wavelengths = []
        for measurement in spectra:
            nm = measurement.spectrum.wavelength_nm
            inside = nm[(nm >= low) & (nm <= high)]
            if inside.size < 2:
                problem = f"must have at least two values from {low:g} to {high:g} nm"
                raise InputError(f"spectrum {measurement.name}", problem, key="wavelength_nm")
            wavelengths.append(inside)
        surfaces = tuple(surface_of_kind(cultivar, measurement.kind) for measurement in spectra)
        return cls(tuple(spectra), surfaces, tuple(wavelengths), cultivar, tuned_parts)

    @property
    def measured(self) -> Array:
        """`(m,)` measured reflectances of all spectra, concatenated."""
        pairs = zip(self.spectra, self.wavelength_nm, strict=True)
        return np.concatenate([np.empty(0), *(measurement.spectrum.at(nm) for measurement, nm in pairs)])

    @property
    def sd(self) -> Array:
        """`(m,)` standard deviations of the residuals, from the model's own error.

        Errors are correlated over `CORRELATION_NM`: with k values in that interval, each counts as a k-th of
        a value, so its variance is k times that of the error. Finer sampling adds no weight.
        """
        parts = [np.empty(0)]
        for nm in self.wavelength_nm:
            spacing = np.gradient(nm)
            parts.append(MODEL_ERROR * np.sqrt(np.maximum(1.0, CORRELATION_NM / spacing)))
        return np.concatenate(parts)

    @property
    def independent(self) -> float:
        """Number of independent data in the `(m,)` residuals: the expected sum of their squares."""
        return float(((MODEL_ERROR / self.sd) ** 2).sum())

    @property
    def parts(self) -> Mapping[str, slice]:
        """Slice of the `(m,)` values of each spectrum, by name."""
        ends = np.cumsum([0, *(nm.size for nm in self.wavelength_nm)]).tolist()
        pairs = zip(self.spectra, pairwise(ends), strict=True)
        return {measurement.name: slice(first, end) for measurement, (first, end) in pairs}

    def predicted(self, values: Values) -> Array:
        """`(m,)` reflectances that the instrument would read at these values."""
        paths = self.tuned_parts(values).pigments
        spectra = [np.empty(0)]
        for surface, nm in zip(self.surfaces, self.wavelength_nm, strict=True):
            path = paths.get(surface.surface, self.cultivar.pigments[surface.surface])
            spectra.append(instrument_reflectance(path, nm, surface.state, thin=surface.thin))
        return np.concatenate(spectra)

    def residuals(self, values: Values) -> Array:
        """`(m,)` predicted minus measured reflectance, in standard deviations."""
        return (self.predicted(values) - self.measured) / self.sd

    def jacobian(self, values: Values, entries: Sequence[Entry]) -> Array:
        """`(m, p)` derivatives of `residuals` with respect to entries of the parameters.

        Finite differences of fourth order (five points), all of them within the entry's bounds: central, or
        one-sided near a bound. The functions are smooth, so that the relative error is 1e-9; for
        `roughness`, because the albedo of the gloss is a quadrature, some 1e-3, and 2e-2 at a value of 0.1.
        """
        columns = [self._derivative(values, entry) / self.sd for entry in entries]
        return np.stack(columns, axis=1) if columns else np.empty((self.sd.size, 0))

    def _derivative(self, values: Values, entry: Entry) -> Array:
        """`(m,)` derivative of `predicted` with respect to one entry."""
        value, prior = entry.value(values), entry.prior
        step, derivative = STEP * prior.sd, np.zeros(self.sd.size)
        # Light and camera do not change a reflectance, and a fixed entry has no derivative.
        if step > 0.0 and entry.parameter.group in ("pigments", "cuticle"):
            offsets, weights = _stencil(value - prior.low, prior.high - value, step)
            for offset, weight in zip(offsets, weights, strict=True):
                derivative += weight / step * self.predicted(entry.with_step(values, offset * step))
        return derivative


def _stencil(below: float, above: float, step: float) -> tuple[Array, Array]:
    """Offsets in steps, and weights, of a five-point first derivative with this much space to either side."""
    if min(below, above) >= 2.0 * step:
        return np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
    one_sided = np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) / 12.0
    sign = 1.0 if above >= below else -1.0
    return sign * np.arange(5.0), sign * one_sided

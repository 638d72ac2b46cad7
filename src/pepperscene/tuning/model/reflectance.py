"""What an instrument that leaves the mirror-like part out reads of a plant's surface.

Light from the direction i meets a cuticle of openness A(i) = 1 - E(i), whose cosine-weighted mean is a; the
body below sends back the share R. Towards o the surface has (docs/explanation/optics.md, "The cuticle")

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import OrganClass
from pepperscene.errors import InputError
from pepperscene.materials import leaf_body, rind_reflectance
from pepperscene.materials.gloss import cuticle_transmittance, fresnel, gloss_albedo

if TYPE_CHECKING:
    from pepperscene.colour import MeasuredSpectrum
    from pepperscene.cultivar import Cultivar, PigmentPath
    from pepperscene.tuning.model.view_model import Entry
    from pepperscene.tuning.parameters.tuned import TunedParts


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
    mean_open = [cuticle_transmittance(path.ior, alpha)[1] for alpha in path.roughness]
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
    share = entering * leaving / cuticle_transmittance(ior, alpha)[1]
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


Values = Mapping[str, Array]

RANGE_NM: Final = (400.0, 730.0)
"""Where spectra are compared: PROSPECT's pigments are known from 400 nm on, and beyond 730 nm, where the
measurements of fruit that ship end too, they no longer absorb: what is left there is water and dry matter,
which no fit changes."""
MODEL_ERROR: Final = 0.01
"""Standard deviation of what the model itself errs by at one wavelength, in reflectance: .010 is the RMSE of
a layer on flesh that was fitted to the measured green pepper, .011 the median of PROSPECT's fits to twelve
shipped leaves (Vrhel et al. 1994). An instrument's noise is small beside it."""
CORRELATION_NM: Final = 30.0
"""How far apart the model's errors are independent: the integral of the autocorrelation of what those fits
leave over, up to its first zero, is 28 nm in the median. Sampling a spectrum more finely says no more."""

FORMS: Final[Mapping[OrganClass, str]] = {
    OrganClass.LEAF: "blade",
    OrganClass.PEPPER: "fruit",
    OrganClass.PEDUNCLE: "peduncle",
    OrganClass.STEM: "internode",
    OrganClass.SHOOT: "stalk",
}
"""Which organs of a class are measured, where a plant has several: a peduncle and not its calyx, an internode
and not a node. A class whose plants lack that form is shown by the first kind that it has."""
STAGES: Final = ("unripe", "breaker", "ripe")
"""The stages of a fruit, which are the names of its laws; of all else the law is called `state`."""
THIN: Final = ("blade", "flower")
"""Forms that light passes through; all others are a rind on its flesh."""


STEP: Final = 2e-3
"""Step of the differences as a share of the bounds' standard deviation: chosen, so that what is cut off (of
the order of its fourth power) and what rounding takes are both far below 1e-9 of the slope."""


@dataclass(frozen=True)
class ShownSurface:
    """What of a plant a measured spectrum shows.

    Attributes:
        surface: whose pigments.
        state: along their path, the mean of the law that the organ's state is drawn from.
        thin: a blade or a petal, seen from above with nothing behind it.
    """

    surface: str
    state: float
    thin: bool


def shown(cultivar: Cultivar, kind: str) -> ShownSurface:
    """The surface and the state that a kind of spectrum stands for.

    Args:
        cultivar: whose plants.
        kind: a class in lower case ("leaf", "stem"), for fruit with its stage ("pepper.unripe").

    Raises:
        InputError: the plants have no such organ, or the stage is none of the organ's.
    """
    name, _, stage = kind.partition(".")
    classes = {one.name.lower(): one for one in OrganClass}
    kinds, grown = cultivar.kinds, cultivar.grown
    having = {kinds[one].organ_class for one in grown if kinds[one].surface in cultivar.pigments}
    if name not in classes or classes[name] not in having:
        allowed = ", ".join(one.name.lower() for one in sorted(having - {OrganClass.BACKGROUND}))
        raise InputError(f"cultivar {cultivar.name}", f"must be one of {allowed}", key="kind", value=kind)

    # The usual organ of the class, or the first of those that it has.
    of_class = [one for one in grown if kinds[one].organ_class == classes[name] and one in cultivar.organs]
    usual = [one for one in of_class if kinds[one].form == FORMS.get(classes[name])]
    chosen = (usual or of_class)[0]

    # Fruit has a law for each of its stages, all else one.
    laws = cultivar.organs[chosen].distributions
    law = stage or "state"
    if law not in laws or law not in (*STAGES, "state"):
        stages = [f"{name}.{one}" for one in STAGES if one in laws] or [name]
        raise InputError(
            f"cultivar {cultivar.name}", f"must be one of {', '.join(stages)}", key="kind", value=kind
        )
    surface = kinds[chosen].surface
    forms = {one.form for one in kinds.values() if one.surface == surface}
    return ShownSurface(surface, laws[law].mean, bool(forms & set(THIN)))


@dataclass(frozen=True, eq=False)
class DirectModel:
    """Measured spectra, and what the pigments at a fit's values make of them.

    Attributes:
        spectra: measured reflectances.
        shown: what each of them shows.
        wavelength_nm: `(n,)` of each, its own within `RANGE_NM`.
        cultivar: whose paths hold for the surfaces that the fit does not change.
        tuned: the recipe's parts at some values, of which the pigment paths are used.
        instrument: that read the spectra.
    """

    spectra: tuple[MeasuredSpectrum, ...]
    shown: tuple[ShownSurface, ...]
    wavelength_nm: tuple[Array, ...]
    cultivar: Cultivar
    tuned: Callable[[Values], TunedParts]
    instrument: Instrument = "8/d"

    @classmethod
    def of(
        cls,
        spectra: Sequence[MeasuredSpectrum],
        cultivar: Cultivar,
        tuned: Callable[[Values], TunedParts],
        instrument: Instrument = "8/d",
    ) -> Self:
        """The model of these spectra.

        Raises:
            InputError: the cultivar has no organ of a spectrum's kind, or a spectrum has fewer than two
                wavelengths within `RANGE_NM`.
        """
        low, high = RANGE_NM
        wavelengths = []
        for one in spectra:
            nm = one.spectrum.wavelength_nm
            inside = nm[(nm >= low) & (nm <= high)]
            if inside.size < 2:
                where = f"must have at least two values from {low:g} to {high:g} nm"
                raise InputError(f"spectrum {one.name}", where, key="wavelength_nm")
            wavelengths.append(inside)
        seen = tuple(shown(cultivar, one.kind) for one in spectra)
        return cls(tuple(spectra), seen, tuple(wavelengths), cultivar, tuned, instrument)

    @property
    def measured(self) -> Array:
        """`(m,)` reflectances of all spectra, one after the other."""
        pairs = zip(self.spectra, self.wavelength_nm, strict=True)
        return np.concatenate([np.empty(0), *(one.spectrum.at(nm) for one, nm in pairs)])

    @property
    def sd(self) -> Array:
        """`(m,)` standard deviation that a difference has to be seen against: the model's own error.

        Errors are alike over `CORRELATION_NM`: of k values within it, each counts as a k-th of one, its
        variance being k times the error's. So finer sampling adds no weight.
        """
        found = [np.empty(0)]
        for nm in self.wavelength_nm:
            spacing = np.gradient(nm)
            found.append(MODEL_ERROR * np.sqrt(np.maximum(1.0, CORRELATION_NM / spacing)))
        return np.concatenate(found)

    @property
    def independent(self) -> float:
        """How many independent data the `(m,)` residuals are worth: what their squares add up to if the model
        errs as it is expected to.
        """
        return float(((MODEL_ERROR / self.sd) ** 2).sum())

    @property
    def parts(self) -> Mapping[str, slice]:
        """Which of the `(m,)` belong to which spectrum, by name."""
        ends = np.cumsum([0, *(nm.size for nm in self.wavelength_nm)]).tolist()
        places = zip(self.spectra, pairwise(ends), strict=True)
        return {one.name: slice(first, end) for one, (first, end) in places}

    def predicted(self, values: Values) -> Array:
        """`(m,)` reflectances that the instrument would read at these values."""
        return self._of_paths(self.tuned(values).pigments)

    def residuals(self, values: Values) -> Array:
        """`(m,)` predicted less measured, in standard deviations."""
        return (self.predicted(values) - self.measured) / self.sd

    def jacobian(self, values: Values, entries: Sequence[Entry]) -> Array:
        """`(m, p)` derivatives of `residuals` with respect to entries of the fit's parameters.

        Finite differences of fourth order (five points), all of them within the entry's bounds: central, or
        to one side near a bound. The chain is smooth, so that they err by 1e-9 of the slope; by 2e-3 for
        `roughness`, because the gloss' albedo is a quadrature with that much grain in its slope.
        """
        slopes = [self._slope(values, entry) / self.sd for entry in entries]
        return np.stack(slopes, axis=1) if slopes else np.empty((self.sd.size, 0))

    def rmse(self, values: Values) -> float:
        """Root mean square difference of all wavelengths, in reflectance."""
        return _rms(self.predicted(values) - self.measured)

    def rmse_by_name(self, values: Values) -> Mapping[str, float]:
        """The same of each spectrum."""
        off = self.predicted(values) - self.measured
        return {name: _rms(off[part]) for name, part in self.parts.items()}

    def _of_paths(self, paths: Mapping[str, PigmentPath]) -> Array:
        found = [np.empty(0)]
        for seen, nm in zip(self.shown, self.wavelength_nm, strict=True):
            path = paths.get(seen.surface, self.cultivar.pigments[seen.surface])
            found.append(read_reflectance(path, nm, seen.state, thin=seen.thin, instrument=self.instrument))
        return np.concatenate(found)

    def _slope(self, values: Values, entry: Entry) -> Array:
        """`(m,)` derivative of `predicted` with respect to one entry."""
        parameter, law = entry.parameter, entry.parameter.prior[entry.place]
        here = float(values.get(parameter.name, parameter.default)[entry.place])
        step, slope = STEP * law.sd, np.zeros(self.sd.size)
        # Light and camera do not change a reflectance, and what may not move has no slope.
        if step > 0.0 and parameter.group in ("pigments", "cuticle"):
            offsets, weights = _stencil(here - law.low, law.high - here, step)
            for offset, weight in zip(offsets, weights, strict=True):
                slope += weight / step * self.predicted(entry.moved(values, offset * step))
        return slope


def _stencil(below: float, above: float, step: float) -> tuple[Array, Array]:
    """Offsets in steps and weights of a five-point first derivative with this much room to either side."""
    if min(below, above) >= 2.0 * step:
        return np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
    one_sided = np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) / 12.0
    sign = 1.0 if above >= below else -1.0
    return sign * np.arange(5.0), sign * one_sided


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(difference**2)))

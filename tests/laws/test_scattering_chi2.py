"""Chi-squared tests of samples against their density, over all surfaces, by Mitsuba's own test.

Each case draws 2^19 directions into about 1,300 cells. The significance, 0.01 over all cases together, is
corrected by Sidak; without errors the p-values are uniform. Power, measured with deliberate errors: it fails
if samples choose the gloss .01 too often or transmission 2 % too often, or if they are drawn for an alpha 3 %
too large.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scatterers import Cases, lossless, plain, shipped, two_lobes, waves

from pepperscene.render.variant import mitsuba_modules

SHIPPED_COSINES = (1.0, 0.4, 0.05, -0.7, -0.05)
SYNTHETIC_COSINES = (0.9, 0.02, -0.3)
SYNTHETIC = (
    "T 0.4, ior 1.5, alpha (0.001, 1.0)",
    "T 1, ior 1.28, alpha (0.7, 0.02)",
    "T 0.4, ior 2.5, alpha (0.1, 0.45)",
)
RINGS = 41
TWO_LOBES = (
    "T 0.4, ior 1.28, alpha (0.25, 0.25) and (0.8, 0.8)",
    "T 1, ior 2.5, alpha (0.02, 0.1) and (0.6, 1.0)",
)
GROUPS = ("shipped", "relief", "synthetic", "two lobes", "residue", "filtered")


@cache
def cases_of(group: str) -> Cases:
    """Every surface at all cosines, the shipped ones in alternating extreme states."""
    if group == "synthetic":
        return Cases.over([s for s in lossless() if s.name in SYNTHETIC], (0.0,), SYNTHETIC_COSINES, seed=7)
    if group in ("two lobes", "residue", "filtered"):
        surfaces = [s for s in two_lobes() if s.name in TWO_LOBES]
        if group == "filtered":
            surfaces = [replace(s, relief_mm=waves(0.15)) for s in surfaces]
        residue = 0.6 if group == "residue" else 0.0
        footprint_m2 = 1e-5 if group == "filtered" else 0.0
        cases = Cases.over(surfaces, (0.0,), SYNTHETIC_COSINES, seed=8)
        return replace(cases, residue=residue, footprint_m2=footprint_m2)
    if group == "relief":
        surfaces = [s for s in shipped() if s.relief_mm is not None]
    else:
        surfaces = [plain(s) for s in shipped()]
    cases = Cases.over(surfaces, (0.0,), SHIPPED_COSINES, seed=6)
    return replace(cases, state=np.arange(len(cases)) % 2)


class AboutMirror:
    """The sphere in polar coordinates about the mirrored direction, stretched to the shape of the gloss.

    With cells of equal area a glossy lobe would fill a single one. At a cosine z to the surface it is about
    alpha wide along the plane of incidence, and alpha z across. So directions are first stretched across (a
    linear map, back onto the sphere); then x is the azimuth and y in [0, 1] a logarithmic radius, with
    1 - cosine = width ((1 + 2 / width)^y - 1) and width = alpha^2: about half of the rings are in the lobe.
    """

    def __init__(self, normal: np.ndarray, wi: np.ndarray, alpha: float) -> None:
        mi, dr = mitsuba_modules()
        cosine = float(normal @ wi)
        axis = 2.0 * cosine * normal - wi
        axis /= np.linalg.norm(axis)
        across = np.cross(normal, axis) if cosine < 0.999 else np.cross(axis, (axis[2], axis[0], axis[1]))
        across /= np.linalg.norm(across)
        vectors = (mi.Vector3f(*map(float, v)) for v in (across, np.cross(axis, across), axis))
        self.frame = mi.Frame3f(*vectors)
        self.across = mi.Float(1.0 / max(cosine, alpha))
        self.width, self.log = mi.Float(alpha**2), mi.Float(float(np.log(1.0 + 2.0 / alpha**2)))
        dr.make_opaque(self.frame, self.across, self.width, self.log)

    def bounds(self):
        mi, dr = mitsuba_modules()
        return mi.ScalarBoundingBox2f([-dr.pi, 0.0], [dr.pi, 1.0])

    def aspect(self) -> float:
        return 1.3

    def map_forward(self, p):
        mi, dr = mitsuba_modules()
        below = dr.minimum(self.width * (dr.exp(p.y * self.log) - 1.0), 2.0)
        sine = dr.safe_sqrt(below * (2.0 - below))
        sin_phi, cos_phi = dr.sincos(p.x)
        local = dr.normalize(mi.Vector3f(sine * cos_phi / self.across, sine * sin_phi, 1.0 - below))
        return self.frame.to_world(local)

    def map_backward(self, p):
        mi, dr = mitsuba_modules()
        local, _ = self._stretched(p)
        return mi.Vector2f(dr.atan2(local.y, local.x), dr.log(1.0 + _below(local) / self.width) / self.log)

    def solid_angle(self, p):
        """Solid angle per area of the domain."""
        local, length = self._stretched(p)
        return (_below(local) + self.width) * self.log * length**3 / self.across

    def _stretched(self, p):
        mi, dr = mitsuba_modules()
        local = self.frame.to_local(p)
        stretched = mi.Vector3f(local.x * self.across, local.y, local.z)
        return dr.normalize(stretched), dr.norm(stretched)


def _below(local):
    """1 - cosine to the axis, accurate near it."""
    _, dr = mitsuba_modules()
    return 0.5 * (dr.square(local.x) + dr.square(local.y) + dr.square(local.z - 1.0))


def chi_squared(cases: Cases, optics, frames: np.ndarray, case: int):
    """Mitsuba's test of one case, not yet run."""
    mi, dr = mitsuba_modules()
    from mitsuba.chi2 import ChiSquareTest

    domain = AboutMirror(frames[case, 2], cases.wi[case].astype(float), float(cases.alpha()[case]))
    number = mi.UInt32(case)
    dr.make_opaque(number)

    def points(n: int):
        return cases.points(optics, number + dr.zeros(mi.UInt32, n))

    def sample(u):
        wo, density, _, _ = points(dr.width(u)).sample(u[0], mi.Point2f(u[1], u[2]))
        return wo, mi.Float(dr.select(density > 0.0, 1.0, 0.0))

    def density(wo):
        return points(dr.width(wo)).eval_pdf(wo)[1] * domain.solid_angle(wo)

    return ChiSquareTest(
        domain, sample, density, sample_dim=3, sample_count=1 << 19, res=RINGS, ires=48, seed=case
    )


LONG = ("shipped", "relief", "two lobes")


@pytest.mark.parametrize(
    "group", [pytest.param(group, marks=pytest.mark.long if group in LONG else ()) for group in GROUPS]
)
def test_samples_follow_their_density(group):
    cases, tests = cases_of(group), sum(len(cases_of(g)) for g in GROUPS)
    optics = cases.optics()
    frames = cases.frames(optics)
    failed = []
    for case in range(len(cases)):
        test = chi_squared(cases, optics, frames, case)
        if not test.run(significance_level=0.01, test_count=tests, quiet=True):
            failed.append(f"{cases.label(case)}\n{test.messages}")
    assert not failed, "\n".join(failed)

"""Many surfaces, states and view directions in one kernel call, for the tests of scattering."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import Surface, greenhouse_surfaces, organ_surfaces
from pepperscene.materials.gloss import gloss_albedo
from pepperscene.render.surface.optics import Optics
from pepperscene.render.surface.tables import MIN_ALPHA
from pepperscene.render.variant import mitsuba_modules

GRID_NM = np.arange(380.0, 961.0, 5.0)
TEST_NM = (450.0, 550.0, 680.0, 850.0)  # a leaf's two absorption bands, green and bright infrared
EXTENT_M = 0.03  # of a unit of uv: makes shipped reliefs about three times as steep as on the plant
IORS = (1.0, 1.05, 1.28, 1.5, 2.5)
ROUGHNESSES = ((1e-3, 1e-3), (1e-3, 1.0), (0.1, 0.45), (0.7, 0.02))
TRANSMITTANCES = (0.0, 0.4, 1.0)


@cache
def shipped() -> tuple[Surface, ...]:
    """All surfaces that a frame of the shipped recipes can hold."""
    organs = organ_surfaces(load_cultivar("kaite"), GRID_NM)
    return (*organs.values(), *greenhouse_surfaces(GRID_NM).values())


def plain(surface: Surface) -> Surface:
    """A surface without textures."""
    return replace(surface, pattern=None, relief_mm=None, residue_pattern=None, ageing_order=None)


def grey_surface(name: str, front: float, back: float, through: float, ior: float, roughness) -> Surface:
    """A grey surface."""
    body = np.repeat(np.array([front, back])[None, :, None], 2, axis=2)
    return Surface(name, GRID_NM[[0, -1]], body, np.full((1, 2), through), ior, roughness)


def lossless() -> tuple[Surface, ...]:
    """Bodies that absorb nothing, under cuticles of all kinds, with equal and different sides."""
    return tuple(
        grey_surface(f"T {t:g}, ior {ior:g}, alpha {roughness}", 1.0 - t, 1.0 - t, t, ior, roughness)
        for ior in IORS
        for roughness in ROUGHNESSES
        for t in TRANSMITTANCES
    )


def two_lobes() -> tuple[Surface, ...]:
    """Lossless bodies under cuticles with two lobes, with equal and different sides."""
    pairs = (((0.25, 0.25), (0.8, 0.8)), ((0.02, 0.1), (0.6, 1.0)))
    return tuple(
        replace(
            grey_surface(f"T {t:g}, ior {ior:g}, alpha {narrow} and {wide}", 1 - t, 1 - t, t, ior, narrow),
            wide_roughness=wide,
            wide_share=share,
            residue_reflectance=1.0,
            residue_behind=behind,
        )
        for ior, share, behind in ((1.28, 0.7, 0.0), (1.45, 0.5, 0.6), (2.5, 0.1, 1.0))
        for narrow, wide in pairs
        for t in TRANSMITTANCES
    )


def waves(slope: float, texels: int = 64) -> np.ndarray:
    """`(1, texels, texels)` relief in mm of waves along u and v, with this rms slope along each."""
    x = (np.arange(texels) + 0.5) / texels
    amplitude_mm = 1e3 * EXTENT_M * slope * np.sqrt(2.0) / (2.0 * np.pi * 4.0)
    height = np.sin(8.0 * np.pi * x)[None, :] + np.sin(8.0 * np.pi * x)[:, None]
    return (amplitude_mm * height).astype(np.float32)[None]


@dataclass(frozen=True, eq=False)
class Cases:
    """Surfaces in a state, seen from a direction.

    Attributes:
        surfaces: of all cases.
        surface: `(c,)` number of each case's surface.
        state: `(c,)`.
        wi: `(c, 3)` unit vectors, float32.
        uv: `(c, 2)`.
        residue, ageing: of all organs, or `(c,)`.
        footprint_m2: area that a pixel covers on the surface; None for hits that no camera ray found.
    """

    surfaces: tuple[Surface, ...]
    surface: np.ndarray
    state: np.ndarray
    wi: np.ndarray
    uv: np.ndarray
    residue: float | np.ndarray = 0.0
    ageing: float | np.ndarray = 0.0
    footprint_m2: float | None = 0.0

    @classmethod
    def over(
        cls, surfaces: Sequence[Surface], states: Iterable[float], cosines: Iterable[float], seed: int
    ) -> Cases:
        """Every surface in every state at every cosine of view, at random azimuths and uv."""
        rng = np.random.default_rng(seed)
        grid = np.meshgrid(np.arange(len(surfaces)), list(states), list(cosines), indexing="ij")
        surface, state, cosine = (axis.ravel() for axis in grid)
        azimuth = rng.uniform(0.0, 2.0 * np.pi, cosine.size)
        sine = np.sqrt(1.0 - cosine**2)
        wi = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=1)
        uv = rng.uniform(0.05, 0.95, (cosine.size, 2))
        return cls(tuple(surfaces), surface, state, wi.astype(np.float32), uv.astype(np.float32))

    def __len__(self) -> int:
        return self.surface.size

    def label(self, case: int) -> str:
        return f"{self.surfaces[self.surface[case]].name}, state {self.state[case]}, wi {self.wi[case]}"

    @property
    def side(self) -> np.ndarray:
        """`(c,)`: 0 if seen from the front, 1 from the back."""
        return np.where(self.wi[:, 2] > 0.0, 0, 1)

    def alpha(self, blur: float = 0.0) -> np.ndarray:
        """`(c,)` roughness of the first lobe on the viewer's side, with 2 s^2 of a filtered relief."""
        sides = zip(self.surface, self.side, strict=True)
        narrow = np.array([max(self.surfaces[k].roughness[side], MIN_ALPHA) for k, side in sides])
        return np.sqrt(narrow**2 + blur)

    def gloss(self, case: int, blur: float = 0.0) -> float:
        """Albedo of the gloss of one case by NumPy, with 2 s^2 of a filtered relief."""
        surface, side = self.surfaces[self.surface[case]], self.side[case]
        lobes = [(surface.roughness[side], 1.0)]
        if surface.wide_roughness is not None:
            share = surface.wide_share
            lobes = [(surface.roughness[side], 1.0 - share), (surface.wide_roughness[side], share)]
        cosine = abs(float(self.wi[case, 2]))
        albedos = [
            share * gloss_albedo(cosine, surface.ior, float(np.sqrt(alpha**2 + blur)))[0]
            for alpha, share in lobes
        ]
        return float(sum(albedos))

    def expected(self) -> np.ndarray:
        """`(c, 4)`: E + (1 - E) (R + T) by NumPy, of plain surfaces without residue and ageing."""
        albedo = np.empty((len(self), len(TEST_NM)))
        for case, (number, side, state) in enumerate(zip(self.surface, self.side, self.state, strict=True)):
            surface = self.surfaces[number]
            rows = surface.reflectance[:, side] + surface.transmittance
            at_nm = np.stack([np.interp(TEST_NM, surface.wavelength_nm, row) for row in rows])
            states = np.linspace(surface.first_state, 1.0, len(rows))
            body = np.array([np.interp(state, states, column) for column in at_nm.T])
            gloss = self.gloss(case)
            albedo[case] = gloss + (1.0 - gloss) * body
        return albedo

    def optics(self) -> Optics:
        organs = np.ones((len(self), 4))
        organs[:, 0], organs[:, 2], organs[:, 3] = self.surface, self.residue, self.ageing
        return Optics.pack(self.surfaces, float(GRID_NM[0]), float(GRID_NM[-1]), organs=organs)

    def points(self, optics: Optics, case):
        """The optical states of lanes; `case` is a `UInt32` of case numbers."""
        mi, dr = mitsuba_modules()
        wi = dr.gather(mi.Vector3f, mi.Float(self.wi.ravel()), case)
        uv = dr.gather(mi.Point2f, mi.Float(self.uv.ravel()), case)
        state = dr.gather(mi.Float, mi.Float(self.state), case)
        footprint = None if self.footprint_m2 is None else mi.Float(self.footprint_m2)
        return optics.point(interaction(wi, dr.width(case), uv), case, state, mi.Bool(True), footprint)

    def frames(self, optics: Optics) -> np.ndarray:
        """`(c, 3, 3)`: axes (rows) of the relief's frame with z towards the viewer, as the lobes use it."""
        mi, dr = mitsuba_modules()
        point = self.points(optics, dr.arange(mi.UInt32, len(self)))
        dr.eval(point.frame, point.flip)
        one = dr.ones(mi.Float, dr.width(point.flip))
        local = mi.Vector3f(one, 0, 0), mi.Vector3f(0, one, 0), mi.Vector3f(0, 0, one * point.flip)
        axes = [np.broadcast_to(np.asarray(point.frame.to_world(axis)), (3, len(self))) for axis in local]
        return np.stack(axes).transpose(2, 0, 1).astype(float)


def interaction(wi, n: int, uv=(0.5, 0.5)):
    """`n` interactions on the plane z = 0 seen from `wi`."""
    mi, dr = mitsuba_modules()
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi, si.n = mi.Vector3f(*wi), mi.Normal3f(0.0, 0.0, 1.0)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0))
    si.dp_du, si.dp_dv = mi.Vector3f(EXTENT_M, 0.0, 0.0), mi.Vector3f(0.0, EXTENT_M, 0.0)
    si.uv = mi.Point2f(*uv)
    si.wavelengths = mi.Spectrum(*TEST_NM)
    return si


def sample_cases(cases: Cases, repeats: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Directional albedos `(c, repeats, 4)` and rejected fractions `(c, repeats)` by sampling.

    Each repeat takes `count` points of a lattice (powers of the root of x^4 = x + 1, Roberts 2018) with its
    own random shift: the repeats are independent and unbiased (Cranley & Patterson 1976).
    """
    rng = np.random.default_rng(seed)
    root = 1.2207440846057596
    lattice = np.outer(root ** -np.arange(1.0, 4.0), np.arange(count)) % 1.0
    shift = rng.random((len(cases), repeats, 3))
    optics = cases.optics()
    chunks = [np.arange(first, min(first + 100, len(cases))) for first in range(0, len(cases), 100)]
    means = np.concatenate([_sample_chunk(cases, optics, chunk, lattice, shift[chunk]) for chunk in chunks])
    return means[..., :4], means[..., 4]


def _sample_chunk(
    cases: Cases, optics: Optics, chosen: np.ndarray, lattice: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """`(c, repeats, 5)`: means of the weights at four wavelengths, and the rejected fraction."""
    mi, dr = mitsuba_modules()
    count, repeats = lattice.shape[1], shift.shape[1]
    lane = dr.arange(mi.UInt32, len(chosen) * repeats * count)
    block = lane // count
    u = []
    for axis in range(3):
        x = dr.gather(mi.Float, mi.Float(lattice[axis]), lane - block * count)
        x += dr.gather(mi.Float, mi.Float(shift[..., axis].ravel()), block)
        u.append(dr.minimum(x - dr.floor(x), 1.0 - 2.0**-24))
    case = dr.gather(mi.UInt32, mi.UInt32(chosen), block // repeats)
    _, density, weight, _ = cases.points(optics, case).sample(u[0], mi.Point2f(u[1], u[2]))
    good = density > 0.0
    values = [dr.select(good, weight[k], 0.0) for k in range(4)] + [dr.select(good, 0.0, 1.0)]
    dr.eval(values)
    sums = [np.asarray(dr.block_reduce(dr.ReduceOp.Add, value, count)) for value in values]
    return np.stack(sums, axis=-1).reshape(len(chosen), repeats, 5) / count


def integrate_cases(cases: Cases, blur: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Directional albedos `(c, 4)` and integrals of the density `(c,)` by quadrature of `eval_pdf`.

    `blur` is 2 s^2 of a filtered relief.

    Independent of the BSDF's own sampling: a grid of diffuse directions on both sides, and one of microfacet
    normals weighted by their area, combined by the balance heuristic.
    """
    mi, dr = mitsuba_modules()
    optics = cases.optics()
    frames = cases.frames(optics)
    local, weight = [], []
    for case, alpha in enumerate(cases.alpha(blur)):
        directions, weights = _directions(frames[case] @ cases.wi[case].astype(float), alpha)
        local.append(directions @ frames[case])
        weight.append(weights)
    count = weight[0].size
    wo = np.concatenate(local).astype(np.float32)
    lane = dr.arange(mi.UInt32, len(wo))
    value, density = cases.points(optics, lane // count).eval_pdf(mi.Vector3f(*wo.T))
    values = np.concatenate([np.asarray(value), np.asarray(density)[None]])
    sums = (values.reshape(5, len(cases), count) * np.stack(weight)).sum(axis=2)
    return sums[:4].T, sums[4]


def _directions(wi: np.ndarray, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """`(n, 3)` directions in the viewer's frame and `(n,)` their weights in an integral over the sphere."""

    def mirror_density(wo: np.ndarray) -> np.ndarray:
        half = wi + wo
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        stretched = (half[:, 0] ** 2 + half[:, 1] ** 2) / alpha**2 + half[:, 2] ** 2
        return half[:, 2] / (np.pi * alpha**2 * stretched**2) / (4.0 * np.maximum(half @ wi, 1e-9))

    # Diffuse directions: above the surface combined with the mirror's density, below it alone.
    node, weight = np.polynomial.legendre.leggauss(56)
    theta, phi = np.meshgrid(
        (node + 1.0) * np.pi / 4.0, (np.arange(80) + 0.5) / 80 * 2 * np.pi, indexing="ij"
    )
    solid_angle = (np.pi / 4.0 * weight * np.sin(theta[:, 0]) * 2.0 * np.pi / 80).repeat(80)
    theta, phi = theta.ravel(), phi.ravel()
    above = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    lambert = above[:, 2] / np.pi
    by_area = solid_angle * lambert / (lambert + mirror_density(above))

    # Mirrored directions; those below the horizon have no weight.
    area, psi = np.meshgrid(
        (np.arange(120) + 0.5) / 120, (np.arange(96) + 0.5) / 96 * 2 * np.pi, indexing="ij"
    )
    area, psi = area.ravel(), psi.ravel()
    weight_of_normal = 3.0 * area**2 / area.size  # finer in the tail, where gloss and body are similar
    slope = alpha * np.sqrt(1.0 / area**3 - 1.0)
    half = np.stack([slope * np.cos(psi), slope * np.sin(psi), np.ones_like(area)], axis=1)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cosine = half @ wi
    mirrored = 2.0 * cosine[:, None] * half - wi
    usable = (cosine > 1e-6) & (mirrored[:, 2] > 1e-6)
    mirrored[~usable] = (0.0, 0.0, 1.0)
    by_mirror = usable * weight_of_normal / (mirrored[:, 2] / np.pi + mirror_density(mirrored))
    directions = np.concatenate([above, above * (1.0, 1.0, -1.0), mirrored])
    return directions, np.concatenate([by_area, solid_angle, by_mirror])

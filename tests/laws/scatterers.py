"""Many surfaces, states and directions of view in one kernel call, for the laws of scattering."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import Surface, greenhouse_surfaces, organ_surfaces
from pepperscene.materials.gloss import gloss_albedo
from pepperscene.render.surface.optics import Optics
from pepperscene.render.surface.optics import MIN_ALPHA, Optics
from pepperscene.render.variant import mitsuba_modules

GRID_NM = np.arange(380.0, 961.0, 5.0)
SEEN_NM = (
    450.0,
    550.0,
    680.0,
    850.0,
)  # a leaf's two absorption bands, its green, its bright infrared
EXTENT_M = 0.03  # of a unit of uv: makes the shipped reliefs some three times as steep as on the plant
MADE_IORS = (1.0, 1.05, 1.28, 1.5, 2.5)
MADE_ROUGHNESS = ((1e-3, 1e-3), (1e-3, 1.0), (0.1, 0.45), (0.7, 0.02))
MADE_TRANSMITTANCES = (0.0, 0.4, 1.0)


@cache
def shipped() -> tuple[Surface, ...]:
    """All surfaces that a frame of the shipped recipes can hold."""
    organs = organ_surfaces(load_cultivar("kaite"), GRID_NM)
    return (*organs.values(), *greenhouse_surfaces(GRID_NM).values())


def plain(surface: Surface) -> Surface:
    """The same without pattern and relief."""
    return replace(surface, pattern=None, relief_mm=None)


def made(name: str, front: float, back: float, through: float, ior: float, roughness) -> Surface:
    """A grey surface."""
    body = np.repeat(np.array([front, back])[None, :, None], 2, axis=2)
    return Surface(name, GRID_NM[[0, -1]], body, np.full((1, 2), through), ior, roughness)


def lossless() -> tuple[Surface, ...]:
    """Bodies that absorb nothing, under cuticles of all kinds, the sides alike and unlike."""
    return tuple(
        made(f"T {t:g}, ior {ior:g}, alpha {roughness}", 1.0 - t, 1.0 - t, t, ior, roughness)
        for ior in MADE_IORS
        for roughness in MADE_ROUGHNESS
        for t in MADE_TRANSMITTANCES
    )


@dataclass(frozen=True, eq=False)
class Cases:
    """Surfaces seen in some state from some direction.

    Attributes:
        surfaces: of all cases.
        surface: `(c,)` number of each case's surface.
        state: `(c,)`.
        wi: `(c, 3)` unit vectors, float32.
        uv: `(c, 2)`.
    """

    surfaces: tuple[Surface, ...]
    surface: np.ndarray
    state: np.ndarray
    wi: np.ndarray
    uv: np.ndarray

    @classmethod
    def over(
        cls, surfaces: Sequence[Surface], states: Iterable[float], cosines: Iterable[float], seed: int
    ) -> Cases:
        """Every surface in every state at every cosine of view, at random azimuths and places."""
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
        """`(c,)`: 0 seen from the front, 1 from the back."""
        return np.where(self.wi[:, 2] > 0.0, 0, 1)

    def alpha(self) -> np.ndarray:
        """`(c,)` of the cuticle on the viewer's side, as packed."""
        return np.array(
            [
                max(self.surfaces[k].roughness[s], MIN_ALPHA)
                for k, s in zip(self.surface, self.side, strict=True)
            ]
        )

    def expected(self) -> np.ndarray:
        """`(c, 4)`: E + (1 - E) (R + T) by NumPy, of plain surfaces."""
        found = np.empty((len(self), len(SEEN_NM)))
        for case, (number, side, state) in enumerate(zip(self.surface, self.side, self.state, strict=True)):
            surface = self.surfaces[number]
            rows = surface.reflectance[:, side] + surface.transmittance
            at_nm = np.stack([np.interp(SEEN_NM, surface.wavelength_nm, row) for row in rows])
            place = np.linspace(0.0, 1.0, len(rows))
            body = np.array([np.interp(state, place, column) for column in at_nm.T])
            mirrored = gloss_albedo(abs(float(self.wi[case, 2])), surface.ior, surface.roughness[side])[0]
            found[case] = mirrored + (1.0 - mirrored) * body
        return found

    def optics(self) -> Optics:
        return Optics.pack(self.surfaces, float(GRID_NM[0]), float(GRID_NM[-1]))

    def points(self, optics: Optics, case):
        """The optical states at lanes that belong to the cases numbered `case` (a kernel's integer)."""
        mi, dr = mitsuba_modules()
        wi = dr.gather(mi.Vector3f, mi.Float(self.wi.ravel()), case)
        uv = dr.gather(mi.Point2f, mi.Float(self.uv.ravel()), case)
        surface = dr.gather(mi.UInt32, mi.UInt32(self.surface), case)
        state = dr.gather(mi.Float, mi.Float(self.state), case)
        return optics.at(interaction(wi, dr.width(case), uv), surface, state, mi.Bool(True))

    def frames(self, optics: Optics) -> np.ndarray:
        """`(c, 3, 3)`: axes (rows) of the directions that `quadrature` and the lobes use: the relief's, with
        z towards the viewer."""
        mi, dr = mitsuba_modules()
        point = self.points(optics, dr.arange(mi.UInt32, len(self)))
        dr.eval(point.frame, point.flip)
        axes = [np.broadcast_to(np.asarray(axis), (3, len(self))) for axis in _axes(point)]
        return np.stack(axes).transpose(2, 0, 1).astype(float)


def _axes(point):
    mi, dr = mitsuba_modules()
    one, zero = dr.ones(mi.Float, dr.width(point.flip)), 0.0
    return (
        point.frame.to_world(mi.Vector3f(one, zero, zero)),
        point.frame.to_world(mi.Vector3f(zero, one, zero)),
        point.frame.to_world(mi.Vector3f(zero, zero, one * point.flip)),
    )


def interaction(wi, n: int, uv=(0.5, 0.5)):
    """`n` interactions on the plane z = 0 seen from `wi`."""
    mi, dr = mitsuba_modules()
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(*wi)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0))
    si.dp_du, si.dp_dv = mi.Vector3f(EXTENT_M, 0.0, 0.0), mi.Vector3f(0.0, EXTENT_M, 0.0)
    si.uv = mi.Point2f(*uv)
    si.wavelengths = mi.Spectrum(*SEEN_NM)
    return si


def sampled(cases: Cases, repeats: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Directional albedos `(c, repeats, 4)` and shares of samples rejected `(c, repeats)` by sampling.

    Each repeat takes `count` points of a lattice (powers of the root of x^4 = x + 1, Roberts 2018), shifted
    by random numbers of its own: the repeats are independent and without bias (Cranley & Patterson 1976).
    """
    rng = np.random.default_rng(seed)
    root = 1.2207440846057596
    lattice = np.outer(root ** -np.arange(1.0, 4.0), np.arange(count)) % 1.0
    shift = rng.random((len(cases), repeats, 3))
    optics = cases.optics()
    chunks = [np.arange(first, min(first + 100, len(cases))) for first in range(0, len(cases), 100)]
    found = np.concatenate([_sampled(cases, optics, chunk, lattice, shift[chunk]) for chunk in chunks])
    return found[..., :4], found[..., 4]


def _sampled(
    cases: Cases, optics: Optics, chosen: np.ndarray, lattice: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """`(c, repeats, 5)`: means of the weights at four wavelengths, and the share rejected."""
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


def integrated(cases: Cases) -> tuple[np.ndarray, np.ndarray]:
    """Directional albedos `(c, 4)` and integrals of the density `(c,)` by quadrature of `eval_pdf`.

    Nothing of the BSDF's own sampling is used: a grid of diffuse directions on both sides, and one of
    microfacet normals drawn by their area, each with its density in the other (the balance heuristic makes
    one integral of the two).
    """
    mi, dr = mitsuba_modules()
    optics = cases.optics()
    frames = cases.frames(optics)
    local, weight = [], []
    for case, alpha in enumerate(cases.alpha()):
        directions, share = _directions(frames[case] @ cases.wi[case].astype(float), alpha)
        local.append(directions @ frames[case])
        weight.append(share)
    count = weight[0].size
    wo = np.concatenate(local).astype(np.float32)
    lane = dr.arange(mi.UInt32, len(wo))
    value, density = cases.points(optics, lane // count).eval_pdf(mi.Vector3f(*wo.T))
    values = np.concatenate([np.asarray(value), np.asarray(density)[None]])
    sums = (values.reshape(5, len(cases), count) * np.stack(weight)).sum(axis=2)
    return sums[:4].T, sums[4]


def _directions(wi: np.ndarray, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """`(n, 3)` directions in the view's frame and `(n,)` their weights in an integral over the sphere."""

    def mirror_density(wo: np.ndarray) -> np.ndarray:
        half = wi + wo
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        spread = (half[:, 0] ** 2 + half[:, 1] ** 2) / alpha**2 + half[:, 2] ** 2
        return half[:, 2] / (np.pi * alpha**2 * spread**2) / (4.0 * np.maximum(half @ wi, 1e-9))

    # Diffuse directions: above with the mirror's density beside their own, below alone.
    node, weight = np.polynomial.legendre.leggauss(40)
    theta, phi = np.meshgrid(
        (node + 1.0) * np.pi / 4.0, (np.arange(48) + 0.5) / 48 * 2 * np.pi, indexing="ij"
    )
    solid_angle = (np.pi / 4.0 * weight * np.sin(theta[:, 0]) * 2.0 * np.pi / 48).repeat(48)
    theta, phi = theta.ravel(), phi.ravel()
    above = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    lambert = above[:, 2] / np.pi
    by_area = solid_angle * lambert / (lambert + mirror_density(above))

    # Mirrored directions; those beyond the horizon count for nothing.
    rest, psi = np.meshgrid((np.arange(80) + 0.5) / 80, (np.arange(64) + 0.5) / 64 * 2 * np.pi, indexing="ij")
    rest, psi = rest.ravel(), psi.ravel()
    share = 3.0 * rest**2 / rest.size  # finer towards the far tail, where the mirror meets the body
    slope = alpha * np.sqrt(1.0 / rest**3 - 1.0)
    half = np.stack([slope * np.cos(psi), slope * np.sin(psi), np.ones_like(rest)], axis=1)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    towards = half @ wi
    mirrored = 2.0 * towards[:, None] * half - wi
    usable = (towards > 1e-6) & (mirrored[:, 2] > 1e-6)
    mirrored[~usable] = (0.0, 0.0, 1.0)
    by_mirror = usable * share / (mirrored[:, 2] / np.pi + mirror_density(mirrored))
    directions = np.concatenate([above, above * (1.0, 1.0, -1.0), mirrored])
    return directions, np.concatenate([by_area, solid_angle, by_mirror])

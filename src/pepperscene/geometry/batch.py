"""Organs of one form as arrays: their measures, their noise, and meshes that share one grid of triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar.organs import OrganForm
from pepperscene.geometry.mesh import FloatArray, IndexArray
from pepperscene.geometry.spine import normalize
from pepperscene.grammar.frames import cross
from pepperscene.grammar.hashing import GOLDEN_GAMMA, splitmix64
from pepperscene.grammar.plant import Organ, Plant


def form_indices(plant: Plant, form: OrganForm) -> IndexArray:
    """Indices of a plant's organs of one form."""
    kinds = {name for name, kind in plant.kinds.items() if kind.form == form}
    return np.array([i for i, organ in enumerate(plant.organs) if organ.kind in kinds], dtype=np.intp)


def read_measure(organs: Sequence[Organ], name: str, default: float | FloatArray | None = None) -> FloatArray:
    """Read `(n,)` values of one measure; `default` is one number or `(n,)`.

    Raises:
        ValueError: an organ lacks it and there is no default, or it is not a finite number.
    """
    defaults = default if isinstance(default, np.ndarray) else [default] * len(organs)
    # Without a default, a missing measure becomes NaN.
    values = np.array(
        [organ.measures.get(name, fallback) for organ, fallback in zip(organs, defaults, strict=True)],
        np.float64,
    )
    finite = np.isfinite(values)
    if not finite.all():
        organ = organs[int(np.argmin(finite))]
        location, value = f"{organ.kind} of phytomer {organ.phytomer}", organ.measures.get(name)
        raise ValueError(f"{location}: measure {name} must be a finite number, not {value}")
    return values


def read_positive(organs: Sequence[Organ], name: str) -> FloatArray:
    """Read `(n,)` values of one measure that must be above zero.

    Raises:
        ValueError: an organ lacks it, or it is not above zero.
    """
    values = read_measure(organs, name)
    if not np.all(values > 0.0):
        raise ValueError(f"{organs[0].kind}: {name} must be above zero, not {values.min()}")
    return values


_WAVES: Final = 8  # chosen: enough plane waves that no single one shows as a stripe


def hash_uniform(seed: FloatArray, salt: int, count: int) -> FloatArray:
    """Compute `(n, count)` numbers uniform in [0, 1) from `(n,)` seeds in [0, 1), equal on every machine.

    `salt` separates one use of a seed from another. The mixer is SplitMix64 (Steele, Lea & Flood 2014, "Fast
    splittable pseudorandom number generators").
    """
    start = np.ldexp(np.mod(seed, 1.0), 53).astype(np.uint64)[:, None]
    step = np.arange(1, count + 1, dtype=np.uint64) + np.uint64(salt) * np.uint64(1 << 20)
    bits = splitmix64(start + step * GOLDEN_GAMMA) >> np.uint64(11)
    return np.ldexp(bits.astype(np.float64), -53)


def hash_signed(seed: FloatArray, salt: int, count: int) -> FloatArray:
    """Compute `(n, count)` numbers uniform in [-1, 1), otherwise like `hash_uniform`."""
    return 2.0 * hash_uniform(seed, salt, count) - 1.0


def smooth_field(points: FloatArray, seed: FloatArray, salt: int, size: float) -> FloatArray:
    """Compute `(n, m)` smooth noise of mean 0 and variance 1 at `(n, m, d)` points, d = 2 or 3.

    A sum of plane waves of random direction and phase, which tends to a Gaussian random field (the spectral
    method of Shinozuka & Deodatis 1991). Equal points get equal values, so seams do not show. `size` is the
    mean wavelength, in the unit of the points; `seed` and `salt` as in `hash_uniform`.
    """
    dimensions = points.shape[-1]
    # Directions are uniform on the circle or the sphere; wavenumbers vary by up to 40 % either way.
    angle = 2.0 * np.pi * hash_uniform(seed, salt, _WAVES)
    height = hash_signed(seed, salt + 1, _WAVES) if dimensions == 3 else np.zeros_like(angle)
    radius = np.sqrt(1.0 - height**2)
    direction = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)[:, :dimensions]
    wavenumber = 2.0 * np.pi / size * (1.0 + 0.4 * hash_signed(seed, salt + 2, _WAVES))
    phase = 2.0 * np.pi * hash_uniform(seed, salt + 3, _WAVES)
    waves = np.cos(points @ (direction * wavenumber[:, None, :]) + phase[:, None, :])
    return waves.sum(axis=2) * np.sqrt(2.0 / _WAVES)


@dataclass(frozen=True, eq=False)
class MeshBatch:
    """Meshes of n organs that share one topology."""

    vertices: FloatArray  # `(n, v, 3)` metres
    normals: FloatArray  # `(n, v, 3)` unit
    uv: FloatArray  # `(n, v, 2)`
    state: FloatArray  # `(n, v)`
    faces: IndexArray  # `(f, 3)` of each organ
    colour: NDArray[np.floating] | None = None  # `(n, v, 3)` linear sRGB, or None if pigments give it


def subdivisions(count: int, detail: float, minimum: int) -> int:
    """Number of pieces of a grid line: `count` at detail 1, in proportion elsewhere, at least `minimum`."""
    return max(minimum, round(count * detail))


def vertex_normals(vertices: FloatArray, faces: IndexArray) -> FloatArray:
    """Compute `(n, v, 3)` unit normals of `(n, v, 3)` vertices: area-weighted means of the faces around each.

    A vertex without faces has a zero normal.
    """
    from scipy.sparse import csr_array

    # Organs come last in memory, so that a face gathers each of its corners from one contiguous block.
    corners = np.ascontiguousarray(vertices.transpose(1, 2, 0))
    origin = corners[faces[:, 0]]
    p, q = corners[faces[:, 1]] - origin, corners[faces[:, 2]] - origin
    face_normals = np.empty_like(p)
    for axis in range(3):
        second, third = (axis + 1) % 3, (axis + 2) % 3
        face_normals[:, axis] = p[:, second] * q[:, third] - p[:, third] * q[:, second]
    # The sum over the faces around each vertex is a product with a sparse matrix of ones, twice as fast as
    # sums by indices, and in the same order.
    rows, columns = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    around = csr_array((np.ones(rows.size), (rows, columns)), shape=(vertices.shape[1], len(faces)))
    total = (around @ face_normals.reshape(len(faces), -1)).reshape(corners.shape)
    length = np.sqrt(np.einsum("vin,vin->vn", total, total))
    total /= np.where(length > 0.0, length, 1.0)[:, None]
    return np.ascontiguousarray(total.transpose(2, 0, 1))


@lru_cache(maxsize=64)
def ring_faces(rings: int, sides: int) -> IndexArray:
    """`(f, 3)` faces of a closed body: a first point, `rings` rows of `sides + 1` vertices, and a last point.

    The last vertex of each row coincides with its first: the seam, where u jumps from 1 to 0.
    """
    row, column = np.mgrid[0:rings, 0 : sides + 1]
    last = 1 + rings * (sides + 1)
    corner = (1 + row * (sides + 1) + column)[:, :-1]
    a, b, d, c = corner[:-1], corner[:-1] + 1, corner[1:], corner[1:] + 1
    return np.concatenate(
        [
            np.stack([np.zeros(sides, dtype=np.intp), corner[0] + 1, corner[0]], axis=1),
            np.stack([a, b, c], axis=-1).reshape(-1, 3),
            np.stack([a, c, d], axis=-1).reshape(-1, 3),
            np.stack([np.full(sides, last), corner[-1], corner[-1] + 1], axis=1),
        ]
    )


def pack_rings(ends: FloatArray, rings: FloatArray) -> FloatArray:
    """`(n, v, k)` values in the vertex order of `ring_faces`: ends `(n, 2, k)` and rings `(n, r, c, k)`."""
    n, count, sides, width = rings.shape
    result = np.empty((n, 2 + count * (sides + 1), width))
    result[:, 0], result[:, -1] = ends[:, 0], ends[:, 1]
    inner = result[:, 1:-1].reshape(n, count, sides + 1, width)  # a view
    inner[:, :, :-1], inner[:, :, -1] = rings, rings[:, :, 0]
    return result


def ring_uv(v: FloatArray, sides: int) -> FloatArray:
    """`(..., vertices, 2)` uv in the order of `ring_faces`; `v` is that of the rings, `(..., r)`."""
    grid = np.stack(np.broadcast_arrays(np.arange(sides + 1) / sides, v[..., None]), axis=-1)
    uv = np.empty((*v.shape[:-1], 2 + grid.shape[-3] * (sides + 1), 2))
    uv[..., 0, :], uv[..., -1, :] = (0.5, 0.0), (0.5, 1.0)
    uv[..., 1:-1, :] = grid.reshape(*v.shape[:-1], -1, 2)
    return uv


def ring_shells(rings: FloatArray, ends: FloatArray, v: FloatArray, state: FloatArray) -> MeshBatch:
    """Build closed bodies of r > 1 rings of c points between a first and a last point.

    A normal is the mean of the faces around its point, all with the same weight, so that the edge of a plate
    looks rounded; two triangles between rings count as one face.

    Args:
        rings: `(n, r, c, 3)` metres; the columns run right-handed about the way from first to last.
        ends: `(n, 2, 3)` metres, first and last points.
        v: `(n, r)` surface coordinate of the rings; the first point has 0, the last one 1.
        state: `(n, 2 + r * c)` pigment state: first point, rings, last point; it is clipped to [0, 1].
    """
    n, r, c, _ = rings.shape
    first, last = ends[:, 0], ends[:, 1]
    following = np.concatenate([rings[:, :, 1:], rings[:, :, :1]], axis=2)
    between = cross(following[:, 1:] - rings[:, :-1], rings[:, 1:] - following[:, :-1])
    start = cross(following[:, 0] - first[:, None], rings[:, 0] - first[:, None])
    end = cross(rings[:, -1] - last[:, None], following[:, -1] - last[:, None])
    strips = normalize(np.concatenate([start[:, None], between, end[:, None]], axis=1))
    # Each point has a face on either side in the strip before its ring and in the strip after it.
    around = strips[:, :-1] + strips[:, 1:]
    around[:, :, 1:] += around[:, :, :-1].copy()
    around[:, :, 0] += strips[:, :-1, -1] + strips[:, 1:, -1]
    poles = normalize(np.stack([start.sum(axis=1), end.sum(axis=1)], axis=1))
    states = pack_rings(state[:, [0, -1], None], state[:, 1:-1].reshape(n, r, c, 1))[..., 0]
    return MeshBatch(
        pack_rings(ends, rings),
        pack_rings(poles, normalize(around)),
        ring_uv(v, c),
        np.clip(states, 0.0, 1.0),
        ring_faces(r, c),
    )

"""Callipers and rulers laid on the triangles of plants: what a person with the plant could measure.

Nothing here asks the grammar or the mesh makers how long a thing was meant to be. It reads vertices, the uv
that tells where along and around an organ a vertex lies, and which instance grows out of which.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pepperscene.geometry import Mesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

DIRECTIONS = 90  # of the callipers around a fruit: 2 degrees apart, so at most .015 % of a diameter is missed
GAUSS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, eq=False)
class Bodies:
    """n instances of one kind that share a grid.

    Attributes:
        instances: `(n,)` their numbers in the mesh.
        vertices: `(n, v, 3)` metres.
        uv: `(n, v, 2)`.
        faces: `(f, 3)` of each.
    """

    instances: IntArray
    vertices: FloatArray
    uv: FloatArray
    faces: IntArray


class Measured:
    """The instances of a plant's mesh, one by one.

    Args:
        mesh: of one plant, foot at the origin, z up, the aisle at -y.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.kinds = np.array([one.kind for one in mesh.instances])
        self.parents = np.array([one.parent for one in mesh.instances])
        self.phytomers = np.array([one.phytomer for one in mesh.instances])

    @cached_property
    def _layout(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """First vertex, number of vertices, first face and number of faces of each instance."""
        count = len(self.mesh.instances)
        owner = np.full(len(self.mesh.vertices), -1)
        owner[self.mesh.faces] = self.mesh.face_instance[:, None]
        found = []
        for of in (owner, self.mesh.face_instance):
            edges = np.flatnonzero(np.diff(of)) + 1
            starts = np.concatenate([[0], edges])
            # The vertices of an instance lie together, and so do its faces.
            assert len(starts) == count
            assert (owner >= 0).all()
            sizes = np.diff(np.concatenate([starts, [len(of)]]))
            first, size = np.empty(count, np.intp), np.empty(count, np.intp)
            first[of[starts]], size[of[starts]] = starts, sizes
            found += [first, size]
        return found[0], found[1], found[2], found[3]

    def bodies(self, kind: str) -> Iterator[Bodies]:
        """The instances of a kind, by their grids."""
        first, size, first_face, faces = self._layout
        chosen = np.flatnonzero(self.kinds == kind)
        for grid in np.unique(np.stack([size[chosen], faces[chosen]]), axis=1).T:
            alike = chosen[(size[chosen] == grid[0]) & (faces[chosen] == grid[1])]
            at = first[alike][:, None] + np.arange(grid[0])
            one = self.mesh.faces[first_face[alike[0]] : first_face[alike[0]] + grid[1]]
            yield Bodies(
                alike,
                self.mesh.vertices[at].astype(float),
                self.mesh.uv[at].astype(float),
                one.astype(np.intp) - first[alike[0]],
            )

    def roots(self, instances: IntArray) -> NDArray[np.str_]:
        """Kind of what each instance grows out of; empty for the first of all."""
        parents = self.parents[instances]
        return np.where(parents >= 0, self.kinds[parents], "")


# --- lines ------------------------------------------------------------------------------------------------


def rings(bodies: Bodies) -> tuple[FloatArray, FloatArray]:
    """Centres `(n, r, 3)` and greatest radii `(n, r)` of the rings of tubes, from base to tip.

    The points at both ends and the rings that round the caps off are left out: they reach into what the tube
    grows out of.
    """
    height = bodies.uv[0, :, 1]
    assert np.ptp(bodies.uv, axis=0).max() < 1e-6
    levels = np.unique(height)[CAP:-CAP]
    # Every ring is closed by a second vertex on the seam, which counts once.
    once = bodies.uv[0, :, 0] < 1.0
    centres, radii = [], []
    for level in levels:
        ring = bodies.vertices[:, once & (height == level)]
        centre = ring.mean(axis=1)
        centres.append(centre)
        radii.append(np.linalg.norm(ring - centre[:, None], axis=2).max(axis=1))
    return np.stack(centres, axis=1), np.stack(radii, axis=1)


CAP = 2
"""A tube's point at the end, and the ring that rounds it off."""


def lengths(lines: FloatArray) -> FloatArray:
    """`(n,)` metres along smooth lines through points `(n, k, 3)`: a flexible ruler.

    The straight pieces between the points fall short of a bent organ by up to a quarter of a per cent; cubic
    splines do not.
    """
    if lines.shape[1] < 4:
        return np.linalg.norm(np.diff(lines, axis=1), axis=2).sum(axis=1)
    chord = np.linalg.norm(np.diff(lines, axis=1), axis=2).mean(axis=0)
    knots = np.concatenate([[0.0], np.cumsum(chord)])
    speed = CubicSpline(knots, lines, axis=1).derivative()
    total = np.zeros(len(lines))
    for place, weight in zip(*GAUSS, strict=True):
        at = knots[:-1] + 0.5 * (1.0 + place) * chord
        total += 0.5 * weight * (np.linalg.norm(speed(at), axis=2) * chord).sum(axis=1)
    return total


def midribs(bodies: Bodies) -> tuple[FloatArray, FloatArray]:
    """Points `(n, k, 3)` of blades' midribs from base to tip, and their place `(k,)` along them."""
    middle = np.flatnonzero(np.abs(bodies.uv[0, :, 0] - 0.5) < 1e-6)
    middle = middle[np.argsort(bodies.uv[0, middle, 1])]
    places = bodies.uv[:, middle, 1]
    assert np.ptp(places, axis=0).max() < 1e-6
    return bodies.vertices[:, middle], places[0]


# --- widths -----------------------------------------------------------------------------------------------


def flat_widths(bodies: Bodies, places: FloatArray) -> FloatArray:
    """`(n,)` metres across blades, as if they lay flat between jaws that are parallel to the midrib.

    At each place along the midrib the blade is cut across. A ruler is bent from the midrib over the middle
    of either half to the margin: an arc through three points (two chords and a third of what they exceed the
    one chord by). It lies on the blade and does not follow its small bulges. Each jaw touches its half where
    that is widest.

    Args:
        bodies: blades.
        places: where to cut, parts of the length.
    """
    edges = np.unique(np.sort(bodies.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    return np.max([_halves_at(bodies, edges, place) for place in places], axis=0).sum(axis=1)


def _halves_at(bodies: Bodies, edges: IntArray, place: float) -> FloatArray:
    """`(n, 2)` metres from the midrib to the left and to the right margin."""
    start, end = bodies.uv[:, edges[:, 0], 1] - place, bodies.uv[:, edges[:, 1], 1] - place
    blade, edge = np.nonzero((start <= 0.0) != (end <= 0.0))
    part = start[blade, edge] / (start[blade, edge] - end[blade, edge])
    a, b = edges[edge].T
    points = _mixed(bodies.vertices[blade, a], bodies.vertices[blade, b], part[:, None])
    across = _mixed(bodies.uv[blade, a, 0], bodies.uv[blade, b, 0], part)
    # All cuts on one scale, blade after blade, from left to right.
    key = 2.0 * blade + across
    order = np.argsort(key, kind="stable")
    key, points, across, blade = key[order], points[order], across[order], blade[order]
    n = np.arange(len(bodies.vertices))
    left, right = np.searchsorted(blade, n), np.searchsorted(blade, n, side="right") - 1

    def at(u: FloatArray) -> FloatArray:
        return np.stack([np.interp(2.0 * n + u, key, points[:, axis]) for axis in range(3)], axis=1)

    middle, found = at(np.full(len(n), 0.5)), []
    for margin in (left, right):
        between = at(0.5 * (0.5 + across[margin]))
        one = np.linalg.norm(points[margin] - middle, axis=1)
        two = np.linalg.norm(points[margin] - between, axis=1) + np.linalg.norm(between - middle, axis=1)
        found.append(two + (two - one) / 3.0)
    return np.stack(found, axis=1)


def _mixed(first: FloatArray, second: FloatArray, part: FloatArray) -> FloatArray:
    return first + part * (second - first)


def poles(bodies: Bodies) -> tuple[FloatArray, FloatArray]:
    """Stalk ends `(n, 3)` and blossom ends `(n, 3)` of fruit."""
    height = bodies.uv[0, :, 1]
    return bodies.vertices[:, np.argmin(height)], bodies.vertices[:, np.argmax(height)]


def axes(bodies: Bodies) -> FloatArray:
    """`(n, 3)` unit vectors from the stalk end of fruit to their blossom end."""
    stalk, blossom = poles(bodies)
    return unit(blossom - stalk)


def fruit_sizes(bodies: Bodies) -> tuple[FloatArray, FloatArray]:
    """Length along the axis `(n,)` and greatest width across it `(n,)`, metres, between a calliper's jaws."""
    axis = axes(bodies)
    side = unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)]))
    other = np.cross(axis, side)
    along, right, up = (np.einsum("nvi,ni->nv", bodies.vertices, one) for one in (axis, side, other))
    turn = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    width = np.zeros(len(axis))
    for angle in turn:
        width = np.maximum(width, np.ptp(np.cos(angle) * right + np.sin(angle) * up, axis=1))
    return np.ptp(along, axis=1), width


# --- angles -----------------------------------------------------------------------------------------------


def unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def azimuths(vectors: FloatArray) -> FloatArray:
    """Radians around the vertical, counter-clockwise seen from above, 0 towards the aisle, in [0, 2 pi)."""
    return np.arctan2(vectors[..., 0], -vectors[..., 1]) % (2.0 * np.pi)


def inclinations(vectors: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Radians above the horizontal in the vertical plane of an azimuth; beyond -pi / 2 they point back."""
    forward = vectors[..., 0] * np.sin(azimuth) - vectors[..., 1] * np.cos(azimuth)
    return np.arctan2(vectors[..., 2], forward)


def ends(lines: FloatArray, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`(n,)` inclinations at the base and at the tip of lines `(n, k, 3)`, out of their whole course.

    To the pieces' inclinations, weighted by length, an even bend is fitted and one that grows as a stalk gets
    thinner: a + b s + c s^1.5, s from 0 at the base to 1.
    """
    pieces = np.diff(lines, axis=1)
    size = np.linalg.norm(pieces, axis=2)
    place = np.concatenate([np.zeros((len(lines), 1)), np.cumsum(size, axis=1)], axis=1)
    place /= place[:, -1:]
    start, end = place[:, :-1], place[:, 1:]
    # Of each piece the mean of the three terms over it.
    width = end - start
    terms = [np.ones_like(width), 0.5 * (start + end), (end**2.5 - start**2.5) / (2.5 * width)]
    design = np.stack(terms, axis=2)
    weighted = design * width[..., None]
    slopes = inclinations(pieces, azimuth[:, None])
    right = np.einsum("npk,np->nk", weighted, slopes)[..., None]
    fit = np.linalg.solve(np.einsum("npk,npl->nkl", weighted, design), right)[..., 0]
    return fit[:, 0], fit.sum(axis=1)


def halfway(lines: FloatArray, places: FloatArray, azimuth: FloatArray) -> FloatArray:
    """`(n,)` inclination of lines `(n, k, 3)` at half their length: a chord over the middle fifth."""
    smooth = CubicSpline(places, lines, axis=1)
    return inclinations(smooth(0.6) - smooth(0.4), azimuth)

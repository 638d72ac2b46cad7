"""Measures lengths, widths and angles on the triangles of plants, as with ruler, callipers and protractor.

Uses only vertices, their uv along and around an organ, and the parents of instances: nothing that the grammar
or the mesh generators intended.
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

DIRECTIONS = 90  # of the callipers around a fruit: 2 degrees apart, at most .015 % of a diameter is missed
GAUSS = np.polynomial.legendre.leggauss(3)
CAP = 2  # rings at a tube's end: the end point and the ring that rounds it off


@dataclass(frozen=True, eq=False)
class OrganGroup:
    """n instances of one kind with the same topology.

    Attributes:
        instances: `(n,)` their indices in the mesh.
        vertices: `(n, v, 3)` metres.
        uv: `(n, v, 2)`.
        faces: `(f, 3)` of each.
    """

    instances: IntArray
    vertices: FloatArray
    uv: FloatArray
    faces: IntArray


class PlantOrgans:
    """The instances of a plant's mesh, grouped by kind.

    Args:
        mesh: of one plant, stem base at the origin, z up, the aisle at -y.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.kinds = np.array([instance.kind for instance in mesh.instances])
        self.parents = np.array([instance.parent for instance in mesh.instances])
        self.phytomers = np.array([instance.phytomer for instance in mesh.instances])

    @cached_property
    def _layout(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """First vertex, number of vertices, first face and number of faces of each instance."""
        count = len(self.mesh.instances)
        owner = np.full(len(self.mesh.vertices), -1)
        owner[self.mesh.faces] = self.mesh.face_instance[:, None]
        result = []
        for instance in (owner, self.mesh.face_instance):
            starts = np.concatenate([[0], np.flatnonzero(np.diff(instance)) + 1])
            # The vertices of an instance are contiguous, and so are its faces.
            assert len(starts) == count
            assert (owner >= 0).all()
            first, size = np.empty(count, np.intp), np.empty(count, np.intp)
            first[instance[starts]] = starts
            size[instance[starts]] = np.diff(np.concatenate([starts, [len(instance)]]))
            result += [first, size]
        return tuple(result)

    def groups(self, kind: str) -> Iterator[OrganGroup]:
        """The instances of a kind, by their topology."""
        first, size, first_face, faces = self._layout
        chosen = np.flatnonzero(self.kinds == kind)
        for sizes in np.unique(np.stack([size[chosen], faces[chosen]]), axis=1).T:
            group = chosen[(size[chosen] == sizes[0]) & (faces[chosen] == sizes[1])]
            index = first[group][:, None] + np.arange(sizes[0])
            triangles = self.mesh.faces[first_face[group[0]] : first_face[group[0]] + sizes[1]]
            yield OrganGroup(
                group,
                self.mesh.vertices[index].astype(float),
                self.mesh.uv[index].astype(float),
                triangles.astype(np.intp) - first[group[0]],
            )


def rings(group: OrganGroup) -> tuple[FloatArray, FloatArray]:
    """Centres `(n, r, 3)` and greatest radii `(n, r)` of the rings of tubes, from base to tip.

    Caps are left out: they reach into the parent organ.
    """
    height = group.uv[0, :, 1]
    assert np.ptp(group.uv, axis=0).max() < 1e-6
    levels = np.unique(height)[CAP:-CAP]
    # Every ring has a second vertex on the seam, which is left out.
    unique = group.uv[0, :, 0] < 1.0
    centres, radii = [], []
    for level in levels:
        ring = group.vertices[:, unique & (height == level)]
        centre = ring.mean(axis=1)
        centres.append(centre)
        radii.append(np.linalg.norm(ring - centre[:, None], axis=2).max(axis=1))
    return np.stack(centres, axis=1), np.stack(radii, axis=1)


def lengths(lines: FloatArray) -> FloatArray:
    """`(n,)` metres along smooth lines through points `(n, k, 3)`.

    Straight pieces are shorter than a bent organ by up to .25 %; cubic splines are not.
    """
    if lines.shape[1] < 4:
        return np.linalg.norm(np.diff(lines, axis=1), axis=2).sum(axis=1)
    chord = np.linalg.norm(np.diff(lines, axis=1), axis=2).mean(axis=0)
    knots = np.concatenate([[0.0], np.cumsum(chord)])
    speed = CubicSpline(knots, lines, axis=1).derivative()
    total = np.zeros(len(lines))
    for node, weight in zip(*GAUSS, strict=True):
        position = knots[:-1] + 0.5 * (1.0 + node) * chord
        total += 0.5 * weight * (np.linalg.norm(speed(position), axis=2) * chord).sum(axis=1)
    return total


def midribs(group: OrganGroup) -> tuple[FloatArray, FloatArray]:
    """Points `(n, k, 3)` of blades' midribs from base to tip, and their relative positions `(k,)`."""
    midrib = np.flatnonzero(np.abs(group.uv[0, :, 0] - 0.5) < 1e-6)
    midrib = midrib[np.argsort(group.uv[0, midrib, 1])]
    positions = group.uv[:, midrib, 1]
    assert np.ptp(positions, axis=0).max() < 1e-6
    return group.vertices[:, midrib], positions[0]


def flat_widths(group: OrganGroup, positions: FloatArray) -> FloatArray:
    """`(n,)` metres across blades, as if they were flat between jaws parallel to the midrib.

    At each relative position along the midrib the blade is cut across. The width of each half is an arc from
    the midrib over the middle of the half to the margin (two chords plus a third of their excess over the
    single chord), which does not follow small bulges. Each jaw touches its half at the widest cut.
    """
    edges = np.unique(np.sort(group.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    return np.max([_half_widths(group, edges, position) for position in positions], axis=0).sum(axis=1)


def _half_widths(group: OrganGroup, edges: IntArray, position: float) -> FloatArray:
    """`(n, 2)` metres from the midrib to the left and to the right margin."""
    start, end = group.uv[:, edges[:, 0], 1] - position, group.uv[:, edges[:, 1], 1] - position
    blade, edge = np.nonzero((start <= 0.0) != (end <= 0.0))
    fraction = start[blade, edge] / (start[blade, edge] - end[blade, edge])
    a, b = edges[edge].T
    points = _interpolate(group.vertices[blade, a], group.vertices[blade, b], fraction[:, None])
    across = _interpolate(group.uv[blade, a, 0], group.uv[blade, b, 0], fraction)
    # All cuts on one scale, blade after blade, from left to right.
    key = 2.0 * blade + across
    order = np.argsort(key, kind="stable")
    key, points, across, blade = key[order], points[order], across[order], blade[order]
    n = np.arange(len(group.vertices))
    left, right = np.searchsorted(blade, n), np.searchsorted(blade, n, side="right") - 1

    def point_at(u: FloatArray) -> FloatArray:
        return np.stack([np.interp(2.0 * n + u, key, points[:, axis]) for axis in range(3)], axis=1)

    midrib, widths = point_at(np.full(len(n), 0.5)), []
    for margin in (left, right):
        middle = point_at(0.5 * (0.5 + across[margin]))
        single = np.linalg.norm(points[margin] - midrib, axis=1)
        double = np.linalg.norm(points[margin] - middle, axis=1) + np.linalg.norm(middle - midrib, axis=1)
        widths.append(double + (double - single) / 3.0)
    return np.stack(widths, axis=1)


def _interpolate(first: FloatArray, second: FloatArray, fraction: FloatArray) -> FloatArray:
    return first + fraction * (second - first)


def axes(group: OrganGroup) -> FloatArray:
    """`(n, 3)` unit vectors from the stalk end of fruit to their blossom end."""
    height = group.uv[0, :, 1]
    return unit(group.vertices[:, np.argmax(height)] - group.vertices[:, np.argmin(height)])


def fruit_sizes(group: OrganGroup) -> tuple[FloatArray, FloatArray]:
    """Length along the axis `(n,)` and greatest width across it `(n,)`, metres, between a calliper's jaws."""
    z = axes(group)
    x = unit(np.cross(z, np.eye(3)[np.argmin(np.abs(z), axis=1)]))
    y = np.cross(z, x)
    across_x, across_y, along = (np.einsum("nvi,ni->nv", group.vertices, axis) for axis in (x, y, z))
    width = np.zeros(len(z))
    for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        width = np.maximum(width, np.ptp(np.cos(angle) * across_x + np.sin(angle) * across_y, axis=1))
    return np.ptp(along, axis=1), width


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
    """`(n,)` inclinations at the base and at the tip of lines `(n, k, 3)`, by a fit to the complete lines.

    Fits a + b s + c s^1.5, with s from 0 at the base to 1, to the pieces' inclinations weighted by length: a
    uniform bend, and one that increases as a stalk gets thinner.
    """
    pieces = np.diff(lines, axis=1)
    length = np.linalg.norm(pieces, axis=2)
    position = np.concatenate([np.zeros((len(lines), 1)), np.cumsum(length, axis=1)], axis=1)
    position /= position[:, -1:]
    start, end = position[:, :-1], position[:, 1:]
    # The mean of each term over a piece.
    width = end - start
    terms = [np.ones_like(width), 0.5 * (start + end), (end**2.5 - start**2.5) / (2.5 * width)]
    design = np.stack(terms, axis=2)
    weighted = design * width[..., None]
    slopes = inclinations(pieces, azimuth[:, None])
    right_side = np.einsum("npk,np->nk", weighted, slopes)[..., None]
    fit = np.linalg.solve(np.einsum("npk,npl->nkl", weighted, design), right_side)[..., 0]
    return fit[:, 0], fit.sum(axis=1)


def middle_inclinations(lines: FloatArray, positions: FloatArray, azimuth: FloatArray) -> FloatArray:
    """`(n,)` inclination of lines `(n, k, 3)` at half their length: a chord over the middle fifth."""
    smooth = CubicSpline(positions, lines, axis=1)
    return inclinations(smooth(0.6) - smooth(0.4), azimuth)

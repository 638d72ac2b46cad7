"""What the views of a path can see, and what of the rest their light can tell apart from something simpler.

A scene serves all poses of a path, so that a frame does not depend on which others are asked for: what goes
is decided once, for all of them. An organ that no pose can see, and that stands in no flash's way to what one
can see, only sends and takes soft light; a stand-in of few triangles does that as well. Far away it does too
little to count, and is left out.

What a view can see stays as it is, however far: labels leave no room for less. Outlines that shift by d
pixels change the labels of d times the outlines' length. In `barth2018` at 800x600 that length is 0.07 a
pixel, so that 0.05 % of the pixels allow a shift of 0.007 pixels. Half the grid lines move the points of a
leaf by 0.7 mm on average, which comes down to so little beyond 45 m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh
from pepperscene.scene.frustum import ViewFrustums, gaps, lamps
from pepperscene.scene.lod import stand_ins
from pepperscene.scene.sky import SUN_ANGULAR_RADIUS

_LONG: Final = 2500  # chosen: faces of an instance that is looked at in pieces; twine and rows, but no organ
_PIECE: Final = 256  # chosen: faces of a piece, about the leaves of one node in a far row
_MOST_DAYLIGHT: Final = 0.03
"""Chosen: stand-ins cover some 15 % less of the sky; of 3 % of the light that is half a per cent, half a code
at middle grey, were there nothing else overhead."""

LEAST_LIGHT: Final = 1e-3
"""What all that is left out may change, as a share of the light at the path's distance: chosen, a twentieth
of a code of 8 bits at middle grey."""


@dataclass(frozen=True)
class LightReach:
    """How much light what is not seen can give or take, as shares of the light at the path's distance.

    Attributes:
        sky: what the sky gives to a level plane in the open.
        sun: what the sun's disc gives to a plane that faces it.
        stray: what the flash gives just beside the picture, at the path's distance.
        distance_m: the path's.
        lamp_m: from the projection centre to the furthest point of the flash.
    """

    sky: float
    sun: float
    stray: float
    distance_m: float
    lamp_m: float = 0.0

    @property
    def simple(self) -> bool:
        """Whether stand-ins will do: daylight is small enough that nobody sees what shades it."""
        return self.sky + self.sun <= _MOST_DAYLIGHT


def light_reach(camera: Camera, distance_m: float, sky_lx: float, sun_lx: float = 0.0) -> LightReach:
    """How much light what is not seen can give or take.

    A flash told in W m-2 cannot be compared with lux: daylight then counts in full, as it does without one.

    Args:
        camera: its flash and its field of view.
        distance_m: from the path to what it shows.
        sky_lx: from the sky on a level plane in the open.
        sun_lx: from the sun's disc on a plane that faces it.
    """
    flash, slopes = camera.flash, np.abs(camera.ray_slopes())
    if flash is None:
        return LightReach(1.0, 1.0, 0.0, distance_m)
    # Beside the picture, and beside what lies in the flash's way to it, lies what is at least as far off the
    # flash's axis as the nearest border.
    borders = (slopes[0, :, 1].min(), slopes[-1, :, 1].min(), slopes[:, 0, 0].min(), slopes[:, -1, 0].min())
    beyond = np.linspace(np.arctan(min(borders)), np.pi / 2.0, 65)
    stray = float(np.max(flash.profile.at(beyond)))
    lamp = float(np.linalg.norm(lamps(flash), axis=1).max()) + flash.radius_m
    if flash.illuminance_lx is None:
        return LightReach(float(sky_lx > 0.0), float(sun_lx > 0.0), stray, distance_m, lamp)
    # The flash shines for a part of the exposure.
    flash_lx = flash.illuminance_lx * (flash.at_m / distance_m) ** 2 * camera.flash_duty
    whole = flash_lx + sky_lx + sun_lx
    return LightReach(sky_lx / whole, sun_lx / whole, stray * flash_lx / whole, distance_m, lamp)


@dataclass(frozen=True, eq=False)
class Pieces:
    """The runs of faces of a mesh that are kept or go together: an organ, or a part of a long thing.

    Attributes:
        faces: `(n + 1,)` first face of each, and the end of the last.
        vertices: `(n, 2)` first vertex that it uses and the one after the last.
        owner: `(n,)` its instance.
        whole: `(n,)` whether it is all of its instance.
        centres, halves: `(n, 3)` float32, metres: middle and half extent of the box that holds it.
    """

    faces: NDArray[np.intp]
    vertices: NDArray[np.intp]
    owner: NDArray[np.intp]
    whole: NDArray[np.bool_]
    centres: NDArray[np.float32]
    halves: NDArray[np.float32]

    @cached_property
    def radii(self) -> NDArray[np.float32]:
        """`(n,)` metres, of the ball round the centre that holds the box."""
        return np.asarray(np.linalg.norm(self.halves, axis=1))


def pieces(mesh: Mesh) -> Pieces:
    """The organs of a mesh, and the parts of what is long."""
    change = 1 + np.flatnonzero(mesh.face_instance[1:] != mesh.face_instance[:-1])
    runs = np.concatenate([[0], change, [len(mesh.faces)]])
    size = np.diff(runs)
    parts = np.where(size > _LONG, -(-size // _PIECE), 1)
    # Part k of n begins at face k * size / n of its run.
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    starts = np.repeat(runs[:-1], parts) + number * np.repeat(size, parts) // np.repeat(parts, parts)
    owner = mesh.face_instance[starts].astype(np.intp)
    runs_of = np.bincount(owner, minlength=len(mesh.instances))

    # The box of all vertices between the first and the last of a piece holds the piece.
    corners = mesh.faces.ravel()
    low = np.minimum.reduceat(corners, 3 * starts).astype(np.intp)
    high = np.maximum.reduceat(corners, 3 * starts).astype(np.intp) + 1
    least, most = _bounds(mesh.vertices, low, high)
    half = (most - least) / 2.0
    return Pieces(
        np.append(starts, len(mesh.faces)),
        np.stack([low, high], axis=1),
        owner,
        runs_of[owner] == 1,
        least + half,
        half,
    )


def _bounds(
    points: NDArray[np.float32], low: NDArray[np.intp], high: NDArray[np.intp]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`(n, 3)` and `(n, 3)`: least and greatest coordinates of points low to high - 1, for each of n."""
    ends = np.stack([low, np.minimum(high, len(points) - 1)], axis=1).ravel()
    least = np.minimum.reduceat(points, ends, axis=0)[::2]
    most = np.maximum.reduceat(points, ends, axis=0)[::2]
    # The last point of all cannot be an end.
    last = high == len(points)
    least[last], most[last] = np.minimum(least[last], points[-1]), np.maximum(most[last], points[-1])
    return least, most


def negligible(
    found: Pieces, seen: NDArray[np.bool_], view: ViewFrustums, light: LightReach
) -> NDArray[np.bool_]:
    """`(n,)` which pieces can be left out: those that matter least, as many as together stay below
    `LEAST_LIGHT`.

    A ball of radius r at the distance d from a point covers at most (r / d)^2 of the cosine-weighted sky
    there. By so much of the sky's and the sun's light it can shade or light the point, were it white; so much
    can it throw there of the flash's stray light, which falls with the square of the distance from the flash.
    Of the sun's disc, of angular radius s, it can hide (r / d)^2 / s^2.
    """
    out = np.zeros(len(seen), dtype=bool)
    if not seen.any() or seen.all():
        return out
    hidden, lit = np.flatnonzero(~seen), np.flatnonzero(seen)
    centres, radii = found.centres[hidden], found.radii[hidden]
    near = np.maximum(view.distances(centres, radii) - light.lamp_m, 1e-3)
    share = light.sky + light.sun + light.stray * (light.distance_m / near) ** 2

    def weight(rows: NDArray[np.intp], others: NDArray[np.intp]) -> NDArray[np.float32]:
        """At the surface of the nearest of other balls, as seen from the middle of a ball."""
        away = gaps(centres[rows], found.centres[others], found.radii[others])
        form = (radii[rows] / np.maximum(away, radii[rows])) ** 2
        return np.asarray(share[rows] * form + light.sun * np.minimum(form / SUN_ANGULAR_RADIUS**2, 1.0))

    # By a few of those that are seen each matters at least so much; all are asked about the rest alone.
    few = _cheapest(weight(np.arange(len(hidden)), lit[:: max(1, len(lit) // 64)]))
    if few.size:
        out[hidden[few[_cheapest(weight(few, lit))]]] = True
    return out


def _cheapest(weights: NDArray[np.float32]) -> NDArray[np.intp]:
    """The smallest of the weights, as many as together stay below `LEAST_LIGHT`."""
    order = np.argsort(weights, kind="stable")
    return order[np.cumsum(weights[order], dtype=float) <= LEAST_LIGHT]


def cull_mesh(mesh: Mesh, view: ViewFrustums, light: LightReach) -> Mesh:
    """The mesh with what no view can see made simple, or left out where it does not matter.

    Instances stay as they are, so that their numbers do. Triangles that a view can see, or that can stand
    between it or its flash and what is seen, are those of the mesh, in the same order.

    Args:
        mesh: everything placed; the faces of an organ lie together.
        view: all views of the scene.
        light: how much light what is not seen can give or take.
    """
    found = pieces(mesh)
    seen = view.meets(found.centres, found.halves)
    if seen.all() or not seen.any():
        return mesh
    out = negligible(found, seen, view, light)
    if not light.simple:
        return _kept(mesh, np.repeat(~out, np.diff(found.faces))) if out.any() else mesh
    simple = np.flatnonzero(~seen & ~out & found.whole)
    ends = np.stack([found.faces[simple], found.faces[simple + 1]], axis=1)
    stand_in, replaced = stand_ins(mesh, ends, found.vertices[simple])
    out[simple[replaced]] = True
    return _joined(_kept(mesh, np.repeat(~out, np.diff(found.faces))), stand_in)


def _kept(mesh: Mesh, kept: NDArray[np.bool_]) -> Mesh:
    """The mesh with some of its faces, and the vertices that they use."""
    faces = mesh.faces.compress(kept, axis=0)
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[faces] = True
    return replace(
        mesh,
        vertices=mesh.vertices.compress(used, axis=0),
        normals=mesh.normals.compress(used, axis=0),
        uv=mesh.uv.compress(used, axis=0),
        state=mesh.state[used],
        faces=(np.cumsum(used, dtype=np.uint32) - np.uint32(1))[faces],
        face_instance=mesh.face_instance[kept],
        face_surface=mesh.face_surface[kept],
    )


def _joined(one: Mesh, other: Mesh) -> Mesh:
    """Both meshes, which share instances and surfaces."""
    return replace(
        one,
        vertices=np.concatenate([one.vertices, other.vertices]),
        normals=np.concatenate([one.normals, other.normals]),
        uv=np.concatenate([one.uv, other.uv]),
        state=np.concatenate([one.state, other.state]),
        faces=np.concatenate([one.faces, other.faces + np.uint32(len(one.vertices))]),
        face_instance=np.concatenate([one.face_instance, other.face_instance]),
        face_surface=np.concatenate([one.face_surface, other.face_surface]),
    )

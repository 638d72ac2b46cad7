"""Long straight bodies along x with one convex cross-section: what a greenhouse is built of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes, rectangle, single_instance_mesh
from pepperscene.scene.row import DoubleRow

_SIDES = 12  # chosen: a wire or a pipe is some pixels wide


def beam(section: ArrayLike, ends: tuple[float, float], surface: str, *, smooth: bool = False) -> Mesh:
    """A closed prism along x.

    Args:
        section: `(k, 2)` y and z of its convex cross-section in metres, counter-clockwise seen from +x.
        ends: x of its two ends in metres, the first one less.
        surface: name of its surface.
        smooth: whether its sides look round.

    Returns:
        u runs around, v along; state is 0.5; one instance "beam" of the background.

    Raises:
        ValueError: the section is not convex and counter-clockwise, or the ends are not in order.
    """
    corners = np.asarray(section, dtype=float)
    k = len(corners)
    edge = np.roll(corners, -1, axis=0) - corners
    turning = edge[:, 0] * np.roll(edge, -1, axis=0)[:, 1] - edge[:, 1] * np.roll(edge, -1, axis=0)[:, 0]
    if k < 3 or not np.all(turning > 0.0) or not ends[0] < ends[1]:
        raise ValueError("a beam needs a convex section, counter-clockwise, and two ends in order")
    out = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    # Four corners to a side: both ends of its first edge, then of its second.
    side = np.stack([np.arange(k), (np.arange(k) + 1) % k] * 2, axis=1)
    at = np.repeat(ends, 2)[None, :].repeat(k, axis=0)
    normals = np.repeat(out[:, None], 4, axis=1)
    if smooth:
        mean = out + np.roll(out, 1, axis=0)
        normals = (mean / np.linalg.norm(mean, axis=1, keepdims=True))[side]
    u = np.stack([np.arange(k), np.arange(k) + 1] * 2, axis=1) / k
    sides = np.dstack([at, corners[side]]), np.pad(normals, ((0, 0), (0, 0), (1, 0)))
    quads = 4 * np.arange(k)[:, None, None] + np.array([[0, 1, 3], [0, 3, 2]])
    # Lids are fans about their first corner.
    span = np.ptp(corners, axis=0)
    flat = (corners - corners.min(axis=0)) / span
    lids = [np.column_stack([np.full(k, x), corners]) for x in ends]
    facing = np.repeat([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], k, axis=0)
    fan = np.stack([np.zeros(k - 2, int), np.arange(1, k - 1), np.arange(2, k)], axis=1)
    faces = np.concatenate([quads.reshape(-1, 3), 4 * k + fan[:, ::-1], 5 * k + fan])
    along = np.tile([0.0, 0.0, 1.0, 1.0], k)
    vertices = np.concatenate([sides[0].reshape(-1, 3), *lids])
    normals = np.concatenate([sides[1].reshape(-1, 3), facing])
    uv = np.concatenate([np.column_stack([u.ravel(), along]), flat, flat])
    state = np.full(len(vertices), 0.5)
    return single_instance_mesh(vertices, normals, uv, state, faces, OrganClass.BACKGROUND, "beam", surface)


def box(y: tuple[float, float], z: tuple[float, float], ends: tuple[float, float], surface: str) -> Mesh:
    """A closed box between two values of each coordinate, in metres."""
    return beam([(y[0], z[0]), (y[1], z[0]), (y[1], z[1]), (y[0], z[1])], ends, surface)


def rod(y: float, z: float, radius_m: float, ends: tuple[float, float], surface: str) -> Mesh:
    """A closed round rod about the line at this y and z, in metres."""
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    section = np.column_stack([y + radius_m * np.cos(angle), z + radius_m * np.sin(angle)])
    return beam(section, ends, surface, smooth=True)


def as_one(mesh: Mesh, organ_class: OrganClass, kind: str) -> Mesh:
    """The mesh as a single instance."""
    whole = np.zeros(len(mesh.faces), dtype=np.uint32)
    return replace(mesh, face_instance=whole, instances=(Instance(organ_class, kind),))


_SHEET: Final = 0.004  # chosen: folded steel is thinner, but its rims are rolled
_RIM: Final = 0.05  # chosen: the slab stands out of the gutter, so that it can be changed
_SLAB: Final = (0.15, 0.075)  # chosen: width and height, a common size of rockwool slabs
_BLOCK: Final = (0.10, 0.10, 0.065)  # chosen: along, across, height, a common size of propagation blocks
_WIRE_RADIUS: Final = 0.002  # chosen: crop wires are 3 to 5 mm thick
_PIPE_RADIUS: Final = 0.0255  # the pipe-rail that carries harvest trolleys is made of 51 mm pipe
_GAUGE: Final = 0.55  # chosen: a common distance of the two pipes' axes
_PIPE_HEIGHT: Final = 0.1  # chosen: of the axes, on low supports
_FLOOR_REACH: Final = 30.0  # chosen: for an eye at 1.5 m it ends 3 degrees below the horizon


@dataclass(frozen=True)
class Greenhouse:
    """The greenhouse around a double row; what is 0 or False is not there.

    Attributes:
        row_lean_rad: of each row towards its own aisle, away from the other row (V-trellis).
        lean_sd_rad: spread of the plants' lean about that of the row.
        turn_sd_rad: spread of the plants' turn about their own vertical axes.
        spacing_sd_m: spread of the places along the row about even spacing.
        across_sd_m: spread of the plants' feet across the row.
        gutter_width_m: of the gutter under each row.
        gutter_height_m: of its underside above the floor; 0 lies on it.
        floor: whether film lies on the floor.
        crop_wire_m: height above the floor of the wire that the twine of a row is tied to.
        far_rows: further double rows on either side.
        far_reach_m: how far all rows reach to either side of the middle plant.
        aisle_m: between double rows.
        pipes: whether two heating pipes lie in every aisle.
    """

    row_lean_rad: float = 0.0
    lean_sd_rad: float = 0.0
    turn_sd_rad: float = 0.0
    spacing_sd_m: float = 0.0
    across_sd_m: float = 0.0
    gutter_width_m: float = 0.0
    gutter_height_m: float = 0.0
    floor: bool = False
    crop_wire_m: float = 0.0
    far_rows: int = 0
    far_reach_m: float = 4.0
    aisle_m: float = 1.2
    pipes: bool = False

    @property
    def foot_m(self) -> float:
        """Height of the stems' feet above the floor: the upper side of the blocks that they root in."""
        if self.gutter_width_m == 0.0:
            return 0.0
        return self.gutter_height_m + _SHEET + _SLAB[1] + _BLOCK[2]

    def away(self, height_m: float) -> float:
        """By how much a row's middle has moved towards its aisle at a height above the floor, metres."""
        return float(np.tan(self.row_lean_rad)) * max(0.0, height_m - self.foot_m)

    def wire_above_foot(self) -> tuple[float, float] | None:
        """Where the row's wire runs, as the y and z of a plant with its aisle at -y; None without a wire."""
        if self.crop_wire_m == 0.0:
            return None
        return -self.away(self.crop_wire_m), self.crop_wire_m - self.foot_m


@dataclass(frozen=True)
class RowLine:
    """One row of the greenhouse.

    Attributes:
        y_m: where it stands.
        aisle: -1 where its own aisle lies at -y, 1 where it lies at +y.
        own: whether it belongs to the double row in front of the camera.
        shift_m: of its places along x.
    """

    y_m: float
    aisle: int
    own: bool
    shift_m: float


def row_lines(row: DoubleRow, house: Greenhouse) -> list[RowLine]:
    """The double row's own rows, front first, then those of its neighbours, nearest first."""
    single = row.back == 0
    pitch = house.aisle_m + (0.0 if single else row.gap_m)
    lines = []
    for number in sorted(range(-house.far_rows, house.far_rows + 1), key=lambda n: (abs(n), n)):
        lines.append(RowLine(number * pitch, -1, number == 0, 0.0))
        if not single:
            lines.append(RowLine(number * pitch + row.gap_m, 1, number == 0, row.shift_m))
    return lines


def greenhouse_mesh(row: DoubleRow, house: Greenhouse, places: NDArray[np.float64]) -> list[Mesh]:
    """All that is asked for besides plants, one instance for each thing.

    Args:
        row: in front of the camera.
        house: what there is.
        places: `(n, 2)` x and y of the double row's plants, where blocks stand in the gutters.

    Returns:
        Meshes of the class background, but for the crop wires of the double row, which are of the class wire.
    """
    lines, reach = row_lines(row, house), (-house.far_reach_m, house.far_reach_m)
    things: list[Mesh] = []
    if house.gutter_width_m > 0.0:
        things += [part for line in lines for part in _gutter(line.y_m, house, reach)]
        things.append(_blocks(places, house, row.spacing_m))
    if house.crop_wire_m > 0.0:
        things += [_wire(line, house, reach) for line in lines]
    if house.pipes:
        things += [_pipe(y, reach) for y in _pipe_lines(row, house)]
    if house.floor:
        things.append(_floor())
    return things


def _gutter(y: float, house: Greenhouse, reach: tuple[float, float]) -> list[Mesh]:
    """A gutter out of a bottom and two sides, and the slab in it, wrapped in white foil."""
    bottom, half = house.gutter_height_m, house.gutter_width_m / 2.0
    parts = [box((y - half, y + half), (bottom, bottom + _SHEET), reach, "gutter")]
    for side in (y - half, y + half - _SHEET):
        parts.append(box((side, side + _SHEET), (bottom + _SHEET, bottom + _RIM), reach, "gutter"))
    wide = min(_SLAB[0], house.gutter_width_m - 4.0 * _SHEET) / 2.0
    slab = box((y - wide, y + wide), (bottom + _SHEET, bottom + _SHEET + _SLAB[1]), reach, "foil")
    return [
        as_one(concatenate_meshes(parts), OrganClass.BACKGROUND, "gutter"),
        as_one(slab, OrganClass.BACKGROUND, "slab"),
    ]


def _blocks(places: NDArray[np.float64], house: Greenhouse, spacing_m: float) -> Mesh:
    """The blocks that the plants root in: foil around rockwool whose top is open."""
    top, half = house.foot_m, _BLOCK[1] / 2.0
    along = min(_BLOCK[0], 0.9 * spacing_m) / 2.0
    parts: list[Mesh] = []
    for x, y in places:
        ends, skin = (x - along, x + along), top - _SHEET
        parts.append(box((y - half, y + half), (top - _BLOCK[2], skin), ends, "foil"))
        parts.append(box((y - half, y + half), (skin, top), ends, "rockwool"))
    return as_one(concatenate_meshes(parts), OrganClass.BACKGROUND, "block")


def _wire(line: RowLine, house: Greenhouse, reach: tuple[float, float]) -> Mesh:
    """The wire above a row, which has moved towards the row's aisle as far as the row leans."""
    y = line.y_m + line.aisle * house.away(house.crop_wire_m)
    wire = rod(y, house.crop_wire_m, _WIRE_RADIUS, reach, "steel")
    return as_one(wire, OrganClass.WIRE if line.own else OrganClass.BACKGROUND, "crop_wire")


def _pipe_lines(row: DoubleRow, house: Greenhouse) -> Sequence[float]:
    """The y of the two pipes in each aisle, those of the camera's own aisle first."""
    gap = 0.0 if row.back == 0 else row.gap_m
    gauge = min(_GAUGE, 0.5 * house.aisle_m)  # a narrow aisle has a narrower pair
    aisles = range(-house.far_rows, house.far_rows + 2)
    middles = [n * (house.aisle_m + gap) - house.aisle_m / 2.0 for n in sorted(aisles, key=abs)]
    return [middle + side * gauge / 2.0 for middle in middles for side in (-1.0, 1.0)]


def _pipe(y: float, reach: tuple[float, float]) -> Mesh:
    pipe = rod(y, _PIPE_HEIGHT, _PIPE_RADIUS, reach, "pipe")
    return as_one(pipe, OrganClass.BACKGROUND, "heating_pipe")


def _floor() -> Mesh:
    """The film on the floor, level, far beyond the rows."""
    film = rectangle(
        (0.0, 0.0, 0.0), (2.0 * _FLOOR_REACH, 0.0, 0.0), (0.0, 2.0 * _FLOOR_REACH, 0.0), "floor_film"
    )
    return as_one(film, OrganClass.BACKGROUND, "floor_film")


_MOST: Final = 3.0  # standard deviations; what lies beyond is laid there, 0.3 % of all


@dataclass(frozen=True)
class Posture:
    """What a plant keeps wherever it stands.

    Attributes:
        across_m: of its foot, away from its aisle.
        lean_rad: towards its aisle.
        turn_rad: about its own vertical axis, counter-clockwise seen from above.
    """

    across_m: float = 0.0
    lean_rad: float = 0.0
    turn_rad: float = 0.0


def draw_posture(house: Greenhouse, rng: np.random.Generator) -> Posture:
    """How one plant stands: normal spreads about its row's line, lean and facing."""
    across, lean, turn = _normal(rng, 3)
    return Posture(
        across_m=float(house.across_sd_m * across),
        lean_rad=float(house.row_lean_rad + house.lean_sd_rad * lean),
        turn_rad=float(house.turn_sd_rad * turn),
    )


def jittered_places(row: DoubleRow, house: Greenhouse, rng: np.random.Generator) -> NDArray[np.float64]:
    """`(n, 2)` x and y of the places of a double row: along the row, each lies by chance off its spot."""
    places = row.places()
    places[:, 0] += house.spacing_sd_m * _normal(rng, len(places))
    return places


def _normal(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Standard normal numbers, none further out than `_MOST`."""
    return np.clip(rng.standard_normal(count), -_MOST, _MOST)

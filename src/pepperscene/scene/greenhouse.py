"""The greenhouse around a double row: gutters, slabs, wires, pipes, floor, and irregular plant positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Annotated, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes, rectangle, single_instance_mesh
from pepperscene.scene.row import DoubleRow
from pepperscene.units import DEGREES, MILLIMETRES, Switch, Table, file_values, within

_ROD_SIDES: Final = 12  # chosen: a wire or a pipe is a few pixels wide
_SHEET: Final = 0.004  # chosen: folded steel is thinner, but its rims are rolled
_RIM: Final = 0.05  # chosen: the slab rises above the gutter, so that it can be replaced
_SLAB: Final = (0.15, 0.075)  # chosen: width and height, a common size of rockwool slabs
_BLOCK: Final = (0.10, 0.10, 0.065)  # chosen: along, across, height, a common size of propagation blocks
_WIRE_RADIUS: Final = 0.002  # chosen: crop wires are 3 to 5 mm thick
_PIPE_RADIUS: Final = 0.0255  # the pipe rail that carries harvest trolleys is made of 51 mm pipe
_GAUGE: Final = 0.55  # chosen: a common distance of the two pipes' axes
_PIPE_HEIGHT: Final = 0.1  # chosen: of the axes, on low supports
_FLOOR_SIZE: Final = 60.0  # chosen: seen from 1.5 m above its centre, it ends 3 degrees below the horizon
_MIN_GUTTER_WIDTH_MM: Final = 110  # the substrate block of a plant is 100 mm wide
_MIN_WIRE_HEIGHT_MM: Final = 500  # above the gutter; chosen: a lower wire could hardly hold a stem
_MAX_DEVIATIONS: Final = 3.0  # standard deviations; the 0.3 % of draws beyond are clipped to it


def beam(section: ArrayLike, ends: tuple[float, float], surface: str, *, smooth: bool = False) -> Mesh:
    """A closed prism along x.

    Args:
        section: `(k, 2)` y and z of its convex cross-section in metres, counter-clockwise seen from +x.
        ends: x of its two ends in metres, ascending.
        surface: name of its surface.
        smooth: whether its sides are shaded as round.

    Returns:
        A single instance "beam" of the background; u runs around, v along, and the state is 0.5.

    Raises:
        ValueError: the section is not convex and counter-clockwise, or the ends are not ascending.
    """
    corners = np.asarray(section, dtype=float)
    k = len(corners)
    edge = np.roll(corners, -1, axis=0) - corners
    turning = edge[:, 0] * np.roll(edge, -1, axis=0)[:, 1] - edge[:, 1] * np.roll(edge, -1, axis=0)[:, 0]
    if k < 3 or not np.all(turning > 0.0) or not ends[0] < ends[1]:
        raise ValueError("a beam needs a convex, counter-clockwise section and ascending ends")
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)

    # Sides: four corners each, both ends of the first edge, then of the second.
    side = np.stack([np.arange(k), (np.arange(k) + 1) % k] * 2, axis=1)
    x = np.repeat(ends, 2)[None, :].repeat(k, axis=0)
    normals = np.repeat(outward[:, None], 4, axis=1)
    if smooth:
        mean = outward + np.roll(outward, 1, axis=0)
        normals = (mean / np.linalg.norm(mean, axis=1, keepdims=True))[side]
    side_u = np.stack([np.arange(k), np.arange(k) + 1] * 2, axis=1) / k
    quads = 4 * np.arange(k)[:, None, None] + np.array([[0, 1, 3], [0, 3, 2]])

    # Lids: fans around the first corner.
    lid_uv = (corners - corners.min(axis=0)) / np.ptp(corners, axis=0)
    fan = np.stack([np.zeros(k - 2, int), np.arange(1, k - 1), np.arange(2, k)], axis=1)

    vertices = [np.dstack([x, corners[side]]).reshape(-1, 3)]
    vertices += [np.column_stack([np.full(k, end), corners]) for end in ends]
    side_normals = np.pad(normals, ((0, 0), (0, 0), (1, 0))).reshape(-1, 3)
    lid_normals = np.repeat([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], k, axis=0)
    side_uv = np.column_stack([side_u.ravel(), np.tile([0.0, 0.0, 1.0, 1.0], k)])
    return single_instance_mesh(
        np.concatenate(vertices),
        np.concatenate([side_normals, lid_normals]),
        np.concatenate([side_uv, lid_uv, lid_uv]),
        np.full(6 * k, 0.5),
        np.concatenate([quads.reshape(-1, 3), 4 * k + fan[:, ::-1], 5 * k + fan]),
        OrganClass.BACKGROUND,
        "beam",
        surface,
    )


def box(y: tuple[float, float], z: tuple[float, float], ends: tuple[float, float], surface: str) -> Mesh:
    """A closed box between two values of each coordinate, in metres."""
    return beam([(y[0], z[0]), (y[1], z[0]), (y[1], z[1]), (y[0], z[1])], ends, surface)


def rod(y: float, z: float, radius_m: float, ends: tuple[float, float], surface: str) -> Mesh:
    """A closed round rod along x with its axis at this y and z, in metres."""
    angle = 2.0 * np.pi * np.arange(_ROD_SIDES) / _ROD_SIDES
    section = np.column_stack([y + radius_m * np.cos(angle), z + radius_m * np.sin(angle)])
    return beam(section, ends, surface, smooth=True)


def as_single_instance(mesh: Mesh, kind: str, organ_class: OrganClass = OrganClass.BACKGROUND) -> Mesh:
    """The mesh with all its faces in one instance; they keep their surfaces and appearances."""
    face_instance = np.zeros(len(mesh.faces), dtype=np.uint32)
    return replace(mesh, face_instance=face_instance, instances=(Instance(organ_class, kind),))


class FarRowsAs(StrEnum):
    """What the plants of far rows are in label images."""

    LABELS = "labels"  # organs, each with its class
    IGNORE = "ignore"  # `IGNORE_CLASS`, one instance for each row
    BACKGROUND = "background"  # one instance of the background class for each row


@dataclass(frozen=True)
class Greenhouse(Table):
    """Surroundings of a double row, and irregularity of its plants; parts that are 0 or False are left out.

    Attributes:
        row_lean_rad: of both rows, each towards its own aisle and away from the other (V-trellis); stems
            lean, fruit hangs vertically.
        lean_sd_rad: standard deviation of the plants' lean about that of their row.
        turn_sd_rad: standard deviation of the plants' rotation about their vertical axes, in addition to the
            cultivar's angles to the aisle.
        spacing_sd_m: standard deviation of the positions along the row about even spacing.
        across_sd_m: standard deviation of the stems' feet across the row.
        gutter_width_m: 0 for none, or at least 110: of the white gutter under each row, with a slab of
            substrate and a block under every plant; at most the `gap_mm` of `[row]` and `aisle_m`.
        gutter_height_m: of its underside above the floor. The stems' feet are 144 mm higher, on the blocks.
        floor: white film on the floor.
        crop_wire_m: 0 for none; height above the floor of a steel wire over each row, which holds the twine;
            at least 500 above `gutter_height_m`.
        far_rows: double rows on either side, beyond the aisles.
        far_rows_as: what the plants beyond the recipe's own are in labels.
        far_reach_m: extent of rows, gutters, wires and pipes to either side of the middle plant.
        aisle_m: distance between double rows.
        pipes: two white heating pipes on low supports in every aisle.
    """

    row_lean_rad: Annotated[float, within(0, 20), DEGREES] = 0.0
    lean_sd_rad: Annotated[float, within(0, 10), DEGREES] = 0.0
    turn_sd_rad: Annotated[float, within(0, 180), DEGREES] = 0.0
    spacing_sd_m: Annotated[float, within(0, 500), MILLIMETRES] = 0.0
    across_sd_m: Annotated[float, within(0, 500), MILLIMETRES] = 0.0
    gutter_width_m: Annotated[float, within(0, 1000), MILLIMETRES] = 0.0
    gutter_height_m: Annotated[float, within(0, 1500), MILLIMETRES] = 0.0
    floor: Switch = False
    crop_wire_m: Annotated[float, within(0, 10_000), MILLIMETRES] = 0.0
    far_rows: Annotated[int, within(0, 5)] = 0
    far_rows_as: FarRowsAs = FarRowsAs.LABELS
    far_reach_m: Annotated[float, within(500, 20_000), MILLIMETRES] = 4.0
    aisle_m: Annotated[float, within(600, 5000), MILLIMETRES] = 1.2
    pipes: Switch = False

    def __post_init__(self) -> None:
        if self.gutter_width_m == 0 and self.gutter_height_m > 0:
            raise ValueError("gutter_height_mm needs a gutter_width_mm above 0")
        # In the file's unit, in which limits are not rounded.
        in_file = file_values(self)
        width_mm, wire_mm = in_file["gutter_width_mm"], in_file["crop_wire_mm"]
        if 0 < width_mm < _MIN_GUTTER_WIDTH_MM:
            raise ValueError(
                f"gutter_width_mm = {width_mm:g} must be 0 for none, or at least "
                f"{_MIN_GUTTER_WIDTH_MM}, so that a plant's block fits in"
            )
        if 0 < wire_mm < in_file["gutter_height_mm"] + _MIN_WIRE_HEIGHT_MM:
            raise ValueError(
                f"crop_wire_mm = {wire_mm:g} must be 0 for none, or at least "
                f"{_MIN_WIRE_HEIGHT_MM} above the gutter"
            )

    @property
    def stem_base_m(self) -> float:
        """Height of the stem bases above the floor: the upper side of the substrate blocks."""
        if self.gutter_width_m == 0.0:
            return 0.0
        return self.gutter_height_m + _SHEET + _SLAB[1] + _BLOCK[2]

    def lean_offset_m(self, height_m: float) -> float:
        """Distance that a row's middle is shifted towards its aisle at a height above the floor."""
        return float(np.tan(self.row_lean_rad)) * max(0.0, height_m - self.stem_base_m)

    def wire_position(self) -> tuple[float, float] | None:
        """Position of the row's wire: y and z from the stem base of a plant with its aisle at -y, or None."""
        if self.crop_wire_m == 0.0:
            return None
        return -self.lean_offset_m(self.crop_wire_m), self.crop_wire_m - self.stem_base_m


@dataclass(frozen=True)
class RowLine:
    """The line of one plant row."""

    y_m: float  # its position across the rows
    aisle: int  # -1 if its own aisle is at -y, 1 if it is at +y
    labelled: bool  # whether it belongs to the double row in front of the camera
    shift_m: float  # shift of its plants along x


def row_lines(row: DoubleRow, greenhouse: Greenhouse) -> list[RowLine]:
    """The labelled rows, front row first, then those of the neighbouring double rows, nearest first."""
    single = row.plants_back == 0
    pitch = greenhouse.aisle_m + (0.0 if single else row.gap_m)
    lines = []
    for number in sorted(range(-greenhouse.far_rows, greenhouse.far_rows + 1), key=lambda n: (abs(n), n)):
        lines.append(RowLine(number * pitch, -1, number == 0, 0.0))
        if not single:
            lines.append(RowLine(number * pitch + row.gap_m, 1, number == 0, row.shift_m))
    return lines


def greenhouse_mesh(row: DoubleRow, greenhouse: Greenhouse, positions: NDArray[np.float64]) -> list[Mesh]:
    """The greenhouse's parts except for plants, one instance each.

    Args:
        row: the double row in front of the camera.
        greenhouse: its dimensions.
        positions: `(n, 2)` x and y of the double row's plants, where blocks are placed in the gutters.

    Returns:
        Meshes of the background class; only the crop wires of the double row are of the wire class.
    """
    lines, ends = row_lines(row, greenhouse), (-greenhouse.far_reach_m, greenhouse.far_reach_m)
    meshes: list[Mesh] = []
    if greenhouse.gutter_width_m > 0.0:
        meshes += [part for line in lines for part in _gutter_and_slab(line.y_m, greenhouse, ends)]
        meshes.append(_substrate_blocks(positions, greenhouse, row.spacing_m))
    if greenhouse.crop_wire_m > 0.0:
        meshes += [_crop_wire(line, greenhouse, ends) for line in lines]
    if greenhouse.pipes:
        pipes = [rod(y, _PIPE_HEIGHT, _PIPE_RADIUS, ends, "pipe") for y in _pipe_axes(row, greenhouse)]
        meshes += [as_single_instance(pipe, "heating_pipe") for pipe in pipes]
    if greenhouse.floor:
        film = rectangle((0.0, 0.0, 0.0), (_FLOOR_SIZE, 0.0, 0.0), (0.0, _FLOOR_SIZE, 0.0), "floor_film")
        meshes.append(as_single_instance(film, "floor_film"))
    return meshes


def _gutter_and_slab(y: float, greenhouse: Greenhouse, ends: tuple[float, float]) -> list[Mesh]:
    """A gutter made of a bottom and two sides, and the slab in it, wrapped in white foil."""
    bottom, half = greenhouse.gutter_height_m, greenhouse.gutter_width_m / 2.0
    parts = [box((y - half, y + half), (bottom, bottom + _SHEET), ends, "gutter")]
    for side in (y - half, y + half - _SHEET):
        parts.append(box((side, side + _SHEET), (bottom + _SHEET, bottom + _RIM), ends, "gutter"))
    half = min(_SLAB[0], greenhouse.gutter_width_m - 4.0 * _SHEET) / 2.0
    slab = box((y - half, y + half), (bottom + _SHEET, bottom + _SHEET + _SLAB[1]), ends, "foil")
    return [as_single_instance(concatenate_meshes(parts), "gutter"), as_single_instance(slab, "slab")]


def _substrate_blocks(positions: NDArray[np.float64], greenhouse: Greenhouse, spacing_m: float) -> Mesh:
    """The substrate blocks: rockwool, open at the top and wrapped in foil."""
    top, half = greenhouse.stem_base_m, _BLOCK[1] / 2.0
    half_length = min(_BLOCK[0], 0.9 * spacing_m) / 2.0
    parts: list[Mesh] = []
    for x, y in positions:
        ends, foil_end = (x - half_length, x + half_length), top - _SHEET
        parts.append(box((y - half, y + half), (top - _BLOCK[2], foil_end), ends, "foil"))
        parts.append(box((y - half, y + half), (foil_end, top), ends, "rockwool"))
    return as_single_instance(concatenate_meshes(parts), "block")


def _crop_wire(line: RowLine, greenhouse: Greenhouse, ends: tuple[float, float]) -> Mesh:
    """The wire above a row, shifted towards the row's aisle as far as the row leans."""
    height = greenhouse.crop_wire_m
    y = line.y_m + line.aisle * greenhouse.lean_offset_m(height)
    wire = rod(y, height, _WIRE_RADIUS, ends, "steel")
    return as_single_instance(wire, "crop_wire", OrganClass.WIRE if line.labelled else OrganClass.BACKGROUND)


def _pipe_axes(row: DoubleRow, greenhouse: Greenhouse) -> Sequence[float]:
    """Positions in y of the two pipes in each aisle, those of the camera's aisle first."""
    gap = 0.0 if row.plants_back == 0 else row.gap_m
    gauge = min(_GAUGE, 0.5 * greenhouse.aisle_m)  # a narrow aisle has a narrower pair
    aisles = sorted(range(-greenhouse.far_rows, greenhouse.far_rows + 2), key=abs)
    middles = [n * (greenhouse.aisle_m + gap) - greenhouse.aisle_m / 2.0 for n in aisles]
    return [middle + side * gauge / 2.0 for middle in middles for side in (-1.0, 1.0)]


@dataclass(frozen=True)
class Posture:
    """Deviation of a plant from its regular position, the same wherever it is placed.

    Attributes:
        across_m: offset of its stem base, away from its aisle.
        lean_rad: lean towards its aisle.
        turn_rad: rotation about its vertical axis, counter-clockwise seen from above.
    """

    across_m: float = 0.0
    lean_rad: float = 0.0
    turn_rad: float = 0.0


def draw_posture(greenhouse: Greenhouse, rng: np.random.Generator) -> Posture:
    """Draw a plant's offset across the row, lean and rotation from normal distributions."""
    across, lean, turn = _clipped_normal(rng, 3)
    return Posture(
        across_m=float(greenhouse.across_sd_m * across),
        lean_rad=float(greenhouse.row_lean_rad + greenhouse.lean_sd_rad * lean),
        turn_rad=float(greenhouse.turn_sd_rad * turn),
    )


def jittered_positions(
    row: DoubleRow, greenhouse: Greenhouse, rng: np.random.Generator
) -> NDArray[np.float64]:
    """`(n, 2)` x and y of the plants of a double row, each shifted randomly along the row."""
    positions = row.positions()
    positions[:, 0] += greenhouse.spacing_sd_m * _clipped_normal(rng, len(positions))
    return positions


def _clipped_normal(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Standard normal numbers, clipped at `_MAX_DEVIATIONS`."""
    return np.clip(rng.standard_normal(count), -_MAX_DEVIATIONS, _MAX_DEVIATIONS)

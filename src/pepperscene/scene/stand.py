"""A stand for one plant: pot, stake, tray, turntable, backdrop and charts, of the background class.

The axes of a scene turn with the turntable: the plant does not move in them, and camera, backdrop, light and
the charts that do not turn go round it the other way. So labels, poses and point clouds of all frames are in
the plant's own axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from typing import Annotated, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes, single_instance_mesh
from pepperscene.scene.charts import CalibrationChart
from pepperscene.scene.greenhouse import as_single_instance
from pepperscene.scene.row import rotation_about_z
from pepperscene.scene.sky import Sky
from pepperscene.units import DEGREES, MILLIMETRES, Name, Switch, Table, ZeroOrAtLeast, within

_ROUND: Final = 64  # chosen: sides of round objects
_BASE: Final = {"round": 0.74, "square": 0.82}  # chosen: width of a pot's base over that of its rim
_WALL: Final = 0.03  # chosen: thickness of a pot's wall over its width
_LIP: Final = (0.04, 0.16)
"""Chosen: how far the rim stands out, and its height, over the width of a round pot."""
_BELOW_RIM: Final = 0.1  # chosen: free space above the substrate, over the height of the pot
_TRAY: Final = (1.15, 0.14)
"""Chosen: width of a tray over that of the pot's base, and its height over its width."""
_TRAY_FLOOR: Final = 0.003  # chosen
_TABLE_HEIGHT: Final = 0.03  # chosen: thickness of a turntable's disc
_STAKE: Final = (0.004, (0.015, 0.012))  # chosen: radius of a bamboo cane, and its place beside the stem
_GRAIN: Final = 0.004  # chosen: grains of substrate
_GRAIN_HEIGHT: Final = 0.0025  # chosen: standard deviation of their heights
_PERLITE: Final = 0.06  # chosen: fraction of grains that are perlite
_SUBSTRATE_SEED: Final = 4001  # chosen
_BEND: Final = 0.3  # chosen: radius of a cloth's curved lower edge over its distance from the plant, at most


class PotShape(StrEnum):
    """Cross-section of a pot, which tapers to its base."""

    ROUND = "round"
    SQUARE = "square"


class Backdrop(StrEnum):
    """What is behind the plant."""

    NONE = "none"
    CLOTH = "cloth"  # hangs behind the plant, and goes on below it with a curved edge
    CABIN = "cabin"  # a floor and three walls, open to the aisle and above


@dataclass(frozen=True, kw_only=True)
class Stand(Table):
    """A stand for a single plant in a pot; parts that are 0 or False are left out. All of it is background.

    Colours are `terracotta`, `black`, `white`, `grey`, `blue`, or the path of a CSV file of spectra, whose
    first column of reflectances is used.

    Attributes:
        pot: round or square; both taper to their base.
        pot_width_m: of the pot at its rim.
        pot_height_m: of the pot.
        pot_colour: a colour; also of the tray.
        tray: a tray below the pot.
        stake_m: 0 for none; height above the substrate of a bamboo cane beside the stem.
        turntable_m: 0 for none; diameter of the disc that carries the pot, at least its width.
        turn_rad: angle by which the plant turns from each view to the next, counter-clockwise seen from
            above; camera, light and backdrop stay.
        backdrop: a cloth behind and below the plant, a cabin of a floor and three walls, or none.
        backdrop_colour: a colour.
        backdrop_distance_m: from the plant's axis, also of a cabin's side walls.
        backdrop_width_m: of a cloth.
        backdrop_height_m: of a cloth or a wall.
        charts: marker boards, ColorCheckers and scale bars.
    """

    pot: PotShape = PotShape.ROUND
    pot_width_m: Annotated[float, within(50, 600), MILLIMETRES] = 0.14
    pot_height_m: Annotated[float, within(40, 600), MILLIMETRES] = 0.13
    pot_colour: Name = "terracotta"
    tray: Switch = False
    stake_m: Annotated[float, within(0, 3000), ZeroOrAtLeast(50), MILLIMETRES] = 0.0
    turntable_m: Annotated[float, within(0, 2000), MILLIMETRES] = 0.0
    turn_rad: Annotated[float, within(-180, 180), DEGREES] = 0.0
    backdrop: Backdrop = Backdrop.NONE
    backdrop_colour: Name = "white"
    backdrop_distance_m: Annotated[float, within(200, 5000), MILLIMETRES] = 0.6
    backdrop_width_m: Annotated[float, within(200, 10_000), MILLIMETRES] = 2.0
    backdrop_height_m: Annotated[float, within(200, 5000), MILLIMETRES] = 1.6
    charts: Annotated[tuple[CalibrationChart, ...], Field(max_length=20)] = ()

    def __post_init__(self) -> None:
        if 0 < self.turntable_m < self.pot_width_m:
            raise ValueError(
                f"turntable_mm = {1e3 * self.turntable_m:g} must be 0 for none, or at least pot_width_mm, "
                f"{1e3 * self.pot_width_m:g}"
            )
        if self.backdrop != Backdrop.NONE and self.backdrop_distance_m < 0.5 * max(
            self.turntable_m, self.pot_width_m
        ):
            raise ValueError("backdrop_distance_mm must be at least half of turntable_mm and pot_width_mm")

    @property
    def _pot_foot_m(self) -> float:
        """Height of the pot's underside above the ground."""
        on_table = _TABLE_HEIGHT if self.turntable_m else 0.0
        return on_table + (_TRAY_FLOOR if self.tray else 0.0)

    @property
    def stem_base_m(self) -> float:
        """Height of the stem's base above the ground: the substrate's surface."""
        return self._pot_foot_m + (1.0 - _BELOW_RIM) * self.pot_height_m

    def turned(self, step: int) -> float:
        """Angle in radians by which the plant has turned at a step, counter-clockwise seen from above."""
        return self.turn_rad * step


def stand_meshes(stand: Stand) -> tuple[list[Mesh], list[Mesh]]:
    """The parts of a stand, an instance each: those that turn with the plant, and those that stay."""
    turning = [_pot(stand), _substrate(stand)]
    if stand.tray:
        turning.append(_tray(stand))
    if stand.stake_m:
        turning.append(_stake(stand))
    if stand.turntable_m:
        radius = stand.turntable_m / 2.0
        disc = _lathe([(0.0, 0.0), (radius, 0.0), (radius, _TABLE_HEIGHT), (0.0, _TABLE_HEIGHT)], "turntable")
        turning.append(as_single_instance(disc, "turntable"))
    turning += [chart.mesh() for chart in stand.charts if chart.turns]
    staying = [chart.mesh() for chart in stand.charts if not chart.turns]
    if stand.backdrop != Backdrop.NONE:
        staying.append(_backdrop(stand))
    return turning, staying


def turned_parts(mesh: Mesh, instances: int, angle_rad: float) -> Mesh:
    """A mesh whose last instances are turned about the vertical, counter-clockwise seen from above."""
    turned = mesh.vertex_instance >= len(mesh.instances) - instances
    rotation = rotation_about_z(angle_rad).astype(np.float32)
    vertices, normals = mesh.vertices.copy(), mesh.normals.copy()
    vertices[turned], normals[turned] = vertices[turned] @ rotation.T, normals[turned] @ rotation.T
    return replace(mesh, vertices=vertices, normals=normals)


def turned_sky(sky: Sky, angle_rad: float) -> Sky:
    """A sky turned about the vertical, counter-clockwise seen from above; its maps are interpolated."""
    columns = sky.weights.shape[2]
    whole, share = divmod(float(angle_rad) / (2.0 * np.pi) * columns, 1.0)
    weights = (1.0 - share) * np.roll(sky.weights, int(whole), 2) + share * np.roll(
        sky.weights, int(whole) + 1, 2
    )
    sun = sky.sun
    if sun is not None:
        sun = replace(sun, direction=rotation_about_z(angle_rad) @ sun.direction)
    return Sky(weights.astype(np.float32), sky.radiance, sun)


def _pot(stand: Stand) -> Mesh:
    """A pot that tapers to its base, open above; a round one has a rim that stands out."""
    radius, height, foot = stand.pot_width_m / 2.0, stand.pot_height_m, stand._pot_foot_m
    wall, base = _WALL * stand.pot_width_m, _BASE[stand.pot] * radius
    out, lip = (_LIP[0] * radius, min(_LIP[1] * stand.pot_width_m, 0.5 * height))
    rim, neck = radius, radius - out
    inside = (neck - wall, 0.85 * (1.0 - _BELOW_RIM) * height)
    profile = [
        (0.0, 0.0), (base, 0.0), (neck, height - lip), (rim, height - lip), (rim, height),
        (neck - wall, height), inside,
    ]  # fmt: skip
    return as_single_instance(_lathe(profile, "pot", stand.pot, foot), "pot")


def _tray(stand: Stand) -> Mesh:
    """A flat tray below the pot, open above."""
    base = _TRAY[0] * _BASE[stand.pot] * stand.pot_width_m / 2.0
    height, foot = 2.0 * _TRAY[1] * base, stand._pot_foot_m - _TRAY_FLOOR
    profile = [
        (0.0, 0.0), (base, 0.0), (base + 0.1 * height, height), (base + 0.1 * height - _TRAY_FLOOR, height),
        (base - _TRAY_FLOOR, _TRAY_FLOOR), (0.0, _TRAY_FLOOR),
    ]  # fmt: skip
    return as_single_instance(_lathe(profile, "pot", stand.pot, foot), "tray")


def _stake(stand: Stand) -> Mesh:
    """A bamboo cane beside the stem, from the pot's base upwards."""
    radius, beside = _STAKE
    top = stand.stem_base_m + stand.stake_m
    foot = stand._pot_foot_m + _TRAY_FLOOR
    cane = _lathe([(0.0, foot), (radius, foot), (0.9 * radius, top), (0.0, top)], "stake")
    return as_single_instance(cane.moved(np.eye(3), np.array([*beside, 0.0])), "stake")


def _substrate(stand: Stand) -> Mesh:
    """The uneven surface of the substrate: facets of the size of grains, some of them perlite."""
    # It meets the inner wall, which is as wide as the neck up to there.
    radius = stand.pot_width_m / 2.0 * (1.0 - _LIP[0]) - _WALL * stand.pot_width_m
    rings = max(4, round(radius / _GRAIN))
    sides = max(16, 4 * round(np.pi * radius / (2.0 * _GRAIN)))
    rng = np.random.default_rng(_SUBSTRATE_SEED)
    angle = 2.0 * np.pi * (np.arange(sides) + 0.5 * (np.arange(rings + 1)[:, None] % 2)) / sides
    reach = np.linspace(0.0, 1.0, rings + 1)[:, None] * radius * _outline(angle, stand.pot)
    heights = _GRAIN_HEIGHT * rng.standard_normal(angle.shape) + 0.5 * _GRAIN_HEIGHT
    # One height in the middle, and a closed edge.
    heights[0], heights[-1] = heights[0, 0], 0.0
    corners = np.stack([reach * np.cos(angle), reach * np.sin(angle), stand.stem_base_m + heights], axis=-1)
    n = np.arange(sides)
    ring, following = np.arange(rings)[:, None] * sides, (np.arange(rings)[:, None] + 1) * sides
    here, after = n, (n + 1) % sides
    first = np.stack([ring + here, following + here, following + after], axis=-1)
    second = np.stack([ring + here, following + after, ring + after], axis=-1)[1:]  # the middle is a fan
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    state = np.where(rng.random(len(faces)) < _PERLITE, 1.0, rng.uniform(0.0, 0.08, len(faces)))
    facets = _facets(corners.reshape(-1, 3)[faces], state, "substrate")
    return as_single_instance(facets, "substrate")


def _backdrop(stand: Stand) -> Mesh:
    """A cloth from the wall over a bend to the ground, or the floor and walls of a cabin."""
    behind, height = stand.backdrop_distance_m, stand.backdrop_height_m
    if stand.backdrop == Backdrop.CLOTH:
        bend = min(_BEND * behind, 0.5 * height)
        turn = np.linspace(0.0, np.pi / 2.0, 17)
        arc = np.column_stack([behind - bend + bend * np.sin(turn), bend - bend * np.cos(turn)])
        line = np.vstack([[-behind, 0.0], arc, [behind, height]])
        half = stand.backdrop_width_m / 2.0
        return as_single_instance(_strip(line, half), "backdrop")
    walls = [
        _strip([(-behind, 0.0), (behind, 0.0)], behind),
        _strip([(behind, 0.0), (behind, height)], behind),
    ]
    for side in (np.pi / 2.0, -np.pi / 2.0):
        walls.append(walls[1].moved(rotation_about_z(side), np.zeros(3)))
    return as_single_instance(concatenate_meshes(walls), "cabin")


def _strip(line: ArrayLike, half_width: float) -> Mesh:
    """A sheet that follows a line `(k, 2)` in y and z, shaded as bent; its front is on the line's left."""
    yz = np.asarray(line, dtype=float)
    along = np.diff(yz, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    # Straight pieces at the ends are flat, and the bend between them is round.
    mean = np.vstack([normal[:1], normal[:-1] + normal[1:], normal[-1:]])
    if len(yz) > 3:
        mean[1], mean[-2] = normal[0], normal[-1]
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    vertices = np.concatenate([np.insert(yz, 0, side, axis=1) for side in (-half_width, half_width)])
    normals = np.tile(np.insert(mean, 0, 0.0, axis=1), (2, 1))
    k = len(yz)
    v = np.linspace(0.0, 1.0, k)
    uv = np.concatenate([np.column_stack([np.full(k, u), v]) for u in (0.0, 1.0)])
    left = np.arange(k - 1)
    faces = np.concatenate(
        [np.stack([left, left + k, left + k + 1], axis=1), np.stack([left, left + k + 1, left + 1], axis=1)]
    )
    state = np.full(2 * k, 0.5)
    return single_instance_mesh(
        vertices, normals, uv, state, faces, OrganClass.BACKGROUND, "sheet", "backdrop"
    )


def _outline(angle: NDArray[np.float64], shape: PotShape) -> NDArray[np.float64]:
    """Distance of a pot's outline from its axis, over half of its width."""
    if shape == PotShape.ROUND:
        return np.ones_like(angle)
    return np.asarray(1.0 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle))))


def _lathe(profile: ArrayLike, surface: str, shape: PotShape = PotShape.ROUND, foot_m: float = 0.0) -> Mesh:
    """A profile `(k, 2)` of half-widths and heights around the vertical, outside first; smooth if round."""
    round_ = shape == PotShape.ROUND
    angle = 2.0 * np.pi * np.arange(_ROUND + 1) / _ROUND if round_ else np.pi * (np.arange(5) / 2.0 + 0.25)
    unit = np.column_stack([np.cos(angle), np.sin(angle)]) * _outline(angle, shape)[:, None]
    parts = []
    for (r0, z0), (r1, z1) in pairwise(np.asarray(profile, dtype=float).tolist()):
        ends = [np.column_stack([r * unit, np.full(len(unit), z + foot_m)]) for r, z in ((r0, z0), (r1, z1))]
        quads = np.stack([ends[0][:-1], ends[0][1:], ends[1][1:], ends[1][:-1]], axis=1)
        # At the axis, a quad is a triangle.
        kept = [(0, 1, 2)] * (r0 > 0.0) + [(0, 2, 3)] * (r1 > 0.0) if r0 else [(0, 2, 3)]
        corners = np.concatenate([quads[:, list(three)] for three in kept])
        normals = None
        if round_:
            slope = np.array([z1 - z0, r0 - r1]) / np.hypot(z1 - z0, r1 - r0)
            every = np.column_stack([slope[0] * unit, np.full(len(unit), slope[1])])
            around = np.stack([every[:-1], every[1:], every[1:], every[:-1]], axis=1)
            normals = np.concatenate([around[:, list(three)] for three in kept])
        parts.append(_facets(corners, np.full(len(corners), 0.5), surface, normals))
    return concatenate_meshes(parts)


def _facets(
    corners: NDArray[np.float64],
    state: NDArray[np.float64],
    surface: str,
    normals: NDArray[np.float64] | None = None,
) -> Mesh:
    """Triangles `(n, 3, 3)` that share no vertices, each with a state `(n,)`; flat without `normals`."""
    if normals is None:
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flat = across / np.linalg.norm(across, axis=1, keepdims=True)
        normals = np.repeat(flat[:, None], 3, axis=1)
    points = corners.reshape(-1, 3)
    low, size = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-9)
    faces = np.arange(len(points)).reshape(-1, 3)
    uv = ((points - low) / size)[:, [0, 2]]
    return single_instance_mesh(
        points, normals.reshape(-1, 3), uv, np.repeat(state, 3), faces, OrganClass.BACKGROUND, "part", surface
    )

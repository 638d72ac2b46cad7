"""The double row of Barth et al. 2018, section 2.5: plant positions, and the twine that supports a plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.geometry import Mesh, concatenate_meshes, stem_branches, stem_profile, twine_mesh
from pepperscene.grammar import Plant
from pepperscene.units import MILLIMETRES, Table, ZeroOrAtLeast, within

_STRAIGHT: Final = 0.15  # chosen: metres of twine below the wire that are not wound round the stem


@dataclass(frozen=True)
class Twine(Table):
    """Horticultural twine of three strands, wound around every stem.

    Attributes:
        diameter_m: of the cord.
        turns_per_m: windings per metre of stem.
    """

    # Chosen: at least fine sewing thread.
    diameter_m: Annotated[float, within(0, 20), ZeroOrAtLeast(0.1), MILLIMETRES]
    turns_per_m: Annotated[float, within(0, 50)]


@dataclass(frozen=True)
class DoubleRow(Table):
    """Two parallel rows of plants along x, both centred on the front row's middle plant.

    Attributes:
        plants_front: plants in the front row, at y = 0; the middle one is at the origin.
        plants_back: plants in the back row, at y = `gap_m`.
        spacing_m: between neighbours in a row.
        gap_m: between the rows.
        shift_m: of the back row, along the row; with half the spacing, its plants face the front row's gaps.
    """

    plants_front: Annotated[int, within(1, 50)]
    plants_back: Annotated[int, within(0, 50)]
    spacing_m: Annotated[float, within(50, 2000), MILLIMETRES]
    gap_m: Annotated[float, within(0, 5000), MILLIMETRES]
    shift_m: Annotated[float, within(-2000, 2000), MILLIMETRES]

    def positions(self) -> NDArray[np.float64]:
        """`(front + back, 2)` x and y of the plants in metres, front to back and left to right."""
        front_x = (np.arange(self.plants_front) - self.plants_front // 2) * self.spacing_m
        back_x = (np.arange(self.plants_back) - self.plants_back // 2) * self.spacing_m + self.shift_m
        x = np.concatenate([front_x, back_x])
        return np.stack([x, np.repeat([0.0, self.gap_m], [self.plants_front, self.plants_back])], axis=1)


def add_twine(
    plant: Plant, mesh: Mesh, twine: Twine, rng: np.random.Generator, wire: ArrayLike | None = None
) -> Mesh:
    """Add a twine to a plant's mesh, wound unevenly round its main stem from a random side.

    The twine touches internodes and nodes, and passes next to the organs that grow out of them.

    Args:
        plant: the plant.
        mesh: its mesh.
        twine: the twine.
        rng: draws the side, and how uneven the winding is.
        wire: `(3,)` metres in the plant's coordinates, where the twine is tied; the stem above that height is
            left free. With None, the twine continues straight up above the stem.

    Raises:
        ValueError: the wire is too low above the stem's base.
    """
    axis, radius = stem_profile(plant)
    phase, seed = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform())
    wound = partial(
        twine_mesh,
        twine_radius_m=twine.diameter_m / 2.0,
        turns_per_m=twine.turns_per_m,
        phase_rad=phase,
        branches=stem_branches(plant),
        seed=seed,
    )
    if wire is None:
        return concatenate_meshes([mesh, wound(axis, radius)])
    knot = np.asarray(wire, dtype=float)
    axis, radius = _stem_below(axis, radius, float(knot[2]) - _STRAIGHT)
    top = axis[-1]
    rise = float(knot[2] - top[2])
    upright = wound(axis, radius, above_m=rise)
    # Shear the straight part above the stem towards the wire.
    fraction = np.maximum(upright.vertices[:, 2:] - top[2], 0.0) / rise
    vertices = upright.vertices + fraction * np.append(knot[:2] - top[:2], 0.0)
    return concatenate_meshes([mesh, replace(upright, vertices=vertices.astype(np.float32))])


def _stem_below(
    axis: NDArray[np.float64], radius: NDArray[np.float64], height: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Axis and radius of the part of a stem below a height above the ground."""
    above = np.flatnonzero(axis[:, 2] > height)
    if not above.size:
        return axis, radius
    last = int(above[0])
    if last == 0:
        raise ValueError(f"the wire must be more than {_STRAIGHT} m above the stem's base")
    fraction = (height - axis[last - 1, 2]) / (axis[last, 2] - axis[last - 1, 2])
    point = axis[last - 1] + fraction * (axis[last] - axis[last - 1])
    end_radius = radius[last - 1] + fraction * (radius[last] - radius[last - 1])
    return np.vstack([axis[:last], point]), np.append(radius[:last], end_radius)


def double_row(
    front: Sequence[Mesh], back: Sequence[Mesh], *, spacing_m: float, gap_m: float, shift_m: float
) -> Mesh:
    """Place plants in two parallel rows along x; `back` may be empty. See `DoubleRow` for the dimensions.

    Returns:
        One mesh; instances are numbered front to back, left to right, and carry their plant's number.
    """
    positions = DoubleRow(len(front), len(back), spacing_m, gap_m, shift_m).positions()
    return place_plants([*front, *back], np.pad(positions, ((0, 0), (0, 1))), np.zeros(len(positions)))


def place_plants(plants: Sequence[Mesh], bases: NDArray[np.float64], turns: NDArray[np.float64]) -> Mesh:
    """Rotate each plant about its own vertical axis, move it to its position, and join all in one mesh.

    Args:
        plants: meshes in plant coordinates.
        bases: `(n, 3)` positions of the stem bases, metres.
        turns: `(n,)` radians, counter-clockwise seen from above.

    Returns:
        One mesh; instances are numbered consecutively and carry their plant's number.
    """
    placements = enumerate(zip(plants, bases, turns, strict=True))
    return concatenate_meshes(
        [plant.with_plant(n).moved(rotation_about_z(turn), base) for n, (plant, base, turn) in placements]
    )


def rotation_about_z(angle: float) -> NDArray[np.float64]:
    """`(3, 3)` rotation about the vertical axis, counter-clockwise seen from above; exact for half turns."""
    half_turns = float(angle) / np.pi
    if half_turns == round(half_turns):
        return np.diag([(-1.0) ** round(half_turns), (-1.0) ** round(half_turns), 1.0])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

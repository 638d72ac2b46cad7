"""The double row of Barth et al. 2018, section 2.5: where plants stand, and the twine that holds each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.geometry import Mesh, concatenate_meshes, stem_branches, stem_profile, twine_mesh
from pepperscene.grammar import Plant

_STRAIGHT: Final = 0.15  # chosen: metres of cord below the wire that are not wound round the stem


@dataclass(frozen=True)
class Twine:
    """Horticultural twine, wound round the stem.

    Attributes:
        diameter_m: of the cord.
        turns_per_m: windings per metre of stem.
    """

    diameter_m: float
    turns_per_m: float


@dataclass(frozen=True)
class DoubleRow:
    """Two parallel rows of plants along x, both centred on the front row's middle plant.

    Attributes:
        front: plants in the row at y = 0; the middle one, number `front // 2`, stands at the origin.
        back: plants in the row behind, at y = `gap_m`.
        spacing_m: between neighbours of a row.
        gap_m: between the rows.
        shift_m: of the back row along x; half the spacing puts its plants into the front row's gaps.
    """

    front: int
    back: int
    spacing_m: float
    gap_m: float
    shift_m: float

    def places(self) -> NDArray[np.float64]:
        """`(front + back, 2)` x and y of the plants in metres, front to back and left to right."""
        front_x = (np.arange(self.front) - self.front // 2) * self.spacing_m
        back_x = (np.arange(self.back) - self.back // 2) * self.spacing_m + self.shift_m
        x = np.concatenate([front_x, back_x])
        return np.stack([x, np.repeat([0.0, self.gap_m], [self.front, self.back])], axis=1)


def add_twine(
    plant: Plant, mesh: Mesh, cord: Twine, rng: np.random.Generator, wire: ArrayLike | None = None
) -> Mesh:
    """The plant's mesh with a twine wound unevenly round its main stem, starting at a random side.

    It lies on sections and nodes, and beside what grows out of them.

    Args:
        plant: whose stem it is.
        mesh: of the plant.
        cord: the twine.
        rng: chooses the side, and how uneven the winding is.
        wire: `(3,)` metres in the plant's coordinates, where the twine is tied; stem above that height is
            left alone. None lets the twine go straight up above the stem.

    Raises:
        ValueError: the wire hangs lower than the stem's foot.
    """
    axis, radius = stem_profile(plant)
    branches = stem_branches(plant)
    phase, seed = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform())
    wound = partial(
        twine_mesh,
        twine_radius_m=cord.diameter_m / 2.0,
        turns_per_m=cord.turns_per_m,
        phase_rad=phase,
        branches=branches,
        seed=seed,
    )
    if wire is None:
        return concatenate_meshes([mesh, wound(axis, radius)])
    end = np.asarray(wire, dtype=float)
    axis, radius = _below(axis, radius, float(end[2]) - _STRAIGHT)
    top = axis[-1]
    rise = float(end[2] - top[2])
    cord_mesh = wound(axis, radius, above_m=rise)
    # What goes straight up is leant over to the wire, the more the higher it is.
    share = np.maximum(cord_mesh.vertices[:, 2:] - top[2], 0.0) / rise
    leant = cord_mesh.vertices + share * np.append(end[:2] - top[:2], 0.0)
    return concatenate_meshes([mesh, replace(cord_mesh, vertices=leant.astype(np.float32))])


def _below(
    axis: NDArray[np.float64], radius: NDArray[np.float64], height: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The part of a stem that lies below a height above the ground."""
    above = np.flatnonzero(axis[:, 2] > height)
    if not above.size:
        return axis, radius
    last = int(above[0])
    if last == 0:
        raise ValueError(f"a wire must hang more than {_STRAIGHT} m above the stem's foot")
    part = (height - axis[last - 1, 2]) / (axis[last, 2] - axis[last - 1, 2])
    point = axis[last - 1] + part * (axis[last] - axis[last - 1])
    width = radius[last - 1] + part * (radius[last] - radius[last - 1])
    return np.vstack([axis[:last], point]), np.append(radius[:last], width)


def double_row(
    front: Sequence[Mesh], back: Sequence[Mesh], *, spacing_m: float, gap_m: float, shift_m: float
) -> Mesh:
    """Plants in two parallel rows along x, both centred on the front row's middle plant.

    Args:
        front: the row at y = 0; its middle plant, number `len(front) // 2`, stands at the origin.
        back: the row behind, at y = `gap_m`; may be empty.
        spacing_m: between neighbours of a row.
        gap_m: between the rows.
        shift_m: of the back row along x; half the spacing puts its plants into the front row's gaps.

    Returns:
        One mesh; instances are numbered front to back, left to right, and carry their plant's number.
    """
    places = DoubleRow(len(front), len(back), spacing_m, gap_m, shift_m).places()
    return place_plants([*front, *back], np.pad(places, ((0, 0), (0, 1))), np.zeros(len(places)))


def place_plants(plants: Sequence[Mesh], feet: NDArray[np.float64], turns: NDArray[np.float64]) -> Mesh:
    """One mesh of plants, each turned about its own vertical axis and put in its place.

    Args:
        plants: in plant coordinates; they are left alone.
        feet: `(n, 3)` metres, where the stems begin.
        turns: `(n,)` radians, counter-clockwise seen from above.

    Returns:
        One mesh; instances are numbered on and carry their plant's number.
    """
    return concatenate_meshes(
        [
            plant.select_plant(number).moved(rotation_about_z(turn), foot)
            for number, (plant, foot, turn) in enumerate(zip(plants, feet, turns, strict=True))
        ]
    )


def rotation_about_z(angle: float) -> NDArray[np.float64]:
    """`(3, 3)` turn about the vertical axis, counter-clockwise seen from above; exact for half turns."""
    half = float(angle) / np.pi
    if half == round(half):
        return np.diag([(-1.0) ** round(half), (-1.0) ** round(half), 1.0])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

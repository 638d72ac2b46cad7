"""The double row of Barth et al. 2018, section 2.5, and the twine that holds each plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepperscene.geometry import Mesh, concatenate, twine
from pepperscene.grammar import Plant


@dataclass(frozen=True)
class Twine:
    """Horticultural twine, wound round the stem.

    Attributes:
        diameter_m: of the cord.
        turns_per_m: windings per metre of stem.
    """

    diameter_m: float
    turns_per_m: float


def with_twine(plant: Plant, mesh: Mesh, cord: Twine, rng: np.random.Generator) -> Mesh:
    """The plant's mesh with a twine wound round its main stem, starting at a random side."""
    stem = plant.of_kind("internode")
    axis = np.concatenate([organ.curve for organ in stem])
    radius = np.concatenate(
        [np.linspace(one.measures["radius_m"], one.measures["radius_tip_m"], len(one.curve)) for one in stem]
    )
    # Neighbouring sections share their joints; a repeated point has no direction.
    apart = np.concatenate([[True], np.linalg.norm(np.diff(axis, axis=0), axis=1) > 1e-4])
    axis, radius = axis[apart], radius[apart]
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    cord_mesh = twine(axis, radius, cord.diameter_m / 2.0, cord.turns_per_m, phase)
    return concatenate([mesh, cord_mesh])


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
    front_x = (np.arange(len(front)) - len(front) // 2) * spacing_m
    back_x = (np.arange(len(back)) - len(back) // 2) * spacing_m + shift_m
    spots = [(x, 0.0) for x in front_x] + [(x, gap_m) for x in back_x]
    upright = np.eye(3)
    placed = [
        mesh.of_plant(number).moved(upright, np.array([x, y, 0.0]))
        for number, (mesh, (x, y)) in enumerate(zip((*front, *back), spots, strict=True))
    ]
    return concatenate(placed)

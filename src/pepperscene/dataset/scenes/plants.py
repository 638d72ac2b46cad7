"""One plant made ready: grown, meshed, held by its twine, and settled so that its organs keep apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING

from pepperscene.dataset.recipe.plan import Stream, random_generator
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.geometry import ContactCounts, Mesh
    from pepperscene.grammar import Plant


@dataclass(frozen=True, eq=False)
class GrownPlant:
    """A plant and its triangles.

    Attributes:
        plant: its organs as they lie in the mesh.
        mesh: instance i is organ i of the plant; what holds it comes behind.
        contacts: what of its fruit and blades still touches.
    """

    plant: Plant
    mesh: Mesh
    contacts: ContactCounts


def grow_plant(
    cultivar: str | Path | Cultivar,
    seed: int = 0,
    *,
    detail: float = 1.0,
    until: str | Path | Cultivar | None = None,
    share: float | None = None,
) -> GrownPlant:
    """A plant of a cultivar, upright and by itself.

    Args:
        cultivar: shipped name or path, or the cultivar itself.
        seed: of its random numbers, a whole number from 0 and below 2^63; with the seed of a recipe it is the
            first plant of that recipe's first set, but for its lean, its twine and what its neighbours move.
        detail: fineness of the mesh, as of `mesh_plant`.
        until: the cultivar at a later growth stage, or None.
        share: of the way from the first stage to the later one, in [0, 1]; one half if left out. It needs
            `until`.

    Raises:
        InputError: a cultivar is not found or not valid, nothing lies between the two, or the seed
            or the share is outside its range.
        ValueError: `detail` is not above zero and finite.
    """
    return grow_plant_at(growth_stage(cultivar, until, share), check_seed(seed), 0, 0, detail=detail)


def growth_stage(
    cultivar: str | Path | Cultivar, until: str | Path | Cultivar | None = None, share: float | None = None
) -> Cultivar:
    """The growth stage that `grow_plant` grows, of the same arguments and with the same errors."""
    from pepperscene.cultivar import Cultivar, interpolate_cultivars, load_cultivar

    if share is not None and not 0.0 <= share <= 1.0:
        raise InputError("share", f"must lie in [0, 1], not {share:g}")
    if share is not None and until is None:
        raise InputError("share", "needs until, the cultivar that it is the share of the way to")
    first, *later = (
        one if isinstance(one, Cultivar) else load_cultivar(one)
        for one in (cultivar, until)
        if one is not None
    )
    return interpolate_cultivars(first, later[0], 0.5 if share is None else share) if later else first


def check_seed(seed: int) -> int:
    """The seed itself.

    Raises:
        InputError: it is not a whole number from 0 and below 2^63, the range that recipes have.
    """
    whole = isinstance(seed, Integral) and not isinstance(seed, bool)
    if not (whole and 0 <= seed < 2**63):
        raise InputError("seed", f"must be a whole number, at least 0 and below 2^63, not {seed}")
    return int(seed)


def grow_plant_at(
    cultivar: Cultivar,
    seed: int,
    *address: int,
    detail: float = 1.0,
    lean_rad: float = 0.0,
    hold: Callable[[Plant, Mesh], Mesh] | None = None,
) -> GrownPlant:
    """The plant at an address of a data set; it depends on nothing else.

    Args:
        cultivar: its parameters.
        seed: of the recipe.
        address: set and number.
        detail: fineness of the mesh.
        lean_rad: towards its aisle, -y.
        hold: adds what holds the plant, which its organs then keep clear of.
    """
    from pepperscene.geometry import mesh_plant, move_plant, resolve_contacts
    from pepperscene.grammar import grow

    plant = grow(cultivar, random_generator(seed, Stream.PLANT, *address), lean=lean_rad)
    mesh = mesh_plant(plant, detail)
    held = mesh if hold is None else hold(plant, mesh)
    settled = resolve_contacts(held, random_generator(seed, Stream.SETTLE, *address))
    return GrownPlant(move_plant(plant, settled.motions), settled.mesh, settled.contacts)

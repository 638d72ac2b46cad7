"""From a recipe to what stands in a scene: the plants of a set, the greenhouse, the rows beyond."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pepperscene.dataset.recipe.plan import Stream, random_generator, rotated
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.scenes.plant_worker import make_plants_in_two_processes, processes
from pepperscene.dataset.scenes.plants import grow_plant_at

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.geometry import ContactCounts, Mesh
    from pepperscene.grammar import Plant
    from pepperscene.scene import DoubleRow, Greenhouse, Posture, Skeleton


FAR_DETAIL = 0.3
"""Fineness of the plants that far rows are made coarse from: chosen, their leaves still hang and fold."""


@dataclass(frozen=True, eq=False)
class BuiltScene:
    """What stands in a scene.

    Attributes:
        mesh: plants first, then greenhouse and far rows.
        contacts: what of the plants' fruit and blades still touches, within plants and between them; what
            does both counts twice.
        skeleton: the plants' organs as they lie in the mesh.
    """

    mesh: Mesh
    contacts: ContactCounts
    skeleton: Skeleton


@dataclass(frozen=True, eq=False)
class PlacedPlant:
    """A plant of a set.

    Attributes:
        plant: its organs as they lie in the mesh.
        mesh: with its twine, in the plant's own coordinates.
        posture: how it stands.
        contacts: what of its fruit and blades still touches within it.
    """

    plant: Plant
    mesh: Mesh
    posture: Posture
    contacts: ContactCounts


class SceneBuilder:
    """Grows the sets of a recipe and plants them, in any order.

    The plants of one set are held at a time; its rotations reuse them.

    Args:
        recipe: what to show.
        cultivar: of the plants.
        in_processes: 1 or 2, in which the plants of a set are made, which changes nothing but the time; None
            leaves it to the environment (see `second.processes`).

    Raises:
        InputError: another number of processes is asked for.
    """

    def __init__(self, recipe: Recipe, cultivar: Cultivar, in_processes: int | None = None) -> None:
        self.recipe = recipe
        self.cultivar = cultivar
        self._processes = processes(in_processes)
        self._set: tuple[int, list[PlacedPlant]] | None = None

    def scene(self, which: int, rotation: int) -> BuiltScene:
        """What stands in the scene of a set at a rotation."""
        from pepperscene.geometry import concatenate_meshes, resolve_contacts
        from pepperscene.scene import Skeleton, far_rows, greenhouse_mesh, jittered_places, place_plants

        plants, row, house = self.plants(which), self.row, self.house
        moved_on = rotated(plants[: row.front], rotation) + rotated(plants[row.front :], rotation)

        # Places belong to the greenhouse, postures to the plants that move on.
        places = jittered_places(row, house, random_generator(self.recipe.seed, Stream.PLACE, which, 0))
        feet = np.column_stack([places, np.full(len(places), house.foot_m)])
        turns = np.array([plant.posture.turn_rad for plant in moved_on])
        across = np.array([plant.posture.across_m for plant in moved_on])
        if self.recipe.greenhouse is not None:
            # The back row faces its own aisle, behind it.
            turns[row.front :] += np.pi
            across[row.front :] *= -1.0
        feet[:, 1] += across

        together = place_plants([plant.mesh for plant in moved_on], feet, turns)
        settling = random_generator(self.recipe.seed, Stream.SETTLE, which, rotation, 0)
        settled = resolve_contacts(together, settling, between_plants=True)
        around = greenhouse_mesh(row, house, places)
        if house.far_rows > 0:
            chance = random_generator(self.recipe.seed, Stream.FAR, 1, which, rotation)
            around += far_rows(self._models, row, house, chance)
        mesh = concatenate_meshes([settled.mesh, *around]) if around else settled.mesh
        organs = Skeleton(
            tuple(one.plant for one in moved_on),
            tuple(len(one.mesh.instances) for one in moved_on),
            feet,
            turns,
            settled.motions,
        )
        return BuiltScene(mesh, _all_contacts(settled.contacts, plants), organs)

    def plants(self, which: int) -> list[PlacedPlant]:
        """A set's plants, the front row's first."""
        if self._set is None or self._set[0] != which:
            self._set = None
            count = self.row.front + self.row.back
            if self._processes > 1:
                made = make_plants_in_two_processes(self.recipe, self.cultivar, which, count, self.plant)
            else:
                made = [self.plant(which, number) for number in range(count)]
            self._set = (which, made)
        return self._set[1]

    def plant(self, which: int, number: int) -> PlacedPlant:
        """A plant of a set; it depends on nothing else."""
        from pepperscene.scene import draw_posture

        seed = self.recipe.seed
        stands = draw_posture(self.house, random_generator(seed, Stream.PLACE, which, 1, number))

        def hold(plant: Plant, mesh: Mesh) -> Mesh:
            return self._held(plant, mesh, stands, random_generator(seed, Stream.TWINE, which, number))

        made = grow_plant_at(self.cultivar, seed, which, number, lean_rad=stands.lean_rad, hold=hold)
        return PlacedPlant(made.plant, made.mesh, stands, made.contacts)

    def _held(self, plant: Plant, mesh: Mesh, stands: Posture, rng: np.random.Generator) -> Mesh:
        """The plant with its twine, tied to the wire above its row where there is one."""
        from pepperscene.scene import Twine, add_twine

        cord = self.recipe.twine
        if cord is None or cord.diameter_mm == 0:
            return mesh
        return add_twine(
            plant, mesh, Twine(cord.diameter_mm / 1e3, cord.turns_per_m), rng, self._knot(plant, stands)
        )

    def _knot(self, plant: Plant, stands: Posture) -> np.ndarray | None:
        """`(3,)` where the twine is tied in the plant's own coordinates: straight above the stem's top, as
        far as the wire lets it.
        """
        from pepperscene.scene import rotation_about_z

        wire = self.house.wire_above_foot()
        if wire is None:
            return None
        turn = rotation_about_z(stands.turn_rad)
        top = turn @ plant.of_form("internode")[-1].curve[-1]
        return np.array([top[0], wire[0] - stands.across_m, wire[1]]) @ turn

    @cached_property
    def row(self) -> DoubleRow:
        """The double row in metres."""
        from pepperscene.scene import DoubleRow

        row = self.recipe.row
        return DoubleRow(
            row.plants_front, row.plants_back, row.spacing_mm / 1e3, row.gap_mm / 1e3, row.shift_mm / 1e3
        )

    @cached_property
    def house(self) -> Greenhouse:
        """The greenhouse in metres and radians; without the table, upright plants in even rows alone."""
        from pepperscene.scene import Greenhouse

        table = self.recipe.greenhouse
        if table is None:
            return Greenhouse()
        return Greenhouse(
            row_lean_rad=float(np.radians(table.row_lean_deg)),
            lean_sd_rad=float(np.radians(table.lean_sd_deg)),
            turn_sd_rad=float(np.radians(table.turn_sd_deg)),
            spacing_sd_m=table.spacing_sd_mm / 1e3,
            across_sd_m=table.across_sd_mm / 1e3,
            gutter_width_m=table.gutter_width_mm / 1e3,
            gutter_height_m=table.gutter_height_mm / 1e3,
            floor=table.floor,
            crop_wire_m=table.crop_wire_mm / 1e3,
            far_rows=table.far_rows,
            far_reach_m=table.far_reach_mm / 1e3,
            aisle_m=table.aisle_mm / 1e3,
            pipes=table.pipes,
        )

    @cached_property
    def _models(self) -> list[Mesh]:
        """The coarse plants that far rows are made of, the same ones in every scene."""
        from pepperscene.geometry import mesh_plant
        from pepperscene.grammar import grow
        from pepperscene.scene import coarsen_plant
        from pepperscene.scene.far_rows import MODELS

        made = []
        for number in range(MODELS):
            rng = random_generator(self.recipe.seed, Stream.FAR, 0, number)
            plant = grow(self.cultivar, rng, lean=self.house.row_lean_rad)
            made.append(coarsen_plant(mesh_plant(plant, FAR_DETAIL)))
        return made


def _all_contacts(between: ContactCounts, plants: Sequence[PlacedPlant]) -> ContactCounts:
    """The contacts between plants, and those that are left within each."""
    return replace(
        between,
        fruit_touching=between.fruit_touching + sum(one.contacts.fruit_touching for one in plants),
        blades_touching=between.blades_touching + sum(one.contacts.blades_touching for one in plants),
    )

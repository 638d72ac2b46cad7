"""Plants ready for a scene: grown, meshed, tied to their twine, and with contacts between organs resolved.

The plants of a set are independent, so two processes can share them.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from pepperscene.building.memory import PER_TRIANGLE, check_fits
from pepperscene.building.subprocess_rpc import FunctionWorker, available_cores
from pepperscene.errors import ArgumentError, InputError
from pepperscene.interrupts import raise_if_interrupted
from pepperscene.recipe.plan import Stream, check_seed, random_generator

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.geometry import ContactCounts, Mesh
    from pepperscene.grammar import Plant
    from pepperscene.scene import Greenhouse, Posture, Twine


PROCESSES: Final = "PEPPERSCENE_PROCESSES"
"""Environment variable: processes that make the plants of a set, 1 or 2."""

_LARGE: Final = 2_000_000  # chosen, as four tomatoes: triangles of a plant that is checked before it is built

MIN_SHARED_PLANTS: Final = 6  # chosen: a process takes as long to start as three plants take to make


@dataclass(frozen=True, eq=False)
class GrownPlant:
    """A plant and its triangles.

    Attributes:
        plant: its organs, with poses as in the mesh.
        mesh: instance i is organ i of the plant; its twine follows.
        contacts: fruit and blades that still touch.
    """

    plant: Plant
    mesh: Mesh
    contacts: ContactCounts


@dataclass(frozen=True, eq=False)
class PlacedPlant(GrownPlant):
    """A plant of a set, with its twine, in its own coordinates, and its posture in the row."""

    posture: Posture


def grow_plant(
    cultivar: str | Path | Cultivar,
    seed: int = 0,
    *,
    detail: float = 1.0,
    until: str | Path | Cultivar | None = None,
    share: float | None = None,
) -> GrownPlant:
    """Grow a single upright plant.

    Args:
        cultivar: shipped name or path, or the cultivar itself.
        seed: of the random numbers, from 0 and below 2^63. With a recipe's seed it is the first plant of the
            recipe's first set, without lean, twine, and contacts with neighbours.
        detail: fineness of the mesh, as for `mesh_plant`.
        until: the cultivar at a later growth stage, or None.
        share: fraction of the way from the first stage to the later one, in [0, 1]; by default 0.5. Needs
            `until`.

    Raises:
        ArgumentError: the seed or the share is outside its range.
        InputError: a cultivar is missing or not valid, or the two cannot be interpolated.
        ValueError: `detail` is not above zero and finite.
    """
    stage = growth_stage(cultivar, until, share)
    return grow_plant_at(stage, check_seed(seed), 0, 0, detail=detail)


def growth_stage(
    cultivar: str | Path | Cultivar, until: str | Path | Cultivar | None = None, share: float | None = None
) -> Cultivar:
    """The growth stage that `grow_plant` grows; same arguments and errors."""
    from pepperscene.cultivar import Cultivar, interpolate_cultivars, load_cultivar

    if share is not None and not 0.0 <= share <= 1.0:
        raise ArgumentError("share", f"must be between 0 and 1, not {share:g}")
    if share is not None and until is None:
        raise ArgumentError("share", "needs `until`, the cultivar at the later stage")
    first = cultivar if isinstance(cultivar, Cultivar) else load_cultivar(cultivar)
    if until is None:
        return first
    last = until if isinstance(until, Cultivar) else load_cultivar(until)
    return interpolate_cultivars(first, last, 0.5 if share is None else share)


def grow_plant_at(
    cultivar: Cultivar,
    seed: int,
    *address: int,
    detail: float = 1.0,
    lean_rad: float = 0.0,
    add_support: Callable[[Plant, Mesh], Mesh] | None = None,
    free_leaves: bool = True,
) -> GrownPlant:
    """Grow the plant at an address of a data set; it depends on nothing else.

    Args:
        cultivar: its parameters.
        seed: of the recipe.
        address: set and number.
        detail: fineness of the mesh.
        lean_rad: towards the plant's aisle, -y.
        add_support: adds the twine that holds the plant; organs are then moved off it.
        free_leaves: rotate leaves that cross each other; not needed where the row does so for all plants.
    """
    from pepperscene.geometry import mesh_plant, move_plant, resolve_contacts

    plant = grow_in_memory(
        cultivar, random_generator(seed, Stream.PLANT, *address), lean=lean_rad, detail=detail
    )
    mesh = mesh_plant(plant, detail)
    supported = mesh if add_support is None else add_support(plant, mesh)
    rng = random_generator(seed, Stream.SETTLE, *address)
    resolved = resolve_contacts(supported, rng, free_leaves=free_leaves)
    return GrownPlant(move_plant(plant, resolved.motions), resolved.mesh, resolved.contacts)


def grow_in_memory(
    cultivar: Cultivar, rng: np.random.Generator, *, lean: float = 0.0, detail: float = 1.0
) -> Plant:
    """The plant of `pepperscene.grammar.grow`, unless the mesh of so many organs cannot fit into memory.

    `rng` gives one number, the plant's key; `lean`, in radians, is added to the drawn lean of the stem.

    Raises:
        SetupError: it does not fit.
    """
    from pepperscene.geometry.triangle_counts import max_triangles
    from pepperscene.grammar import build_plant, draw_parameters

    parameters = draw_parameters(cultivar, rng, lean)
    triangles = max_triangles(parameters, detail)
    if triangles > _LARGE:
        organs = sum(map(len, parameters.organs.values()))
        check_fits(
            PER_TRIANGLE * triangles,
            f"{cultivar.name}: a plant of {organs:,} organs and up to {triangles:,} triangles",
            "let its organs bear fewer others",
        )
    return build_plant(parameters)


@dataclass(frozen=True, eq=False)
class PlantFactory:
    """Makes the plants of a recipe's sets; each depends on nothing else."""

    cultivar: Cultivar
    seed: int
    greenhouse: Greenhouse
    twine: Twine | None

    def plant(self, set_index: int, number: int, *, free_leaves: bool = False) -> PlacedPlant:
        """Make one plant of a set.

        Its leaves may cross each other: they are rotated once, with those of the row, unless `free_leaves`.
        """
        from pepperscene.scene import draw_posture

        posture = draw_posture(
            self.greenhouse, random_generator(self.seed, Stream.PLACE, set_index, 1, number)
        )

        def add_support(plant: Plant, mesh: Mesh) -> Mesh:
            rng = random_generator(self.seed, Stream.TWINE, set_index, number)
            return self._with_twine(plant, mesh, posture, rng)

        grown = grow_plant_at(
            self.cultivar,
            self.seed,
            set_index,
            number,
            lean_rad=posture.lean_rad,
            add_support=add_support,
            free_leaves=free_leaves,
        )
        return PlacedPlant(grown.plant, grown.mesh, grown.contacts, posture)

    def far_plant(self, number: int, detail: float = 1.0) -> Plant:
        """One of the plants that far rows repeat, as drawn; its mesh at this detail fits into memory."""
        rng = random_generator(self.seed, Stream.FAR, 0, number)
        return grow_in_memory(self.cultivar, rng, lean=self.greenhouse.row_lean_rad, detail=detail)

    def full_far_plant(self, number: int) -> GrownPlant:
        """The same plant as those of a set: in full detail, with its twine and contacts resolved."""
        from pepperscene.geometry import mesh_plant, move_plant, resolve_contacts
        from pepperscene.scene import Posture

        plant, posture = self.far_plant(number), Posture(lean_rad=self.greenhouse.row_lean_rad)
        rng = random_generator(self.seed, Stream.FAR, 2, number)
        mesh = self._with_twine(plant, mesh_plant(plant), posture, rng)
        resolved = resolve_contacts(mesh, random_generator(self.seed, Stream.FAR, 3, number))
        return GrownPlant(move_plant(plant, resolved.motions), resolved.mesh, resolved.contacts)

    def _with_twine(self, plant: Plant, mesh: Mesh, posture: Posture, rng: np.random.Generator) -> Mesh:
        from pepperscene.scene import add_twine

        if self.twine is None or self.twine.diameter_m == 0:
            return mesh
        return add_twine(plant, mesh, self.twine, rng, self._wire_knot(plant, posture))

    def _wire_knot(self, plant: Plant, posture: Posture) -> np.ndarray | None:
        """`(3,)` point on the wire, if there is one, above the stem's tip, in the plant's coordinates."""
        from pepperscene.scene import rotation_about_z

        wire = self.greenhouse.wire_position()
        if wire is None:
            return None
        rotation = rotation_about_z(posture.turn_rad)
        tip = rotation @ plant.of_form("internode")[-1].curve[-1]
        return np.array([tip[0], wire[0] - posture.across_m, wire[1]]) @ rotation


def plant_processes(processes: int | None = None) -> int:
    """Processes for the plants of a set: the argument, `PROCESSES`, or 2 where there are two cores.

    Raises:
        ArgumentError: the argument is neither 1 nor 2.
        InputError: the environment variable is neither.
    """
    if processes is not None:
        if processes not in (1, 2):
            raise ArgumentError("processes", f"must be 1 or 2, not {processes}")
        return processes
    text = os.environ.get(PROCESSES, "").strip()
    if text in ("1", "2"):
        return int(text)
    if text:
        raise InputError(PROCESSES, f"must be 1 or 2, not {text}")
    # A worker of a process pool has its own core only.
    pool = sys.modules.get("multiprocessing")
    is_pool_worker = pool is not None and pool.parent_process() is not None
    return 1 if is_pool_worker or available_cores() < 2 else 2


def make_plants(
    factory: PlantFactory, set_index: int, count: int, processes: int, worker: FunctionWorker | None = None
) -> list[PlacedPlant]:
    """Make the plants of a set, in one or two processes with the same result.

    Leaves of several plants may cross each other until the row frees them. A `worker` is left open.

    With two processes the first label frame of `barth2018` takes 4.5 s instead of 5.0 (two cores).
    """
    pending, plants = deque(range(count)), dict[int, PlacedPlant]()
    if processes == 2 and count >= MIN_SHARED_PLANTS:
        # Without a second process, or when it fails, the plants are made here, where errors are reported.
        with suppress(OSError), FunctionWorker() if worker is None else nullcontext(worker) as second:
            _make_in_two_processes(factory, set_index, pending, plants, second)
    # A single one has no neighbours and stays the plant that is grown alone.
    alone = count == 1
    for number in _drain(deque(n for n in range(count) if n not in plants).popleft):
        plants[number] = factory.plant(set_index, number, free_leaves=alone)
    return [plants[number] for number in range(count)]


def _make_in_two_processes(
    factory: PlantFactory,
    set_index: int,
    pending: deque[int],
    plants: dict[int, PlacedPlant],
    worker: FunctionWorker,
) -> None:
    """Make the pending plants: this process takes them from the front, a worker from the end."""

    def fetch_plants() -> None:
        with suppress(OSError, EOFError):
            for number in _drain(pending.pop):
                plants[number] = worker.call(_make_plant, factory, set_index, number)

    thread = threading.Thread(target=fetch_plants, name="plant worker", daemon=True)
    worker.start()
    try:
        thread.start()
        for number in _drain(pending.popleft):
            plants[number] = factory.plant(set_index, number)
        thread.join()
    finally:
        # The thread is still alive only if this process failed or was interrupted.
        pending.clear()
        if thread.is_alive():
            worker.close(0.0)
        if thread.ident is not None:
            thread.join()


def _make_plant(factory: PlantFactory, set_index: int, number: int) -> PlacedPlant:
    """Make one of the plants, in a worker process."""
    return factory.plant(set_index, number)


def _drain(pop: Callable[[], int]) -> Iterator[int]:
    """Yield numbers from one end of a deque until it is empty."""
    with suppress(IndexError):
        while True:
            raise_if_interrupted()
            yield pop()

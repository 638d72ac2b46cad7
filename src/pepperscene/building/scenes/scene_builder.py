"""The objects of a scene, from a recipe: the plants of a set, the greenhouse, the rows beyond."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.plants import (
    MIN_SHARED_PLANTS,
    GrownPlant,
    PlacedPlant,
    PlantFactory,
    make_plants,
    plant_processes,
)
from pepperscene.building.scenes.row_cache import RowCache
from pepperscene.building.subprocess_rpc import FunctionWorker
from pepperscene.recipe.plan import FrameSpec, Stream, random_generator, rotate_row
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.camera_views import CameraViews, DrawnViews
from pepperscene.recipe.views.near_plants import CoarsePlants

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.geometry import ContactCounts, Mesh
    from pepperscene.scene import FarRow, Scene, Skeleton


FAR_DETAIL: Final = 0.3
"""Fineness of the plants that far rows are coarsened from. Chosen: their leaves still hang and fold."""


_COARSE: Final = 0.09
"""Triangles of a plant of the far rows over those of a plant at detail 1, at most: those of stalks; of blades
they are .06, and of the shipped cultivars .030 to .048."""
_NEAR_PLANTS: Final = 20  # chosen: plants of far rows that are grown in full; measured 0 to 25


DECISIVE_VIEWS: Final = 64
"""The first random views of a scene decide which plants are grown in full; further ones are drawn so that
they show no coarse plant from near. Chosen: all frames of a scene wait for these views, .1 to .2 s of CPU
time for each."""


@dataclass(frozen=True, eq=False)
class BuiltScene:
    """The objects of a scene.

    Attributes:
        mesh: plants first, then greenhouse and far rows.
        contacts: fruit and blades of the plants that still touch, within plants plus between them.
        skeleton: the plants' organs, with poses as in the mesh.
        far_rows: the plants of far rows.
        begin: numbers of vertices, faces and instances of the mesh before the far rows.
        staying: number of instances at the mesh's end that do not turn with a stand.
    """

    mesh: Mesh
    contacts: ContactCounts
    skeleton: Skeleton
    far_rows: tuple[FarRow, ...] = ()
    begin: tuple[int, int, int] = (0, 0, 0)
    staying: int = 0


class SceneBuilder:
    """Grows the sets of a recipe and places them in rows, in any order.

    The plants of one set are held at a time, and reused by its rotations.

    Args:
        recipe: of the data set.
        cultivar: of the plants.
        processes: 1 or 2 that make the plants of a set, with the same result; None for `plant_processes()`.
    """

    def __init__(self, recipe: Recipe, cultivar: Cultivar, processes: int | None = None) -> None:
        from pepperscene.scene import Greenhouse

        self.recipe = recipe
        self.row, self.greenhouse = recipe.row, recipe.greenhouse or Greenhouse()
        self.cultivar = cultivar
        self._processes = plant_processes(processes)
        self._factory = PlantFactory(cultivar, recipe.seed, self.greenhouse, recipe.twine)
        inputs = recipe.seed, self.row, recipe.greenhouse, recipe.twine, recipe.stand
        self._cache = RowCache(cultivar, inputs, _row_classes())
        self._set: tuple[int, list[PlacedPlant]] | None = None
        self._full_models: dict[int, GrownPlant] = {}

    def scene(self, set_index: int, rotation: int) -> BuiltScene:
        """The scene of a set at a rotation, with coarse plants in all far rows; grown once (`RowCache`)."""
        return self._cache.get(lambda: self._build(set_index, rotation), "scene", set_index, rotation)

    def _build(self, set_index: int, rotation: int) -> BuiltScene:
        from pepperscene.geometry import concatenate_meshes, resolve_contacts
        from pepperscene.scene import (
            Skeleton,
            draw_far_rows,
            far_row_meshes,
            greenhouse_mesh,
            jittered_positions,
            place_plants,
            stand_meshes,
        )

        plants, row, greenhouse, seed = self.plants(set_index), self.row, self.greenhouse, self.recipe.seed
        front, back = plants[: row.plants_front], plants[row.plants_front :]
        ordered = rotate_row(front, rotation) + rotate_row(back, rotation)

        # Positions belong to the greenhouse, postures to the plants that rotate through the row.
        positions = jittered_positions(row, greenhouse, random_generator(seed, Stream.PLACE, set_index, 0))
        stand = self.recipe.stand
        base_m = (stand or greenhouse).stem_base_m
        feet = np.column_stack([positions, np.full(len(positions), base_m)])
        turns = np.array([plant.posture.turn_rad for plant in ordered])
        across = np.array([plant.posture.across_m for plant in ordered])
        if self.recipe.greenhouse is not None:
            # The back row faces the aisle behind it.
            turns[row.plants_front :] += np.pi
            across[row.plants_front :] *= -1.0
        feet[:, 1] += across

        # The row, without contacts between its plants.
        together = place_plants([plant.mesh for plant in ordered], feet, turns)
        rng = random_generator(seed, Stream.SETTLE, set_index, rotation, 0)
        resolved = resolve_contacts(together, rng, between_plants=True)
        skeleton = Skeleton(
            tuple(plant.plant for plant in ordered),
            tuple(len(plant.mesh.instances) for plant in ordered),
            feet,
            turns,
            resolved.motions,
        )

        # Its surroundings.
        surroundings, far_rows = greenhouse_mesh(row, greenhouse, positions), []
        turning, staying = ([], []) if stand is None else stand_meshes(stand)
        parts = [resolved.mesh, *surroundings, *turning, *staying]
        begin = (
            sum(len(part.vertices) for part in parts),
            sum(len(part.faces) for part in parts),
            sum(len(part.instances) for part in parts),
        )
        if greenhouse.far_rows > 0:
            rng = random_generator(seed, Stream.FAR, 1, set_index, rotation)
            far_rows = draw_far_rows(len(self.far_models), row, greenhouse, rng)
            parts += far_row_meshes(self.far_models, far_rows, greenhouse.far_rows_as, begin[2])
        mesh = concatenate_meshes(parts) if len(parts) > 1 else resolved.mesh
        contacts = _total_contacts(resolved.contacts, plants)
        return BuiltScene(mesh, contacts, skeleton, tuple(far_rows), begin, len(staying))

    def with_full_plants(self, built: BuiltScene, numbers: Collection[int]) -> BuiltScene:
        """The scene, which `scene` has built, with the plants of these numbers in far rows grown in full.

        With labels they are part of the skeleton, so that their fruit have harvest truth.
        """
        from pepperscene.geometry import concatenate_meshes
        from pepperscene.scene import far_row_meshes
        from pepperscene.scene.greenhouse import FarRowsAs

        if not numbers:
            return built
        chosen = self.full_plants(built, numbers)
        meshes = {plant: grown.mesh for plant, (grown, _, _) in chosen.items()}
        labelled_as = self.greenhouse.far_rows_as
        rows = far_row_meshes(self.far_models, built.far_rows, labelled_as, built.begin[2], meshes)
        mesh = concatenate_meshes([_first_part(built.mesh, *built.begin), *rows])
        if labelled_as != FarRowsAs.LABELS:
            return replace(built, mesh=mesh)

        # Their organs are in the order of their instances.
        starts: dict[int, int] = {}
        for index, item in enumerate(mesh.instances[built.begin[2] :], built.begin[2]):
            if item.full:
                starts.setdefault(item.plant, index)
        old, in_full = built.skeleton, [chosen[plant] for plant in starts]
        skeleton = replace(
            old,
            plants=(*old.plants, *(grown.plant for grown, _, _ in in_full)),
            sizes=(*old.sizes, *(len(grown.mesh.instances) for grown, _, _ in in_full)),
            bases=np.concatenate([old.bases, [base for _, _, base in in_full]]),
            turns=np.concatenate([old.turns, [turn for _, turn, _ in in_full]]),
            starts=(*accumulate(old.sizes[:-1], initial=0), *starts.values()),
        )
        return replace(built, mesh=mesh, skeleton=skeleton)

    def full_plants(
        self, built: BuiltScene, numbers: Collection[int]
    ) -> dict[int, tuple[GrownPlant, float, NDArray[np.float64]]]:
        """Some plants of the far rows in full, their turns in radians and their stem bases, by number."""
        return {
            int(plant): (self._full_model(int(row.choice[at])), float(row.turns[at]), row.bases[at])
            for row in built.far_rows
            for at, plant in enumerate(row.plants)
            if plant in numbers
        }

    def plants(self, set_index: int, worker: FunctionWorker | None = None) -> list[PlacedPlant]:
        """The plants of a set, those of the front row first; a `worker` that helps is left open."""
        if self._set is None or self._set[0] != set_index:
            # Release the old plants before making new ones.
            self._set = None
            count = self.row.plants_front + self.row.plants_back
            self._set = (
                set_index,
                self._cache.get(
                    lambda: make_plants(self._factory, set_index, count, self._processes, worker),
                    "plants",
                    set_index,
                ),
            )
        return self._set[1]

    def leaf_area_index(self, set_index: int) -> float:
        """That of the crop, by the leaves of a set's plants."""
        from pepperscene.scene import leaf_area_index

        def measured() -> float:
            meshes = [plant.mesh for plant in self.plants(set_index)]
            return leaf_area_index(meshes, self.row, self.greenhouse)

        return self._cache.get(measured, "leaf area index", set_index)

    def shares_work(self, set_index: int, rotation: int) -> bool:
        """Whether another process takes a part of the work of `scene`."""
        has_plants = self.row.plants_front + self.row.plants_back >= MIN_SHARED_PLANTS
        return self._processes == 2 and has_plants and not self._cache.has("scene", set_index, rotation)

    @cached_property
    def far_models(self) -> list[Mesh]:
        """The coarse plants that far rows consist of, the same in every scene."""
        from pepperscene.geometry import mesh_plant
        from pepperscene.scene import coarsen_plant
        from pepperscene.scene.far_rows import FAR_ROW_PLANTS

        def make() -> list[Mesh]:
            plants = [self._factory.far_plant(number, FAR_DETAIL) for number in range(FAR_ROW_PLANTS)]
            return [coarsen_plant(mesh_plant(plant, FAR_DETAIL)) for plant in plants]

        return self._cache.get(make, "far models")

    def estimate_triangles(self) -> int:
        """Triangles of a scene, from the first plant of the first set: it is drawn, but not built."""
        from pepperscene.geometry.triangle_counts import max_triangles
        from pepperscene.grammar import draw_parameters
        from pepperscene.scene.greenhouse import row_lines

        rng = random_generator(self.recipe.seed, Stream.PLANT, 0, 0)
        per_plant = max_triangles(draw_parameters(self.cultivar, rng))
        full, far = self.row.plants_front + self.row.plants_back, 0
        if self.greenhouse.far_rows > 0:
            in_line = 2 * math.floor(self.greenhouse.far_reach_m / self.row.spacing_m) + 1
            far = max(len(row_lines(self.row, self.greenhouse)) * in_line - full, 0)
        near = min(_NEAR_PLANTS, far)
        return math.ceil(per_plant * (full + near + _COARSE * (far - near)))

    def _full_model(self, number: int) -> GrownPlant:
        """One of these plants in full, grown when it is first needed."""
        if number not in self._full_models:
            self._full_models[number] = self._cache.get(
                lambda: self._factory.full_far_plant(number), "full plant", number
            )
        return self._full_models[number]


def _row_classes() -> tuple[type, ...]:
    """What plants and rows consist of."""
    from pepperscene.classes import Appearance, Instance, OrganClass
    from pepperscene.cultivar.organs import FruitScans, OrganKind
    from pepperscene.geometry import ContactCounts, JointRotation, Mesh
    from pepperscene.grammar import Organ, Plant
    from pepperscene.scene import FarRow, Posture
    from pepperscene.scene.placement import Skeleton

    of_plants = (FruitScans, OrganKind, Organ, Plant, GrownPlant, PlacedPlant, Posture)
    of_meshes = (Appearance, Instance, OrganClass, JointRotation, Mesh, ContactCounts)
    return (*of_plants, *of_meshes, FarRow, Skeleton, BuiltScene)


def _first_part(mesh: Mesh, vertices: int, faces: int, instances: int) -> Mesh:
    """The first objects of a mesh."""
    return replace(
        mesh,
        vertices=mesh.vertices[:vertices],
        normals=mesh.normals[:vertices],
        uv=mesh.uv[:vertices],
        state=mesh.state[:vertices],
        faces=mesh.faces[:faces],
        face_instance=mesh.face_instance[:faces],
        face_surface=mesh.face_surface[:faces],
        face_appearance=mesh.face_appearance[:faces],
        instances=mesh.instances[:instances],
        colour=mesh.colours_of(slice(vertices)),
    )


def _total_contacts(between: ContactCounts, plants: Sequence[PlacedPlant]) -> ContactCounts:
    """The contacts between plants, and those that are left within each."""
    return replace(
        between,
        fruit_touching=between.fruit_touching + sum(plant.contacts.fruit_touching for plant in plants),
        blades_touching=between.blades_touching + sum(plant.contacts.blades_touching for plant in plants),
    )


@dataclass(frozen=True, eq=False)
class NearScene:
    """A scene with its near plants in full.

    Attributes:
        built: its objects.
        coarse: the other plants of its far rows, or None without far rows.
        views: drawn before the plants were grown in full.
    """

    built: BuiltScene
    coarse: CoarsePlants | None
    views: DrawnViews


class NearPlants:
    """Finds the plants of far rows that views of a scene show from near; those of the last scene are kept.

    Args:
        views: of the recipe.
        renderer: makes the renderer of a scene.
    """

    def __init__(self, views: CameraViews, renderer: Callable[[Scene], Any]) -> None:
        self._views, self._renderer = views, renderer
        self._found: tuple[object, tuple[int, ...], DrawnViews] | None = None

    def grow(
        self, key: object, built: BuiltScene, builder: SceneBuilder, specs: Sequence[FrameSpec]
    ) -> NearScene:
        """Grow in full what the views of a scene show from near.

        Args:
            key: of the scene.
            built: the scene with coarse plants.
            builder: that built it.
            specs: all frames of the scene.
        """
        if not built.far_rows:
            return NearScene(built, None, {})
        if self._found is None or self._found[0] != key:
            self._found = None
            self._found = key, *self._find(built, builder, specs)
        _, numbers, drawn = self._found
        coarse = CoarsePlants(builder.far_models, built.far_rows, numbers)
        return NearScene(builder.with_full_plants(built, numbers), coarse, drawn)

    def _find(
        self, built: BuiltScene, builder: SceneBuilder, specs: Sequence[FrameSpec]
    ) -> tuple[tuple[int, ...], DrawnViews]:
        """The numbers of the plants, and the views if they depend on the scene."""
        coarse, views = CoarsePlants(builder.far_models, built.far_rows), self._views
        if not views.depends_on_scene:
            return coarse.shown_near(views.near_views((spec, views.view(spec)) for spec in specs)), {}
        from pepperscene.scene import assemble_scene

        scene = assemble_scene(built.mesh, skeleton=built.skeleton)
        visible = self._renderer(scene).visible_points
        if views.are_random:
            specs = [spec for spec in specs if spec.step < DECISIVE_VIEWS]
        seen = views.near_views((spec, views.view(spec, scene, visible)) for spec in specs)
        return coarse.shown_near(seen), views.drawn(scene)

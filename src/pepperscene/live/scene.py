"""A scene that stays open: look at it from anywhere, ask what is where, and change it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.scene_builder import NearScene
from pepperscene.building.scenes.trait_tables import PlantTraits, scene_traits
from pepperscene.camera import Camera
from pepperscene.camera.poses.generators import as_points
from pepperscene.classes import Instance, OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.frame import Frame
from pepperscene.geometry import Mesh
from pepperscene.live import arguments
from pepperscene.live.objects import SceneFruit, SceneList, SceneOrgan, scene_fruit, scene_organs
from pepperscene.live.queries import nearest_surface, touched_instances
from pepperscene.live.renderers import StateRenderers, ViewSetup, ViewSetups
from pepperscene.live.state import FarPlants, SceneState, open_state
from pepperscene.materials import Surface, greenhouse_surfaces
from pepperscene.outputs import check_outputs, needs_surfaces
from pepperscene.recipe.plan import FrameSpec, frame_seed
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.recipe.views.near_plants import CoarsePlants, near_views
from pepperscene.render import Quality, resolve_quality
from pepperscene.scene import FarRow, Scene, ground_area
from pepperscene.scene.placement import organ_poses

if TYPE_CHECKING:
    from trimesh import Trimesh


FloatArray = NDArray[np.float64]
VIEW_OUTPUTS: Final = ("class", "instance", "depth_z")
"""Outputs of a view by default: those that robots use, in some tens of milliseconds."""


def open_scene(
    recipe: Recipe | ResolvedRecipe | str | Path,
    frame: int = 0,
    *,
    allow_code: bool = False,
    on_stage: Callable[[str], None] | None = None,
    **changes: Any,
) -> LiveScene:
    """Grow the scene of a frame, and keep it open.

    Args:
        recipe: a recipe, the name of a shipped one, or a path.
        frame: index of a frame of the recipe. It decides the plants, their places, the light and the camera.
        allow_code: whether the recipe's code may run: views of the kind "function".
        on_stage: called with the name of each stage that takes long, when it begins.
        changes: values of the recipe to replace, by dotted key: `**{"row.plants_front": 3}`. Only with the
            name or path of a recipe.

    Raises:
        InputError: the recipe, a file that it names, a change or the frame is not valid.
    """
    if changes and isinstance(recipe, Recipe | ResolvedRecipe):
        raise ArgumentError("changes", "need the name or the path of a recipe; change the recipe itself")
    resolved = resolve_recipe(recipe, changes, allow_code=allow_code)
    (index,) = resolved.recipe.plan.select_indices([frame], "frame")
    frames = FrameRenderer(resolved, on_stage=on_stage)
    if frames.views.depends_on_scene:
        resolved.check_code()
    if on_stage is not None:
        on_stage("growing plants")
    # The first edit would wait for it.
    import trimesh  # noqa: F401

    spec = resolved.recipe.plan.frame(index)
    return LiveScene(frames, spec, frames.grow(spec))


class LiveScene:
    """The scene of a frame, kept open; made by `open_scene`.

    Instances are given by their numbers in instance images. They never change: what an edit removes keeps its
    number unused, and what it adds has new ones. Nothing of the scene is left out for the recipe's own views.
    An error leaves the scene as it was. On a turntable, lamps, backdrop and charts are where they are in the
    frame; a view at the pose of another frame has them as that frame.

    Seeds: a view at a pose of the data set has the seed of that frame, so that it is that frame, bit by bit.
    Every other view has a seed of its own, from the recipe's seed, the frame and `view_count`, which counts
    these views. The same calls give the same images in another process.

    Attributes:
        view_count: number of views so far that were not at a pose of the data set. Set it to repeat a view.
    """

    def __init__(self, frames: FrameRenderer, spec: FrameSpec, near: NearScene) -> None:
        self._frames, self._spec, self._near = frames, spec, near
        builder, far = frames.builder(spec), near.built.far_rows
        coarse = near.coarse.numbers if near.coarse is not None else frozenset()
        grown = builder.full_plants(near.built, {n for row in far for n in row.plants.tolist()} - coarse)
        meshes = {number: plant.mesh for number, (plant, _, _) in grown.items()}
        models = builder.far_models if far else []
        self._opened = self._state = open_state(near.built, models, meshes)
        self._edited = False
        self.view_count = 0
        self._last: ViewSetup | None = None
        self._coarse: tuple[FarPlants, CoarsePlants] | None = None
        self._renderers = StateRenderers(frames, spec, near)
        self._setups = ViewSetups(frames, spec, self._renderers)

    def __repr__(self) -> str:
        row = self._frames.setups.at(self._spec).recipe.row
        name, frame = self._frames.recipe.name, self._spec.index
        fruit = sum(bool(self._state.present[index]) for index in self._state.skeleton.of_form("fruit"))
        return f"LiveScene({name}, frame {frame}, {row.plants_front + row.plants_back} plants, {fruit} fruit)"

    # --- views ---

    @property
    def camera(self) -> Camera:
        """The camera of the frame, at its pose; an automatic exposure is not metered."""
        return self._setups.camera(ViewSetup(self._spec))

    def render(
        self,
        pose: ArrayLike | None = None,
        outputs: Sequence[str] = VIEW_OUTPUTS,
        quality: str | Quality = "draft",
        camera: Camera | None = None,
        *,
        axes: arguments.CameraAxes = "optical",
    ) -> Any:
        """Render one view, or several.

        Args:
            pose: `(4, 4)` camera to world, metres, as of `look_at`; the camera stands still there. None for
                the pose of the frame. Several, `(n, 4, 4)`, give a list.
            outputs: names from `OUTPUTS`.
            quality: "draft", "standard", "reference", or a `Quality`.
            camera: in place of the recipe's, with its own exposure; it has no partners. The recipe's camera
                has the exposure that the recipe gives or lets choose.
            axes: of the camera in its pose: "optical", x right, y down, z forward, also of OpenCV and of
                optical frames of ROS; "opengl", x right, y up, z backwards, also of Blender and nerfstudio;
                "body", x forward, y left, z up, of other frames of ROS.

        Returns:
            A `Frame`, or a list of them.

        Raises:
            ArgumentError: a pose is no rigid motion, or an output or a quality is unknown.
            InputError: an output needs a device that the recipe or the camera does not have.
        """
        names, level = check_outputs(outputs), resolve_quality(quality)
        arguments.check_axes(axes)
        if camera is not None and not isinstance(camera, Camera):
            raise ArgumentError("camera", f"must be a Camera, not {type(camera).__name__}")
        poses = [None] if pose is None else arguments.camera_poses(pose, axes)
        frames = []
        for one in poses:
            setup = self._setups.at(one, camera, self.view_count, edited=self._edited)
            frames.append(self._render(setup, names, level))
        return frames[0] if pose is None or np.ndim(pose) == 2 else frames

    def _render(self, setup: ViewSetup, outputs: tuple[str, ...], quality: Quality) -> Frame:
        held, state, traced = None, self._state, needs_surfaces(outputs)
        if setup.is_frame and not self._edited:
            # Light in a scene that is culled for the data set differs by less than can be seen, but differs.
            if traced or self._frames.views.depends_on_scene or self._renderers.turn(setup.spec):
                held = self._renderers.of_frames(setup.spec, traced=traced)
            else:
                held = self._renderers.of(self._opened)
        if held is None:
            state = self._with_near_plants(setup)
            held = self._renderers.of(state, setup.camera, setup.spec, traced=traced)
        if setup.camera is None:
            frame = self._frames.render_view(
                setup.spec, held.assembled, held.renderer, outputs, quality, view=setup.view, seed=setup.seed
            )
        else:
            seed = setup.seed
            if seed is None:
                seed = frame_seed(self._frames.recipe.seed, setup.spec.index)
            frame = held.renderer.render(setup.camera, outputs, quality, seed)
            frame = Frame(frame.images, {**frame.metadata, **held.assembled.statistics})
        self.view_count += setup.seed is not None
        self._state, self._last = state, setup
        return frame

    def _with_near_plants(self, setup: ViewSetup) -> SceneState:
        """The state with the plants of far rows in full that a view shows from near."""
        far, builder, state = self._near.built.far_rows, self._frames.builder(self._spec), self._state
        if not far or setup.is_frame:
            return state
        if setup.view is not None:
            seen = self._frames.views.near_views([(setup.spec, setup.view)])
        else:
            assert setup.camera is not None  # as it is no frame of the data set
            seen = near_views([setup.camera])
        if self._coarse is None or self._coarse[0] is not state.far:
            full = {number for row in far for number in row.plants.tolist()} - set(state.far.counts)
            self._coarse = state.far, CoarsePlants(builder.far_models, far, full)
        shown = self._coarse[1].shown_near(seen)
        for plant, (grown, turn, base) in builder.full_plants(self._near.built, shown).items():
            number = next(row.number for row in far if plant in row.plants)
            alone = FarRow(number, np.array([plant]), np.zeros(1, np.intp), np.array([turn]), base[None])
            state = state.with_full_plant(plant, grown, alone, builder.greenhouse.far_rows_as)
        return state

    # --- what is where ---

    @property
    def scene(self) -> Scene:
        """Triangles and skeleton as they are now, without surfaces and light, as `export_scene` takes."""
        return self._renderers.of(self._state).assembled.scene

    def traits(self) -> PlantTraits:
        """Traits of the plants, leaves and fruit that are there now; see `plant_traits`."""
        builder = self._frames.builder(self._spec)
        return scene_traits(self.scene, ground_area(1, builder.row, builder.greenhouse))

    @property
    def fruit(self) -> SceneList[SceneFruit]:
        """The fruit of the scene, with what a harvest robot needs to know of each."""
        held = self._renderers.of(self._state, spec=None if self._last is None else self._last.spec)
        visible = None
        if self._last is not None:
            frame = held.renderer.render(self._setups.camera(self._last), ("harvest",))
            visible = {entry["instance"]: entry["visible_fraction"] for entry in frame["harvest"]["fruit"]}
        return scene_fruit(held.renderer.fruit_truths(), visible)

    @property
    def organs(self) -> SceneList[SceneOrgan]:
        """The organs of the labelled plants, then the added objects."""
        state = self._state
        return scene_organs(state.skeleton, state.instances, state.present, state.objects)

    def raycast(
        self, origins: ArrayLike, directions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """`(n,)` distance to the first surface of each ray, metres, and `(n,)` the number of its instance.

        Rays that meet nothing have an infinite distance and the number 0.

        Args:
            origins: `(n, 3)` world metres, or one `(3,)` for all rays.
            directions: `(n, 3)` of any length above 0.

        Raises:
            ArgumentError: the shapes differ, a number is not finite, or a direction has no length.
        """
        held = self._renderers.of(self._state)
        distance, face = held.renderer.cast_rays(origins, directions)
        instance = self._state.mesh.face_instance[face].astype(np.int64) + 1
        return distance, np.where(face >= 0, instance, 0)

    def nearest(self, points: ArrayLike) -> tuple[FloatArray, NDArray[np.int64]]:
        """`(n,)` exact distance from `(n, 3)` points to the nearest surface, metres, and its instance.

        Raises:
            ArgumentError: the points have another shape, or are not finite.
        """
        places = as_points(points)
        if not np.isfinite(places).all():
            raise ArgumentError("points", "must be finite numbers")
        distance, index = nearest_surface(self._state.parts, places)
        return distance, index.astype(np.int64) + 1

    def collides(
        self,
        body: Mesh | Trimesh | ArrayLike,
        pose: ArrayLike | None = None,
        ignore: Collection[int] = (),
    ) -> tuple[int, ...]:
        """The instances that a body touches, ascending; none is false.

        A mesh touches what its triangles cross, what is inside it if it is closed, and closed surfaces that
        it is inside of.

        Args:
            body: a mesh, or capsules `(n, 7)`: both ends of the axis and the radius, metres. They have
                triangles that are inside by up to 1 % of the radius.
            pose: `(4, 4)` of the body in the world; None if it is given in world coordinates.
            ignore: numbers of instances that do not count.

        Raises:
            ArgumentError: the body or the pose is not valid.
        """
        place = np.eye(4) if pose is None else arguments.rigid_motion(pose)
        bodies = [body] if hasattr(body, "faces") else arguments.capsule_meshes(body)
        triangles = [arguments.body_triangles(one, place) for one in bodies]
        found = {index + 1 for one in triangles for index in touched_instances(self._state.parts, one)}
        return tuple(sorted(found.difference(ignore)))

    # --- edits ---

    def pick(self, instance: int) -> None:
        """Take a fruit away, with its calyx and the part of its stalk beyond the cut.

        Other fruit that hang on the same stalk go with it.

        Raises:
            ArgumentError: it is not a fruit of a labelled plant, or gone.
        """
        self._edit(self._state.picked(self._state.index(instance)))

    def move(self, instance: int, pose: ArrayLike) -> None:
        """Move an organ with all that grows on it, or an added object, to a pose.

        A fruit moves with its calyx and its whole stalk.

        Args:
            instance: its number.
            pose: `(4, 4)` in the world, as in `fruit` and `organs`.

        Raises:
            ArgumentError: the pose is no rigid motion; or the instance is gone, or neither an organ of a
                labelled plant nor an added object.
        """
        state, index = self._state, self._state.index(instance)
        target = arguments.rigid_motion(pose)
        members = state.branch(index)  # refuses what cannot move
        old = (
            state.objects[index] if index in state.objects else organ_poses([state.skeleton.organ(index)])[0]
        )
        motion = np.eye(4)
        motion[:3, :3] = target[:3, :3] @ old[:3, :3].T
        motion[:3, 3] = target[:3, 3] - motion[:3, :3] @ old[:3, 3]
        self._edit(state.moved(state.body(members[0]), motion))

    def add(
        self,
        mesh: Mesh | Trimesh,
        pose: ArrayLike | None = None,
        surface: str | Surface = "steel",
        kind: str = "object",
    ) -> int:
        """Put a body into the scene, a gripper or a crate, say, and return its number.

        Args:
            mesh: in metres.
            pose: `(4, 4)` of the body in the world; None if it is given in world coordinates.
            surface: one made by `lambertian_surface`, say, or the name of one: of the greenhouse ("steel",
                "foil", "pipe"), or of the plants.
            kind: its name in the description of instances; its class is the background.

        Raises:
            ArgumentError: the mesh, the pose or the surface is not valid, or there are too many instances.
        """
        place = np.eye(4) if pose is None else arguments.rigid_motion(pose)
        body = arguments.object_mesh(mesh, kind)
        if isinstance(surface, str):
            known = {*self._state.surfaces, *greenhouse_surfaces([550.0])}
            if surface not in known:
                raise ArgumentError("surface", f"must be one of {', '.join(sorted(known))}", value=surface)
        elif not isinstance(surface, Surface):
            raise ArgumentError("surface", "must be a Surface or the name of one")
        self._edit(self._state.added(body, place, Instance(OrganClass.BACKGROUND, kind), surface))
        return len(self._state.instances)

    def remove(self, instance: int) -> None:
        """Take an organ away with all that grows on it, or an added object.

        Raises:
            ArgumentError: the instance is gone, or neither an organ of a labelled plant nor an added object.
        """
        self._edit(self._state.without(self._state.branch(self._state.index(instance))))

    def reset(self) -> None:
        """Undo all edits, and start the count of views at 0 again."""
        self._state, self._edited, self._last, self.view_count = self._opened, False, None, 0

    def copy(self) -> LiveScene:
        """Another scene in the same state, edited on its own; the two share what no edit touched."""
        other = copy.copy(self)
        other._renderers = self._renderers.copy()
        return other

    def _edit(self, state: SceneState) -> None:
        self._state, self._edited = state, True

"""What a recipe's plan contains: frames, views, cameras, varied values and twins."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.recipe.camera_tables import FIRST_CAMERA
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.frame_setups import changed_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.recipe.tables import PLANT_TABLES
from pepperscene.recipe.views.random_views import image_rays
from pepperscene.units import file_values

if TYPE_CHECKING:
    from pepperscene.camera import Camera

_FIRST_INDICES: Final = 8  # chosen: selected indices that are listed, which fit into a line


@dataclass(frozen=True)
class FrameCount:
    """The numbers of frames of a plan.

    Attributes:
        sets, rotations, views, twins, cameras: the factors of `total`; `views` are those of a scene.
        total: all frames of the plan.
        selected: number of frames that a build makes by default.
        first: indices of the first selected frames.
        scenes: different scenes of the selected frames, each with plants to place.
    """

    sets: int
    rotations: int
    views: int
    twins: int
    cameras: int
    total: int
    selected: int
    first: tuple[int, ...]
    scenes: int


@dataclass(frozen=True)
class CameraSummary:
    """A camera of the rig with typical values.

    Attributes:
        name: on the rig.
        sensor: file of the sensor.
        width, height: of the image, pixels.
        hfov_deg: angle between the rays through the left and the right border at half height.
        exposure_us: None if automatic.
        auto_exposure: target and limits of the automatic exposure; None if the exposure is given.
        varied: keys of `[camera]` and `[auto_exposure]` whose values vary.
    """

    name: str
    sensor: str
    width: int
    height: int
    hfov_deg: float
    exposure_us: float | None
    auto_exposure: dict[str, Any] | None
    varied: tuple[str, ...]


@dataclass(frozen=True)
class VariedSummary:
    """A varied value.

    Attributes:
        key: dotted.
        per: "set", "scene" or "frame".
        values: range or probabilities, in words.
        draw: name of the draw that this value shares with others; None if it shares none.
        reversed: whether the value decreases where others of the same draw increase.
    """

    key: str
    per: str
    values: str
    draw: str | None
    reversed: bool


@dataclass(frozen=True)
class PlanSummary:
    """What a recipe's plan contains.

    Attributes:
        name, seed: of the recipe.
        frames: their numbers.
        views: the table `[views]`, with typical values for those that vary.
        cameras: of the rig, the main camera first.
        varied: values that are drawn.
        twins: values by dotted key.
        warnings: a sentence each.
    """

    name: str
    seed: int
    frames: FrameCount
    views: dict[str, Any]
    cameras: tuple[CameraSummary, ...]
    varied: tuple[VariedSummary, ...]
    twins: dict[str, tuple[Any, ...]]
    warnings: tuple[str, ...]


def summarise_plan(resolved: ResolvedRecipe, indices: Sequence[int]) -> PlanSummary:
    """Collect what a plan with selected frames, ascending, contains; nothing is grown or rendered."""
    recipe, plan = resolved.recipe, resolved.recipe.plan
    frames = FrameCount(
        sets=plan.sets,
        rotations=plan.rotations,
        views=plan.frames,
        twins=plan.twins,
        cameras=plan.cameras,
        total=plan.count,
        selected=len(indices),
        first=tuple(indices[:_FIRST_INDICES]),
        scenes=count_scenes(recipe, indices),
    )
    return PlanSummary(
        name=recipe.name,
        seed=recipe.seed,
        frames=frames,
        views=file_values(recipe.views, mode="json", exclude_none=True),
        cameras=tuple(_summarise_camera(resolved, number) for number in range(plan.cameras)),
        varied=_summarise_variation(recipe),
        twins=dict(recipe.twins),
        warnings=(*_warnings(recipe), *resolved.spectra_notes),
    )


def count_scenes(recipe: Recipe, indices: Sequence[int]) -> int:
    """Number of scenes that have to be built for some frames.

    Frames of a set and rotation share a scene, unless their plants differ in drawn values or between twins.
    """
    per_frame = varies_plants_per_frame(recipe)
    per_twin = any(_is_plant_key(key.split(".")) for key in recipe.twins)
    plan, index = recipe.plan, np.asarray(indices)
    # The arithmetic of `Plan.frame`, for all frames at once.
    view, scene = index // plan.cameras, index // plan.scene_frames
    twin, step = view // plan.frames % plan.twins, view % plan.frames
    return len(np.unique((scene * plan.twins + twin * per_twin) * plan.frames + step * per_frame))


def varies_plants_per_frame(recipe: Recipe) -> bool:
    """Whether values that plants depend on are drawn anew for every frame."""
    return bool(_plant_keys_per_frame(recipe))


def _plant_keys_per_frame(recipe: Recipe) -> list[str]:
    return [varied.name for varied in recipe.variation if varied.per == "frame" and _is_plant_key(varied.key)]


def _is_plant_key(key: Sequence[str | int]) -> bool:
    return key[0] in PLANT_TABLES


def _warnings(recipe: Recipe) -> tuple[str, ...]:
    keys = _plant_keys_per_frame(recipe)
    if not keys:
        return ()
    verb = "varies" if len(keys) == 1 else "vary"
    return (f"{', '.join(keys)} {verb} per frame, so that each frame needs plants and a scene of its own",)


def _summarise_variation(recipe: Recipe) -> tuple[VariedSummary, ...]:
    uses = Counter(varied.draw for varied in recipe.variation)
    return tuple(
        VariedSummary(
            key=varied.name,
            per=varied.per,
            values=varied.describe(),
            draw=varied.draw if uses[varied.draw] > 1 else None,
            reversed=varied.reversed,
        )
        for varied in recipe.variation
    )


def _summarise_camera(resolved: ResolvedRecipe, number: int) -> CameraSummary:
    """The camera of this number on the rig; raises `InputError` if its files do not fit together."""
    recipe, camera, name, replaced = resolved.recipe, resolved.camera, FIRST_CAMERA, set[str]()
    if number:
        member = recipe.rig[number - 1]
        name, replaced = member.name, set(member.camera)
        recipe = changed_recipe(recipe, [], recipe.name, number)
        camera = load_camera(recipe, recipe.name)
    control, exposure_us = recipe.exposure_control, file_values(recipe.camera)["exposure_us"]
    varied = [
        varied.name
        for varied in resolved.recipe.variation
        if varied.key[0] in ("camera", "auto_exposure") and varied.key[1] not in replaced
    ]
    return CameraSummary(
        name=name,
        sensor=camera.sensor.name,
        width=camera.width,
        height=camera.height,
        hfov_deg=horizontal_field_deg(camera),
        exposure_us=exposure_us if isinstance(exposure_us, float | int) else None,
        auto_exposure=None if control is None else file_values(control, mode="json"),
        varied=tuple(varied),
    )


def horizontal_field_deg(camera: Camera) -> float:
    """Angle between the rays through the left and the right border of an image at half its height."""
    left, right = image_rays(camera, np.array([[-1.0, 0.0], [1.0, 0.0]]))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(left, right)), left @ right)))

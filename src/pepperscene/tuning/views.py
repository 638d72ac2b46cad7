"""Small images of single organs in the recipe's light, which a fit renders in each step.

Each organ is alone, near the middle of the image of the recipe's camera, at the distance of the recipe's path
or somewhat farther away, like most of a plant. A lens with a longer focal length and the same f-number
enlarges it, so that irradiance on the sensor, electrons and noise are those of the recipe. The effect of
neighbours on its light is missing; `pepperscene.tuning.whole_scene` measures it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, Distortion, look_at, pedestal
from pepperscene.classes import OrganClass
from pepperscene.cultivar import Cultivar
from pepperscene.errors import InputError
from pepperscene.geometry import Mesh, mesh_plant
from pepperscene.grammar import grow
from pepperscene.materials import Surface, organ_surfaces
from pepperscene.recipe.plan import Stream, random_generator
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load_camera import surface_wavelengths
from pepperscene.render import Renderer
from pepperscene.scene import Scene, Sky, assemble_scene

Array = NDArray[np.float64]
ORGANS: Final = 3  # of each kind; chosen: a dark, a medium and a pale one
PIXELS: Final = 48
"""Width and height of a view. Chosen: the mean of its pixels is then known to a hundredth of their spread."""
POSITIONS: Final = ((0.12, 0.0, 1.0), (-0.11, 0.19, 1.2), (-0.15, -0.26, 1.4))
"""Positions of the organs, used cyclically: slopes to the right and down off the optical axis, and distance
relative to the path's. Chosen: radii that divide the central 300 x 300 pixels of the paper's camera, where
hues are counted, into thirds; and distances behind the nearest organs as of leaves and fruit of a plant."""
_PLANTS: Final = 6  # chosen: maximum number of plants to grow until there are enough organs of every kind
_CANDIDATES: Final = 3  # times the organs wanted: the most visible ones, among which states are chosen
_SLENDER: Final = 1.6  # width of a view relative to the thickness of its organ
_RIPE: Final = 0.5  # ripeness that separates unripe from ripe fruit


@dataclass(frozen=True, eq=False)
class OrganView:
    """A small image of one organ."""

    name: str  # unique among the views of a fit
    kind: str  # kind of the organ as for patches: "leaf", "pepper.unripe"
    scene: Scene  # the organ alone, with the surfaces that it shows
    camera: Camera  # the camera
    mask: NDArray[np.bool_]  # (h, w) pixels that show nothing but the organ


def organ_views(
    recipe: Recipe,
    cultivar: Cultivar,
    camera: Camera,
    kinds: Sequence[str],
    *,
    sky: Sky | None = None,
    organs: int = ORGANS,
    pixels: int = PIXELS,
    seed: int = 0,
) -> tuple[OrganView, ...]:
    """Return views of at most `organs` organs of each kind, from plants of the cultivar.

    Kinds are class names in lower case, peppers also "pepper.unripe" and "pepper.ripe". Recipe, camera and
    sky give the camera path and the light; the seed of the plants is added to the recipe's.

    Raises:
        InputError: A kind is not that of an organ, or the plants have no such organ.
    """
    for kind in kinds:
        _check_kind(kind)
    surfaces = organ_surfaces(cultivar, surface_wavelengths(camera.sensor))
    pitch = recipe.views.typical_pitch_rad
    forward = np.array([0.0, np.cos(pitch), np.sin(pitch)])

    # Grow plants until there are enough organs of every kind.
    meshes: dict[str, list[Mesh]] = {kind: [] for kind in kinds}
    for plant in range(_PLANTS):
        missing = [kind for kind in kinds if len(meshes[kind]) < organs]
        if not missing:
            break
        mesh = mesh_plant(grow(cultivar, random_generator(recipe.seed, Stream.PLANT, seed, plant)))
        for kind in missing:
            meshes[kind] += _select_organs(mesh, kind, forward, organs - len(meshes[kind]))

    # Place a camera in front of each.
    views: list[OrganView] = []
    for kind, of_kind in meshes.items():
        if not of_kind:
            problem = f"must have organs of the kind {kind!r} to fit them"
            raise InputError(recipe.name, problem, key="cultivar", value=recipe.cultivar)
        for i, mesh in enumerate(of_kind):
            right, down, distance = POSITIONS[i % len(POSITIONS)]
            position = recipe.views.subject_m * distance * np.array([right, down, 1.0])
            close_up = _close_up_camera(camera, mesh, forward, position, pixels)
            scene = assemble_scene(mesh, {name: surfaces[name] for name in mesh.surfaces}, sky)
            views.append(OrganView(f"{kind} {i + 1}", kind, scene, close_up, _mask(kind, scene, close_up)))
    return tuple(view for view in views if view.mask.any())


def with_surfaces(view: OrganView, surfaces: dict[str, Surface]) -> OrganView:
    """Return the same view with other surfaces of the organ."""
    used = {name: surfaces[name] for name in view.scene.mesh.surfaces}
    return replace(view, scene=assemble_scene(view.scene.mesh, used, view.scene.sky, lamps=view.scene.lamps))


def _check_kind(kind: str) -> None:
    name, _, stage = kind.partition(".")
    known = [
        organ_class.name.lower()
        for organ_class in OrganClass
        if organ_class not in (OrganClass.BACKGROUND, OrganClass.WIRE)
    ]
    if name not in known or (stage and (name != "pepper" or stage not in ("unripe", "ripe"))):
        allowed = ", ".join([*known, "pepper.unripe", "pepper.ripe"])
        raise InputError("patches", f"must be one of {allowed}", key="kind", value=kind)


def _select_organs(mesh: Mesh, kind: str, forward: Array, count: int) -> list[Mesh]:
    """Meshes of some of the most visible organs of a kind, by surface and from low to high states."""
    name, _, stage = kind.partition(".")
    indices = [
        i
        for i, instance in enumerate(mesh.instances)
        if instance.organ_class == OrganClass[name.upper()] and instance.far_row < 0
    ]
    corners = mesh.vertices[mesh.faces].astype(float)
    normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.bincount(mesh.face_instance, np.abs(normal @ forward), minlength=len(mesh.instances))
    totals = np.bincount(mesh.face_instance, mesh.state[mesh.faces].mean(axis=1), minlength=len(area))
    states = totals / np.maximum(np.bincount(mesh.face_instance, minlength=len(area)), 1)
    if stage:
        indices = [i for i in indices if (states[i] >= _RIPE) == (stage == "ripe")]
    # A fruit's stalk and calyx are one kind with two surfaces: alternate, starting with the larger area.
    surface = np.zeros(len(mesh.instances), int)
    surface[mesh.face_instance] = mesh.face_surface
    by_surface: dict[int, list[int]] = {}
    for i in sorted(indices, key=lambda i: -area[i]):
        by_surface.setdefault(int(surface[i]), []).append(i)
    groups = sorted(by_surface.values(), key=lambda group: -area[group].sum())
    selected: list[int] = []
    for rank, group in enumerate(groups):
        quota = -(-(count - rank) // len(groups))
        by_state = sorted(group[: _CANDIDATES * quota], key=lambda i: float(states[i]))
        positions = np.round((np.arange(quota) + 0.5) / max(quota, 1) * len(by_state) - 0.5)
        selected += [by_state[position] for position in np.unique(positions.astype(int))]
    return [mesh.select_instances([i]) for i in selected]


def _close_up_camera(camera: Camera, mesh: Mesh, forward: Array, position: Array, pixels: int) -> Camera:
    """The camera that sees an organ at a position `(3,)` in its own axes, with a lens that enlarges it."""
    # The width of the view follows from the thickness of the organ across its longer axis.
    points = mesh.vertices.astype(float)
    right = np.array([1.0, 0.0, 0.0])
    flat = (points - points.mean(axis=0)) @ np.stack([right, np.cross(forward, right)]).T
    _, _, axes = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    along, across = np.ptp(flat @ axes.T, axis=0)
    width = float(min(_SLENDER * across, 1.1 * max(along, across)))
    # Long organs bend: look at the point of the organ that is closest to its centre.
    target = points[np.argmin((flat**2).sum(axis=1))]
    step = 2 if camera.sensor.binning == 1 and camera.sensor.channels == 3 else 1
    sensor = replace(camera.sensor, columns=pixels - pixels % step, rows=pixels - pixels % step)
    # A longer focal length, and the part of its image that shows the organ.
    focal = position[2] * pixels * sensor.pixel_pitch_m / width
    lens = replace(
        camera.lens,
        focal_length_m=focal,
        distortion=Distortion(),
        fy_over_fx=1.0,
        principal_offset_m=(-focal * position[0] / position[2], -focal * position[1] / position[2]),
    )
    pose = look_at(target - forward, target)
    pose[:3, 3] = target - pose[:3, :3] @ position
    # Stray light depends on the whole scene, so views have none. The pedestal is that of the recipe's camera.
    steps = replace(camera.developing, stray_light=False, pedestal=pedestal(camera))
    return replace(camera, lens=lens, sensor=sensor, pose=pose, focus_m=None, developing=steps)


def _mask(kind: str, scene: Scene, camera: Camera) -> NDArray[np.bool_]:
    """`(h, w)` pixels that show the organ, as do all their neighbours."""
    from scipy.ndimage import binary_erosion

    organ_class = OrganClass[kind.partition(".")[0].upper()]
    visible = Renderer(scene).render(camera, ["class"])["class"] == organ_class
    # Outside of the image nothing is known; assume more of the same.
    return np.asarray(binary_erosion(visible, np.ones((3, 3), bool), border_value=1))

"""Small pictures of single organs, in the recipe's own light and camera: what a fit looks at in each step.

An organ stands alone, somewhere in the middle of the picture that the camera of the recipe's path takes, at
its distance or a little further, as most of a plant is. A longer lens of the same f-number shows it large:
the light on the sensor, and so electrons and noise, stay those of the recipe. What neighbours do to its light
is left out; the whole scene is looked at in the end (see `pepperscene.tuning.whole_scene`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.recipe.plan import Stream, random_generator
from pepperscene.dataset.recipe.resolved import surface_wavelengths
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.cultivar import Cultivar
    from pepperscene.dataset import Recipe
    from pepperscene.geometry import Mesh
    from pepperscene.materials import Surface
    from pepperscene.scene import Scene, Sky


Array = NDArray[np.float64]

ORGANS: Final = 3
"""Chosen: of each kind: a dark, a middling and a pale one."""
PIXELS: Final = 48
"""Chosen: along the sides of a view; a mean over its pixels is then good to a hundredth of its spread."""

PLACES: Final = ((0.12, 0.0, 1.0), (-0.11, 0.19, 1.2), (-0.15, -0.26, 1.4))
"""Where organs stand in turn: slopes to the right and down off the optical axis, and the distance in units of
the path's. Chosen: radii that part the middle 300 x 300 pixels of the paper's camera, in which hues are
counted, into thirds; and as far behind the nearest organs as leaves and fruit of one plant lie."""

_PLANTS: Final = 6  # chosen: grown at most, until there are organs enough of every kind
_CANDIDATES: Final = 3  # times the organs wanted: those that show most are looked at for their states
_SLENDER: Final = 1.6  # a view is so many times as wide as an organ is thick
_RIPE: Final = 0.5  # ripeness that parts unripe from ripe fruit


@dataclass(frozen=True, eq=False)
class OrganView:
    """A small picture of an organ.

    Attributes:
        name: unique among the views of a fit.
        kind: of the organ, as patches call it: "leaf", "pepper.unripe".
        scene: the organ alone, with all surfaces that it shows.
        camera: that sees it.
        mask: `(h, w)` the pixels that show nothing else.
    """

    name: str
    kind: str
    scene: Scene
    camera: Camera
    mask: NDArray[np.bool_]


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
    """Views of a few organs of each kind, of plants that the cultivar grows.

    Args:
        recipe: gives path, and the seed of its plants.
        cultivar: that grows; its pigments make the surfaces.
        camera: the recipe's, at no place.
        kinds: class names in lower case, peppers also as "pepper.unripe" and "pepper.ripe".
        sky: the recipe's daylight, or None.
        organs: of each kind, at most.
        pixels: along the sides of a view.
        seed: of the plants, besides the recipe's own.

    Raises:
        InputError: a kind is no organ's, or no plant of the cultivar has it.
    """
    from pepperscene.geometry import mesh_plant
    from pepperscene.grammar import grow
    from pepperscene.materials import organ_surfaces
    from pepperscene.scene import assemble_scene

    for kind in kinds:
        _check(kind)
    surfaces = organ_surfaces(cultivar, surface_wavelengths(camera.sensor))
    path = recipe.path
    forward = np.array([0.0, np.cos(np.radians(path.pitch_deg)), np.sin(np.radians(path.pitch_deg))])
    found: dict[str, list[Mesh]] = {kind: [] for kind in kinds}
    for plant in range(_PLANTS):
        missing = [kind for kind in kinds if len(found[kind]) < organs]
        if not missing:
            break
        grown = grow(cultivar, random_generator(recipe.seed, Stream.PLANT, seed, plant))
        mesh = mesh_plant(grown)
        for kind in missing:
            found[kind] += _shown(mesh, kind, forward, organs - len(found[kind]))
    views: list[OrganView] = []
    for kind, meshes in found.items():
        if not meshes:
            raise InputError(
                recipe.name,
                f"must have organs of the kind {kind!r} to fit them",
                key="cultivar",
                value=recipe.cultivar,
            )
        for i, mesh in enumerate(meshes):
            own = {name: surfaces[name] for name in mesh.surfaces}
            right, down, far = PLACES[i % len(PLACES)]
            place = 1e-3 * path.distance_mm * far * np.array([right, down, 1.0])
            placed = _placed(camera, mesh, forward, place, pixels)
            views.append(_view(f"{kind} {i + 1}", kind, assemble_scene(mesh, own, sky), placed))
    return tuple(view for view in views if view.mask.any())


def with_surfaces(view: OrganView, surfaces: dict[str, Surface]) -> OrganView:
    """The same view of an organ of other surfaces."""
    from pepperscene.scene import assemble_scene

    own = {name: surfaces[name] for name in view.scene.mesh.surfaces}
    return replace(view, scene=assemble_scene(view.scene.mesh, own, view.scene.sky))


# --- organs -----------------------------------------------------------------------------------------------


def _check(kind: str) -> None:
    name, _, stage = kind.partition(".")
    known = [one.name.lower() for one in OrganClass if one not in (OrganClass.BACKGROUND, OrganClass.WIRE)]
    if name not in known or (stage and (name != "pepper" or stage not in ("unripe", "ripe"))):
        allowed = ", ".join([*known, "pepper.unripe", "pepper.ripe"])
        raise InputError("patches", f"must be one of {allowed}", key="kind", value=kind)


def _shown(mesh: Mesh, kind: str, forward: Array, most: int) -> list[Mesh]:
    """Organs of a kind by themselves, surface by surface: of those that show most, from the lowest to the
    highest state.
    """
    name, _, stage = kind.partition(".")
    chosen = [i for i, one in enumerate(mesh.instances) if one.organ_class == OrganClass[name.upper()]]
    corners = mesh.vertices[mesh.faces].astype(float)
    normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.bincount(mesh.face_instance, np.abs(normal @ forward), minlength=len(mesh.instances))
    states = np.bincount(mesh.face_instance, mesh.state[mesh.faces].mean(axis=1), minlength=len(area))
    state = states / np.maximum(np.bincount(mesh.face_instance, minlength=len(area)), 1)
    if stage:
        chosen = [i for i in chosen if (state[i] >= _RIPE) == (stage == "ripe")]
    # The stalk of a fruit and its calyx are one kind of two surfaces: they take turns, what shows more first.
    surface = np.zeros(len(mesh.instances), int)
    surface[mesh.face_instance] = mesh.face_surface
    by_surface: dict[int, list[int]] = {}
    for i in sorted(chosen, key=lambda i: -area[i]):
        by_surface.setdefault(int(surface[i]), []).append(i)
    turns = sorted(by_surface.values(), key=lambda own: -area[own].sum())
    found: list[int] = []
    for turn, own in enumerate(turns):
        share = -(-(most - turn) // len(turns))
        by_state = sorted(own[: _CANDIDATES * share], key=lambda i: float(state[i]))
        places = np.round((np.arange(share) + 0.5) / max(share, 1) * len(by_state) - 0.5)
        found += [by_state[place] for place in np.unique(places.astype(int))]
    return [mesh.select_instances([i]) for i in found]


# --- cameras ----------------------------------------------------------------------------------------------


def _placed(camera: Camera, mesh: Mesh, forward: Array, place: Array, pixels: int) -> Camera:
    """The camera that has an organ at a place `(3,)` in its own axes, with a lens that shows it large."""
    from pepperscene.camera import Distortion, look_at

    # How thick the organ looks across its longer axis tells how much of it is shown.
    points = mesh.vertices.astype(float)
    right = np.array([1.0, 0.0, 0.0])
    flat = (points - points.mean(axis=0)) @ np.stack([right, np.cross(forward, right)]).T
    _, _, axes = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    along, across = np.ptp(flat @ axes.T, axis=0)
    width = float(min(_SLENDER * across, 1.1 * max(along, across)))
    # Long organs bend: the middle of the view is a point on them.
    target = points[np.argmin((flat**2).sum(axis=1))]
    step = 2 if camera.sensor.binning == 1 and camera.sensor.channels == 3 else 1
    sensor = replace(camera.sensor, columns=pixels - pixels % step, rows=pixels - pixels % step)
    # A longer lens, and of its picture the piece around the organ.
    focal = place[2] * pixels * sensor.pixel_pitch_m / width
    lens = replace(
        camera.lens,
        focal_length_m=focal,
        distortion=Distortion(),
        principal_offset_m=(-focal * place[0] / place[2], -focal * place[1] / place[2]),
    )
    pose = look_at(target - forward, target)
    pose[:3, 3] = target - pose[:3, :3] @ place
    return replace(camera, lens=lens, sensor=sensor, pose=pose, focus_m=None)


def _view(name: str, kind: str, scene: Scene, camera: Camera) -> OrganView:
    from scipy.ndimage import binary_erosion

    from pepperscene.render import Renderer

    wanted = OrganClass[kind.partition(".")[0].upper()]
    seen = Renderer(scene).render(camera, ["class"])["class"] == wanted
    # Beyond the border nothing is known, so what lies there counts as more of the same.
    inside = binary_erosion(seen, np.ones((3, 3), bool), border_value=1)
    return OrganView(name, kind, scene, camera, inside)

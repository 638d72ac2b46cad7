"""The 3D view of a scene in a report: its plants, simplified, and the cameras of its frames."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.fields import read_frame
from pepperscene.dataset.store.frame_json import DIGITS
from pepperscene.dataset.store.recorded_values import DATE, recorded_recipe
from pepperscene.errors import InputError
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.recipe import digest
from pepperscene.recipe.resolve.frame_setups import FrameSetups
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.recipe.variation.recorded import read_variation
from pepperscene.review.report.data import evenly_spaced
from pepperscene.review.report.image_view import card_id
from pepperscene.review.report.label_regions import pack
from pepperscene.review.report.page import plural
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.geometry import Mesh

_MAX_CAMERAS: Final = 500  # chosen: more would cover each other
_MAX_TRIANGLES: Final = 120_000  # chosen: they take 1.1 MB of the page
_FRUSTUM_M: Final = 0.15  # chosen: depth of a camera's drawn frustum; plants are 0.4 m away
_PER_METRE: Final = 1000  # coordinates are in whole millimetres
_SHOWN: Final = (
    OrganClass.LEAF, OrganClass.PEPPER, OrganClass.PEDUNCLE, OrganClass.STEM, OrganClass.SHOOT,
)  # fmt: skip
"""The classes of a simplified plant."""
_LIBRARY: Final = re.compile(
    r"<script>\s*(/\*\*\s+\* @license\s+\* Copyright [^\n]*Three\.js Authors\n.*?\*/\n[^\n]+)\n", re.DOTALL
)
"""The first script of the template starts with the licence and one line, the minified library."""


class MissingSceneError(Exception):
    """A scene cannot be shown; the message is the reason, and part of the page."""


@dataclass(frozen=True)
class SceneView:
    """The 3D view of a page.

    Attributes:
        note: which plants and cameras it has.
        data: for the page's script, as of `pack`.
        library: the script three.js; empty if there is nothing to draw.
        missing: why there is no view although one was asked for; empty otherwise.
    """

    note: str = ""
    data: str = ""
    library: str = ""
    missing: str = ""
    classes: tuple[OrganClass, ...] = _SHOWN


def scene_view(dataset: Dataset, shown: Sequence[int]) -> SceneView:
    """The 3D view of the scene of the first of some frames, which the page shows.

    Raises:
        InputError: the JSON of a frame is damaged.
    """
    try:
        library = three_js()
        if library is None:
            raise MissingSceneError("it needs three.js r140 of trimesh 4.8.3 or later")
        note, data = _note_and_data(dataset, shown)
        return SceneView(note, data, library)
    except MissingSceneError as error:
        return SceneView(missing=str(error))


def three_js() -> Markup | None:
    """The library with its licence notice (MIT), as a script that defines `THREE`.

    None if the installed trimesh does not contain it: versions before 4.8.3 have one of 2020 without its
    licence notice.
    """
    try:
        from trimesh.resources import get_bytes
        from trimesh.util import decompress

        (template,) = decompress(get_bytes("templates/viewer.zip"), file_type="zip").values()
        page = template.read().decode("utf-8")
    except (ImportError, OSError, KeyError, ValueError):
        return None
    found = _LIBRARY.search(page)
    return None if found is None else Markup(found[1])


def _note_and_data(dataset: Dataset, shown: Sequence[int]) -> tuple[str, str]:
    resolved = resolve_recorded(dataset.info)
    plan = resolved.recipe.plan
    if shown[0] >= plan.count:
        raise MissingSceneError(f"frame {shown[0]} is not in the plan of the recipe")
    spec = plan.frame(shown[0])
    indices = sorted(set(dataset.indices()) & set(plan.scene_indices(spec)))
    indices = [indices[position] for position in evenly_spaced(len(indices), _MAX_CAMERAS)]
    cameras = [camera_entry(read_frame(dataset, index), shown) for index in indices]
    centres = np.array([camera["points"][0] for camera in cameras]) / _PER_METRE
    organs, plants, total = organ_triangles(grow_row(resolved, spec), centres)
    number = plural(plants, "plant") if plants == total else f"the {plants} nearest of {total} plants"
    note = (
        f"Set {spec.set}, rotation {spec.rotation}: {number}, simplified, and the cameras of "
        f"{plural(len(cameras), 'frame')}."
    )
    return note, pack({"organs": organs, "cameras": cameras})


def camera_entry(metadata: Mapping[str, Any], shown: Collection[int]) -> dict[str, Any]:
    """A frame's camera: `index`, the id of its `card` if it is one of those shown, and `points`.

    The points are the projection centre and the upper left, upper right, lower right and lower left corners
    of the image at `_FRUSTUM_M`, without distortion, in millimetres.

    Raises:
        MissingSceneError: its focal length is not above 0.
    """
    camera, index = metadata["camera"], metadata["index"]
    if not min(camera["fx"], camera["fy"]) > 0:
        raise MissingSceneError(f"the camera of frame {index} has no focal length above 0")
    # Data sets of early versions do not record the size; the principal point is near the centre.
    width = camera.get("width") or 2.0 * camera["cx"]
    height = camera.get("height") or 2.0 * camera["cy"]
    u, v = np.array([0.0, width, width, 0.0]), np.array([0.0, 0.0, height, height])
    x = (u - camera["cx"]) / camera["fx"]
    y = (v - camera["cy"]) / camera["fy"]
    corners = _FRUSTUM_M * np.column_stack([x, y, np.ones(4)])
    pose = np.array(camera["pose"], dtype=float)
    points = np.vstack([np.zeros(3), corners]) @ pose[:3, :3].T + pose[:3, 3]
    card = card_id(f"{index:0{DIGITS}d}", "a") if index in shown else None
    return {"index": index, "card": card, "points": _whole(points).tolist()}


def organ_triangles(
    mesh: Mesh, centres: NDArray[np.float64]
) -> tuple[dict[str, dict[str, list[int]]], int, int]:
    """The triangles of simplified plants, those nearest to some points first until they are too many.

    The points are `(n, 3)` in metres.

    Returns:
        By class id, `positions`: x, y and z of each vertex in millimetres, and `faces`: three vertices of
        each triangle. Then the number of plants in it, and that of all plants.

    Raises:
        MissingSceneError: the plants have no organ of these classes.
    """
    from pepperscene.scene import coarsen_plant

    try:
        coarse = coarsen_plant(mesh)
    except ValueError as error:
        raise MissingSceneError(str(error)) from None
    plant_of = np.array([item.plant for item in coarse.instances])[coarse.face_instance]
    plants = np.unique(plant_of[plant_of >= 0])
    middles = coarse.vertices[coarse.faces].mean(axis=1)
    places = np.array([middles[plant_of == plant].mean(axis=0) for plant in plants])
    distance = np.linalg.norm(places[:, None, :2] - centres[None, :, :2], axis=2).min(axis=1)
    order = plants[np.argsort(distance, kind="stable")]
    totals = np.cumsum([np.count_nonzero(plant_of == plant) for plant in order])
    chosen = order[: max(1, int(np.count_nonzero(totals <= _MAX_TRIANGLES)))]
    is_chosen = np.isin(plant_of, chosen)
    organs = {}
    for organ in _SHOWN:
        faces = coarse.faces[is_chosen & (coarse.face_class == organ)]
        used, renumbered = np.unique(faces, return_inverse=True)
        if used.size:
            positions = _whole(coarse.vertices[used].astype(float))
            organs[str(int(organ))] = {
                "positions": positions.ravel().tolist(),
                "faces": renumbered.ravel().tolist(),
            }
    return organs, len(chosen), len(plants)


def _whole(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Metres in whole millimetres."""
    return np.rint(_PER_METRE * points).astype(np.int64)


def resolve_recorded(info: Mapping[str, Any]) -> ResolvedRecipe:
    """The recipe of a data set from the content of its `dataset.json`, which `read_info` has checked.

    Raises:
        MissingSceneError: its scenes cannot be grown again: it is of another version, or of files that are
            not shipped or have changed.
    """
    if info["version"] != __version__:
        raise MissingSceneError(
            f"the data set was built by version {info['version']}, and this is {__version__}"
        )
    if any(varied.name == DATE for varied in read_variation(info["recipe"])):
        raise MissingSceneError("the recipe draws dates, which data sets record as text")
    try:
        resolved = resolve_recipe(recorded_recipe(info))
        is_same = digest(dict(resolved.identity)) == info["recipe_sha256"]
    except (InputError, ValueError):
        # Data sets record the names of the user's own files, not their folders.
        is_same = False
    if not is_same:
        raise MissingSceneError("the recipe names files that are not shipped with this version")
    return resolved


def grow_row(resolved: ResolvedRecipe, spec: FrameSpec) -> Mesh:
    """The plants of a frame's scene with the greenhouse, without far rows, in world coordinates.

    Raises:
        MissingSceneError: drawn values of the frame are not valid together.
    """
    try:
        setup = FrameSetups(resolved).at(spec)
    except InputError as error:
        raise MissingSceneError(str(error)) from None
    recipe = setup.recipe
    if recipe.greenhouse is not None:
        # Plants do not depend on the far rows.
        recipe = recipe.model_copy(update={"greenhouse": replace(recipe.greenhouse, far_rows=0)})
    return SceneBuilder(recipe, setup.cultivar).scene(spec.set, spec.rotation).mesh

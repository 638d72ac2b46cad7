"""BOP: poses of fruit in camera axes, amodal and visible masks, and a model of each fruit.

Format: https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md (BOP-scenewise).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera
from pepperscene.camera.optics.calibration import CENTRE_OF_FIRST_PIXEL
from pepperscene.classes import OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.dataset import MARK, Dataset
from pepperscene.dataset.store.images import png_bytes
from pepperscene.dataset.store.recorded_values import recorded_recipe
from pepperscene.errors import InputError
from pepperscene.export.job import ExportJob, write_table
from pepperscene.export.surface import MILLIMETRES, RangeImage, depth_png, read_label, read_surface
from pepperscene.recipe.plan import Plan
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.truth.encodings import decode_rle
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.geometry import Mesh

_TABLES: Final = ("scene_camera", "scene_gt", "scene_gt_info")
_FOLDERS: Final = ("rgb", "depth", "mask", "mask_visib")
_COLUMNS: Final = (
    "obj_id",
    "scene_id",
    "instance",
    "plant",
    "phytomer",
    "ripeness",
    "length_m",
    "diameter_m",
)

_MODEL_AXES: Final = np.diag([1.0, -1.0, -1.0])
"""From fruit to model axes, a half turn about x: the model's z points to the stalk, up as the fruit hangs."""

_TOLERANCE_M: Final = 1e-5
"""Of the side lengths of a fruit's box. Chosen: ten times the rounding of the harvest truth."""


def write_bop(job: ExportJob, folder: Path) -> None:
    """Write `train/000004/rgb/001000.png` and so on, `models/obj_000001.ply`, `camera.json`, `objects.csv`.

    A scene of BOP is a scene of the recipe, an image id the index of a frame. Each fruit of a scene is an
    object with a model of its own, in millimetres; `objects.csv` lists them.

    Raises:
        InputError: the lens distorts, or a rolling shutter moves, which BOP does not have; or the plants
            cannot be grown again.
    """
    scenes = {index: _scene_id(job.plan, index) for index in job.split_of}
    groups: dict[str, list[int]] = {}
    # Ascending scenes, so that each is grown once.
    for index in sorted(scenes, key=lambda index: (scenes[index], index)):
        groups.setdefault(f"{job.split_of[index]}/{scenes[index]:06d}", []).append(index)
    models = _Models(job, folder)
    for name, frames in job.frames_by_group(groups):
        _write_scene(folder / name, frames, models)
    models.write_tables()


def _scene_id(plan: Plan, index: int) -> int:
    """Number of a frame's scene; twins, which may differ in anything, are scenes of their own."""
    spec = plan.frame(index)
    return spec.scene * plan.twins + spec.twin


@dataclass(frozen=True, eq=False)
class _FruitModel:
    """The mesh of a fruit; the origin is the centre of its bounding box.

    Attributes:
        vertices: `(n, 3)` metres, in model axes.
        normals: `(n, 3)` unit vectors, in model axes.
        faces: `(m, 3)` indices of vertices.
        centre: `(3,)` the origin in the axes of the fruit, metres.
    """

    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.int64]
    centre: NDArray[np.float64]

    def to_camera(self, pose: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation `(3, 3)` and translation `(3,)` in metres of the model at a fruit's pose `(4, 4)`."""
        rotation = pose[:3, :3]
        return rotation @ _MODEL_AXES.T, rotation @ self.centre + pose[:3, 3]


class _Models:
    """The models of all fruit, written when a frame first shows them; one scene is grown at a time."""

    def __init__(self, job: ExportJob, folder: Path) -> None:
        self.plan, self.folder, self.where = job.plan, folder, job.dataset.folder / MARK
        self.renderer = FrameRenderer(_restored_recipe(job.dataset))
        self.scene: tuple[int, Mesh] | None = None
        self.models: dict[tuple[int, int], tuple[int, _FruitModel]] = {}  # by scene and instance
        self.info: dict[str, dict[str, float]] = {}
        self.rows: list[dict[str, Any]] = []
        self.camera: dict[str, float] = {}
        (folder / "models").mkdir()

    def of(self, frame: DatasetFrame, fruit: Mapping[str, Any]) -> tuple[int, _FruitModel]:
        """Object id and model of a fruit in a frame."""
        scene = _scene_id(self.plan, frame.index)
        key = scene, fruit["instance"]
        if key not in self.models:
            number, pose = len(self.models) + 1, np.asarray(frame.metadata["camera"]["pose"], dtype=float)
            model = self._grown(self._mesh(frame.index), pose, fruit)
            self.models[key] = number, model
            content, self.info[str(number)] = _model_file(model)
            (self.folder / "models" / f"obj_{number:06d}.ply").write_bytes(content)
            self.rows.append({**fruit, "obj_id": number, "scene_id": scene})
        return self.models[key]

    def write_tables(self) -> None:
        _write_json(self.folder / "models" / "models_info.json", self.info)
        _write_json(self.folder / "camera.json", self.camera)
        write_table(self.folder / "objects.csv", _COLUMNS, self.rows)

    def _mesh(self, index: int) -> Mesh:
        scene = _scene_id(self.plan, index)
        if self.scene is None or self.scene[0] != scene:
            # Release the old scene before making the new one.
            self.scene = None
            self.scene = scene, self.renderer.scene(self.plan.frame(index), traced=False).mesh
        return self.scene[1]

    def _grown(self, mesh: Mesh, camera_pose: NDArray[np.float64], fruit: Mapping[str, Any]) -> _FruitModel:
        """The model of a fruit, whose box must be that of the truth of a frame with this camera `(4, 4)`."""
        number = fruit["instance"] - 1
        is_fruit = number < len(mesh.instances) and mesh.instances[number].organ_class == OrganClass.PEPPER
        faces = mesh.faces[mesh.face_instance == number] if is_fruit else np.empty((0, 3), np.int64)
        if not len(faces):
            raise self._other_plants(fruit)
        used, numbers = np.unique(faces, return_inverse=True)
        # From the world into the axes of the fruit, where its box is upright.
        to_world = camera_pose @ np.asarray(fruit["pose"], dtype=float)
        vertices = (mesh.vertices[used] - to_world[:3, 3]) @ to_world[:3, :3]
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        size = np.asarray((fruit.get("box_3d") or {"size": [np.nan] * 3})["size"], dtype=float)
        if not np.abs(high - low - size).max() <= _TOLERANCE_M:
            raise self._other_plants(fruit)
        # Then into the axes of the model, with the origin in the centre.
        centre = (low + high) / 2
        normals = mesh.normals[used] @ to_world[:3, :3]
        return _FruitModel(
            (vertices - centre) @ _MODEL_AXES.T, normals @ _MODEL_AXES.T, numbers.reshape(-1, 3), centre
        )

    def _other_plants(self, fruit: Mapping[str, Any]) -> InputError:
        problem = f"the plants that its recipe grows have no fruit like instance {fruit['instance']}"
        return InputError(self.where, problem)


def _restored_recipe(dataset: Dataset) -> Recipe:
    """The recipe that a `dataset.json` records, with all its values and the same files.

    Raises:
        InputError: a file of the recipe differs or is not shipped, or another version built the data set.
    """
    where, info = dataset.folder / MARK, dataset.info
    if info["version"] != __version__:
        problem = f"the plants cannot be grown again: version {__version__} may grow others"
        raise InputError(where, problem, key="version", value=info["version"])
    try:
        recipe = recorded_recipe(info)
        identity = resolve_recipe(recipe).identity
    except (InputError, ValueError) as error:
        detail = error.detail if isinstance(error, InputError) else "its values are not valid"
        problem = f"the plants cannot be grown again: {detail}"
        raise InputError(where, problem, key="recipe") from None
    if json.loads(json.dumps(identity)) != {key: info.get(key) for key in ("recipe", "files")}:
        raise InputError(where, "the plants cannot be grown again: the recipe's files have changed")
    return recipe


def _model_file(model: _FruitModel) -> tuple[bytes, dict[str, float]]:
    """A PLY file of a model in millimetres, and its entry in `models_info.json`."""
    import trimesh
    from scipy.spatial import ConvexHull
    from scipy.spatial.distance import pdist

    vertices = MILLIMETRES * model.vertices
    mesh = trimesh.Trimesh(vertices, model.faces, vertex_normals=model.normals, process=False)
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    info = {"diameter": float(pdist(vertices[ConvexHull(vertices).vertices]).max())}
    info |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    info |= {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}
    return bytes(mesh.export(file_type="ply", vertex_normal=True)), info


def _write_scene(place: Path, frames: Iterable[DatasetFrame], models: _Models) -> None:
    for name in _FOLDERS:
        (place / name).mkdir(parents=True)
    tables: dict[str, dict[str, Any]] = {name: {} for name in _TABLES}
    for frame in frames:
        surface = read_surface(frame)
        _check_camera(frame, surface.camera)
        fruit, key = list(frame.fruit.values()), str(frame.index)
        (place / "rgb" / f"{frame.name}.png").write_bytes(frame.content("colour"))
        (place / "depth" / f"{frame.name}.png").write_bytes(depth_png(surface.depth_z, surface.depth_unit_m))
        tables["scene_camera"][key] = _camera_record(surface)
        tables["scene_gt"][key] = [_pose_record(frame, entry, models) for entry in fruit]
        tables["scene_gt_info"][key] = _write_masks(place, frame, surface, fruit)
        models.camera = models.camera or _camera_file(surface)
    for name, records in tables.items():
        _write_json(place / f"{name}.json", records)


def _check_camera(frame: DatasetFrame, camera: Camera) -> None:
    path = frame.dataset.frame_path(frame.index)
    if not camera.lens.distortion.is_zero:
        value = camera.lens.distortion.to_json()
        raise InputError(path, "must be zero: BOP has no distortion", key="camera.distortion", value=value)
    if camera.rows_move:
        raise InputError(path, "must be zero: BOP has one pose for all rows", key="camera.motion")


def _pose_record(frame: DatasetFrame, fruit: Mapping[str, Any], models: _Models) -> dict[str, Any]:
    number, model = models.of(frame, fruit)
    rotation, translation = model.to_camera(np.asarray(fruit["pose"], dtype=float))
    return {
        "cam_R_m2c": rotation.ravel().tolist(),
        "cam_t_m2c": (MILLIMETRES * translation).tolist(),
        "obj_id": number,
    }


def _write_masks(
    place: Path, frame: DatasetFrame, surface: RangeImage, fruit: Iterable[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Write the masks of the fruit of a frame, and return their entries in `scene_gt_info.json`."""
    instance, has_depth = read_label(frame, "instance", surface), np.isfinite(surface.distance)
    records = []
    for number, entry in enumerate(fruit):
        amodal, visible = decode_rle(entry["amodal"]), instance == entry["instance"]
        if amodal.shape != instance.shape:
            problem = f"must have masks of {instance.shape[1]} x {instance.shape[0]} pixels"
            raise InputError(frame.dataset.path(frame.index, "harvest"), problem, key="fruit.amodal")
        for name, mask in (("mask", amodal), ("mask_visib", visible)):
            content = png_bytes(np.where(mask, np.uint8(255), np.uint8(0)))
            (place / name / f"{frame.name}_{number:06d}.png").write_bytes(content)
        counts = {"all": amodal.sum(), "valid": (amodal & has_depth).sum(), "visib": visible.sum()}
        records.append(
            {
                "bbox_obj": _box(amodal),
                "bbox_visib": _box(visible),
                **{f"px_count_{name}": int(count) for name, count in counts.items()},
                "visib_fract": float(counts["visib"] / counts["all"]) if counts["all"] else 0.0,
            }
        )
    return records


def _box(mask: NDArray[np.bool_]) -> list[int]:
    """Left, top, width and height of a mask, as BOP has them; -1 for an empty one."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return [-1] * 4
    return [
        int(columns[0]), int(rows[0]), int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1),
    ]  # fmt: skip


def _camera_record(surface: RangeImage) -> dict[str, Any]:
    """An entry of `scene_camera.json`; as in OpenCV, the centre of the upper left pixel is at (0, 0)."""
    camera = surface.camera
    matrix = camera.intrinsics.copy()
    matrix[:2, 2] -= CENTRE_OF_FIRST_PIXEL
    to_camera = camera.pose[:3, :3].T
    return {
        "cam_K": matrix.ravel().tolist(),
        "cam_R_w2c": to_camera.ravel().tolist(),
        "cam_t_w2c": (-MILLIMETRES * (to_camera @ camera.pose[:3, 3])).tolist(),
        # Millimetres of a step, without the rounding errors of the product.
        "depth_scale": round(MILLIMETRES * surface.depth_unit_m, 9),
    }


def _camera_file(surface: RangeImage) -> dict[str, float]:
    record, camera = _camera_record(surface), surface.camera
    fx, _, cx, _, fy, cy, *_ = record["cam_K"]
    size = {"width": camera.width, "height": camera.height}
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, **size, "depth_scale": record["depth_scale"]}


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    """A JSON object with one key per line, as BOP's own files."""
    encode = json.JSONEncoder(allow_nan=False).encode
    lines = [f"  {encode(key)}: {encode(value)}" for key, value in content.items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")

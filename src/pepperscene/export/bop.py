"""BOP: poses of fruit in camera axes, amodal and visible masks, and a model of each fruit.

Format: https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md (BOP-scenewise).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.camera.optics.calibration import CENTRE_OF_FIRST_PIXEL
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.images import png_bytes
from pepperscene.errors import InputError
from pepperscene.export.fruit_models import FruitMeshes, FruitModel
from pepperscene.export.job import ExportJob, write_table
from pepperscene.export.surface import MILLIMETRES, RangeImage, read_label, read_surface
from pepperscene.recipe.plan import Plan
from pepperscene.truth.encodings import decode_rle

_DEPTH_SCALE: Final = 1.0  # millimetres per step of a depth image
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
_NO_BOX: Final = (-1, -1, -1, -1)


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
    models = _Models(FruitMeshes(job.dataset), job.plan, folder)
    for name, frames in job.frames_by_group(groups):
        _write_scene(folder / name, frames, models)
    models.write_tables()


def _scene_id(plan: Plan, index: int) -> int:
    """Number of a frame's scene; twins, which may differ in anything, are scenes of their own."""
    spec = plan.frame(index)
    return spec.scene * plan.twins + spec.twin


class _Models:
    """The models of all fruit, written when the first frame shows them."""

    def __init__(self, meshes: FruitMeshes, plan: Plan, folder: Path) -> None:
        self.meshes, self.plan, self.folder = meshes, plan, folder
        self.ids: dict[tuple[int, int], int] = {}  # by scene and instance
        self.models: dict[int, FruitModel] = {}
        self.info: dict[str, dict[str, float]] = {}
        self.rows: list[dict[str, Any]] = []
        self.camera: dict[str, float] = {}
        (folder / "models").mkdir()

    def of(self, frame: DatasetFrame, fruit: Mapping[str, Any]) -> tuple[int, FruitModel]:
        """Object id and model of a fruit in a frame."""
        scene = _scene_id(self.plan, frame.index)
        key = scene, fruit["instance"]
        if key not in self.ids:
            number = self.ids[key] = len(self.ids) + 1
            pose = np.asarray(frame.metadata["camera"]["pose"], dtype=float)
            model = self.models[number] = self.meshes.model(self.plan.frame(frame.index), pose, fruit)
            content, self.info[str(number)] = _model_file(model)
            (self.folder / "models" / f"obj_{number:06d}.ply").write_bytes(content)
            self.rows.append({**fruit, "obj_id": number, "scene_id": scene})
        return self.ids[key], self.models[self.ids[key]]

    def write_tables(self) -> None:
        _write_json(self.folder / "models" / "models_info.json", self.info)
        _write_json(self.folder / "camera.json", self.camera)
        write_table(self.folder / "objects.csv", _COLUMNS, self.rows)


def _model_file(model: FruitModel) -> tuple[bytes, dict[str, float]]:
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
        (place / "depth" / f"{frame.name}.png").write_bytes(surface.depth_png())
        tables["scene_camera"][key] = _camera_record(surface.camera)
        tables["scene_gt"][key] = [_pose_record(frame, entry, models) for entry in fruit]
        tables["scene_gt_info"][key] = _write_masks(place, frame, surface, fruit)
        models.camera = models.camera or _camera_file(surface.camera)
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
    rotation, translation = model.model_to_camera(np.asarray(fruit["pose"], dtype=float))
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
        return list(_NO_BOX)
    return [
        int(columns[0]), int(rows[0]), int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1),
    ]  # fmt: skip


def _camera_record(camera: Camera) -> dict[str, Any]:
    """An entry of `scene_camera.json`; as in OpenCV, the centre of the upper left pixel is at (0, 0)."""
    matrix = camera.intrinsics.copy()
    matrix[:2, 2] -= CENTRE_OF_FIRST_PIXEL
    to_camera = camera.pose[:3, :3].T
    return {
        "cam_K": matrix.ravel().tolist(),
        "cam_R_w2c": to_camera.ravel().tolist(),
        "cam_t_w2c": (-MILLIMETRES * (to_camera @ camera.pose[:3, 3])).tolist(),
        "depth_scale": _DEPTH_SCALE,
    }


def _camera_file(camera: Camera) -> dict[str, float]:
    fx, _, cx, _, fy, cy, *_ = _camera_record(camera)["cam_K"]
    size = {"width": camera.width, "height": camera.height}
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, **size, "depth_scale": _DEPTH_SCALE}


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    """A JSON object with one key per line, as BOP's own files."""
    encode = json.JSONEncoder(allow_nan=False).encode
    lines = [f"  {encode(key)}: {encode(value)}" for key, value in content.items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")

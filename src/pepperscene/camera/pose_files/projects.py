"""Poses in files of reconstruction programs: nerfstudio's transforms.json, and COLMAP's text model."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.camera.camera import Camera
from pepperscene.camera.poses.pose_list import (
    Array,
    PoseList,
    check_count,
    check_name,
    check_positions,
    finite_number,
    nearest_rotations,
    quaternions_of,
    rigid_poses,
    rotations_of_quaternions,
    text_of,
)
from pepperscene.document import parse_json
from pepperscene.errors import ArgumentError, InputError

_OPENGL: Final = np.array([1.0, -1.0, -1.0])
"""Signs of the camera's axes: nerfstudio's point right, up and backwards, ours right, down and forward."""
_COLMAP_FIELDS: Final = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
COLMAP_CAMERAS: Final = "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n"
COLMAP_IMAGES: Final = f"# {_COLMAP_FIELDS}\n# POINTS2D[] as X Y POINT3D_ID\n"
COLMAP_POINTS: Final = "# POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX\n"
"""First lines of the files of a model."""
_RADIAL: Final = ("k1", "k2", "k3", "k4", "k5", "k6")


# --- nerfstudio ------------------------------------------------------------------------------------------


def read_nerfstudio(path: Path, text: str) -> PoseList:
    """Poses of a transforms.json, in the order of the file, with their `file_path` as names.

    A key `applied_transform` says that the file's world is A times the original world, and `applied_scale`
    that its positions were multiplied by a factor; both are undone.

    Raises:
        InputError: the file is not JSON, has no frames, or a matrix is not a rotation and a translation.
    """
    try:
        content = parse_json(text.encode(), "poses")
    except ValueError as error:
        raise InputError(path, f"is not valid JSON: {error}") from None
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list):
        raise InputError(path, "must be a list of frames, each with a transform_matrix", key="frames")
    check_count(len(frames), path)

    def label(number: int) -> str:
        return f"frames[{number}].transform_matrix"

    matrices = []
    for number, frame in enumerate(frames):
        matrix = frame.get("transform_matrix") if isinstance(frame, dict) else None
        matrices.append(_matrix(matrix, path, label(number)))
    stack = np.array(matrices)
    rotation = nearest_rotations(stack[:, :3, :3] * _OPENGL, path, label)
    poses = _original_world(content, rigid_poses(rotation, stack[:, :3, 3]), path)
    check_positions(poses[:, :3, 3], path, label)
    return PoseList(poses, names=_frame_names(frames, path))


def nerfstudio_text(poses: PoseList, camera: Camera | None) -> str:
    """The text of a transforms.json; times are not part of it.

    Raises:
        ArgumentError: the lens has a rational distortion, which nerfstudio does not have.
    """
    content: dict[str, Any] = {} if camera is None else nerfstudio_intrinsics(camera)
    content["frames"] = [
        nerfstudio_frame(name, pose) for name, pose in zip(_image_names(poses), poses.poses, strict=True)
    ]
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def nerfstudio_frame(file_path: str, pose: Array) -> dict[str, Any]:
    """An entry of `frames`: the image's path, and the pose `(4, 4)` with nerfstudio's camera axes."""
    matrix = pose.copy()
    matrix[:3, :3] *= _OPENGL
    return {"file_path": file_path, "transform_matrix": matrix.tolist()}


def _matrix(rows: object, path: Path, key: str) -> list[list[float]]:
    """Four rows of four numbers; the last row may be left out."""
    problem = "must have 4 rows of 4 numbers, the last of them 0, 0, 0, 1"
    is_matrix = isinstance(rows, list) and all(isinstance(row, list) and len(row) == 4 for row in rows)
    if not isinstance(rows, list) or not is_matrix or len(rows) not in (3, 4):
        raise InputError(path, problem, key=key)
    matrix = [[finite_number(value, path, key) for value in row] for row in rows]
    last = [0.0, 0.0, 0.0, 1.0]
    if len(matrix) == 4 and matrix[3] != last:
        raise InputError(path, problem, key=key, value=matrix[3])
    return [*matrix[:3], last]


def _original_world(content: dict[str, Any], poses: Array, path: Path) -> Array:
    """Poses in the original world, without the file's transform A and scale: p' = scale A p."""
    # Positions that overflow are reported with those that are too far away.
    with np.errstate(over="ignore", invalid="ignore"):
        if "applied_scale" in content:
            scale = finite_number(content["applied_scale"], path, "applied_scale")
            if not scale > 0:
                raise InputError(path, "must be positive", key="applied_scale", value=scale)
            poses[:, :3, 3] /= scale
        if "applied_transform" in content:
            key = "applied_transform"
            applied = np.array(_matrix(content[key], path, key))
            applied[:3, :3] = nearest_rotations(applied[None, :3, :3], path, lambda _: key)[0]
            back = applied[:3, :3].T
            poses = rigid_poses(back @ poses[:, :3, :3], (poses[:, :3, 3] - applied[:3, 3]) @ back.T)
    return poses


def _frame_names(frames: list[dict[str, Any]], path: Path) -> tuple[str, ...] | None:
    names: list[Any] = [frame.get("file_path") for frame in frames]
    if None in names:
        return None
    for number, name in enumerate(names):
        check_name(name, path, f"frames[{number}].file_path")
    return tuple(names)


def nerfstudio_intrinsics(camera: Camera) -> dict[str, Any]:
    """Keys of the camera; nerfstudio's pixel centres are at half pixels, as ours.

    Raises:
        ArgumentError: the lens has a rational distortion, which nerfstudio does not have.
    """
    matrix, coefficients = camera.intrinsics, _coefficients(camera)
    is_fisheye = "p1" not in coefficients
    if not is_fisheye and any(coefficients.get(name) for name in ("k4", "k5", "k6")):
        allowed = "must be k1, k2, p1, p2, k3 or a fisheye's k1 to k4 for nerfstudio"
        raise ArgumentError("camera", f"{allowed}; only COLMAP has k4 to k6", key="lens.distortion")
    return {
        "camera_model": "OPENCV_FISHEYE" if is_fisheye else "OPENCV",
        "fl_x": float(matrix[0, 0]),
        "fl_y": float(matrix[1, 1]),
        "cx": float(matrix[0, 2]),
        "cy": float(matrix[1, 2]),
        "w": camera.width,
        "h": camera.height,
        **{name: value for name, value in coefficients.items() if name not in ("k5", "k6")},
    }


# --- COLMAP ----------------------------------------------------------------------------------------------


def read_colmap(path: Path, text: str) -> PoseList:
    """Poses of an images.txt, sorted by name.

    Each image has a line `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME` with its pose from world to camera,
    and a line of points, which may be empty.

    Raises:
        InputError: a line does not have these fields, a quaternion is not of length 1, or names are equal.
    """
    values: list[list[float]] = []
    places: dict[str, str] = {}  # the line of each image, by name
    lines = enumerate(text.split("\n"), start=1)
    for number, line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        place = f"line {number}"
        fields = line.split(maxsplit=9)
        if len(fields) != 10:
            problem = f"must have 10 fields, {_COLMAP_FIELDS}, not {len(fields)}"
            raise InputError(path, problem, key=place)
        columns = zip(_COLMAP_FIELDS.split()[1:8], fields[1:8], strict=True)
        values.append([finite_number(field, path, f"{place}, {column}") for column, field in columns])
        name = fields[9].strip()
        check_name(name, path, f"{place}, NAME")
        if name in places:
            raise InputError(path, "must be a name of one image only", key=f"{place}, NAME", value=name)
        places[name] = place
        check_count(len(values), path)
        # The line of points is always there, except at the end of the file.
        if not _is_line_of_points(next(lines, (0, ""))[1]):
            problem = "must be the points X Y POINT3D_ID of the image before it, or empty"
            raise InputError(path, problem, key=f"line {number + 1}")
    check_count(len(values), path)
    names = list(places)

    def label(number: int) -> str:
        return places[names[number]]

    table = np.array(values)
    to_camera = rotations_of_quaternions(table[:, [1, 2, 3, 0]], path, label)
    check_positions(table[:, 4:], path, label)
    rotation = np.swapaxes(to_camera, 1, 2)
    position = -(rotation @ table[:, 4:, None])[..., 0]
    order = sorted(range(len(names)), key=names.__getitem__)
    return PoseList(rigid_poses(rotation, position)[order], names=tuple(sorted(names)))


def _is_line_of_points(line: str) -> bool:
    """Whether a line has triples X Y POINT3D_ID or nothing; an image's line ends with a name instead."""
    # Counted one by one: a line can have millions.
    count = sum(1 for _ in re.finditer(r"\S+", line))
    return not count or (count % 3 == 0 and line.rsplit(maxsplit=1)[-1].removeprefix("-").isdecimal())


def colmap_texts(poses: PoseList, camera: Camera | None) -> dict[str, str]:
    """Content of the files of a COLMAP model by name; times are not part of it.

    Raises:
        ArgumentError: two names are equal.
    """
    names = _image_names(poses)
    if len(set(names)) != len(names):
        raise ArgumentError("poses", "must be different for a COLMAP model", key="names")
    lines = colmap_images(poses.poses, range(1, 1 + len(names)), [1] * len(names), names)
    # An empty line of points follows each image.
    files = {"images.txt": COLMAP_IMAGES + "".join(f"{line}\n\n" for line in lines)}
    if camera is not None:
        files["cameras.txt"] = f"{COLMAP_CAMERAS}{colmap_camera(camera)}\n"
        files["points3D.txt"] = COLMAP_POINTS
    return files


def colmap_images(
    poses: Array, numbers: Sequence[int], cameras: Sequence[int], names: Sequence[str]
) -> list[str]:
    """The first lines of images of images.txt, without the lines of points.

    Args:
        poses: `(n, 4, 4)` camera to world.
        numbers: IMAGE_ID of each.
        cameras: CAMERA_ID of each.
        names: of the files.
    """
    to_camera = np.swapaxes(poses[:, :3, :3], 1, 2)
    translation = -(to_camera @ poses[:, :3, 3:])[..., 0]
    rows = np.hstack([np.roll(quaternions_of(to_camera), 1, axis=1), translation])
    return [
        f"{number} {' '.join(text_of(row))} {camera} {name}"
        for number, row, camera, name in zip(numbers, rows, cameras, names, strict=True)
    ]


def colmap_camera(camera: Camera, number: int = 1) -> str:
    """A line of cameras.txt with the simplest model; COLMAP's pixel centres are at half pixels, as ours."""
    matrix, values = camera.intrinsics, _coefficients(camera)
    if "p1" not in values:
        model, names = "OPENCV_FISHEYE", ["k1", "k2", "k3", "k4"]
    elif not any(values.values()):
        model, names = "PINHOLE", []
    elif not any(values.get(name) for name in _RADIAL[2:]):
        model, names = "OPENCV", ["k1", "k2", "p1", "p2"]
    else:
        model, names = "FULL_OPENCV", ["k1", "k2", "p1", "p2", *_RADIAL[2:]]
    parameters = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    parameters += [values.get(name, 0.0) for name in names]
    return f"{number} {model} {camera.width} {camera.height} {' '.join(text_of(np.array(parameters)))}"


# --- both ------------------------------------------------------------------------------------------------


def _coefficients(camera: Camera) -> dict[str, float]:
    """Coefficients of the lens' distortion by OpenCV's names; a fisheye has no p1."""
    fields = dataclasses.asdict(camera.lens.distortion)
    return {name: float(fields[name]) for name in (*_RADIAL, "p1", "p2") if name in fields}


def _image_names(poses: PoseList) -> tuple[str, ...]:
    """The names of the poses, or numbers with as many digits as 100,000 poses need."""
    return poses.names or tuple(f"{number:06d}.png" for number in range(len(poses)))

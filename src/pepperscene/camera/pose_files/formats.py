"""Reading and writing files of camera poses: TUM, CSV, nerfstudio and COLMAP."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal, get_args

from pepperscene.camera.camera import Camera
from pepperscene.camera.pose_files.projects import colmap_texts, nerfstudio_text, read_colmap, read_nerfstudio
from pepperscene.camera.pose_files.tables import csv_text, read_csv, read_tum, tum_text
from pepperscene.camera.poses.pose_list import PoseList
from pepperscene.document import read_text
from pepperscene.errors import ArgumentError, InputError, OutputError

PoseFormat = Literal["tum", "csv", "nerfstudio", "colmap"]
_ALLOWED: Final = "allowed are TUM, CSV with a header, nerfstudio's transforms.json and COLMAP's images.txt"
_MOST_LINES: Final = 3_000_000  # chosen: 100,000 poses, the most that are read, have 2.6 million as JSON
_READERS: Final = {"tum": read_tum, "csv": read_csv, "nerfstudio": read_nerfstudio, "colmap": read_colmap}
_IN_FOLDERS: Final = ("images.txt", "sparse/0/images.txt", "transforms.json")
_MODEL_PARTS: Final = ("cameras", "images", "points3D", "rigs", "frames")
_MODEL_FILES: Final = tuple(f"{part}.{kind}" for part in _MODEL_PARTS for kind in ("txt", "bin"))


def read_poses(path: str | Path) -> PoseList:
    """Camera poses of a file, or of the folder of a COLMAP model; the format is recognised.

    - TUM: lines `timestamp tx ty tz qx qy qz qw`, camera to world, in seconds and metres;
    - CSV: a header, and a position with a quaternion, with yaw, pitch and roll, or with a target;
    - nerfstudio: `transforms.json`, with camera axes right, up, backwards; `applied_transform` is undone;
    - COLMAP: `images.txt`, world to camera, sorted by name.

    Positions are in the file's world, which must have z up and metres to place plants in it.

    Raises:
        InputError: the file is missing, has another format, or contains a value that is not allowed.
    """
    file = _file_in(Path(path))
    text = read_text(file, "poses")
    if text.count("\n") > _MOST_LINES:
        raise InputError(file, f"has more than {_MOST_LINES:,} lines")
    return _READERS[_format_of(file, text)](file, text)


def write_poses(path: str | Path, poses: PoseList, format: PoseFormat, camera: Camera | None = None) -> None:
    """Write camera poses with all digits: reading them again gives the same poses to 1e-9.

    A TUM file has no names, a transforms.json and a COLMAP model have no times. Poses without names are
    named `000000.png` and so on. With a camera, `transforms.json` gets its intrinsics (fl_x, fl_y, cx, cy,
    k1, ...), and COLMAP a `cameras.txt` and an empty `points3D.txt`, without which it cannot read a model.
    Nerfstudio and COLMAP have the centre of the upper left pixel at (0.5, 0.5), as this program; OpenCV has
    it at (0, 0).

    Args:
        path: the file, which is replaced; for COLMAP a folder without a model, which is made if missing.
        poses: in order; COLMAP sorts them by name.
        format: "tum", "csv", "nerfstudio" or "colmap".
        camera: for nerfstudio and COLMAP only; its pose is not used.

    Raises:
        ArgumentError: the format cannot hold the poses or the camera.
        OutputError: the file cannot be written, or the folder already has a COLMAP model.
    """
    target = Path(path)
    if format not in get_args(PoseFormat):
        raise ArgumentError("format", f"must be one of {', '.join(get_args(PoseFormat))}", value=format)
    if camera is not None and format in ("tum", "csv"):
        raise ArgumentError("camera", f"must be None: the format {format} has no intrinsics")
    if format == "colmap":
        _write(target, colmap_texts(poses, camera), is_model=True)
    elif format == "nerfstudio":
        _write(target.parent, {target.name: nerfstudio_text(poses, camera)})
    else:
        _write(target.parent, {target.name: tum_text(poses) if format == "tum" else csv_text(poses)})


def _file_in(path: Path) -> Path:
    """The file of a path, which may be a folder."""
    if not path.is_dir():
        return path
    for name in _IN_FOLDERS:
        if (path / name).is_file():
            return path / name
    if (path / "images.bin").exists():
        problem = "has a binary COLMAP model; convert it with colmap model_converter --output_type TXT"
        raise InputError(path, problem)
    raise InputError(path, f"is a folder without one of {', '.join(_IN_FOLDERS)}")


def _format_of(path: Path, text: str) -> PoseFormat:
    """The format of a file, by its name or its first line that is neither empty nor a comment."""
    lines = (line.split("#", 1)[0].strip() for line in text.split("\n"))
    first = next((line for line in lines if line), "")
    if not first:
        raise InputError(path, f"contains no poses; {_ALLOWED}")
    fields = first.split(maxsplit=9)
    if path.suffix.lower() == ".json" or first.startswith(("{", "[")):
        return "nerfstudio"
    if path.suffix.lower() == ".csv" or ("," in first and path.name != "images.txt"):
        return "csv"
    if path.name == "images.txt" or len(fields) >= 10:
        return "colmap"
    if path.suffix.lower() == ".tum" or _is_number(fields[0]):
        return "tum"
    raise InputError(path, f"is not a file of camera poses; {_ALLOWED}")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _write(folder: Path, texts: Mapping[str, str], is_model: bool = False) -> None:
    """Write all files, or none: they are complete under temporary names before the first is renamed."""
    temporary = {name: folder / f".{name}.{secrets.token_hex(8)}.tmp" for name in texts}
    # A single file is named in errors; the files of a model are not what the user has named.
    target = folder if is_model else folder / next(iter(texts))
    try:
        if is_model:
            folder.mkdir(parents=True, exist_ok=True)
            if found := [name for name in _MODEL_FILES if (folder / name).exists()]:
                raise OutputError(f"{folder}: already has a COLMAP model ({found[0]}); choose another folder")
        for name, text in texts.items():
            temporary[name].write_text(text, encoding="utf-8", newline="\n")
        for name in texts:
            os.replace(temporary[name], folder / name)
    except OSError as error:
        raise OutputError(f"{target}: cannot be written ({error.strerror or error})") from None
    except ValueError as error:
        # A path that no file system accepts.
        raise OutputError(f"{str(target)!r}: cannot be written ({error})") from None
    finally:
        for path in temporary.values():
            # Where nothing could be written there is nothing to remove, and trying can fail again.
            with contextlib.suppress(OSError, ValueError):
                path.unlink(missing_ok=True)

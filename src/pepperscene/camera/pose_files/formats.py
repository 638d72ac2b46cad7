"""Files of camera poses: TUM and CSV tables, and the choice among these, nerfstudio and COLMAP."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from pepperscene.atomic import atomic_write
from pepperscene.camera.camera import Camera
from pepperscene.camera.pose_files.projects import colmap_texts, nerfstudio_text, read_colmap, read_nerfstudio
from pepperscene.camera.poses.generators import look_at
from pepperscene.camera.poses.pose_list import (
    Array,
    Label,
    PoseList,
    ascending_times,
    check_count,
    check_name,
    check_positions,
    finite_number,
    quaternions_of,
    rigid_poses,
    rotations_of_quaternions,
    text_of,
)
from pepperscene.document import read_text
from pepperscene.errors import ArgumentError, InputError, OutputError

_TUM_COLUMNS: Final = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_LONGEST_LINE: Final = 10_000  # characters; chosen: a pose with all digits and a long name has 300
_METRES: Final = {"_m": 1.0, "_mm": 1e-3, "": 1.0}
"""Unit of a coordinate by the end of its column's name."""
_QUATERNION: Final = ("qx", "qy", "qz", "qw")
_ANGLES: Final = ("yaw_deg", "pitch_deg", "roll_deg")
_COLUMNS_ALLOWED: Final = (
    "allowed are x_m, y_m, z_m (or x_mm, ..., or x, y, z in metres) with qx, qy, qz, qw, or yaw_deg, "
    "pitch_deg and optionally roll_deg, or target_x_m, target_y_m, target_z_m; and optionally t_s and name"
)
_LEVEL: Final = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""Camera axes in columns at yaw, pitch and roll 0: forward along +y, right along +x."""


class _Table(NamedTuple):
    """Texts of a file by column, and the line of each row."""

    path: Path
    columns: dict[str, int]
    rows: list[list[str]]
    lines: list[int]

    def label(self, row: int) -> str:
        return f"line {self.lines[row]}"

    def numbers(self, names: Sequence[str]) -> Array:
        """`(n, len(names))` finite numbers of these columns."""
        places = [(name, self.columns[name]) for name in names]
        values = [
            [finite_number(row[i].strip(), self.path, f"line {line}, {name}") for name, i in places]
            for row, line in zip(self.rows, self.lines, strict=True)
        ]
        return np.array(values)


def read_tum(path: Path, text: str) -> PoseList:
    """Poses of lines `timestamp tx ty tz qx qy qz qw` in seconds and metres; `#` starts a comment.

    Raises:
        InputError: a line does not have eight finite numbers, a quaternion is not of length 1, or times are
            not ascending.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    for number, line in enumerate(_lines(path, text), start=1):
        fields = line.split("#", 1)[0].split()
        if not fields:
            continue
        if len(fields) != len(_TUM_COLUMNS):
            problem = f"must have {len(_TUM_COLUMNS)} numbers, {' '.join(_TUM_COLUMNS)}, not {len(fields)}"
            raise InputError(path, problem, key=f"line {number}")
        rows.append(fields)
        lines.append(number)
        check_count(len(rows), path)
    check_count(len(rows), path)
    table = _Table(path, {name: i for i, name in enumerate(_TUM_COLUMNS)}, rows, lines)
    values = table.numbers(_TUM_COLUMNS)
    times = ascending_times(values[:, 0].tolist(), path, table.label)
    check_positions(values[:, 1:4], path, table.label)
    rotation = rotations_of_quaternions(values[:, 4:], path, table.label)
    return PoseList(rigid_poses(rotation, values[:, 1:4]), times)


def tum_text(poses: PoseList) -> str:
    """The text of a TUM file; names are not part of it.

    Raises:
        ArgumentError: the poses have no times.
    """
    if poses.times_s is None:
        raise ArgumentError("poses", "must have times to be written as a TUM file", key="times_s")
    rows = np.column_stack([poses.times_s, poses.poses[:, :3, 3], quaternions_of(poses.poses[:, :3, :3])])
    return "\n".join([f"# {' '.join(_TUM_COLUMNS)}", *(" ".join(text_of(row)) for row in rows), ""])


def read_csv(path: Path, text: str) -> PoseList:
    """Poses of a table with commas and a header; blank lines and lines that start with `#` are left out.

    Raises:
        InputError: the columns are not a position with an orientation, or a value is not allowed.
    """
    table = _read_table(path, text)
    names = set(table.columns)
    position_columns, scale = _coordinates("", names, path)
    position = table.numbers(position_columns) * scale
    check_positions(position, path, table.label)
    # Exactly one kind of orientation.
    has_target = any(name.startswith("target_") for name in names)
    has = {"q": bool(names & set(_QUATERNION)), "angles": bool(names & set(_ANGLES)), "target": has_target}
    if sum(has.values()) != 1:
        found = "more than one kind of" if any(has.values()) else "no"
        raise InputError(path, f"has {found} orientation; {_COLUMNS_ALLOWED}", key="header")
    if has["target"]:
        target_columns, scale = _coordinates("target_", names, path)
        used = {*position_columns, *target_columns}
        poses = _poses_of_targets(position, table.numbers(target_columns) * scale, path, table.label)
    else:
        orientation = _QUATERNION if has["q"] else _ANGLES[: 3 if "roll_deg" in names else 2]
        if missing := set(orientation) - names:
            raise InputError(path, f"lacks the column {min(missing)}; {_COLUMNS_ALLOWED}", key="header")
        used = {*position_columns, *orientation}
        values = table.numbers(orientation)
        if has["q"]:
            rotation = rotations_of_quaternions(values, path, table.label)
        else:
            rotation = rotations_of_angles(np.radians(values))
        poses = rigid_poses(rotation, position)
    if unknown := names - used - {"t_s", "name"}:
        raise InputError(path, f"has an unknown column; {_COLUMNS_ALLOWED}", key="header", value=min(unknown))
    times = None
    if "t_s" in names:
        times = ascending_times(table.numbers(["t_s"])[:, 0].tolist(), path, table.label)
    return PoseList(poses, times, _names(table) if "name" in names else None)


def csv_text(poses: PoseList) -> str:
    """The text of a CSV file in metres with quaternions, and with times and names if there are any.

    Raises:
        ArgumentError: a name starts with `#`, so that its row would be read as a comment.
    """
    if comments := [name for name in poses.names or () if name.startswith("#")]:
        problem = "must not start with # in a CSV file, where it starts a comment"
        raise ArgumentError("poses", problem, key="names", value=comments[0])
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    columns = ["x_m", "y_m", "z_m", *_QUATERNION]
    numbers = np.hstack([poses.poses[:, :3, 3], quaternions_of(poses.poses[:, :3, :3])])
    rows = [text_of(row) for row in numbers]
    if poses.times_s is not None:
        columns = ["t_s", *columns]
        rows = [[time, *row] for time, row in zip(text_of(poses.times_s), rows, strict=True)]
    if poses.names is not None:
        columns = ["name", *columns]
        rows = [[name, *row] for name, row in zip(poses.names, rows, strict=True)]
    writer.writerows([columns, *rows])
    return buffer.getvalue()


def rotations_of_angles(angles_rad: Array) -> Array:
    """`(n, 3, 3)` camera axes of yaw, pitch and, by default 0, roll `(n, 2 or 3)`.

    At 0 the camera is level and looks along +y, into the crop. Yaw turns it about the vertical, positive
    counter-clockwise as seen from above; pitch then tilts it up; roll then turns it about its optical axis,
    positive clockwise as seen from behind it: R = Rz(yaw) Rx(pitch) L Rz(roll) with the level axes L.
    """
    from scipy.spatial.transform import Rotation

    direction = Rotation.from_euler("ZX", angles_rad[:, :2]).as_matrix() @ _LEVEL
    if angles_rad.shape[1] == 2:
        return np.asarray(direction)
    return np.asarray(direction @ Rotation.from_euler("z", angles_rad[:, 2:]).as_matrix())


def _read_table(path: Path, text: str) -> _Table:
    reader = csv.reader((f"{line}\n" for line in _lines(path, text)), skipinitialspace=True)
    columns: dict[str, int] = {}
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for fields in reader:
            if not any(field.strip() for field in fields) or fields[0].startswith("#"):
                continue
            if not columns:
                names = [field.strip() for field in fields]
                if repeated := {name for name, count in Counter(names).items() if count > 1}:
                    allowed = "must name each column once"
                    raise InputError(path, allowed, key="header", value=min(repeated))
                columns = {name: number for number, name in enumerate(names)}
                continue
            if len(fields) != len(columns):
                problem = f"must have {len(columns)} values, as many as the header, not {len(fields)}"
                raise InputError(path, problem, key=f"line {reader.line_num}")
            rows.append(fields)
            lines.append(reader.line_num)
            check_count(len(rows), path)
    except csv.Error as error:
        raise InputError(path, f"is not a table: {error}", key=f"line {reader.line_num}") from None
    check_count(len(rows), path)
    return _Table(path, columns, rows, lines)


def _lines(path: Path, text: str) -> Iterator[str]:
    """The lines of a table; raises `InputError` for one that is far too long for a pose."""
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > _LONGEST_LINE:
            raise InputError(path, f"is longer than {_LONGEST_LINE:,} characters", key=f"line {number}")
        yield line


def _coordinates(prefix: str, names: set[str], path: Path) -> tuple[list[str], float]:
    """Three columns of coordinates, and their unit in metres."""
    found = [
        ([f"{prefix}{axis}{suffix}" for axis in "xyz"], scale)
        for suffix, scale in _METRES.items()
        if {f"{prefix}{axis}{suffix}" for axis in "xyz"} & names
    ]
    if len(found) != 1 or not names.issuperset(found[0][0]):
        problem = f"must have {prefix}x, {prefix}y and {prefix}z in one unit; {_COLUMNS_ALLOWED}"
        raise InputError(path, problem, key="header")
    return found[0]


def _poses_of_targets(position: Array, target: Array, path: Path, label: Label) -> Array:
    poses = np.empty((len(position), 4, 4))
    for number, (start, end) in enumerate(zip(position, target, strict=True)):
        try:
            poses[number] = look_at(start, end)
        except ValueError as error:
            raise InputError(path, f"has a target that is not allowed: {error}", key=label(number)) from None
    return poses


def _names(table: _Table) -> tuple[str, ...]:
    names = tuple(row[table.columns["name"]].strip() for row in table.rows)
    for number, name in enumerate(names):
        check_name(name, table.path, f"{table.label(number)}, name")
    return names


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
    target, no_intrinsics = Path(path), {"tum": tum_text, "csv": csv_text}
    if format not in get_args(PoseFormat):
        raise ArgumentError("format", f"must be one of {', '.join(get_args(PoseFormat))}", value=format)
    if camera is not None and format in no_intrinsics:
        raise ArgumentError("camera", f"must be None: the format {format} has no intrinsics")
    if format == "colmap":
        _write(target, colmap_texts(poses, camera), is_model=True)
    else:
        write = no_intrinsics.get(format)
        text = nerfstudio_text(poses, camera) if write is None else write(poses)
        _write(target.parent, {target.name: text})


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
    try:
        if path.suffix.lower() != ".tum":
            float(fields[0])
    except ValueError:
        raise InputError(path, f"is not a file of camera poses; {_ALLOWED}") from None
    return "tum"


def _write(folder: Path, texts: Mapping[str, str], is_model: bool = False) -> None:
    """Write all files, or none: they are complete under temporary names before the first is renamed."""
    # A single file is named in errors; the files of a model are not what the user has named.
    target = folder if is_model else folder / next(iter(texts))
    try:
        if is_model:
            folder.mkdir(parents=True, exist_ok=True)
            if found := [name for name in _MODEL_FILES if (folder / name).exists()]:
                raise OutputError(f"{folder}: already has a COLMAP model ({found[0]}); choose another folder")
        with ExitStack() as files:
            for name, text in texts.items():
                temporary = files.enter_context(atomic_write(folder / name))
                temporary.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise OutputError(f"{target}: cannot be written ({error.strerror or error})") from None
    except ValueError as error:
        # A path that no file system accepts.
        raise OutputError(f"{str(target)!r}: cannot be written ({error})") from None

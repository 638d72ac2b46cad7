"""Files of camera poses against SciPy, COLMAP's own reader, and nerfstudio's conversion written out."""

from __future__ import annotations

import json
from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pepperscene.camera import (
    Camera,
    Distortion,
    FisheyeDistortion,
    PoseList,
    arc_path,
    load_lens,
    load_sensor,
    look_at,
    read_poses,
    write_poses,
)
from pepperscene.camera.optics.calibration import CameraCalibration
from pepperscene.errors import ArgumentError, InputError, OutputError

FORMATS = {"tum": "poses.txt", "csv": "poses.csv", "nerfstudio": "transforms.json", "colmap": "model"}
BARREL = replace(
    load_lens("lensagon_cmfa0420nd"), distortion=Distortion(-0.107, 0.043, 0.001, -0.0005, 0.012)
)
SENSOR = load_sensor("ueye_ui5250re")


def random_poses(count=40, seed=3):
    generator = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng=generator).as_matrix()
    poses[:, :3, 3] = generator.normal(0, 2, (count, 3))
    times = 1.6e9 + np.cumsum(generator.uniform(0.01, 0.1, count))
    return PoseList(poses, times, tuple(f"images/{number:04d}.png" for number in range(count)))


def angles_between(a, b):
    """Of rotations, in radians; exact for small ones, unlike an arc cosine."""
    return Rotation.from_matrix(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3]).magnitude()


def written(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_gives_the_same_poses_back(format, tmp_path):
    poses = random_poses()
    write_poses(tmp_path / FORMATS[format], poses, format)
    again = read_poses(tmp_path / FORMATS[format])
    assert np.abs(again.poses[:, :3, 3] - poses.poses[:, :3, 3]).max() <= 1e-9
    assert angles_between(again.poses, poses.poses).max() <= 1e-9
    if format in ("tum", "csv"):
        np.testing.assert_array_equal(again.times_s, poses.times_s)
    else:
        assert again.times_s is None
    assert again.names == (None if format == "tum" else poses.names)
    assert [path.name for path in tmp_path.rglob("*.tmp")] == []


@pytest.mark.parametrize("format", ["csv", "nerfstudio", "colmap"])
def test_poses_without_names_and_times_keep_their_order(format, tmp_path):
    poses = PoseList(arc_path(12, 0.4, (-0.8, 0.8), (1.0, 2.0), 0.3))
    write_poses(tmp_path / FORMATS[format], poses, format)
    np.testing.assert_allclose(read_poses(tmp_path / FORMATS[format]).poses, poses.poses, atol=1e-12)


def test_tum_lines_are_camera_to_world_with_the_real_part_last(tmp_path):
    half = np.sqrt(0.5)
    text = (
        f"# ground truth\n# timestamp tx ty tz qx qy qz qw\n\n1305031098.5 1 2 3 {-half} 0 0 {half} # note\n"
    )
    poses = read_poses(written(tmp_path / "groundtruth.txt", text))
    # A turn by -90 degrees about x: forward along +y, level, into the crop.
    np.testing.assert_allclose(poses.poses[0], look_at((1, 2, 3), (1, 3, 3)), atol=1e-12)
    assert poses.times_s.tolist() == [1305031098.5]


def test_rounded_quaternions_are_normalised_and_others_are_refused(tmp_path):
    poses = read_poses(written(tmp_path / "a.txt", "0 0 0 0 0.7068 0 0 0.7068\n"))
    np.testing.assert_allclose(np.linalg.det(poses.poses[0, :3, :3]), 1, atol=1e-12)
    with pytest.raises(InputError, match=r"b.txt: line 2 = .*: must be a quaternion of length 1 within 0"):
        read_poses(written(tmp_path / "b.txt", "0 0 0 0 0 0 0 1\n1 0 0 0 0.71 0 0 0.71\n"))


UNIT = np.eye(4).tolist()
TWICE, SCALED = (2 * np.eye(4))[:3].tolist(), np.diag([1, 1, 2, 1]).tolist()


def identity_frame(**changes):
    return {"frames": [{"file_path": "a", "transform_matrix": UNIT, **changes}]}


FAR = identity_frame(transform_matrix=[[1, 0, 0, 1e300], *UNIT[1:]])
QUATERNIONS = "x,y,z,qx,qy,qz,qw"
NOT_ALLOWED = {
    "poses.txt": [
        ("", "contains no poses"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 1\n", "line 2: must have 8 numbers"),
        ("0 0 nan 0 0 0 0 1\n", "line 1, ty = 'nan': must be a finite number"),
        ("0 0 1_0 0 0 0 0 1\n", "line 1, ty = '1_0': must be a finite number"),
        ("0 0 0 0 0 0 0 0\n", "line 1 = .*must be a quaternion"),
        ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "line 2, time = 1.0: must be after the time before it, 1.0"),
        ("0 -2e6 0 0 0 0 0 1\n", "line 1: must have a position within 1,000,000 m of the origin"),
        ("2 0 0 0 0 0 0 1\n\n1 0 0 0 0 0 0 1\n", "line 3, time = 1.0: must be after"),
        ("hello world\n", "is not a file of camera poses; allowed are"),
    ],
    "poses.csv": [
        ("", "contains no poses"),
        ("x,y,z\n0,0,0\n", "header: has no orientation; allowed are"),
        (f"{QUATERNIONS},yaw_deg\n0,0,0,0,0,0,1,0\n", "header: has more than one kind of orientation"),
        ("x,y,z,yaw_deg\n0,0,0,0\n", "header: lacks the column pitch_deg"),
        ("x_m,y_m,z_mm,qx,qy,qz,qw\n0,0,0,0,0,0,1\n", "header: must have x, y and z in one unit"),
        ("x,y,z,target_x_m,target_y_m\n0,0,0,0,0\n", "header: must have target_x, target_y and target_z"),
        (f"{QUATERNIONS},speed\n0,0,0,0,0,0,1,2\n", "header = 'speed': has an unknown column"),
        ("x,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n", "header = 'x': must name each column once"),
        (f"{QUATERNIONS}\n0,0,0,0,0,1\n", "line 2: must have 7 values, as many as the header, not 6"),
        (f"{QUATERNIONS}\n0,0,,0,0,0,1\n", "line 2, z = '': must be a finite number"),
        (f"t_s,{QUATERNIONS}\n1,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n", "line 3, time = 1.0: must be after"),
        (f"t_s,{QUATERNIONS}\n0,0,0,0,0,0,0,1\n1e308,0,0,0,0,0,0,1\n", r"line 3, time = 1e\+308: must be"),
        (f"name,{QUATERNIONS}\n ,0,0,0,0,0,0,1\n", "line 2, name = '': must be a name"),
        ("x,y,z,target_x,target_y,target_z\n0,0,0,0,0,1\n", "line 2: has a target that is not allowed: .*di"),
    ],
    "transforms.json": [
        ("{", "is not valid JSON"),
        ("[]", "frames: must be a list of frames, each with a transform_matrix"),
        ({"frames": [{}]}, r"frames\[0\].transform_matrix: must have 4 rows of 4 numbers"),
        (identity_frame(transform_matrix=np.ones((4, 4)).tolist()), ".*must have 4 rows"),
        (identity_frame(transform_matrix=SCALED), ".*a rotation, without scale or refl"),
        (identity_frame(transform_matrix=np.diag([1, 1, -1, 1]).tolist()), ".*must contain a rotation"),
        (identity_frame(transform_matrix=[[float("nan")] * 4] * 4), ".*= nan: must be a finite number"),
        (identity_frame(transform_matrix=[["1", None, True, 0]] * 4), ".*must be a finite number"),
        (identity_frame(file_path=3), r"frames\[0\].file_path = 3: must be a name"),
        ({**identity_frame(), "applied_scale": 0}, "applied_scale = 0.0: must be positive"),
        ({**identity_frame(), "applied_transform": TWICE}, "applied_transform: must contain a rotation"),
        ({**identity_frame(), "applied_transform": 1}, "applied_transform: must have 4 rows"),
        ({**FAR, "applied_scale": 1e-300, "applied_transform": UNIT}, ".*a position within 1,000,000 m"),
    ],
    "images.txt": [
        ("1 1 0 0 0 0 0 0 1\n\n", "line 1: must have 10 fields, IMAGE_ID .* NAME, not 9"),
        ("1 1 0 0 0 0 0 x 1 a.png\n\n", "line 1, TZ = 'x': must be a finite number"),
        ("1 2 0 0 0 0 0 0 1 a.png\n\n", "line 1 = .*: must be a quaternion of length 1"),
        (2 * "1 1 0 0 0 0 0 0 1 a.png\n\n", "line 3, NAME = 'a.png': must be a name of one image only"),
        # A name of three words makes 12 fields, as many as four points.
        (2 * "1 1 0 0 0 0 0 0 1 my image 1.png\n", "line 2: must be the points X Y POINT3D_ID"),
        ("1 1 0 0 0 0 0 0 1 a\tb.png\n\n", r"line 1, NAME = 'a\\tb.png': must be a name of printable"),
    ],
}


@pytest.mark.parametrize(
    ("name", "text", "message"), [(name, *case) for name, cases in NOT_ALLOWED.items() for case in cases]
)
def test_files_that_are_not_allowed(name, text, message, tmp_path):
    with pytest.raises(InputError, match=f"{name}: {message}"):
        read_poses(written(tmp_path / name, text if isinstance(text, str) else json.dumps(text)))


def test_more_than_100_000_poses_are_refused(tmp_path):
    text = "\n".join(f"{time} 0 0 0 0 0 0 1" for time in range(100_001))
    with pytest.raises(InputError, match="contains more than 100,000 poses"):
        read_poses(written(tmp_path / "poses.txt", text))


@pytest.mark.parametrize(
    ("header", "row"),
    [("x_m,y_m,z_m", "0.1,-0.4,1.5"), ("x_mm,y_mm,z_mm", "100,-400,1500"), ("x,y,z", "0.1, -0.4, 1.5")],
)
def test_csv_units_and_targets(header, row, tmp_path):
    text = f"name,{header},target_x_m,target_y_m,target_z_m\nfirst, {row},0.2,0.1,1.2\n"
    poses = read_poses(written(tmp_path / "poses.csv", text))
    np.testing.assert_allclose(poses.poses[0], look_at((0.1, -0.4, 1.5), (0.2, 0.1, 1.2)), atol=1e-12)
    assert poses.names == ("first",)


def test_csv_angles_agree_with_the_camera_path_and_roll_is_clockwise(tmp_path):
    # Yaw is the azimuth of a camera that faces the plant, pitch its elevation.
    arc = arc_path(1, 0.4, (0.5, 0.5), (1.2, 1.2), 0.3)[0]
    x, y, z = arc[:3, 3]
    text = f"x_m,y_m,z_m,yaw_deg,pitch_deg\n{x},{y},{z},{np.degrees(0.5)},{np.degrees(0.3)}\n"
    poses = read_poses(written(tmp_path / "poses.csv", text))
    np.testing.assert_allclose(poses.poses[0], arc, atol=1e-12)
    text = "x,y,z,yaw_deg,pitch_deg,roll_deg\n0,0,1,0,0,90\n0,0,1,0,0,30\n"
    quarter, twelfth = read_poses(written(tmp_path / "poses.csv", text)).poses
    # After a quarter turn clockwise as seen from behind, the right side is down and it still looks along +y.
    np.testing.assert_allclose(quarter[:3, 0], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(quarter[:3, 2], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(twelfth[:3, 0], [np.cos(np.pi / 6), 0, -np.sin(np.pi / 6)], atol=1e-12)


def test_csv_from_a_spreadsheet_is_read(tmp_path):
    header = '\ufefft_s,"x_m",y_m,z_m,qx,qy,qz,qw\r\n\r\n'
    text = header + '# start\r\n0.5,"1",2,3,0,0,0,1\r\n,,,,,,,\r\n1.5,1,2,3,0,0,0,1\r\n'
    file = tmp_path / "poses.csv"
    file.write_bytes(text.encode())
    poses = read_poses(file)
    assert poses.times_s.tolist() == [0.5, 1.5]
    np.testing.assert_array_equal(poses.poses[:, :3, 3], [[1, 2, 3]] * 2)


def test_nerfstudio_camera_axes_are_right_up_and_backwards(tmp_path):
    # The documentation's columns: +X, +Y and +Z of a camera that looks along its -Z, then its position.
    matrix = [[1, 0, 0, 0.5], [0, 0, -1, -2], [0, 1, 0, 1.5], [0, 0, 0, 1]]
    content = {"fl_x": 500, "frames": [{"file_path": "images/b.png", "transform_matrix": matrix}]}
    poses = read_poses(written(tmp_path / "transforms.json", json.dumps(content)))
    np.testing.assert_allclose(poses.poses[0], look_at((0.5, -2, 1.5), (0.5, 0, 1.5)), atol=1e-12)
    assert poses.names == ("images/b.png",)


def test_nerfstudios_conversion_of_a_colmap_model_is_undone(tmp_path):
    poses = random_poses(8)
    # As `colmap_to_json` of nerfstudio: turn the camera's axes, then the world by rows.
    matrices = poses.poses.copy()
    matrices[:, :3, 1:3] *= -1
    matrices = matrices[:, [0, 2, 1, 3], :]
    matrices[:, 2] *= -1
    applied = np.eye(4)[[0, 2, 1], :]
    applied[2] *= -1
    frames = [{"transform_matrix": matrix.tolist()} for matrix in matrices]
    content = {"applied_transform": applied.tolist(), "frames": frames}
    again = read_poses(written(tmp_path / "a.json", json.dumps(content)))
    np.testing.assert_allclose(again.poses, poses.poses, atol=1e-12)
    assert again.names is None


def test_nerfstudio_scale_and_a_moved_world_are_undone(tmp_path):
    poses = random_poses(8)
    applied = np.eye(4)
    applied[:3, :3], applied[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix(), [1, -2, 0.5]
    matrices = applied @ poses.poses
    matrices[:, :3, 3] *= 0.25
    matrices[:, :3, 1:3] *= -1
    frames = [{"transform_matrix": matrix[:3].tolist()} for matrix in matrices]
    content = {"applied_transform": applied[:3].tolist(), "applied_scale": 0.25, "frames": frames}
    again = read_poses(written(tmp_path / "a.json", json.dumps(content)))
    np.testing.assert_allclose(again.poses, poses.poses, atol=1e-12)


def test_nerfstudio_intrinsics_are_those_of_the_camera(tmp_path):
    camera = Camera(BARREL, SENSOR)
    write_poses(tmp_path / "transforms.json", random_poses(2), "nerfstudio", camera)
    content = json.loads((tmp_path / "transforms.json").read_text(encoding="utf-8"))
    # Nerfstudio's rays go through (column + 0.5, row + 0.5): its principal point is ours.
    expected = camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    assert [content[key] for key in ("fl_x", "fl_y", "cx", "cy")] == expected
    assert [content[key] for key in ("w", "h", "camera_model")] == [camera.width, camera.height, "OPENCV"]
    expected = {"k1": -0.107, "k2": 0.043, "p1": 0.001, "p2": -0.0005, "k3": 0.012}
    assert {key: content[key] for key in expected} == expected


def test_colmap_lines_are_world_to_camera_and_sorted_by_name(tmp_path):
    pose = look_at((0.5, -2, 1.5), (0.1, 0.3, 1.2))
    to_camera = np.linalg.inv(pose)
    x, y, z, w = Rotation.from_matrix(to_camera[:3, :3]).as_quat().tolist()
    translation = " ".join(map(repr, to_camera[:3, 3].tolist()))
    text = (
        "# Image list with two lines of data per image:\n"
        f"7 {w} {x} {y} {z} {translation} 1 b image.png\n10.5 20.5 -1 30.5 40.5 12\n"
        "3 1 0 0 0 1 2 3 1 a.png\n\n"
    )
    file = written(tmp_path / "sparse" / "0" / "images.txt", text)
    other = written(tmp_path / "other.txt", text)  # recognised by its content
    for place in (tmp_path, file.parent, file, other):
        poses = read_poses(place)
        assert poses.names == ("a.png", "b image.png")
        np.testing.assert_allclose(poses.poses[1], pose, atol=1e-12)
        np.testing.assert_allclose(poses.poses[0, :3, 3], [-1, -2, -3], atol=1e-12)


def test_colmap_itself_reads_the_same_poses_and_projects_to_the_same_pixels(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    plain = replace(BARREL, distortion=Distortion())
    four = replace(BARREL, distortion=replace(BARREL.distortion, k3=0.0))
    poses = PoseList(arc_path(6, 0.5, (-0.6, 0.6), (1.0, 1.5), 0.2))
    points = np.random.default_rng(2).uniform([-0.1, -0.1, 1.1], [0.1, 0.1, 1.5], (20, 3))
    for camera, model in (
        (Camera(plain, SENSOR), "PINHOLE"),
        (Camera(four, SENSOR), "OPENCV"),
        (camera_with(RATIONAL), "FULL_OPENCV"),
        (camera_with(FISHEYE), "OPENCV_FISHEYE"),
    ):
        write_poses(tmp_path / model, poses, "colmap", camera)
        reconstruction = pycolmap.Reconstruction(tmp_path / model)
        assert reconstruction.cameras[1].model.name == model
        images = sorted(reconstruction.images.values(), key=lambda image: image.name)
        assert [image.name for image in images] == [f"{number:06d}.png" for number in range(6)]
        for image, pose in zip(images, poses.poses, strict=True):
            np.testing.assert_allclose(image.projection_center(), pose[:3, 3], atol=1e-12)
            expected = camera.at_pose(pose).project(points)
            np.testing.assert_allclose([image.project_point(point) for point in points], expected, atol=1e-9)
    for name, write in (("theirs", reconstruction.write_text), ("binary", reconstruction.write_binary)):
        (tmp_path / name).mkdir()
        write(tmp_path / name)
    np.testing.assert_allclose(read_poses(tmp_path / "theirs").poses, poses.poses, atol=1e-12)
    with pytest.raises(InputError, match="has a binary COLMAP model; convert it"):
        read_poses(tmp_path / "binary")


def test_what_a_format_cannot_hold_is_refused_before_anything_is_written(tmp_path):
    poses = random_poses(3)
    camera = Camera(BARREL, SENSOR)
    for changed, format, with_camera, message in (
        (replace(poses, times_s=None), "tum", None, "times_s: must have times"),
        (poses, "csv", camera, "camera: must be None"),
        (replace(poses, names=("a", "#b", "c")), "csv", None, "names = '#b': must not start with #"),
        (replace(poses, names=("a", "b", "a")), "colmap", None, "names: must be different"),
        (poses, "kitti", None, "format: must be one of tum, csv, nerfstudio, colmap"),
    ):
        with pytest.raises(ArgumentError, match=message):
            write_poses(tmp_path / "out", changed, format, with_camera)
    assert list(tmp_path.iterdir()) == []
    written(tmp_path / "model" / "points3D.txt", "1 2 3\n")
    with pytest.raises(OutputError, match="already has a COLMAP model"):
        write_poses(tmp_path / "model", poses, "colmap")
    assert [path.name for path in (tmp_path / "model").iterdir()] == ["points3D.txt"]


def test_files_and_folders_that_cannot_be_used(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_poses(tmp_path / "missing.csv")
    with pytest.raises(InputError, match=r"is a folder without one of images.txt"):
        read_poses(tmp_path)
    binary = tmp_path / "poses.txt"
    binary.write_bytes(b"\xff\x00\x81")
    with pytest.raises(InputError, match="UTF-8"):
        read_poses(binary)
    (tmp_path / "folder").mkdir()
    for name, format in (("missing/poses.csv", "csv"), ("folder", "csv"), ("poses.txt", "colmap")):
        with pytest.raises(OutputError, match=f"{name}: cannot be written"):
            write_poses(tmp_path / name, random_poses(2), format)
    with pytest.raises(OutputError, match=r"cannot be written \(embedded null"):
        write_poses("poses\0.csv", random_poses(2), "csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "poses.txt"]


def test_pose_list_checks_its_values():
    pose = np.eye(4)[None]
    for arguments, message in (
        ((pose[:0],), "from 1 to 100,000"),
        ((2 * pose,), "must be a rotation"),
        ((np.full((1, 4, 4), np.nan),), "must be a rotation"),
        ((pose, [0.0, 1.0]), "one time"),
        ((np.tile(pose, (2, 1, 1)), [1.0, 1.0]), "ascending"),
        ((pose, None, ["a", "b"]), "one name"),
        ((pose, None, ["a\nb"]), "one name"),
    ):
        with pytest.raises(ValueError, match=message):
            PoseList(*arguments)
    assert not PoseList(pose).poses.flags.writeable


RATIONAL = Distortion(0.3, -0.1, 0.002, -0.001, 0.02, 0.35, -0.05, 0.03)
FISHEYE = FisheyeDistortion(0.03, -0.01, 0.004, -0.001)
PINHOLE = [610.0, 605.0, 321.5, 238.0]


def camera_with(distortion):
    """A camera of 640 x 480 pixels with `PINHOLE`: fx, fy, cx and cy."""
    model = "equidistant" if distortion is FISHEYE else "rational_polynomial"
    fx, fy, cx, cy = PINHOLE
    # Calibrations have the centre of the upper left pixel at (0, 0), half a pixel less than here.
    calibration = CameraCalibration(640, 480, fx, fy, cx - 0.5, cy - 0.5, model, astuple(distortion))
    sensor = replace(SENSOR, columns=640, rows=480)
    return Camera(calibration.lens("test", sensor.pixel_pitch_m, 2.0, 0.9), sensor)


@pytest.mark.parametrize(
    ("distortion", "model", "names"),
    [
        (RATIONAL, "FULL_OPENCV", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
        (FISHEYE, "OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
        (Distortion(-0.1, 0.02, 0.001, -0.002), "OPENCV", ("k1", "k2", "p1", "p2")),
        (Distortion(), "PINHOLE", ()),
    ],
)
def test_colmap_cameras_have_the_parameters_of_their_model_in_order(distortion, model, names, tmp_path):
    write_poses(tmp_path / "model", random_poses(2), "colmap", camera_with(distortion))
    line = (tmp_path / "model" / "cameras.txt").read_text(encoding="utf-8").splitlines()[-1]
    number, name, width, height, *parameters = line.split()
    assert (number, name, width, height) == ("1", model, "640", "480")
    expected = [*PINHOLE, *(getattr(distortion, coefficient) for coefficient in names)]
    np.testing.assert_allclose([float(parameter) for parameter in parameters], expected, rtol=1e-12)


def test_nerfstudio_has_fisheyes_but_no_rational_lens(tmp_path):
    write_poses(tmp_path / "transforms.json", random_poses(2), "nerfstudio", camera_with(FISHEYE))
    content = json.loads((tmp_path / "transforms.json").read_text(encoding="utf-8"))
    assert content["camera_model"] == "OPENCV_FISHEYE"
    assert [content[f"k{number}"] for number in range(1, 5)] == list(astuple(FISHEYE))
    assert [content[key] for key in ("fl_x", "fl_y", "cx", "cy")] == pytest.approx(PINHOLE, rel=1e-12)
    with pytest.raises(ArgumentError, match=r"camera: lens.distortion: must be k1, k2, p1, p2, k3 or a fish"):
        write_poses(tmp_path / "b.json", random_poses(2), "nerfstudio", camera_with(RATIONAL))
    assert not (tmp_path / "b.json").exists()

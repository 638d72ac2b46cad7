"""Calibration files of ROS and OpenCV: round trips, and one sentence for every error."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import yaml

from pepperscene.camera.optics.calibration import CameraCalibration, pinhole_calibration, read_calibration
from pepperscene.camera.optics.distortion import MODELS
from pepperscene.errors import InputError

COEFFICIENTS = {
    "plumb_bob": (-0.28, 0.09, 0.0012, -0.0008, -0.012),
    "rational_polynomial": (0.52, -0.08, 0.0003, -0.0004, 0.003, 0.86, -0.03, 1e-3),
    "equidistant": (0.035, -0.012, 0.006, -0.0015),
}
each_model = pytest.mark.parametrize("model", MODELS)


def calibration_of(model="plumb_bob"):
    return CameraCalibration(1280, 720, 912.25, 911.5, 641.125, 358.75, model, COEFFICIENTS[model])


def matrix_of(calibration):
    return [[calibration.fx, 0.0, calibration.cx], [0.0, calibration.fy, calibration.cy], [0.0, 0.0, 1.0]]


def ros_content(calibration):
    """As written by camera_calibration of ROS."""
    matrix = [number for row in matrix_of(calibration) for number in row]
    coefficients = list(calibration.coefficients)
    return {
        "image_width": calibration.width,
        "image_height": calibration.height,
        "camera_name": "narrow_stereo",
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix},
        "distortion_model": calibration.model,
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": [1, 0, 0, 0, 1, 0, 0, 0, 1]},
    }


def write_opencv(path, calibration, **further):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Mo 23. Nov 2026: 10:00")
    storage.write("image_width", calibration.width)
    storage.write("image_height", calibration.height)
    for name, value in further.items():
        storage.write(name, value)
    storage.write("camera_matrix", np.array(matrix_of(calibration)))
    storage.write("distortion_coefficients", np.array(calibration.coefficients)[:, None])
    storage.release()


@each_model
def test_camera_info_of_ros_and_a_message_of_ros_2(tmp_path, model):
    path, calibration = tmp_path / "camera_info.yaml", calibration_of(model)
    content = ros_content(calibration)
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert read_calibration(path) == calibration
    message = {"width": 1280, "height": 720, "distortion_model": model, "k": content["camera_matrix"]["data"]}
    path.write_text(yaml.safe_dump(message | {"d": list(calibration.coefficients)}) + "---\n")
    assert read_calibration(path) == calibration
    # YAML 1.1 reads 12e-4 as text, and programs write it.
    path.write_text(yaml.safe_dump(content).replace("0.0012", "12e-4"), encoding="utf-8")
    assert read_calibration(path) == calibration


@each_model
@pytest.mark.parametrize("first_line", ["%YAML:1.0", "%YAML 1.2"])  # of OpenCV up to 4, and of OpenCV 5
def test_file_written_by_opencv(tmp_path, model, first_line):
    path, further = tmp_path / "out.yml", {"fisheye_model": 1} if model == "equidistant" else {}
    write_opencv(path, calibration_of(model), **further)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] in ("%YAML:1.0", "%YAML 1.2")
    path.write_text("\n".join([first_line, *lines[1:]]), encoding="utf-8")
    assert read_calibration(path) == calibration_of(model)


@pytest.mark.parametrize("count", [12, 14])
def test_opencv_coefficients_of_models_without_effect_are_left_out(tmp_path, count):
    known = COEFFICIENTS["rational_polynomial"]
    content, path = ros_content(calibration_of("rational_polynomial")), tmp_path / "c.yaml"
    del content["distortion_model"]
    content["distortion_coefficients"] = {"data": [*known, *[0.0] * (count - 8)]}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert read_calibration(path) == calibration_of("rational_polynomial")
    content["distortion_coefficients"]["data"][-1] = 0.1
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(InputError, match=rf"must be the 8 numbers k1, .* k6 of rational.*, not {count}"):
        read_calibration(path)


def change(**values):
    return lambda content: content | values


def without(key):
    return lambda content: {name: value for name, value in content.items() if name != key}


SKEWED = {"data": [900.0, 0.5, 640, 0, 900, 360, 0, 0, 1]}
INVALID = [
    (without("image_width"), r"image_width: is required but missing"),
    (change(image_width=0), r"an image of 0 x 720 must be 1 x 1 to 20000"),
    (change(image_width=12.5), r"image_width = 12\.5: must be a whole number"),
    (change(camera_matrix=[1, 2, 3]), r"camera_matrix: must hold 9 finite numbers"),
    (change(camera_matrix={"data": [float("nan")] * 9}), r"camera_matrix: must hold 9 finite numbers"),
    (change(camera_matrix=SKEWED), r"camera_matrix: must be \[fx, 0, cx.* without skew"),
    (change(camera_matrix={"data": [0, 0, 640, 0, 900, 360, 0, 0, 1]}), r"fx = 0 must be 1 to 1e\+06"),
    (change(camera_matrix={"data": [100, 0, 640, 0, 900, 360, 0, 0, 1]}), r"fy = 900 must be 0\.25 to 4 tim"),
    (change(distortion_model=["x"]), r"distortion_model = \['x'\]: must be one of plumb_bob"),
    (change(distortion_model="equidistant"), r"must be the 4 numbers k1, k2, k3, k4 of equidistant, not 5"),
    (change(distortion_coefficients={"data": ["a"]}), r"distortion_coefficients: must hold finite numbers"),
    (change(distortion_coefficients={"data": [1e9, 0, 0, 0, 0]}), r"the distortion's k1 = 1e\+09 must be"),
]


@pytest.mark.parametrize(("edit", "message"), INVALID)
def test_invalid_values_give_one_sentence_with_the_file(tmp_path, edit, message):
    path = tmp_path / "camera_info.yaml"
    path.write_text(yaml.safe_dump(edit(ros_content(calibration_of()))), encoding="utf-8")
    with pytest.raises(InputError, match=r"camera_info\.yaml: .*" + message) as caught:
        read_calibration(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must be a calibration"),
        ("- 1\n- 2", "must be a calibration"),
        ("a: !!python/object/apply:os.system [ls]", "is not valid YAML at line 1"),
        ("[" * 1500, "is not valid YAML"),
        ("a: 2026-99-99", "is not valid YAML"),
        ('a: !!int ""', "is not valid YAML"),
        ("a: " + "x" * 300_000, "longer than 300,000 bytes"),
    ],
)
def test_other_files_give_one_sentence(tmp_path, text, message):
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_calibration(path)


@pytest.mark.parametrize("hfov_deg", [20, 120])
def test_field_of_view_spans_the_width_of_the_image(hfov_deg):
    calibration = pinhole_calibration(1280, 720, hfov_deg)
    # From the left edge of the image to the right one, half a pixel beyond the outermost centres.
    left, right = ((u - calibration.cx) / calibration.fx for u in (-0.5, 1279.5))
    angle = np.degrees(np.arctan(right) - np.arctan(left))
    assert angle == pytest.approx(hfov_deg, abs=1e-12)
    assert (calibration.cx, calibration.cy) == (639.5, 359.5)

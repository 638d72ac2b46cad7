"""The camera of a recipe in numbers: field of view, intrinsics, calibration files, and sizes of the image."""

from __future__ import annotations

import numpy as np
import pytest
import tomli_w
import yaml

from pepperscene.camera import load_sensor
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import load_recipe, resolve_recipe

SIZE = {"camera.width": 1280, "camera.height": 720}
INTRINSICS = {"camera.fx": 900.0, "camera.fy": 905.0, "camera.cx": 640.5, "camera.cy": 355.0}
CALIBRATION = {
    "image_width": 1280,
    "image_height": 720,
    "camera_matrix": {"rows": 3, "cols": 3, "data": [900.0, 0, 640.5, 0, 905.0, 355.0, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.1, 0.02, 0.001, -0.0005, 0.0]},
}
GENERIC = {"camera.sensor": "generic_rgb"}


def camera_with(changes, recipe="barth2018"):
    return resolve_recipe(recipe, changes).camera


@pytest.fixture
def calibration(tmp_path):
    path = tmp_path / "camera_info.yaml"
    path.write_text(yaml.safe_dump(CALIBRATION), encoding="utf-8")
    return path


def own_recipe(tmp_path, **camera):
    """A recipe that extends the shipped one's plan, row and light, but not its camera."""
    base = load_recipe("barth2018").model_dump(mode="python", exclude_none=True)
    base["camera"] = {"flash": "none", "exposure_us": 3000, **camera}
    base["developing"]["white_balance"] = "daylight"
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(base), encoding="utf-8")
    return path


def test_field_of_view_replaces_an_inherited_lens():
    camera = camera_with({"camera.hfov_deg": 69.4, **SIZE, **GENERIC})
    assert (camera.width, camera.height) == (1280, 720)
    width = camera.width / camera.intrinsics[0, 0]
    assert 2 * np.degrees(np.arctan(width / 2)) == pytest.approx(69.4, abs=1e-9)
    np.testing.assert_allclose(camera.intrinsics[:2, 2], [640, 360])
    assert camera.lens.distortion.is_zero


def test_a_camera_needs_neither_sensor_nor_lens(tmp_path):
    path = own_recipe(tmp_path, width=641, height=479, hfov_deg=60, f_number=2.8, transmittance=0.8)
    camera = camera_with({}, path)
    generic = load_sensor("generic_rgb")
    assert (camera.sensor.name, camera.sensor.pitch_m) == (generic.name, generic.pitch_m)
    assert (camera.width, camera.height) == (641, 479)
    assert (camera.lens.f_number, camera.lens.transmittance) == (2.8, 0.8)
    # The focal length in metres follows from the pixels' pitch.
    assert camera.lens.focal_length_m == pytest.approx(camera.intrinsics[0, 0] * camera.sensor.pixel_pitch_m)
    identity = resolve_recipe(path).identity
    assert "lens" not in identity["files"]
    assert {"sensor", "sensor.quantum_efficiency"} <= identity["files"].keys()


def test_intrinsics_are_those_of_opencv():
    distortion = [-0.1, 0.02, 0.001, -0.0005, 0.0]
    changes = {**SIZE, **GENERIC, **INTRINSICS, "camera.distortion": distortion}
    camera = camera_with(changes)
    expected = [[900, 0, 641], [0, 905, 355.5], [0, 0, 1]]
    np.testing.assert_allclose(camera.intrinsics, expected, rtol=1e-12)
    assert list(camera.lens.distortion.to_json().values()) == distortion
    fisheye = {"camera.distortion": [0.01, 0, 0, 0], "camera.distortion_model": "equidistant"}
    assert camera_with({**changes, **fisheye}).lens.distortion.to_json()["model"] == "equidistant"


def test_calibration_gives_lens_and_size(calibration, write_recipe, tmp_path):
    camera = camera_with({"camera.calibration": str(calibration), **GENERIC})
    changes = {**SIZE, **GENERIC, **INTRINSICS, "camera.distortion": [-0.1, 0.02, 0.001, -0.0005, 0.0]}
    other = camera_with(changes)
    assert (camera.width, camera.height) == (1280, 720)
    np.testing.assert_array_equal(camera.intrinsics, other.intrinsics)
    assert camera.lens.distortion == other.lens.distortion
    # A path relative to the recipe's file, also a bare one; a nearer calibration replaces the size.
    base = write_recipe("base.toml", camera={"hfov_deg": 50, "width": 640, "height": 480})
    path = write_recipe("top.toml", extends=base.name, camera={"calibration": "camera_info.yaml"})
    recipe = load_recipe(path)
    assert recipe.camera.calibration == str(tmp_path / "camera_info.yaml")
    assert (recipe.camera.hfov_deg, recipe.camera.width) == (None, None)


def test_content_of_a_calibration_is_part_of_the_identity(calibration):
    changes = {"camera.calibration": str(calibration), **GENERIC}
    before = load_recipe("barth2018", changes)
    assert str(calibration.parent) not in str(before.identity())
    first = before.sha256()
    calibration.write_text(yaml.safe_dump(CALIBRATION) + "# a comment\n", encoding="utf-8")
    assert load_recipe("barth2018", changes).sha256() == first
    content = CALIBRATION | {"distortion_model": "rational_polynomial", "distortion_coefficients": [0] * 8}
    calibration.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert load_recipe("barth2018", changes).sha256() != first


def test_a_nearer_lens_replaces_inherited_numbers(write_recipe, calibration):
    for name, table in (
        ("fov", {"hfov_deg": 50, "width": 400, "height": 300}),
        ("fx", {"fx": 500.0, "fy": 500.0, "cx": 400.0, "cy": 300.0, "distortion": [0.0] * 5}),
        ("file", {"calibration": str(calibration)}),
    ):
        base = write_recipe(f"{name}.toml", camera=table)
        for key, value in (("lens", "lensagon_cmfa0420nd"), ("hfov_deg", 61.0)):
            if key in table:
                continue
            top = load_recipe(write_recipe("top.toml", extends=base.name, camera={key: value}))
            assert top.camera.lens_key == key


def test_a_size_reads_out_an_inherited_sensor():
    full = {"camera.sensor": "ueye_ui5250re_full"}
    camera = camera_with({**full, "camera.width": 800, "camera.height": 600})
    shipped = camera_with({})
    for name in ("binning", "reduction", "site_shape", "pattern"):
        assert getattr(camera.sensor, name) == getattr(shipped.sensor, name)
    np.testing.assert_array_equal(camera.intrinsics, shipped.intrinsics)
    smaller = camera_with({**full, "camera.width": 1000, "camera.height": 750})
    assert smaller.sensor.reduction == pytest.approx(1.6)
    np.testing.assert_allclose(smaller.intrinsics[0, 0], shipped.intrinsics[0, 0] * 1000 / 800)
    # A field of view alone keeps the sensor's own size.
    assert camera_with({"camera.hfov_deg": 60}).width == 800


FX = {**SIZE, **GENERIC, **INTRINSICS}
INVALID = [
    ({"camera.hfov_deg": 60, **FX}, r"hfov_deg and fx contradict each other"),
    ({"camera.hfov_deg": 60, "camera.lens": "nikkor_18_55mm_at_18mm"}, r"lens and hfov_deg contradict"),
    ({"camera.fx": 900.0}, r"fx, fy, cx and cy must be given together; cx, cy, fy are missing"),
    ({"camera.distortion": [0.0] * 5}, r"given together; cx, cy, fx, fy are missing"),
    ({"camera.lens": "none"}, r"lens, hfov_deg, fx with fy, cx and cy, or calibration is required"),
    ({"camera.width": 640}, r"width and height must be given together, not width alone"),
    ({**GENERIC}, r"width and height are required without a sensor"),
    ({**FX, "camera.distortion": [0.1] * 3}, r"camera\.distortion .*5 numbers k1, k2, p1, p2, k3 .*, not 3"),
    (
        {**FX, "camera.distortion_model": "equidistant", "camera.distortion": [0.1] * 5},
        r"camera\.distortion .*must be the 4 numbers k1, k2, k3, k4 of equidistant, not 5",
    ),
    ({**FX, "camera.distortion": [-2.0, 0, 0, 0, 0]}, r"camera\.distortion = .*must be invertible over"),
    ({**FX, "camera.fx": 90.0}, r"camera\.fx = 90\.0: fy = 905 must be 0\.25 to 4 times fx"),
    (
        {**FX, "camera.fx": 50.0, "camera.fy": 50.0},
        r"camera\.fx = 50\.0: gives .* a corner at 86\.\d degrees",
    ),
    (
        {"camera.hfov_deg": 170, **SIZE, **GENERIC},
        r"camera\.hfov_deg = 170\.0: gives .*corner at 85\.6 degrees",
    ),
    (
        {"camera.width": 1601, "camera.height": 1200},
        r"camera\.width = 1601: an image of 1601 x 1200 .*1600 x 1200",
    ),
    ({"camera.hfov_deg": 60, "camera.width": 20000, "camera.height": 20000, **GENERIC}, r"at most 125000000"),
]


@pytest.mark.parametrize(("changes", "message"), INVALID)
def test_contradictions_are_one_sentence_with_the_key(changes, message):
    with pytest.raises(InputError, match=message) as caught:
        resolve_recipe("barth2018", changes)
    assert "\n" not in str(caught.value)


def test_a_size_must_be_that_of_the_calibration(calibration):
    changes = {"camera.calibration": str(calibration), **GENERIC, "camera.width": 640, "camera.height": 360}
    with pytest.raises(InputError, match=r"camera\.width = 640: must be 1280 as in the calibration"):
        resolve_recipe("barth2018", changes)
    calibration.write_text("image_width: 5", encoding="utf-8")
    with pytest.raises(InputError, match=r"camera_info\.yaml: image_height: is required but missing"):
        resolve_recipe("barth2018", {"camera.calibration": str(calibration), **GENERIC})


@pytest.mark.parametrize(
    ("device", "size", "hfov_deg"),
    [
        ("realsense_d435_colour", (1280, 720), 69.4),
        ("realsense_d435_infrared", (1280, 800), 91.2),
        ("logitech_c920", (1280, 720), 70.42),
    ],
)
def test_shipped_devices_have_the_published_field_of_view(device, size, hfov_deg):
    changes = {"camera.sensor": device, "camera.lens": device, "camera.focus_mm": 500}
    camera = camera_with(changes | {"camera.width": size[0], "camera.height": size[1]})
    assert (camera.width, camera.height) == size
    angle = 2 * np.degrees(np.arctan(camera.width / 2 / camera.intrinsics[0, 0]))
    assert angle == pytest.approx(hfov_deg, abs=0.1)


def test_phone_camera_has_12_megapixels_and_77_degrees():
    changes = {"camera.sensor": "sony_imx363", "camera.lens": "google_pixel_3"}
    camera = camera_with(changes | {"camera.width": 4032, "camera.height": 3024})
    half = np.hypot(4032, 3024) / 2 / camera.intrinsics[0, 0]
    assert 2 * np.degrees(np.arctan(half)) == pytest.approx(77, abs=0.5)
    binned = camera_with(changes).sensor
    assert (binned.columns, binned.rows, binned.binning) == (2016, 1512, 2)
    # An image row is two rows of photosites.
    assert camera.sensor.line_time_s == pytest.approx(binned.line_time_s / 2)

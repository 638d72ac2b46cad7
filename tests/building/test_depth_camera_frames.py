"""The depth camera of a recipe: its table, its place, its outputs in data sets, readers and exports."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from data_sets import D435, set_without_plants
from stand_in import SIZE, StandIn

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.store.images import write_image
from pepperscene.errors import InputError
from pepperscene.export import export_dataset
from pepperscene.frame import Frame
from pepperscene.recipe.resolve.load import load_recipe, parse_changes
from pepperscene.review.check import check_dataset

IMAGER = (5, 7)
OUTPUTS = ("colour", "depth_z", "depth_sensor", "depth_confidence", "imager_left")
HOLE = (2, 3)


def measured(camera, seed):
    """Images of a small camera, of which one pixel is a hole."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.4, 1.0, SIZE).astype(np.float32)
    confidence = rng.uniform(0.5, 1.0, SIZE).astype(np.float32)
    depth[HOLE], confidence[HOLE] = np.nan, 0.0
    return {
        "colour": rng.integers(30, 200, (*SIZE, 3)).astype(np.uint8),
        "depth_z": rng.uniform(0.4, 1.0, SIZE).astype(np.float32),
        "depth_sensor": depth,
        "depth_confidence": confidence,
        "imager_left": rng.integers(0, 255, IMAGER).astype(np.uint8),
    }


class DepthStandIn(StandIn):
    """Renders noise, also that of a depth camera."""

    def render(self, camera, outputs=(), quality="standard", seed=0, *, partners, **others):
        frame = super().render(camera, outputs, quality, seed, **others)
        assert (partners.depth is not None) == bool({"depth_sensor", "imager_left"} & set(outputs))
        images = {**frame.images, **measured(camera, seed)}
        metadata = {**frame.metadata, "depth_camera": {"width": IMAGER[1], "height": IMAGER[0]}}
        metadata["depth_camera"]["depth_unit_m"] = partners.depth.depth_unit_m
        metadata["camera"] = {**metadata["camera"], "width": SIZE[1], "height": SIZE[0]}
        return Frame({name: images[name] for name in outputs}, metadata)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("depth") / "set"
    set_without_plants(path, range(4), OUTPUTS, DepthStandIn, D435)
    return path


def with_changes(**changes):
    return load_recipe("barth2018", {**D435, **{f"depth_camera.{key}": x for key, x in changes.items()}})


@pytest.mark.long
def test_shipped_recipe_has_the_places_of_a_d435():
    frames = FrameRenderer("realsense_depth")
    spec = frames.recipe.plan.frame(5)
    camera, depth_camera = frames.camera(spec), frames.views.depth_camera(spec)
    axes = camera.pose[:3, :3]
    for imager, right_m in ((depth_camera.left, 0.015), (depth_camera.right, 0.065)):
        np.testing.assert_array_equal(imager.pose[:3, :3], axes)
        offset = axes.T @ (imager.pose[:3, 3] - camera.pose[:3, 3])
        np.testing.assert_allclose(offset, [right_m, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(imager.motion.velocity_m_s, camera.motion.velocity_m_s)
    assert depth_camera.projector.offset_m == (0.025, 0.0, 0.0)
    assert (depth_camera.left.width, depth_camera.left.height) == (848, 480)
    # Depth times disparity: 848 pixels across 91.2 degrees, 50 mm.
    expected = 424 / np.tan(np.radians(91.2 / 2)) * 0.05
    assert depth_camera.disparity_m == pytest.approx(expected, rel=1e-3)


def test_a_turned_depth_camera_moves_with_the_main_camera():
    frames = FrameRenderer(with_changes(rotation_deg=[0, 90, 0], position_mm=[0, 0, 100]))
    spec = frames.recipe.plan.frame(3)
    camera, left = frames.camera(spec), frames.views.depth_camera(spec).left
    np.testing.assert_allclose(left.pose[:3, 2], -camera.pose[:3, 1], atol=1e-12)
    np.testing.assert_allclose(left.pose[:3, 3], camera.pose[:3, 3] + 0.1 * camera.pose[:3, 2], atol=1e-12)
    # Views of scenes include the imagers.
    assert len(frames.views.frustums([spec]).positions) == 3


def test_recipes_without_a_depth_camera_keep_their_identity():
    plain, recipe = load_recipe("barth2018"), with_changes()
    assert "depth_camera" not in plain.identity()["recipe"]
    assert {"depth_camera.sensor", "depth_camera.projector"} <= recipe.identity()["files"].keys()
    assert recipe.identity()["files"]["sensor"] == plain.identity()["files"]["sensor"]
    others = [
        {"projector": "none"}, {"baseline_mm": 60}, {"matching.block_px": 9}, {"exposure_us": 500},
        {"auto_exposure.most_gain": 2}, {"focus_mm": 700},
    ]  # fmt: skip
    assert len({recipe.sha256(), *(with_changes(**change).sha256() for change in others)}) == 7


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("baseline_mm", 0, "greater than or equal to 0.1"),
        ("lens", "lensagon_cmfa0420nd_typical_distortion", "must be without distortion"),
        ("filter", "schott_22022010", "emits 850 nm, which the imagers do not detect"),
        ("matching.block_px", 8, "must be odd"),
        ("matching.disparities", 100, "multiple of 16"),
        ("flash", "led_nir_850nm", "none"),
    ],
)
def test_errors_name_the_key(key, value, problem):
    with pytest.raises(InputError, match="depth_camera") as error:
        with_changes(**{key: value})
    assert problem in str(error.value)
    assert "\n" not in str(error.value)


def test_twins_and_varied_values_can_differ_in_the_depth_camera():
    twins = {"twins": {"depth_camera.projector": ["realsense_d435", "none"]}}
    recipe = load_recipe("barth2018", {**D435, **twins})
    cameras = [FrameRenderer(recipe).views.depth_camera(recipe.plan.frame(twin * 250)) for twin in range(2)]
    assert [camera.projector is None for camera in cameras] == [False, True]
    assert cameras[0].left.pose.tolist() == cameras[1].left.pose.tolist()
    text = "depth_camera.exposure_us={ uniform = [100, 900] }"
    varied = load_recipe("barth2018", {**D435, **parse_changes([text])})
    setups = [FrameRenderer(varied).setups.at(varied.plan.frame(index)) for index in (0, 1)]
    exposures = [setup.depth_camera.left.exposure_s for setup in setups]
    assert exposures[0] != exposures[1]
    assert all(1e-4 <= exposure <= 9e-4 for exposure in exposures)


def test_outputs_need_a_depth_camera(recipe, empty_scenes, tmp_path):
    for output in ("depth_sensor", "depth_confidence", "imager_left", "imager_right"):
        with pytest.raises(InputError, match=rf"small: depth_camera: is required for the output {output}"):
            build(recipe, tmp_path / "set", [0], ("class", output), BuildOptions(renderer=StandIn))
    assert not (tmp_path / "set").exists()


def test_a_correct_set_has_no_finding(folder):
    kinds = {finding.kind for finding in check_dataset(folder, workers=1).findings}
    # The images are noise, not photographs of the labels.
    assert kinds <= {"edges", "drift"}


@pytest.mark.parametrize(
    ("output", "at", "value"),
    [
        ("depth_sensor", (0, 0), 0.0), ("depth_sensor", (0, 0), np.inf), ("depth_confidence", (0, 0), 1.5),
        ("depth_confidence", HOLE, 0.3),
    ],
)  # fmt: skip
def test_check_finds_impossible_values_and_images_of_another_size(tmp_path, output, at, value):
    class Faulty(DepthStandIn):
        def render(self, *args, **kwargs):
            frame = super().render(*args, **kwargs)
            frame.images[output][at] = value
            return replace(frame, images={**frame.images, "imager_left": np.zeros(SIZE, np.uint8)})

    set_without_plants(tmp_path / "set", range(1), OUTPUTS, Faulty, D435)
    findings = check_dataset(tmp_path / "set", workers=1).findings
    found = {(finding.kind, finding.file) for finding in findings}
    assert {("value", f"{output}/000000.exr"), ("shape", "imager_left/000000.png")} <= found


def test_readers_return_the_measured_depth(folder):
    images = open_images(folder)
    expected = images.dataset.image(2, "depth_sensor")
    image = images[2]
    np.testing.assert_array_equal(image.depth_sensor_m, expected)
    assert image.depth_sensor_m.dtype == np.float32
    assert np.isnan(image.depth_sensor_m[HOLE])
    selected = images.select("depth_sensor_m")[2]
    assert selected.colour is None
    assert selected.size == SIZE


def test_export_has_the_measured_depth_in_millimetres_and_0_in_holes(folder, tmp_path):
    out = export_dataset(folder, "rgbd_sensor", tmp_path / "out").folder
    exact = export_dataset(folder, "rgbd", tmp_path / "exact").folder
    depths = sorted(out.rglob("depth/*.png"))
    assert [path.name for path in depths] == [path.name for path in sorted(exact.rglob("depth/*.png"))]
    images = open_images(folder)
    for path, image in zip(depths, images, strict=True):
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert depth[HOLE] == 0
        known = np.isfinite(image.depth_sensor_m)
        np.testing.assert_allclose(depth[known], 1000 * image.depth_sensor_m[known], atol=0.51)


def test_export_rejects_a_depth_of_another_size(tmp_path):
    dataset = set_without_plants(tmp_path / "set", range(1), OUTPUTS, DepthStandIn, D435)
    write_image(dataset.path(0, "depth_sensor"), np.ones((3, 4), np.float32), "depth_sensor")
    with pytest.raises(InputError, match=r"depth_sensor/000000\.exr"):
        export_dataset(tmp_path / "set", "rgbd_sensor", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_depth_of_exports_has_the_unit_of_the_depth_camera(tmp_path):
    changes = {**D435, "depth_camera.depth_unit_mm": 0.1}
    set_without_plants(tmp_path / "set", range(1), OUTPUTS, DepthStandIn, changes)
    out = export_dataset(tmp_path / "set", "rgbd_sensor", tmp_path / "out").folder
    exact = export_dataset(tmp_path / "set", "rgbd", tmp_path / "exact").folder
    (image,) = open_images(tmp_path / "set")
    for folder, expected in ((out, image.depth_sensor_m), (exact, image.depth_z_m)):
        (path,), (table,) = folder.rglob("depth/*.png"), folder.rglob("depth.json")
        unit_m = json.loads(table.read_text())["depth_scale_m"]
        assert unit_m == 1e-4
        known = np.isfinite(expected)
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        np.testing.assert_allclose(unit_m * depth[known], expected[known], atol=0.51e-4)


@pytest.mark.parametrize("unit", [0, -1e-3, "mm", None, float("inf")])
def test_export_rejects_a_unit_that_is_no_length(tmp_path, unit):
    dataset = set_without_plants(tmp_path / "set", range(1), OUTPUTS, DepthStandIn, D435)
    path = dataset.frame_path(0)
    content = json.loads(path.read_text())
    content["depth_camera"]["depth_unit_m"] = unit
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"depth_camera\.depth_unit_m") as error:
        export_dataset(tmp_path / "set", "rgbd_sensor", tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()

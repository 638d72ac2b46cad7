"""RGB-D sequences: images, depths, poses and cameras against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from traced_set import HEIGHT, INTRINSICS, LENSES, WIDTH, reprojection_error, visible_pixels
from tum_sequence import Sequence, table

from pepperscene.camera.optics.calibration import read_calibration
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.errors import InputError
from pepperscene.export import export_dataset

LARGEST_PX = 0.001
LARGEST_MM = 0.55  # rounding, and single precision
MODELS = {"rational": "rational_polynomial", "fisheye": "equidistant"}


def pixel_error(sequence, pose, pixels, points):
    """Largest distance between projected points and their pixels; ROS has the first centre at (0, 0)."""
    lens = {
        "distortion_model": sequence.info["distortion_model"],
        "distortion": sequence.matrix("distortion_coefficients")[0],
    }
    in_camera = (points - pose[:3, 3]) @ pose[:3, :3]
    return reprojection_error(in_camera, lens, sequence.matrix(), pixels)


def depth_error_mm(pose, depth, pixels, points):
    in_camera = (points - pose[:3, 3]) @ pose[:3, :3]
    columns, rows = pixels.T
    return 1000 * np.abs(depth[rows, columns] - in_camera[:, 2]).max()


@pytest.mark.parametrize("lens", LENSES)
def test_points_project_to_their_pixels_and_depths(lens, traced, exported):
    dataset, sequence = traced(lens), Sequence(exported("rgbd", lens))
    assert sequence.info["distortion_model"] == MODELS.get(lens, "plumb_bob")
    for number, index in enumerate(dataset.indices()):
        pixels, points = visible_pixels(dataset, index)
        assert len(points) == 1000
        assert pixel_error(sequence, sequence.poses[number], pixels, points) < LARGEST_PX
        assert depth_error_mm(sequence.poses[number], sequence.depths[number], pixels, points) < LARGEST_MM
    # The program reads the camera as the recipe had it.
    found = read_calibration(sequence.folder / "camera_info.yaml")
    assert (found.width, found.height) == (WIDTH, HEIGHT)
    np.testing.assert_allclose([found.fx, found.fy, found.cx, found.cy], list(INTRINSICS.values()), 1e-12)
    assert found.model == MODELS.get(lens, "plumb_bob")
    coefficients = LENSES[lens].get("distortion", [])
    np.testing.assert_array_equal(found.coefficients[: len(coefficients)], coefficients)


def test_images_are_copied_and_the_sky_has_no_depth(traced, exported):
    dataset, sequence = traced(), Sequence(exported("rgbd"))
    assert sequence.times == [0.0, 1.0, 2.0, 3.0]
    for index, (colour, _), depth in zip(dataset.indices(), sequence.files, sequence.depths, strict=True):
        assert colour.read_bytes() == dataset.path(index, "colour").read_bytes()
        np.testing.assert_array_equal(depth == 0, np.isinf(dataset.image(index, "distance")))
    for kind in ("rgb", "depth"):
        rows = table(sequence.folder / f"{kind}.txt")
        assert rows == [[f"{time:.6f}", f"{kind}/{int(time):06d}.png"] for time in sequence.times]


def test_each_split_and_scene_is_a_sequence(traced, two_scenes, tmp_path):
    out = export_dataset(traced().folder, "rgbd", tmp_path / "one", "train=0:2,val=2:4").folder
    assert sorted(path.name for path in out.iterdir()) == ["train", "val"]
    assert Sequence(out / "val").times == [2.0, 3.0]
    out = export_dataset(two_scenes.folder, "rgbd", tmp_path / "two").folder
    names = ["set_000_rotation_000", "set_001_rotation_000"]
    assert sorted(path.name for path in out.iterdir()) == names
    assert Sequence(out / names[1]).files[0][0].name == "000002.png"
    out = export_dataset(two_scenes.folder, "rgbd", tmp_path / "three", "train=0:3,val=3:4").folder
    assert sorted(str(path.parent.relative_to(out)) for path in out.rglob("rgb.txt")) == [
        "train/set_000_rotation_000", "train/set_001_rotation_000", "val/set_001_rotation_000",
    ]  # fmt: skip


def test_a_sequence_has_one_camera(traced, tmp_path, monkeypatch):
    dataset = traced()

    def metadata(frame):
        content = dataset.metadata(frame.index)
        content["camera"]["fx"] += frame.index == 2
        return content

    monkeypatch.setattr(DatasetFrame, "metadata", property(metadata))
    with pytest.raises(InputError, match=r"frames/000002\.json: camera: must be the same in all frames"):
        export_dataset(dataset.folder, "rgbd", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_depth_beyond_16_bits_is_missing(traced, tmp_path, monkeypatch):
    dataset, image = traced(), DatasetFrame.image
    far = dataset.image(0, "distance").copy()
    far[10, 20], far[30, 40] = 65.0, 70.0
    monkeypatch.setattr(DatasetFrame, "image", lambda *key: far if key[1] == "distance" else image(*key))
    sequence = Sequence(export_dataset(dataset.folder, "rgbd", tmp_path / "out", frames="0:1").folder)
    assert 50 < sequence.depths[0][10, 20] < 65
    assert sequence.depths[0][30, 40] == 0

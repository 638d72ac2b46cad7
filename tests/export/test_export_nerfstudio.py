"""transforms.json, read as nerfstudio's documentation describes it.

https://docs.nerf.studio/quickstart/data_conventions.html
"""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import trimesh
from traced_set import (
    HEIGHT,
    IGNORED,
    LENSES,
    WIDTH,
    check_seed_points,
    make_traced_set,
    reprojection_error,
    visible_pixels,
)

from pepperscene.camera import read_poses
from pepperscene.errors import InputError
from pepperscene.export import export_dataset

LARGEST_PX = 0.001
LARGEST_MM = 0.55  # rounding, and single precision


def load(folder):
    return json.loads((folder / "transforms.json").read_text())


def camera_points(entry, points):
    """World points in OpenCV's camera axes: nerfstudio's are right, up and backwards."""
    to_world = np.array(entry["transform_matrix"])
    return (np.linalg.inv(to_world) @ np.column_stack([points, np.ones(len(points))]).T)[:3].T * [1, -1, -1]


def pixel_error(entry, model, pixels, points):
    """Largest distance in pixels between world points, projected as the file says, and their pixels."""
    lens = {"distortion": [entry.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")]}
    if model == "OPENCV_FISHEYE":
        names = ("k1", "k2", "k3", "k4")
        lens = {"distortion_model": "equidistant", "distortion": [entry[name] for name in names]}
    matrix = [[entry["fl_x"], 0, entry["cx"]], [0, entry["fl_y"], entry["cy"]], [0, 0, 1]]
    # The centre of the upper left pixel is at (0.5, 0.5).
    return reprojection_error(camera_points(entry, points), lens, matrix, pixels + 0.5)


def depth_error_mm(entry, folder, pixels, points, scale=1.0):
    """Largest difference between depths along the optical axis, in millimetres."""
    depth = scale * cv2.imread(str(folder / entry["depth_file_path"]), cv2.IMREAD_UNCHANGED).astype(float)
    columns, rows = pixels.T
    return np.abs(depth[rows, columns] - 1000 * camera_points(entry, points)[:, 2]).max()


@pytest.mark.parametrize("lens", [name for name in LENSES if name != "rational"])
def test_points_project_to_their_pixels_and_depths(lens, traced, exported):
    dataset, out = traced(lens), exported("nerfstudio", lens)
    content = load(out)
    assert content["camera_model"] == ("OPENCV_FISHEYE" if lens == "fisheye" else "OPENCV")
    assert content["depth_unit_scale_factor"] == 0.001
    for index, entry in zip(dataset.indices(), content["frames"], strict=True):
        assert (entry["w"], entry["h"]) == (WIDTH, HEIGHT)
        pixels, points = visible_pixels(dataset, index)
        assert len(points) == 1000
        assert pixel_error(entry, content["camera_model"], pixels, points) < LARGEST_PX
        assert depth_error_mm(entry, out, pixels, points) < LARGEST_MM


def test_images_are_copied_and_the_sky_has_no_depth(traced, exported):
    dataset, out = traced(), exported("nerfstudio")
    for index, entry in zip(dataset.indices(), load(out)["frames"], strict=True):
        assert (out / entry["file_path"]).read_bytes() == dataset.path(index, "colour").read_bytes()
        depth = cv2.imread(str(out / entry["depth_file_path"]), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
        np.testing.assert_array_equal(depth == 0, np.isinf(dataset.image(index, "distance")))
        assert "mask_path" not in entry
    expected = [dataset.metadata(index)["camera"]["pose"] for index in dataset.indices()]
    np.testing.assert_allclose(read_poses(out / "transforms.json").poses, expected, rtol=0, atol=1e-12)


def test_seed_points_are_on_the_surfaces_with_their_colours(exported):
    out = exported("nerfstudio", "brown")
    cloud = trimesh.load(out / load(out)["ply_file_path"])
    assert len(cloud.vertices) == 20_000
    check_seed_points(cloud.vertices, cloud.colors[:, :3].astype(int))


def test_splits_are_lists_of_images_and_seed_points_are_from_training(traced, tmp_path):
    out = export_dataset(traced().folder, "nerfstudio", tmp_path / "out", "train=0:1,test=1:3").folder
    content = load(out)
    assert content["train_filenames"] == ["images/000000.png"]
    # Nerfstudio validates with `val`, which it needs if there is any other list.
    assert content["test_filenames"] == content["val_filenames"] == ["images/000001.png", "images/000002.png"]
    assert len(content["frames"]) == 3
    only = export_dataset(traced().folder, "nerfstudio", tmp_path / "only", frames="0:1").folder
    assert not [key for key in load(only) if key.endswith("_filenames")]
    assert (only / "seed_points.ply").read_bytes() == (out / "seed_points.ply").read_bytes()


def test_ignored_pixels_are_masked_and_have_no_seed_points(ignoring, copied, tmp_path):
    out = export_dataset(ignoring.folder, "nerfstudio", tmp_path / "out").folder
    for index, entry in zip(ignoring.indices(), load(out)["frames"], strict=True):
        mask = cv2.imread(str(out / entry["mask_path"]), cv2.IMREAD_UNCHANGED)
        ignored = ignoring.image(index, "instance") == IGNORED
        assert ignored.any()
        np.testing.assert_array_equal(mask, np.where(ignored, 0, 255))
    cloud = trimesh.load(out / "seed_points.ply")
    check_seed_points(cloud.vertices, cloud.colors[:, :3].astype(int), -0.1)
    dataset = copied(ignoring)
    dataset.path(2, "class").unlink()
    with pytest.raises(InputError, match="frame 000002 has no output 'class'"):
        export_dataset(dataset.folder, "nerfstudio", tmp_path / "none")


def test_depth_z_is_used_without_distance(exported, tmp_path):
    dataset = make_traced_set(tmp_path / "set", "brown", ("colour", "depth_z"))
    first = export_dataset(dataset.folder, "nerfstudio", tmp_path / "a").folder
    for entry in load(first)["frames"]:
        name = entry["depth_file_path"]
        a, b = (
            cv2.imread(str(out / name), cv2.IMREAD_UNCHANGED).astype(int)
            for out in (first, exported("nerfstudio", "brown"))
        )
        assert np.abs(a - b).max() <= 1
    dataset.path(1, "depth_z").unlink()
    with pytest.raises(InputError, match=r"frame 000001 has no output 'distance'.*`pepperscene build"):
        export_dataset(dataset.folder, "nerfstudio", tmp_path / "c")


def test_several_scenes_have_a_folder_each(two_scenes, tmp_path):
    out = export_dataset(two_scenes.folder, "nerfstudio", tmp_path / "out", "train=.5,val=.5").folder
    names = ["set_000_rotation_000", "set_001_rotation_000"]
    assert sorted(path.name for path in out.iterdir()) == names
    for name, first in zip(names, (0, 2), strict=True):
        content = load(out / name)
        files = [f"images/{index:06d}.png" for index in (first, first + 1)]
        assert [entry["file_path"] for entry in content["frames"]] == files
        assert content["train_filenames"] == content["val_filenames"] == files


def test_rational_lens_is_an_error(traced, tmp_path):
    with pytest.raises(InputError, match=r"000000\.json: camera\.distortion: must be k1, k2, p1, p2, k3"):
        export_dataset(traced("rational").folder, "nerfstudio", tmp_path / "out")
    assert not (tmp_path / "out").exists()

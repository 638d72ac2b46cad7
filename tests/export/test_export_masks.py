"""Foregrounds of exports: masks, points and depths of some classes, and pictures with a fourth channel."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from test_export_ply import load as load_points
from traced_set import RADIUS_M, SPHERE, make_traced_set

from pepperscene.errors import ArgumentError, InputError
from pepperscene.export import export_dataset
from pepperscene.export.job import parse_foreground

PLANTS = {1, 2, 3, 4, 5, 7}
CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
CLASSES = {"plant": PLANTS, "fruit": {2}, "leaf+stem": {1, 4}, "pepper+peduncle": {2, 3}, "wire": {6}}


@pytest.fixture(scope="module")
def covered(tmp_path_factory):
    """Frames with coverage."""
    outputs = ("colour", "class", "instance", "distance", "coverage")
    return make_traced_set(tmp_path_factory.mktemp("covered") / "set", outputs=outputs, frames=range(2))


def read(path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return image if image.ndim == 2 else image[..., [2, 1, 0, 3][: image.shape[2]]]


@pytest.mark.parametrize(("text", "classes"), CLASSES.items())
def test_foregrounds_are_classes(text, classes):
    assert parse_foreground(text) == classes


@pytest.mark.parametrize("text", ["", "banana", "background", "leaf+", "leaf+leaf", "x=leaf", "leaf,x=stem"])
def test_what_is_no_foreground_is_an_error(text, traced, tmp_path):
    with pytest.raises(ArgumentError, match="mask"):
        export_dataset(traced().folder, "colmap", tmp_path / "out", mask=text)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("mask", ["plant", "fruit"])
def test_masks_are_those_of_the_class_images(mask, traced, tmp_path):
    dataset = traced("brown")
    places = {"nerfstudio": "masks/{}.png", "colmap": "masks/{}.png.png", "rgbd": "mask/{}.png"}
    for name, place in places.items():
        out = export_dataset(dataset.folder, name, tmp_path / name, frames="0:2", mask=mask).folder
        for index in (0, 1):
            expected = np.isin(dataset.image(index, "class"), list(CLASSES[mask]))
            assert 0 < expected.mean() < 1
            found = read(out / place.format(f"{index:06d}"))
            np.testing.assert_array_equal(found, np.where(expected, 255, 0))
    entries = json.loads((tmp_path / "nerfstudio/transforms.json").read_text())["frames"]
    assert [entry["mask_path"] for entry in entries] == ["masks/000000.png", "masks/000001.png"]


def test_points_are_those_of_the_foreground(traced, tmp_path):
    dataset = traced()
    cloud = load_points(
        export_dataset(dataset.folder, "ply", tmp_path / "a", mask="fruit").folder / "points/000001.ply"
    )
    is_fruit = dataset.image(1, "class") == 2
    assert len(cloud) == is_fruit.sum()
    np.testing.assert_array_equal(cloud["instance"], dataset.image(1, "instance")[is_fruit])
    out = export_dataset(dataset.folder, "nerfstudio", tmp_path / "b", mask="fruit").folder
    seeds = load_points(out / "seed_points.ply")
    position = np.column_stack([seeds[name] for name in "xyz"])
    assert len(seeds) > 1000
    assert np.abs(np.linalg.norm(position - SPHERE, axis=1) - RADIUS_M).max() < 2e-6
    assert set(seeds["class"]) == {2}


def test_depths_are_those_of_the_foreground_in_the_unit_of_the_file(traced, tmp_path):
    dataset = traced()
    out = export_dataset(dataset.folder, "rgbd", tmp_path / "out", mask="fruit").folder
    scale = json.loads((out / "depth.json").read_text())["depth_scale_m"]
    expected = np.where(dataset.image(0, "class") == 2, dataset.image(0, "depth_z"), 0)
    np.testing.assert_allclose(scale * read(out / "depth/000000.png"), expected, atol=0.51e-3)


def test_depth_alone_is_exported_without_photographs(tmp_path):
    dataset = make_traced_set(tmp_path / "set", outputs=("distance",), frames=range(2))
    out = export_dataset(dataset.folder, "rgbd", tmp_path / "out").folder
    names = sorted(path.name for path in out.iterdir())
    assert names == ["camera_info.yaml", "depth", "depth.json", "depth.txt", "groundtruth.txt"]
    with pytest.raises(InputError, match="frame 000000 has no output 'class'"):
        export_dataset(dataset.folder, "rgbd", tmp_path / "none", mask="plant")


@pytest.mark.parametrize(("mask", "classes"), [(None, PLANTS), ("fruit", {2})])
def test_fourth_channel_is_the_coverage_of_the_foreground(mask, classes, covered, tmp_path):
    for name in ("nerfstudio", "colmap"):
        out = export_dataset(covered.folder, name, tmp_path / name, mask=mask, alpha=True).folder
        picture, shares = read(out / "images/000001.png"), covered.image(1, "coverage").astype(float)
        share = shares[..., sorted(classes)].sum(axis=-1)
        is_mixed, colour = (share > 0) & (share < 1), covered.image(1, "colour")
        assert 0 < is_mixed.mean() < 0.2
        np.testing.assert_array_equal(picture[~is_mixed][:, :3], colour[~is_mixed])
        # Mixed pixels have the colour of one inside at most 5 away, as far as there is one.
        inside = cv2.erode((share == 1).astype(np.uint8), CROSS, borderValue=1) > 0
        colours = set(map(tuple, colour[inside].tolist()))
        is_near = is_mixed & (cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5) < 4.9)
        assert is_near.any()
        assert set(map(tuple, picture[is_near][:, :3].tolist())) <= colours
        np.testing.assert_array_equal(picture[..., 3], np.rint(255 * share))
        assert (out / "masks").exists() == (mask is not None)


def test_fourth_channel_is_the_mask_without_coverage(traced, tmp_path):
    out = export_dataset(traced().folder, "colmap", tmp_path / "out", frames="0:1", alpha=True).folder
    expected = np.isin(traced().image(0, "class"), list(PLANTS))
    np.testing.assert_array_equal(read(out / "images/000000.png")[..., 3], np.where(expected, 255, 0))


def test_options_that_do_not_apply_are_errors(traced, tmp_path):
    for name, options in [
        ("coco", {"mask": "fruit"}),
        ("ply", {"alpha": True}),
        ("bop", {"undistort": True}),
    ]:
        with pytest.raises(ArgumentError, match=f"does not apply to {name}, only to nerfstudio, colmap"):
            export_dataset(traced().folder, name, tmp_path / "out", **options)

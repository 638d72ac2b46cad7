"""COLMAP's text model: points and poses against closed forms, and COLMAP itself where it is installed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from colmap_text import Model, rotation_of
from test_export_ply import load as load_points
from traced_set import IGNORED, LENSES, check_seed_points, image_points, intersect, visible_pixels

from pepperscene.camera import read_poses
from pepperscene.export import export_dataset

LARGEST_PX = 0.001
MODELS = {
    "pinhole": "PINHOLE", "brown": "OPENCV", "brown_k3": "FULL_OPENCV", "rational": "FULL_OPENCV",
    "fisheye": "OPENCV_FISHEYE",
}  # fmt: skip


def centre_of(pose):
    return -rotation_of(*pose[:4]).T @ pose[4:]


def project(pose, camera, points):
    """Pixels of world points, which must be in front of the camera."""
    model, _, _, (fx, fy, cx, cy, *rest) = camera
    in_camera = points @ rotation_of(*pose[:4]).T + pose[4:]
    assert (in_camera[:, 2] > 0).all()
    lens = {"distortion": rest} if rest else {}
    if model == "OPENCV_FISHEYE":
        lens["distortion_model"] = "equidistant"
    return image_points(in_camera, lens, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))


# `brown_k3` has the model of `rational`, which takes longest to write.
@pytest.mark.parametrize(
    "lens", [pytest.param(lens, marks=pytest.mark.long if lens == "brown_k3" else ()) for lens in LENSES]
)
def test_points_project_to_their_pixels(lens, traced, exported):
    dataset, model = traced(lens), Model(exported("colmap", lens))
    assert [camera[0] for camera in model.cameras.values()] == [MODELS[lens]]
    for index, (pose, camera, name, _) in zip(dataset.indices(), model.images.values(), strict=True):
        assert name == f"{index:06d}.png"
        pixels, points = visible_pixels(dataset, index)
        assert len(points) == 1000
        # The centre of the upper left pixel is at (0.5, 0.5).
        error = project(pose, model.cameras[camera], points) - 0.5 - pixels
        assert np.linalg.norm(error, axis=1).max() < LARGEST_PX


@pytest.mark.parametrize("lens", ["brown", "fisheye"])
def test_tracks_are_consistent_exact_and_not_occluded(lens, exported):
    model = Model(exported("colmap", lens))
    assert 19_900 < len(model.points) <= 20_000
    position = np.array([point[0] for point in model.points.values()])
    row_of = {number: row for row, number in enumerate(model.points)}
    for number, (pose, camera, _, observed) in model.images.items():
        rows = [row_of[int(point)] for point in observed[:, 2]]
        assert len(set(rows)) == len(rows)
        error = np.linalg.norm(project(pose, model.cameras[camera], position[rows]) - observed[:, :2], axis=1)
        assert error.max() < 0.002
        # Nothing is in front of an observed point, except at the edges of a pixel.
        offset = position[rows] - centre_of(pose)
        distance = np.linalg.norm(offset, axis=1)
        nearest = np.minimum(*intersect(centre_of(pose)[None], offset / distance[:, None]))
        assert (nearest < 0.99 * distance).mean() < 0.002
        for row, (_, _, point) in enumerate(observed[::500]):
            assert [number, 500 * row] in model.points[int(point)][3].tolist()
    tracks = [len(point[3]) for point in model.points.values()]
    assert sum(tracks) == sum(len(image[3]) for image in model.images.values())
    assert np.mean(tracks) > 2
    assert max(tracks) == len(model.images)
    assert {point[2] for point in model.points.values()} == {0.0}


@pytest.mark.parametrize("lens", ["brown", "fisheye"])
def test_points_are_in_pixels_of_their_own_organ(lens, traced, exported):
    dataset, out = traced(lens), exported("colmap", lens)
    model, cloud = Model(out), load_points(out / "sparse/0/points3D.ply")
    position = np.array([point[0] for point in model.points.values()])
    np.testing.assert_allclose(np.column_stack([cloud[name] for name in "xyz"]), position, atol=1e-6)
    row_of = {number: row for row, number in enumerate(model.points)}
    for index, (_, _, _, observed) in zip(dataset.indices(), model.images.values(), strict=True):
        rows = [row_of[int(point)] for point in observed[:, 2]]
        x, y = observed[:, :2].astype(int).T
        for name in ("class", "instance"):
            # Only at the outline of the sphere can a pixel within the tolerance of the distance be another's.
            assert (dataset.image(index, name)[y, x] == cloud[name][rows]).mean() > 0.998


def test_images_are_copied_and_poses_are_read_back(traced, exported):
    dataset, out = traced(), exported("colmap")
    for index in dataset.indices():
        copy = out / "images" / f"{index:06d}.png"
        assert copy.read_bytes() == dataset.path(index, "colour").read_bytes()
    expected = [dataset.metadata(index)["camera"]["pose"] for index in dataset.indices()]
    np.testing.assert_allclose(read_poses(out).poses, expected, rtol=0, atol=1e-9)


def test_splits_and_masks_are_lists_and_images(ignoring, tmp_path):
    out = export_dataset(ignoring.folder, "colmap", tmp_path / "out", "train=0:3,test=3:4").folder
    lists = {path.name: path.read_text().splitlines() for path in out.glob("*_list.txt")}
    assert lists == {
        "train_list.txt": ["000000.png", "000001.png", "000002.png"],
        "val_list.txt": ["000003.png"],
        "test_list.txt": ["000003.png"],
    }
    for index in ignoring.indices():
        mask = cv2.imread(str(out / "masks" / f"{index:06d}.png.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask == 0, ignoring.image(index, "instance") == IGNORED)
    points = Model(out).points.values()
    check_seed_points(np.array([one[0] for one in points]), np.array([one[1] for one in points]), -0.1)


def test_error_of_a_rolling_shutter_is_that_of_a_single_pose(rolling, tmp_path):
    model = Model(export_dataset(rolling.folder, "colmap", tmp_path / "out").folder)
    found = {number: [] for number in model.points}
    for pose, camera, _, observed in model.images.values():
        position = np.array([model.points[int(point)][0] for point in observed[:, 2]])
        error = np.linalg.norm(project(pose, model.cameras[camera], position) - observed[:, :2], axis=1)
        for number, value in zip(observed[:, 2], error, strict=True):
            found[int(number)].append(value)
    for number, errors in found.items():
        assert np.mean(errors) == pytest.approx(model.points[number][2], abs=0.002)
    assert max(point[2] for point in model.points.values()) > 0.5


@pytest.mark.parametrize("lens", LENSES)
def test_colmap_itself_reads_the_model_and_finds_no_reprojection_error(lens, exported):
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(exported("colmap", lens) / "sparse" / "0")
    assert model.num_images() == 4
    assert model.compute_mean_track_length() > 2
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() < 0.001
    for image in model.images.values():
        for point in image.points2D[::100]:
            found = image.project_point(model.points3D[point.point3D_id].xyz)
            np.testing.assert_allclose(found, point.xy, atol=0.002)

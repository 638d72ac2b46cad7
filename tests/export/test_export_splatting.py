"""COLMAP models as 3D Gaussian splatting reads them, and images of a pinhole camera against closed forms.

The reader follows the rules of https://github.com/graphdeco-inria/gaussian-splatting (`readColmapSceneInfo`):
text files where there are no binary ones, cameras of the model PINHOLE of which only the fields of view are
used, images sorted by name, and a PLY file with positions, normals and colours.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from colmap_text import lines_of, rotation_of
from test_export_ply import load as load_points
from traced_set import HEIGHT, LENSES, WIDTH, colour_of, intersect

from pepperscene.errors import InputError
from pepperscene.export import export_dataset


class SplattingScene:
    """What the loader makes of a folder: `cameras` by name (R, T, fields of view, picture), and `points`."""

    def __init__(self, folder):
        model = folder / "sparse" / "0"
        assert not list(model.glob("*.bin"))
        intrinsics = {}
        for line in lines_of(model / "cameras.txt"):
            number, name, width, height, fx, fy, *_ = line.split()
            assert name == "PINHOLE"
            size = int(width), int(height)
            half = [n / (2 * float(f)) for n, f in zip(size, (fx, fy), strict=True)]
            intrinsics[int(number)] = 2 * np.arctan(half), size
        self.cameras = {}
        for line in lines_of(model / "images.txt")[::2]:
            _, *pose, camera, name = line.split()
            picture = cv2.imread(str(folder / "images" / name), cv2.IMREAD_UNCHANGED)
            fov, size = intrinsics[int(camera)]
            assert picture.shape[1::-1] == size
            turn, shift = rotation_of(*map(float, pose[:4])), np.array(pose[4:], float)
            self.cameras[name.split(".")[0]] = turn, shift, fov, picture[..., [2, 1, 0]]
        self.cameras = dict(sorted(self.cameras.items()))
        self.points = load_points(model / "points3D.ply")
        assert {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"} <= set(self.points.dtype.names)
        self.position = np.column_stack([self.points[name] for name in "xyz"]).astype(float)

    def project(self, name, points):
        """Pixels `(n, 2)` of points in front of a camera, as the rasteriser projects them."""
        turn, shift, fov, picture = self.cameras[name]
        in_camera = points @ turn.T + shift
        normalised = in_camera[:, :2] / in_camera[:, 2:] / np.tan(fov / 2)
        return (normalised + 1) / 2 * picture.shape[1::-1]


@pytest.fixture(scope="module")
def scene_of(traced, tmp_path_factory):
    """The undistorted scene of each lens, exported once."""
    made = {}

    def scene(lens):
        if lens not in made:
            out = tmp_path_factory.mktemp("splats") / "out"
            made[lens] = SplattingScene(
                export_dataset(traced(lens).folder, "colmap", out, undistort=True).folder
            )
        return made[lens]

    return scene


@pytest.mark.parametrize("lens", LENSES)
def test_poses_and_points_are_those_of_the_scene(lens, traced, scene_of):
    dataset, scene = traced(lens), scene_of(lens)
    assert len(scene.points) > 18_000
    for index, (turn, shift, fov, picture) in zip(dataset.indices(), scene.cameras.values(), strict=True):
        pose = np.array(dataset.metadata(index)["camera"]["pose"])
        np.testing.assert_allclose(turn.T, pose[:3, :3], atol=1e-6)
        np.testing.assert_allclose(-turn.T @ shift, pose[:3, 3], atol=1e-6)
        # Every pixel shows what is behind it.
        columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        slopes = (np.stack([columns / WIDTH, rows / HEIGHT], axis=-1) * 2 - 1) * np.tan(fov / 2)
        ray = np.concatenate([slopes, np.ones((HEIGHT, WIDTH, 1))], axis=-1).reshape(-1, 3) @ turn
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        distance = np.minimum(*intersect(pose[:3, 3][None], ray))
        with np.errstate(invalid="ignore"):
            position = pose[:3, 3] + distance[:, None] * ray
        position[np.isinf(distance)] = np.inf
        error = np.abs(picture.reshape(-1, 3).astype(int) - colour_of(position)).max(axis=1)
        # Interpolation changes edges, and the wall where its pattern is as fine as the pixels.
        assert np.quantile(error, 0.75) <= 8
        assert np.median(error) <= 3


def test_masks_and_depths_are_undistorted_with_the_pictures(traced, tmp_path):
    options = {"mask": "fruit", "undistort": True, "frames": "0:2"}
    out = export_dataset(traced("fisheye").folder, "colmap", tmp_path / "a", **options).folder
    scene = SplattingScene(out)
    for name in scene.cameras:
        mask = cv2.imread(str(out / "masks" / f"{name}.png.png"), cv2.IMREAD_UNCHANGED)
        pixels = scene.project(name, scene.position)
        inside = ((pixels >= 1) & (pixels < [WIDTH - 1, HEIGHT - 1])).all(axis=1)
        columns, rows = pixels[inside].astype(int).T
        assert inside.any()
        # All points are of the sphere: only at its outline can a pixel be that of the wall.
        assert (mask[rows, columns] == 255).mean() > 0.97
        assert set(np.unique(mask)) == {0, 255}
    sequence = export_dataset(traced("fisheye").folder, "rgbd", tmp_path / "b", **options).folder
    depth = cv2.imread(str(sequence / "depth/000000.png"), cv2.IMREAD_UNCHANGED)
    mask = cv2.imread(str(sequence / "mask/000000.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(depth > 0, mask == 255)
    np.testing.assert_array_equal(mask, cv2.imread(str(out / "masks/000000.png.png"), cv2.IMREAD_UNCHANGED))


def test_images_of_moving_rows_are_not_undistorted(rolling, tmp_path):
    with pytest.raises(InputError, match="must not move while its rows are read, with undistort"):
        export_dataset(rolling.folder, "colmap", tmp_path / "out", undistort=True)
    assert not (tmp_path / "out").exists()

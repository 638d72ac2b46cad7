"""Point clouds, read by code for the PLY format and by trimesh."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import trimesh
from traced_set import (
    FRUIT,
    HEIGHT,
    INTRINSICS,
    LEAF,
    LENSES,
    RADIUS_M,
    ROLLING,
    SPHERE,
    WIDTH,
    reprojection_error,
    row_poses,
)

from pepperscene.export import export_dataset

LARGEST_PX = 0.001
TYPES = {"float": "<f4", "uchar": "u1", "ushort": "<u2"}


def load(path):
    """The vertices of a binary PLY file as a structured array."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in header.decode("ascii").splitlines()]
    assert lines[:2] == [["ply"], ["format", "binary_little_endian", "1.0"]]
    (count,) = [int(line[2]) for line in lines if line[:2] == ["element", "vertex"]]
    fields = [(line[2], TYPES[line[1]]) for line in lines if line[0] == "property"]
    vertices = np.frombuffer(body, fields)
    assert len(vertices) == count
    return vertices


def xyz(vertices):
    return np.column_stack([vertices[name] for name in "xyz"]).astype(float)


def pixel_error(vertices, dataset, index, lens, rolling=None):
    """Largest distance in pixels between projected points and the pixels that have a surface, in order."""
    rows, columns = np.nonzero(np.isfinite(dataset.image(index, "distance")))
    poses = row_poses(dataset.metadata(index)["camera"]["pose"], rolling)[rows]
    in_camera = np.einsum("nji,nj->ni", poses[:, :3, :3], xyz(vertices) - poses[:, :3, 3])
    fx, fy, cx, cy = INTRINSICS.values()
    matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    return reprojection_error(in_camera, LENSES[lens], matrix, np.column_stack([columns, rows]))


@pytest.mark.parametrize("lens", LENSES)
def test_points_are_those_of_their_pixels(lens, traced, exported):
    dataset, out = traced(lens), exported("ply", lens)
    for index in dataset.indices():
        vertices = load(out / f"points/{index:06d}.ply")
        position = dataset.image(index, "position")
        is_surface = np.isfinite(position[..., 0])
        assert len(vertices) == is_surface.sum() < HEIGHT * WIDTH
        np.testing.assert_allclose(xyz(vertices), position[is_surface], rtol=0, atol=2e-6)
        assert pixel_error(vertices, dataset, index, lens) < LARGEST_PX


def test_colours_classes_and_instances_are_those_of_the_pixels(traced, exported):
    dataset, out = traced("brown"), exported("ply", "brown")
    vertices = load(out / "points/000002.ply")
    is_surface = np.isfinite(dataset.image(2, "distance"))
    for name in ("class", "instance"):
        # Masks of the points, put back into the image, are those of the data set.
        image = np.zeros((HEIGHT, WIDTH), vertices[name].dtype)
        image[is_surface] = vertices[name]
        np.testing.assert_array_equal(image, dataset.image(2, name))
    colour = np.column_stack([vertices[name] for name in ("red", "green", "blue")])
    np.testing.assert_array_equal(colour, dataset.image(2, "colour")[is_surface])
    on_sphere = np.abs(np.linalg.norm(xyz(vertices) - SPHERE, axis=1) - RADIUS_M) < 1e-5
    np.testing.assert_array_equal(on_sphere, vertices["instance"] == FRUIT)
    assert (vertices["class"][vertices["instance"] == LEAF] == 1).all()
    # The file is one that trimesh reads.
    cloud = trimesh.load(out / "points/000002.ply")
    np.testing.assert_array_equal(cloud.vertices, xyz(vertices))
    np.testing.assert_array_equal(cloud.colors[:, :3], colour)


def test_rows_of_a_rolling_shutter_have_their_own_poses(rolling, tmp_path):
    out = export_dataset(rolling.folder, "ply", tmp_path / "out").folder
    for index in rolling.indices():
        vertices, position = load(out / f"points/{index:06d}.ply"), rolling.image(index, "position")
        np.testing.assert_allclose(xyz(vertices), position[np.isfinite(position[..., 0])], rtol=0, atol=2e-6)
        assert pixel_error(vertices, rolling, index, "brown", ROLLING) < LARGEST_PX


def test_a_table_gives_the_splits(traced, tmp_path):
    out = export_dataset(traced().folder, "ply", tmp_path / "out", "train=0:2,val=3:4").folder
    with (out / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["file"], row["split"]) for row in rows] == [
        ("points/000000.ply", "train"),
        ("points/000001.ply", "train"),
        ("points/000003.ply", "val"),
    ]
    assert sorted(str(path.relative_to(out)) for path in out.glob("points/*")) == [r["file"] for r in rows]

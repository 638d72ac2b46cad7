"""Labels against straightforward versions of the same computation, and against trimesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from bodies import body
from greenhouse import camera, row_of_plants

from pepperscene.classes import OrganClass
from pepperscene.outputs import OUTPUTS
from pepperscene.render.aov import labels
from pepperscene.render.aov.labels import Hits
from pepperscene.render.kernel.camera import camera_rays
from pepperscene.render.kernel.scene import truth_scene
from pepperscene.scene import assemble_scene


@pytest.fixture(scope="module")
def mesh():
    return row_of_plants()


@pytest.fixture(scope="module")
def kernel_scene(mesh):
    return truth_scene(assemble_scene(mesh))


@pytest.fixture(scope="module")
def hits(kernel_scene):
    return labels.first_hits(kernel_scene, camera_rays(camera()))


def normals_per_pixel(mesh, hits, view):
    """One cross product per pixel, turned against the pixel's own ray."""
    corner = mesh.vertices[mesh.faces[np.maximum(hits.face, 0)]].astype(np.float64)
    normal = np.cross(corner[..., 1, :] - corner[..., 0, :], corner[..., 2, :] - corner[..., 0, :])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    ray = view.pixel_directions() @ view.pose[:3, :3].T
    normal *= -np.sign((normal * ray).sum(-1, keepdims=True))
    return np.where(hits.face[..., None] >= 0, normal, 0.0)


def test_normals_equal_cross_products_per_pixel(mesh, hits):
    normal = labels.normals(mesh, hits, camera())
    assert OUTPUTS["normal"].fits(normal)
    np.testing.assert_allclose(normal, normals_per_pixel(mesh, hits, camera()), atol=1e-7)
    # Many triangles and the background are in view.
    assert len(np.unique(hits.face)) > 100
    assert hits.face.min() == -1
    # Each axis is contiguous, so that it can be written to a file as it is.
    assert all(normal[..., axis].flags.c_contiguous for axis in range(3))


def test_classes_and_instances_equal_those_of_the_faces(mesh, hits):
    is_hit = hits.face >= 0
    instance = labels.instance_ids(mesh, hits)
    np.testing.assert_array_equal(instance, np.where(is_hit, mesh.face_instance[hits.face] + 1, 0))
    expected = np.where(is_hit, mesh.face_class[hits.face], 0)
    np.testing.assert_array_equal(labels.class_ids(mesh, instance), expected)


def assert_boxes_and_pixels(described, instance):
    for value in range(1, instance.max() + 1):
        rows, columns = np.nonzero(instance == value)
        if not rows.size:
            assert str(value) not in described
            continue
        item = described[str(value)]
        assert item["box"] == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        assert item["pixels"] == rows.size
        assert all(isinstance(number, int) for number in (*item["box"], item["pixels"]))


def test_visible_instances_have_their_boxes_and_pixel_counts(mesh, hits):
    instance = labels.instance_ids(mesh, hits)
    described = labels.visible_instances(mesh, instance)
    assert set(described) == {str(value) for value in np.unique(instance[instance > 0])}
    assert_boxes_and_pixels(described, instance)
    # Random instances per pixel: they touch every border.
    rng = np.random.default_rng(3)
    for shape in ((1, 1), (1, 40), (40, 1), (17, 23)):
        random = rng.integers(0, 6, shape).astype(np.uint16)
        assert_boxes_and_pixels(labels.visible_instances(mesh, random), random)
    assert labels.visible_instances(mesh, np.zeros((2, 2), np.uint16)) == {}


def test_positions_are_at_their_distance_along_the_pixels_ray(hits):
    view = camera(distorted=True)
    position = labels.positions(hits, view)
    is_hit = hits.face >= 0
    np.testing.assert_array_equal(np.isinf(position).all(axis=-1), ~is_hit)
    expected = view.pose[:3, 3] + hits.distance[..., None] * (view.pixel_directions() @ view.pose[:3, :3].T)
    np.testing.assert_allclose(position[is_hit], expected[is_hit], rtol=0, atol=1e-12)


def test_surface_coordinates_equal_trimeshs(mesh, kernel_scene):
    view = camera(distorted=True)
    hits = labels.first_hits(kernel_scene, camera_rays(view))
    uv = labels.surface_coordinates(mesh, hits, view)
    assert OUTPUTS["uv"].fits(uv)
    assert (uv[hits.face < 0] == -1).all()
    assert ((uv[hits.face >= 0] >= 0) & (uv[hits.face >= 0] <= 1)).all()
    row, column = np.nonzero(hits.face >= 0)
    chosen = np.random.default_rng(5).choice(len(row), 200, replace=False)
    row, column = row[chosen], column[chosen]
    # The intersection of the lens formula's ray with the triangle's plane, and the corners' weights there.
    triangle = mesh.faces[hits.face[row, column]]
    corners = mesh.vertices[triangle].astype(float)
    ray = view.pixel_directions()[row, column] @ view.pose[:3, :3].T
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    distance = ((corners[:, 0] - view.pose[:3, 3]) * normal).sum(1) / (ray * normal).sum(1)
    points = view.pose[:3, 3] + distance[:, None] * ray
    weights = trimesh.triangles.points_to_barycentric(corners, points)
    expected = (weights[..., None] * mesh.uv[triangle]).sum(axis=1)
    np.testing.assert_allclose(uv[row, column], expected, atol=1e-4)
    assert np.median(np.abs(uv[row, column] - expected)) < 1e-6


def test_last_face_is_not_mistaken_for_the_background():
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    mesh, pose = body(triangle, "matt", OrganClass.STEM), np.eye(4)
    pose[2, 3] = -1.0
    view = camera().at_pose(pose)
    hits = Hits(np.array([[0, -1]]), np.array([[1.0, np.inf]], np.float32))
    instance = labels.instance_ids(mesh, hits)
    assert instance.tolist() == [[1, 0]]
    assert labels.class_ids(mesh, instance).tolist() == [[OrganClass.STEM, 0]]
    # The camera looks along +z, from below: it sees the side that faces -z.
    np.testing.assert_array_equal(labels.normals(mesh, hits, view), [[[0, 0, -1], [0, 0, 0]]])


@pytest.mark.parametrize(("columns", "rows"), [(1, 1), (5, 9)])
def test_every_pixel_has_its_own_ray_at_any_image_size(kernel_scene, mesh, columns, rows):
    # The pinhole camera's ray from pixel to hit: the hit is in the plane of the face.
    view = camera(columns=columns, rows=rows)
    hits = labels.first_hits(kernel_scene, camera_rays(view))
    assert hits.face.shape == hits.distance.shape == (rows, columns)
    np.testing.assert_array_equal(hits.face < 0, np.isinf(hits.distance))
    is_hit = hits.face >= 0
    direction = (view.pixel_directions() @ view.pose[:3, :3].T)[is_hit]
    point = view.pose[:3, 3] + hits.distance[is_hit][:, None] * direction
    corner = mesh.vertices[mesh.faces[hits.face[is_hit]]].astype(float)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(((point - corner[:, 0]) * normal).sum(1)).max(initial=0.0) < 1e-5
    low, high = corner.min(axis=1), corner.max(axis=1)
    assert ((point > low - 1e-5) & (point < high + 1e-5)).all()

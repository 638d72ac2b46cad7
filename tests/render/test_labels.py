"""Labels by the short ways of `labels`, against the same told plainly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from greenhouse import camera, row_of_plants

from pepperscene.classes import CLASS_COLOURS, Instance, OrganClass
from pepperscene.frame import OUTPUTS
from pepperscene.geometry import Mesh
from pepperscene.render.aov import labels
from pepperscene.render.aov.labels import Hits
from pepperscene.render.kernel.camera import camera_rays
from pepperscene.render.kernel.scene import truth_scene
from pepperscene.scene import assemble_scene

OTHERWISE = ("coverage", "flow", "stereo", "harvest")  # by rays or cameras of their own
LABELS = tuple(name for name, output in OUTPUTS.items() if not output.traced and name not in OTHERWISE)


@pytest.fixture(scope="module")
def mesh():
    return row_of_plants()


@pytest.fixture(scope="module")
def kernel_scene(mesh):
    return truth_scene(assemble_scene(mesh))


@pytest.fixture(scope="module")
def hits(kernel_scene):
    return labels.first_hits(kernel_scene, camera_rays(camera()))


def plain_normals(mesh, hits, view):
    """One cross product per pixel, turned against the pixel's own ray."""
    corner = mesh.vertices[mesh.faces[np.maximum(hits.face, 0)]].astype(np.float64)
    normal = np.cross(corner[..., 1, :] - corner[..., 0, :], corner[..., 2, :] - corner[..., 0, :])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    ray = view.pixel_directions() @ view.pose[:3, :3].T
    normal *= -np.sign((normal * ray).sum(-1, keepdims=True))
    return np.where(hits.face[..., None] >= 0, normal, 0.0)


def test_normals_are_the_cross_products_of_each_pixels_triangle(mesh, hits):
    normal = labels.normals(mesh, hits, camera())
    assert OUTPUTS["normal"].fits(normal)
    np.testing.assert_allclose(normal, plain_normals(mesh, hits, camera()), atol=1e-7)
    # Every triangle in view and the background are among them.
    assert len(np.unique(hits.face)) > 100
    assert hits.face.min() == -1


def test_each_axis_of_the_normals_lies_in_one_piece(mesh, hits):
    # So that it goes to its file as it is.
    normal = labels.normals(mesh, hits, camera())
    assert all(normal[..., axis].flags.c_contiguous for axis in range(3))


def test_classes_and_instances_are_those_of_the_faces(mesh, hits):
    seen = hits.face >= 0
    instance = labels.instance_ids(mesh, hits)
    np.testing.assert_array_equal(instance, np.where(seen, mesh.face_instance[hits.face] + 1, 0))
    expected = np.where(seen, mesh.face_class[hits.face], 0)
    np.testing.assert_array_equal(labels.class_ids(mesh, hits), expected)
    np.testing.assert_array_equal(labels.class_ids(mesh, hits, instance), expected)


def test_all_truths_are_as_the_outputs_tell(mesh, hits):
    instance = labels.instance_ids(mesh, hits)
    made = labels.label_outputs(mesh, hits, instance, camera(), LABELS)
    assert list(made) == list(LABELS)
    assert all(OUTPUTS[name].fits(image) for name, image in made.items())
    np.testing.assert_array_equal(made["class_colour"], np.array(CLASS_COLOURS, np.uint8)[made["class"]])
    assert list(labels.label_outputs(mesh, hits, instance, camera(), ["distance", "colour"])) == ["distance"]


def test_the_instances_in_view_are_counted(mesh, hits):
    instance = labels.instance_ids(mesh, hits)
    told = labels.instances_in_view(mesh, instance)
    values, pixels = np.unique(instance[instance > 0], return_counts=True)
    assert {int(value): one["pixels"] for value, one in told.items()} == dict(
        zip(values.tolist(), pixels.tolist(), strict=True)
    )
    assert labels.instances_in_view(mesh, np.zeros((2, 2), np.uint16)) == {}


def assert_boxes_are_those_of(told, instance):
    for value in range(1, instance.max() + 1):
        rows, columns = np.nonzero(instance == value)
        if not rows.size:
            assert str(value) not in told
            continue
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        assert told[str(value)]["box"] == box
        assert told[str(value)]["pixels"] == rows.size
        assert all(isinstance(number, int) for number in told[str(value)]["box"])


def test_boxes_hold_their_instances_pixels(mesh, hits):
    instance = labels.instance_ids(mesh, hits)
    assert_boxes_are_those_of(labels.instances_in_view(mesh, instance), instance)
    # Where each pixel may be of any instance: runs that end and begin at every border.
    rng = np.random.default_rng(3)
    for shape in ((1, 1), (1, 40), (40, 1), (17, 23)):
        random = rng.integers(0, 6, shape).astype(np.uint16)
        assert_boxes_are_those_of(labels.instances_in_view(mesh, random), random)


# --- points and surface coordinates ------------------------------------------------------------------------


def test_positions_lie_at_their_distance_on_the_pixels_ray(hits):
    view = camera(distorted=True)
    position = labels.points(hits, view)
    seen = hits.face >= 0
    np.testing.assert_array_equal(np.isinf(position).all(axis=-1), ~seen)
    expected = view.pose[:3, 3] + hits.distance[..., None] * (view.pixel_directions() @ view.pose[:3, :3].T)
    np.testing.assert_allclose(position[seen], expected[seen], rtol=0, atol=1e-12)


@pytest.mark.parametrize("distorted", [False, True])
def test_surface_coordinates_are_those_that_trimesh_finds(mesh, kernel_scene, distorted):
    view = camera(distorted=distorted)
    hits = labels.first_hits(kernel_scene, camera_rays(view))
    uv = labels.surface_coordinates(mesh, hits, view)
    assert OUTPUTS["uv"].fits(uv)
    assert (uv[hits.face < 0] == -1).all()
    assert ((uv[hits.face >= 0] >= 0) & (uv[hits.face >= 0] <= 1)).all()
    row, column = np.nonzero(hits.face >= 0)
    chosen = np.random.default_rng(5).choice(len(row), 200, replace=False)
    row, column = row[chosen], column[chosen]
    # Where the lens formula's ray meets the triangle's plane, and the corners' weights there.
    triangle = mesh.faces[hits.face[row, column]]
    corners = mesh.vertices[triangle].astype(float)
    ray = view.pixel_directions()[row, column] @ view.pose[:3, :3].T
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    depth = ((corners[:, 0] - view.pose[:3, 3]) * normal).sum(1) / (ray * normal).sum(1)
    weights = trimesh.triangles.points_to_barycentric(corners, view.pose[:3, 3] + depth[:, None] * ray)
    expected = (weights[..., None] * mesh.uv[triangle]).sum(axis=1)
    np.testing.assert_allclose(uv[row, column], expected, atol=1e-4)
    assert np.median(np.abs(uv[row, column] - expected)) < 1e-6


def test_nothing_in_view_is_no_face_and_no_normal(mesh):
    empty = Hits(np.full((4, 5), -1), np.full((4, 5), np.inf, np.float32))
    assert not labels.normals(mesh, empty, camera()).any()
    assert not labels.class_ids(mesh, empty).any()
    assert not labels.instance_ids(mesh, empty).any()
    assert np.isinf(labels.points(empty, camera(columns=5, rows=4))).all()
    assert (labels.surface_coordinates(mesh, empty, camera(columns=5, rows=4)) == -1).all()


def test_the_last_face_is_not_taken_for_the_background():
    mesh = Mesh(
        vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32),
        normals=np.tile(np.float32([0, 0, 1]), (3, 1)),
        uv=np.zeros((3, 2), np.float32),
        state=np.zeros(3, np.float32),
        faces=np.array([[0, 1, 2]], np.uint32),
        face_instance=np.zeros(1, np.uint32),
        face_surface=np.zeros(1, np.uint8),
        surfaces=("matt",),
        instances=(Instance(OrganClass.STEM, "sheet"),),
    )
    view = replace(camera(), pose=np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -1], [0, 0, 0, 1.0]]))
    hits = Hits(np.array([[0, -1]]), np.array([[1.0, np.inf]], np.float32))
    assert labels.class_ids(mesh, hits).tolist() == [[OrganClass.STEM, 0]]
    assert labels.instance_ids(mesh, hits).tolist() == [[1, 0]]
    # The camera looks along +z, from below: it sees the side that faces -z.
    np.testing.assert_array_equal(labels.normals(mesh, hits, view), [[[0, 0, -1], [0, 0, 0]]])


@pytest.mark.parametrize(("columns", "rows"), [(1, 1), (3, 2), (4, 4), (5, 9), (81, 62)])
def test_every_pixel_has_its_own_ray_whatever_the_size(kernel_scene, mesh, columns, rows):
    # The pinhole camera's ray from pixel to hit: the hit lies on the plane of the face that is told.
    view = camera(columns=columns, rows=rows)
    hits = labels.first_hits(kernel_scene, camera_rays(view))
    assert hits.face.shape == hits.distance.shape == (rows, columns)
    np.testing.assert_array_equal(hits.face < 0, np.isinf(hits.distance))
    seen = hits.face >= 0
    direction = (view.pixel_directions() @ view.pose[:3, :3].T)[seen]
    point = view.pose[:3, 3] + hits.distance[seen][:, None] * direction
    corner = mesh.vertices[mesh.faces[hits.face[seen]]].astype(float)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(((point - corner[:, 0]) * normal).sum(1)).max(initial=0.0) < 1e-5
    low, high = corner.min(axis=1), corner.max(axis=1)
    assert ((point > low - 1e-5) & (point < high + 1e-5)).all()

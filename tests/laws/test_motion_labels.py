"""Ground truth of a camera that moves while its rows are read out, against an independent ray caster."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera, card, sheet
from test_ground_truth import cast_rays, distorted_view_of_plants

from pepperscene.camera import Camera, Motion, Partners, arc_path
from pepperscene.classes import OrganClass
from pepperscene.geometry import concatenate_meshes, rectangle
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

LINE_TIME_S = 5e-5  # 30 ms for 600 rows
MOTION = Motion((0.5, -0.3, 0.2), (0.4, 0.6, -0.5))
LABELS = ("class", "instance", "distance", "depth_z", "normal", "position", "uv", "coverage")


def rolling(camera: Camera, motion: Motion = MOTION, *, labels_per_row: bool = True) -> Camera:
    sensor = replace(camera.sensor, line_time_s=LINE_TIME_S)
    return replace(camera, sensor=sensor, motion=motion, exposure_s=1e-3, labels_per_row=labels_per_row)


@pytest.fixture(scope="module")
def plants():
    """A renderer of three plants, a camera with a rolling shutter that moves, and its labels."""
    mesh, camera = distorted_view_of_plants()
    view = rolling(camera)
    renderer = Renderer(assemble_scene(mesh))
    return renderer, view, renderer.render(view, LABELS)


def row_poses(view: Camera) -> np.ndarray:
    middle = (np.arange(view.height) + 0.5 - view.height / 2) * LINE_TIME_S
    return view.motion.pose_at(view.pose, middle)


def test_each_row_shows_what_a_ray_caster_finds_from_its_own_pose(plants):
    renderer, view, frame = plants
    mesh, poses = renderer.scene.mesh, row_poses(view)
    rng = np.random.default_rng(8)
    hit_rows, hit_columns = np.nonzero(np.isfinite(frame["distance"]))
    chosen = rng.choice(hit_rows.size, 30, replace=False)
    rows, columns = hit_rows[chosen], hit_columns[chosen]
    directions = np.einsum("nij,nj->ni", poses[rows, :3, :3], view.pixel_directions()[rows, columns])
    nearest, faces = cast_rays(mesh, poses[rows, :3, 3], directions)
    for row, column, direction, distance, face in zip(rows, columns, directions, nearest, faces, strict=True):
        pose = poses[row]
        assert frame["distance"][row, column] == pytest.approx(distance, rel=1e-5)
        assert frame["instance"][row, column] == mesh.face_instance[face] + 1
        assert frame["class"][row, column] == mesh.face_class[face]
        point = pose[:3, 3] + distance * direction
        np.testing.assert_allclose(frame["position"][row, column], point, atol=1e-5)
        assert frame["depth_z"][row, column] == pytest.approx(
            float(pose[:3, 2] @ (point - pose[:3, 3])), rel=1e-4
        )
        assert frame["normal"][row, column] @ direction <= 1e-6
        # The surface coordinates are those of that point in the triangle.
        corners, uv = mesh.vertices[mesh.faces[face]].astype(float), mesh.uv[mesh.faces[face]]
        weights = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), np.append(point, 1.0), rcond=None)[0]
        extent = np.ptp(uv, axis=0).max() + 1e-3
        assert np.abs(weights @ uv - frame["uv"][row, column]).max() < 0.02 * extent + 1e-4


def test_rows_are_those_of_still_cameras_at_their_poses(plants):
    # Whole images from the poses of some rows, of which one row is compared.
    renderer, view, frame = plants
    poses = row_poses(view)
    for row in (0, 299, 599):
        still = replace(view, pose=poses[row], motion=None)
        other = renderer.render(still, LABELS)
        for name in ("class", "instance"):
            assert (frame[name][row] == other[name][row]).mean() > 0.995
        for name in ("distance", "depth_z", "position", "uv", "normal"):
            same = frame["instance"][row] == other["instance"][row]
            near = np.isclose(frame[name][row], other[name][row], rtol=1e-4, atol=1e-3)
            assert near[same].mean() > 0.99
        difference = np.abs(frame["coverage"][row].astype(float) - other["coverage"][row].astype(float))
        assert difference.mean() < 1e-3
    # The readout matters: the image of one pose differs.
    at_once = renderer.render(replace(view, labels_per_row=False), ["instance"])["instance"]
    assert (at_once != frame["instance"]).mean() > 0.05


def test_positions_project_to_the_centres_of_their_pixels(plants):
    _, view, frame = plants
    points = frame["position"].reshape(-1, 3).astype(float)
    seen = np.isfinite(points).all(axis=1)
    v, u = np.mgrid[: view.height, : view.width] + 0.5
    found = view.project(points[seen])
    error = np.linalg.norm(found - np.stack([u.ravel(), v.ravel()], axis=1)[seen], axis=1)
    assert error.max() < 0.02
    # Coverage and classes agree where a pixel shows one class only.
    covered = frame["coverage"].max(axis=-1) == 1
    assert (frame["coverage"].argmax(axis=-1) == frame["class"])[covered].all()
    assert len(OrganClass) == frame["coverage"].shape[-1]


def test_normals_face_the_pose_of_their_own_row():
    # Row v sees the plane y = 0 at the depth y_c f / (h/2 - v) from y_c = -s (v - h/2) below it: at f s, in
    # the upper rows from below (y points down), in the lower rows from above.
    view = axis_camera(48, 64, flash=False)
    speed = 0.5 / (view.intrinsics[1, 1] * 1e-4)
    sensor = replace(view.sensor, line_time_s=1e-4)
    view = replace(view, sensor=sensor, motion=Motion((0.0, -speed, 0.0)))
    plane = rectangle((0.0, 0.0, 0.5), (1.0, 0.0, 0.0), (0.0, 0.0, 0.9))
    frame = Renderer(assemble_scene(plane)).render(view, ["depth_z", "normal"])
    np.testing.assert_allclose(frame["depth_z"], 0.5, rtol=1e-3)
    expected = np.zeros((64, 48, 3))
    expected[:32, :, 1], expected[32:, :, 1] = 1.0, -1.0
    np.testing.assert_allclose(frame["normal"], expected, atol=1e-6)


@pytest.mark.parametrize("name", ["flow", "stereo"])
def test_points_are_hidden_from_the_pose_of_their_row_in_the_other_image(name):
    # A strip at half the distance hides a band of the wall, which moves as the other camera does.
    still = axis_camera(96, 96, flash=False)
    other = replace(still, sensor=replace(still.sensor, line_time_s=1e-4), motion=Motion((8.0, 0.0, 0.0)))
    mesh = concatenate_meshes([sheet(4.0, 4.0, 1.0, "wall"), card(0.0, 0.0, 0.02, 4.0, "strip", 0.5)])
    frame = Renderer(assemble_scene(mesh)).render(
        still, [name, "position"], partners=Partners(**{name: other})
    )
    wall = frame["position"][..., 2] > 0.9
    points, flow = frame["position"][wall].astype(float), frame[name][wall]
    pixels = other.project(points)
    # The line of sight from (c, 0, 0) meets the plane of the strip in the middle.
    distance = np.abs(0.5 * (8.0 * 1e-4 * (pixels[:, 1] - 48) + points[:, 0])) - 0.01
    inside = ((pixels >= 0) & (pixels < 96)).all(axis=1)
    clear = np.abs(distance) > 1e-4
    np.testing.assert_array_equal(flow[clear, 2] == 1, (inside & (distance > 0))[clear])
    at_once = np.abs(0.5 * points[:, 0]) > 0.01
    assert ((distance > 0) != at_once)[inside].mean() > 0.1


def test_one_pose_or_a_global_shutter_gives_the_labels_of_a_still_camera(plants):
    renderer, view, _ = plants
    still = renderer.render(replace(view, motion=None), LABELS)
    for other in (
        replace(view, labels_per_row=False),
        replace(view, sensor=replace(view.sensor, line_time_s=0.0)),
    ):
        frame = renderer.render(other, LABELS)
        for name in LABELS:
            np.testing.assert_array_equal(frame[name], still[name])


@pytest.mark.parametrize(("name", "rows"), [("flow", "first"), ("flow", "second"), ("stereo", "both")])
def test_positions_projected_to_the_next_camera_match_the_flow(plants, name, rows):
    renderer, view, _ = plants
    poses = arc_path(16, 0.4, (-0.3, 0.3), (0.2, 0.5), np.radians(20.0))
    first, second = view.at_pose(poses[7]), replace(view.at_pose(poses[8]), motion=Motion((-0.4, 0.2, 0.0)))
    if rows == "second":
        first = replace(first, motion=None)
    if rows == "first":
        second = replace(second, motion=None)
    frame = renderer.render(first, [name, "position"], partners=Partners(**{name: second}))
    points, flow = frame["position"].reshape(-1, 3).astype(float), frame[name].reshape(-1, 3)
    seen = np.isfinite(points).all(axis=1) & (flow[:, 2] == 1)
    assert seen.sum() > 10_000
    v, u = np.mgrid[: view.height, : view.width] + 0.5
    target = second.project(points[seen])
    expected = target - np.stack([u.ravel(), v.ravel()], axis=1)[seen]
    assert np.linalg.norm(expected - flow[seen, :2], axis=1).mean() < 0.01
    # Where it leads, the other image shows that point: the depth there is its distance.
    shown = renderer.render(second, ["position"])["position"]
    column, row = np.floor(target).astype(int).T
    distance = np.linalg.norm(shown[row, column] - points[seen], axis=1)
    pixel = 0.5 / second.intrinsics[0, 0]  # metres of a pixel at half a metre
    assert (distance < 5 * pixel).mean() > 0.97


def test_the_sky_is_so_far_away_that_a_translation_does_not_move_it(plants):
    renderer, view, _ = plants
    turned = replace(view, motion=Motion((3.0, 0.0, 0.0)))
    frame = renderer.render(replace(view, motion=None), ["flow", "class"], partners=Partners(flow=turned))
    sky = frame["class"] == 0
    assert np.abs(frame["flow"][sky][:, :2]).max() < 1e-3

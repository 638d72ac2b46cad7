"""Random views: limits, free space and visibility, against trimesh, brute force and rendered images."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.stats import kstest

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera, Distortion, load_lens, load_sensor
from pepperscene.classes import Appearance, Instance, OrganClass
from pepperscene.errors import InputError
from pepperscene.geometry import Mesh
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.views import random_views
from pepperscene.recipe.views.free_space import FreeSpace, closed_parts, winding_number
from pepperscene.recipe.views.random_views import ViewSearch, aimed_rotations, directions, image_rays
from pepperscene.recipe.views.targets import RIPE_FROM, target_instances
from pepperscene.recipe.views_tables import RandomViews
from pepperscene.render import Renderer
from pepperscene.scene import Scene, assemble_scene

SETTINGS = RandomViews(
    kind="random",
    target="fruit",
    distance_m=(0.15, 0.45),
    elevation_rad=(-1.0, 1.2),
    azimuth_rad=(-2.0, 3.0),
    volume_m=((-0.5, 0.6), (-0.4, 0.5), (0.8, 2.0)),
    roll_rad=(-0.3, 0.5),
    offset=(0.1, 0.6),
    clearance_m=0.012,
    least_visibility=0.0,
)
NEAR = RandomViews(
    kind="random",
    target="fruit",
    distance_m=(0.3, 0.5),
    elevation_rad=(-np.pi / 4, np.pi / 4),
    azimuth_rad=(-np.pi / 4, np.pi / 4),
    volume_m=None,
    roll_rad=(0.0, 0.0),
    offset=(0.0, 0.0),
    clearance_m=0.02,
    least_visibility=0.5,
)


def anything(camera, points, normals=None, alone=None):
    """All points are visible."""
    return np.ones(len(points), dtype=bool)


def nothing(camera, points, normals=None, alone=None):
    """No point is visible."""
    return np.zeros(len(points), dtype=bool)


def soup(triangles):
    """Triangles `(n, 3, 3)` as a mesh of one instance."""
    count = len(triangles)
    return Mesh(
        vertices=np.reshape(triangles, (-1, 3)).astype(np.float32),
        normals=np.tile(np.float32([0, 0, 1]), (3 * count, 1)),
        uv=np.zeros((3 * count, 2), np.float32),
        state=np.zeros(3 * count, np.float32),
        faces=np.arange(3 * count, dtype=np.uint32).reshape(-1, 3),
        face_instance=np.zeros(count, np.uint32),
        face_surface=np.zeros(count, np.uint8),
        face_appearance=np.zeros(count, np.uint32),
        surfaces=("leaf",),
        instances=(Instance(OrganClass.PEPPER, "ball", plant=0),),
        appearances=(Appearance(),),
    )


def ball(radius=0.03, centre=(0.0, 0.0, 1.0)):
    body = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return soup(body.triangles + np.array(centre))


@pytest.fixture(scope="module")
def frames():
    recipe = load_recipe("barth2018", {"row.plants_front": 2, "row.plants_back": 1})
    return FrameRenderer(recipe, culled=False)


@pytest.fixture(scope="module")
def scene(frames):
    return frames.scene(frames.recipe.plan.frame(0), traced=False)


@pytest.fixture(scope="module")
def space(scene):
    return FreeSpace(scene.mesh)


@pytest.fixture(scope="module")
def camera():
    """The paper's camera with a distorted image, without its flash."""
    lens = replace(load_lens("lensagon_cmfa0420nd"), distortion=Distortion(k1=-0.1, k2=0.02))
    return Camera(lens, load_sensor("ueye_ui5250re"))


@pytest.fixture(scope="module", params=[300, pytest.param(1000, marks=pytest.mark.long)])
def views(request, scene, space, camera):
    rng = np.random.default_rng(5)
    return [ViewSearch(SETTINGS, scene, camera, space).find(rng, anything) for _ in range(request.param)]


@pytest.fixture(scope="module")
def lenses(views):
    return np.array([view.pose[:3, 3] for view in views])


def organ(mesh, instance):
    return trimesh.Trimesh(mesh.vertices, mesh.faces[mesh.face_runs.rows(instance)])


def organ_boxes(mesh):
    """`(i, 2, 3)` lowest and highest coordinates of each instance."""
    corners = (mesh.vertices[mesh.faces[mesh.face_runs.rows(index)]] for index in range(len(mesh.instances)))
    return np.array([[part.min(axis=(0, 1)), part.max(axis=(0, 1))] for part in corners])


def is_inside_organ(mesh, boxes, point):
    """Whether a ray from a point leaves a watertight organ an odd number of times."""
    near = np.flatnonzero(((boxes[:, 0] <= point) & (point <= boxes[:, 1])).all(axis=1))
    bodies = [organ(mesh, instance) for instance in near]
    return any(body.is_watertight and body.contains([point])[0] for body in bodies)


def brute_force_distance(mesh, point):
    triangles = mesh.vertices[mesh.faces].astype(float)
    # Only triangles whose box is not farther than some corner of the mesh.
    limit = np.linalg.norm(mesh.vertices - point, axis=1).min()
    beyond = np.maximum(triangles.min(axis=1) - point, point - triangles.max(axis=1)).max(axis=1)
    near = triangles[beyond <= limit]
    closest = trimesh.triangles.closest_point(near, np.tile(point, (len(near), 1)))
    return np.linalg.norm(closest - point, axis=1).min()


# Free space


@pytest.mark.parametrize("middle", [(0.0, 0.0, 0.0), (25.0, -30.0, 4.0)])
def test_distances_to_triangles_of_all_sizes_are_those_of_trimesh(middle):
    rng = np.random.default_rng(1)
    sizes = np.repeat([1e-3, 5e-3, 0.02, 0.1, 1.0, 60.0], [3000, 5000, 4000, 2500, 20, 2])
    triangles = rng.uniform(-0.5, 0.5, (len(sizes), 1, 3)) + sizes[:, None, None] * rng.normal(
        size=(len(sizes), 3, 3)
    )
    # Some triangles are lines or points.
    triangles[::50, 2] = triangles[::50, 1]
    triangles[::70] = triangles[::70, :1]
    triangles += middle
    space, mesh = FreeSpace(soup(triangles)), soup(triangles)
    points = np.array(middle) + rng.uniform(-1.5, 1.5, (20, 3))
    # Next to the centroids of small triangles, single precision would not be enough.
    points[:10] = triangles[100:110].mean(axis=1) + 1e-5 * rng.normal(size=(10, 3))
    exact = np.array([brute_force_distance(mesh, point) for point in points])
    np.testing.assert_allclose(space.clearance(points), exact, rtol=1e-9, atol=1e-12)
    for limit in (0.0, 1e-3, 0.03, 0.3, 2.0):
        np.testing.assert_array_equal(space.is_free(points, limit), exact > limit)
    # The last digit decides.
    for point, distance in zip(points[:8], space.clearance(points[:8]), strict=True):
        assert not space.is_free(point, distance * (1 + 1e-9))[0]
        assert space.is_free(point, distance * (1 - 1e-9))[0]


def test_points_inside_organs_are_those_of_trimesh(scene, space):
    mesh, rng = scene.mesh, np.random.default_rng(3)
    kinds = ("fruit", "peduncle", "internode", "node", "petiole", "cut", "lamina")
    for kind in kinds:
        instance = next(index for index, item in enumerate(mesh.instances) if item.kind == kind)
        body = organ(mesh, instance)
        # Anywhere in its box, and near its surface: a thin curved tube fills little of its box.
        steps = 1e-3 * rng.normal(size=(40, 3))
        points = np.concatenate([rng.uniform(*body.bounds, (40, 3)), rng.choice(body.vertices, 40) + steps])
        expected = body.contains(points) if body.is_watertight else np.zeros(80, dtype=bool)
        found = np.array([space._parts(instance).contain(point) for point in points])
        np.testing.assert_array_equal(found, expected, err_msg=kind)
        assert expected.any() == (kind != "lamina")
        assert space.inside(points[expected]).all()
        assert space.is_closed(instance) == (kind != "lamina")


def test_only_surfaces_without_a_border_have_an_inside():
    body = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    assert winding_number(np.zeros(3), body.triangles) == pytest.approx(1.0, abs=1e-12)
    assert winding_number(np.zeros(3), body.triangles[:, ::-1]) == pytest.approx(-1.0, abs=1e-12)
    assert winding_number(np.array([1.5, 0.0, 0.0]), body.triangles) == pytest.approx(0.0, abs=1e-12)
    # One of two bodies has a hole.
    together = np.concatenate([body.triangles[1:], body.triangles + 3.0])
    parts = closed_parts(together)
    assert not parts.contain(np.zeros(3))
    assert parts.contain(np.full(3, 3.0))
    assert not FreeSpace(soup(body.triangles[1:])).inside([0.0, 0.0, 0.0])[0]


# Limits


def test_all_lenses_are_in_free_space(scene, space, lenses):
    boxes = organ_boxes(scene.mesh)
    assert not any(is_inside_organ(scene.mesh, boxes, lens) for lens in lenses)
    # The second opinion itself recognises a point inside.
    fruit = scene.skeleton.of_form("fruit")[0]
    assert is_inside_organ(scene.mesh, boxes, organ(scene.mesh, fruit).center_mass)
    assert space.clearance(lenses).min() > SETTINGS.clearance_m
    exact = [brute_force_distance(scene.mesh, lens) for lens in lenses[:6]]
    np.testing.assert_allclose(space.clearance(lenses[:6]), exact, rtol=1e-9)


def test_all_limits_of_the_pose_are_kept(scene, camera, views, lenses):
    target = np.array([view.target_point for view in views])
    away = lenses - target
    distance = np.linalg.norm(away, axis=1)
    measured = {
        "distance_m": distance,
        "elevation_rad": np.arcsin(away[:, 2] / distance),
        "azimuth_rad": np.arctan2(away[:, 0], -away[:, 1]),
        # The vertical, as the image shows it, leans to the left of a camera that is rolled clockwise.
        "roll_rad": np.array([np.arctan2(-view.pose[2, 0], -view.pose[2, 1]) for view in views]),
    }
    place = np.array([camera.at_pose(view.pose).project(view.target_point)[0] for view in views])
    half = np.array([camera.width, camera.height]) / 2
    measured["offset"] = np.linalg.norm((place - half) / half, axis=1)
    for name, values in measured.items():
        low, high = getattr(SETTINGS, name)
        assert low - 1e-6 <= values.min(), name
        assert values.max() <= high + 1e-6, name
        # The whole range is used.
        assert values.min() < low + 0.2 * (high - low), name
        assert values.max() > high - 0.2 * (high - low), name
    low, high = np.array(SETTINGS.volume_m).T
    assert (low <= lenses).all()
    assert (lenses <= high).all()
    fruit = scene.skeleton.of_form("fruit")
    assert {view.target_instance for view in views} <= set(fruit)
    assert len({view.target_instance for view in views}) > (20 if len(views) == 1000 else 15)
    for view in views:
        np.testing.assert_allclose(view.pose[:3, :3] @ view.pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view.pose[:3, :3]) > 0
    for view in views[:5]:
        centroid = organ(scene.mesh, view.target_instance).centroid
        np.testing.assert_allclose(view.target_point, centroid, atol=1e-6)


def test_views_in_empty_space_are_uniform(camera):
    settings = replace(
        NEAR, target=(0.0, 0.0, 3.0), distance_m=(0.5, 2.0), elevation_rad=(-1.2, 0.9),
        azimuth_rad=(-3.0, 2.0), roll_rad=(-0.2, 0.3), offset=(0.0, 0.5),
    )  # fmt: skip
    scene, rng = assemble_scene(ball(centre=(50.0, 0.0, 1.0))), np.random.default_rng(0)
    space = FreeSpace(scene.mesh)
    views = [ViewSearch(settings, scene, camera, space).find(rng, anything) for _ in range(300)]
    away = np.array([view.pose[:3, 3] for view in views]) - settings.target
    distance = np.linalg.norm(away, axis=1)
    place = np.array([camera.at_pose(view.pose).project(view.target_point)[0] for view in views])
    half = np.array([camera.width, camera.height]) / 2
    squared = (((place - half) / half) ** 2).sum(axis=1)
    # Some steep views are not possible with the target beside the image's centre: 0.1 of the solid angle.
    for values, low, high in (
        (distance, 0.5, 2.0),
        (np.arctan2(away[:, 0], -away[:, 1]), -3.0, 2.0),
        (squared, 0.0, 0.25),
    ):
        assert kstest(values, "uniform", (low, high - low)).pvalue > 1e-3
    gentle = away[:, 2][np.abs(away[:, 2]) < 0.7 * distance] / distance[np.abs(away[:, 2]) < 0.7 * distance]
    assert kstest(gentle, "uniform", (-0.7, 1.4)).pvalue > 1e-3
    assert all(view.target_instance is None and view.visibility == 1.0 for view in views)


@pytest.mark.parametrize("elevation", [-90.0, -60.0, 30.0, 89.99])
def test_aimed_cameras_see_the_target_at_its_place(camera, elevation):
    rng = np.random.default_rng(0)
    elevation = np.full(200, np.radians(elevation))
    azimuth, roll = rng.uniform(-3.1, 3.1, (2, 200))
    for places in (np.zeros((200, 2)), rng.uniform(-0.2, 0.2, (200, 2))):
        rays = image_rays(camera, places)
        rotations, possible = aimed_rotations(elevation, azimuth, rays, roll)
        np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), [np.eye(3)] * 200, atol=1e-12)
        assert possible.all() or np.abs(elevation[0]) > 1.0
        assert possible.all() or places.any()
        seen = np.einsum("nij,nj->ni", rotations, rays)[possible]
        np.testing.assert_allclose(seen, -directions(elevation, azimuth)[possible], atol=2e-8)


# The flash, targets, determinism


def test_the_flash_is_in_free_space(scene, space, frames):
    camera = frames.resolved.camera
    settings = replace(SETTINGS, clearance_m=0.0, volume_m=None)
    rng = np.random.default_rng(0)
    views = [ViewSearch(settings, scene, camera, space).find(rng, anything) for _ in range(20)]
    flash = camera.flash
    emitters = np.column_stack([flash.emitters_m, np.zeros(len(flash.emitters_m))]) + flash.offset_m
    for view in views:
        placed = emitters @ view.pose[:3, :3].T + view.pose[:3, 3]
        assert space.is_free(placed, flash.radius_m).all()
        assert not space.inside(placed).any()
        assert space.clearance(view.pose[:3, 3])[0] > camera.aperture_radius_m


def test_targets_are_organs_of_that_name(scene):
    skeleton, instances = scene.skeleton, scene.mesh.instances
    for name in ("petiole", "leaf", "wire"):
        for index in target_instances(scene, name, "test").tolist():
            assert name in (instances[index].kind, instances[index].organ_class.name.lower())
    fruit, ripe, unripe = (
        sorted(target_instances(scene, name, "test")) for name in ("fruit", "ripe fruit", "unripe fruit")
    )
    assert sorted(ripe + unripe) == fruit == list(skeleton.of_form("fruit"))
    assert ripe == [one for one in fruit if skeleton.organ(one).measures["ripeness"] >= RIPE_FROM]


def test_targets_are_the_same_without_the_skeleton(scene):
    bare = Scene(scene.mesh)
    for name in ("fruit", "ripe fruit", "petiole"):
        with_skeleton = set(target_instances(scene, name, "test"))
        # The mean over vertices differs a little from the drawn mean.
        assert len(with_skeleton ^ set(target_instances(bare, name, "test"))) <= 0.1 * len(with_skeleton)


def test_views_depend_on_the_generator_alone(scene, space, camera, monkeypatch):
    def draw(space=None):
        view = ViewSearch(SETTINGS, scene, camera, space).find(np.random.default_rng(7), anything)
        return view.pose.tobytes(), view.target_instance, view.attempts

    first = draw(space)
    assert draw() == first
    assert draw(space) == first
    monkeypatch.setattr(random_views, "_BLOCKS", (3, 5))
    assert draw(space) == first


# Impossible requests


def refusal(settings, scene, camera, visible=anything, attempts=2000):
    rng = np.random.default_rng(0)
    with pytest.raises(InputError) as caught:
        ViewSearch(settings, scene, camera, where="mine.toml").find(rng, visible, attempts=attempts)
    message = str(caught.value)
    assert message.startswith("mine.toml: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"volume_m": ((5.0, 6.0), (0.0, 1.0), (0.0, 1.0))}, "were outside volume_mm"),
        ({"clearance_m": 2.5}, "were nearer than clearance_mm = 2500 to a surface"),
        (
            {"distance_m": (0.0302, 0.0304), "clearance_m": 0.0},
            "were nearer than the radius of the lens' pupil, 1 mm, to a surface",
        ),
        ({"distance_m": (0.001, 0.002), "clearance_m": 0.0}, "were inside an organ"),
        ({"target": (0.0, 0.0, -2.0)}, "were below the floor"),
        ({"least_visibility": 0.3}, "showed less than least_visibility = 0.3 of the target"),
        (
            {"elevation_rad": (np.pi / 2, np.pi / 2), "offset": (0.9, 0.9)},
            "could not have the target at that place in the image with that roll",
        ),
    ],
)
def test_a_view_that_is_not_possible_names_the_limit(camera, changes, reason):
    settings = replace(NEAR, clearance_m=0.01)
    message = refusal(replace(settings, **changes), assemble_scene(ball()), camera, nothing, attempts=1050)
    counts = [int(count.replace(",", "")) for count in re.findall(r"([\d,]+) (?:were|showed|could)", message)]
    assert message.startswith("mine.toml: no view found in 1,050 attempts: ")
    assert sum(counts) == 1050
    assert counts == sorted(counts, reverse=True)
    assert f"{counts[0]:,} {reason}" in message


def test_an_unknown_target_names_the_known_ones(scene, camera):
    message = refusal(replace(SETTINGS, target="banana"), scene, camera)
    assert "views.target = 'banana'" in message
    absent = refusal(replace(NEAR, target="ripe fruit"), assemble_scene(ball()), camera)
    assert "views.target = 'ripe fruit': must be an organ that the plants of the scene have" in absent
    for name in ("ripe fruit", "petiole", "leaf"):
        assert name in message


# Visibility


@pytest.fixture(scope="module")
def small_camera():
    sensor = load_sensor("ueye_ui5250re")
    return Camera(
        load_lens("lensagon_cmfa0420nd"), replace(sensor, columns=200, rows=150, binning=4 * sensor.binning)
    )


@pytest.mark.parametrize("target", ["fruit", pytest.param("lamina", marks=pytest.mark.long)])
def test_visibility_is_the_share_of_the_pixels_that_the_organ_has_alone(scene, space, small_camera, target):
    settings = replace(
        NEAR,
        target=target,
        distance_m=(0.2, 0.3),
        elevation_rad=(-0.5, 0.5),
        azimuth_rad=(-1.0, 1.0),
        least_visibility=0.0,
    )
    renderer, rng, alone = Renderer(scene), np.random.default_rng(11), {}
    predicted, counted = [], []
    for _ in range(30):
        view = ViewSearch(settings, scene, small_camera, space).find(rng, renderer.visible_points)
        index, posed = view.target_instance, small_camera.at_pose(view.pose)
        if index not in alone:
            alone[index] = Renderer(assemble_scene(scene.mesh.select_instances([index])))
        mask = alone[index].render(posed, ["instance"])["instance"] > 0
        if mask[[0, -1]].any() or mask[:, [0, -1]].any():
            continue
        image = renderer.render(posed, ["instance"])["instance"]
        predicted.append(view.visibility)
        counted.append((image == index + 1).sum() / mask.sum())
    difference = np.array(predicted) - counted
    assert len(difference) >= 10
    assert np.ptp(counted) > 0.5
    # 256 points have a standard error of at most 0.03, and outlines of few pixels another 0.01.
    assert np.abs(difference).max() < 0.1
    assert np.abs(difference.mean()) < 0.02

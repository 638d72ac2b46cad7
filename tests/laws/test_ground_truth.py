"""Ground truth agrees with the pinhole formula and with an independent ray caster."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera, sheet, sphere
from greenhouse import row_of_plants
from trimesh.ray.ray_triangle import RayMeshIntersector

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Distortion, arc_path
from pepperscene.classes import OrganClass
from pepperscene.geometry import concatenate_meshes
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

LABELS = ("class", "instance", "distance", "depth_z", "normal")


def test_sphere_is_where_the_pinhole_formula_puts_it():
    # A sphere of 40 mm at (60, -30, 500) mm in camera axes in front of a far wall.
    centre, radius = np.array([0.06, -0.03, 0.5]), 0.04
    camera = axis_camera(flash=False)
    scene = assemble_scene(
        concatenate_meshes([sphere(tuple(centre), radius, "ball", 6), sheet(9, 9, 3.0, "wall")])
    )
    frame = Renderer(scene).render(camera, LABELS)
    focal = 4.16e-3 / 9e-6
    mask = frame["class"] == OrganClass.PEPPER
    # The sphere covers pixels in the cone of half angle asin(r / d), whose ray x has
    # (x . c)^2 > (d^2 - r^2) |x|^2.
    v, u = np.mgrid[0:600, 0:800] + 0.5
    rays = np.stack([(u - 400) / focal, (v - 300) / focal, np.ones_like(u)], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = rays @ centre
    discriminant = along**2 - (centre @ centre - radius**2)
    assert (mask != (discriminant > 0)).mean() < 2e-5  # the tessellated ball is slightly smaller
    # Small-angle approximation: a radius of f r / z pixels around f x / z, f y / z.
    assert u[mask].mean() == pytest.approx(400 + focal * 0.06 / 0.5, abs=0.6)
    assert v[mask].mean() == pytest.approx(300 - focal * 0.03 / 0.5, abs=0.6)
    assert np.sqrt(mask.sum() / np.pi) == pytest.approx(focal * 0.04 / 0.5, rel=0.015)
    # Distance along the ray from the quadratic equation, to 0.2 mm; z along the axis; the normal.
    inside = mask & (discriminant > 1e-4)
    distance = along - np.sqrt(np.maximum(discriminant, 0.0))
    assert np.abs(frame["distance"] - distance)[inside].max() < 2e-4
    assert np.abs(frame["depth_z"] - distance * rays[..., 2])[inside].max() < 2e-4
    outward = (rays * distance[..., None] - centre) / radius
    assert np.degrees(np.arccos(np.clip((outward * frame["normal"]).sum(-1)[inside], -1, 1))).max() < 3.0
    assert frame["distance"][0, 0] == pytest.approx(3.0 / rays[0, 0, 2], rel=1e-5)
    assert np.unique(frame["instance"][mask]).tolist() == [1]


def test_background_is_infinitely_far_and_has_no_labels():
    scene = assemble_scene(sphere((0, 0, -1.0), 0.1, "ball", 2))
    frame = Renderer(scene).render(axis_camera(columns=16, rows=12, flash=False), LABELS)
    assert np.isinf(frame["distance"]).all()
    assert np.isinf(frame["depth_z"]).all()
    assert not frame["class"].any()
    assert not frame["instance"].any()
    assert not frame["normal"].any()


def distorted_view_of_plants():
    """Three plants of twelve stem parts with twine, seen at 40 cm through a distorting lens."""
    camera = axis_camera(flash=False)
    lens = replace(camera.lens, distortion=Distortion(k1=-0.1, k2=0.04, p1=1e-3, p2=-1e-3))
    pose = arc_path(3, 0.4, (-0.3, 0.3), (0.2, 0.5), np.radians(20.0))[1]
    return row_of_plants(12, range(3), 0.5), replace(camera, lens=lens, pose=pose)


def cast_rays(mesh, origin, directions):
    """Distances and faces `(n,)` of the first hits by trimesh (R-tree and triangle tests, no Embree).

    All rays start at one point, or each at its own.
    """
    origin = np.broadcast_to(origin, directions.shape)
    caster = RayMeshIntersector(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))
    nearest, face = np.full(len(directions), np.inf), np.full(len(directions), -1)
    for first in range(0, len(directions), 10):  # in small batches: each ray has many candidate triangles
        batch = directions[first : first + 10]
        points, ray, hit = caster.intersects_location(origin[first : first + 10], batch)
        distance = np.linalg.norm(points - origin[first + ray], axis=1)
        for k in np.argsort(-distance, kind="stable"):
            nearest[first + ray[k]], face[first + ray[k]] = distance[k], hit[k]
    return nearest, face


def test_labels_equal_the_hits_of_an_independent_ray_caster():
    # Random pixels through the lens formula: 95 % certain to find a fault in 1 % of them.
    assert_labels_equal_hits(*distorted_view_of_plants(), pixels=300, seed=5)


def assert_labels_equal_hits(mesh, camera, pixels, seed):
    frame = Renderer(assemble_scene(mesh)).render(camera, LABELS)
    rng = np.random.default_rng(seed)
    row, column = rng.integers(0, 600, pixels), rng.integers(0, 800, pixels)
    directions = camera.pixel_directions()[row, column] @ camera.pose[:3, :3].T
    nearest, face = cast_rays(mesh, camera.pose[:3, 3], directions)
    is_hit = face >= 0
    assert is_hit.mean() > 0.3
    np.testing.assert_array_equal(frame["class"][row, column], np.where(is_hit, mesh.face_class[face], 0))
    np.testing.assert_array_equal(
        frame["instance"][row, column], np.where(is_hit, mesh.face_instance[face] + 1, 0)
    )
    np.testing.assert_allclose(frame["distance"][row, column], nearest, rtol=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("index", [110, 4940, 9225])
def test_labels_of_the_paper_plan_equal_the_hits_of_an_independent_ray_caster(index):
    # Complete scenes of 13 plants and two million triangles.
    recipe = load_recipe("barth2018")
    frames, spec = FrameRenderer(recipe), recipe.plan.frame(index)
    mesh, camera = frames.scene(spec, traced=False).mesh, frames.camera(spec)
    assert_labels_equal_hits(mesh, camera, pixels=200, seed=index)

"""The outputs `irradiance` and `absorbed`, against the tables of organs and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import RANGE_NM, axis_camera, body, sheet

import pepperscene as ps
from pepperscene.camera import Distortion
from pepperscene.classes import OrganClass
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface
from pepperscene.render import Renderer
from pepperscene.render.absorbed import LightTracer
from pepperscene.scene import Sky, Sun, assemble_scene
from pepperscene.spectra import Spectrum

SUN = Sun(np.array([0.6, 0.0, 0.8]), Spectrum(RANGE_NM, np.full(2, 1.0)))
SKY = Sky(np.ones((1, 2, 4), np.float32), Spectrum(RANGE_NM, np.full((1, 2), 0.3)), SUN)
MEASURED = {"irradiance": "received", "absorbed": "absorbed"}


def grey(name):
    return Surface(name, RANGE_NM, np.full((1, 2, 2), 0.4), np.full((1, 2), 0.35))


def views(centre, distance_m, count, columns, rows):
    """Cameras that look at a point from evenly spread directions."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, k * np.pi * (1.0 + np.sqrt(5.0))
    flat, found = np.sqrt(1.0 - z**2), []
    for forward in np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1):
        right = np.cross([0.0, 0.0, 1.0], -forward)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack(
            [right, np.cross(forward, right), forward, centre - distance_m * forward], axis=-1
        )
        plain = axis_camera(columns, rows, flash=None)
        found.append(replace(plain, lens=replace(plain.lens, distortion=Distortion()), pose=pose))
    return found


def pixels_per_area(renderer, camera, places, normals):
    """`(n,)` pixels of a view per m2 of the surface at places `(n, 3)`; 0 where it does not see them."""
    origin = camera.pose[:3, 3]
    ray = places - origin
    distance = np.linalg.norm(ray, axis=1)
    ray /= distance[:, None]
    first, _ = renderer.cast_rays(origin, ray)
    x, y, z = (ray @ camera.pose[:3, :3] @ camera.intrinsics.T).T
    is_inside = (z > 0) & (abs(x / z * 2 - camera.width) < camera.width)
    is_inside &= abs(y / z * 2 - camera.height) < camera.height
    per_steradian = camera.intrinsics[0, 0] * camera.intrinsics[1, 1] / z**3
    density = per_steradian * np.abs((ray * normals).sum(axis=1)) / distance**2
    return np.where(is_inside & (np.abs(first - distance) < 1e-5), density, 0.0)


def integrals_of_pixels(scene, cameras):
    """`(i,)` integral of each output over an instance, by name, and the area, over all that some view sees.

    Each pixel stands for the surface at its centre: its value over the number of pixels per area there, of
    all views that see this place.
    """
    renderer, mesh, shown = Renderer(scene), scene.mesh, []
    for seed, camera in enumerate(cameras):
        frame = renderer.render(camera, [*MEASURED, "instance", "position"], seed=seed)
        hit = frame["instance"] > 0
        for name in MEASURED:
            assert np.array_equal(np.isfinite(frame[name]), hit)
        place = frame["position"][hit].astype(float)
        _, face = renderer.cast_rays(camera.pose[:3, 3], place - camera.pose[:3, 3])
        normal = trimesh.triangles.normals(mesh.vertices[mesh.faces[face]].astype(float))[0]
        shown.append((frame["instance"][hit] - 1, place, normal, *(frame[name][hit] for name in MEASURED)))
    instance, places, normals, *values = (np.concatenate(part) for part in zip(*shown, strict=True))
    density = sum(pixels_per_area(renderer, camera, places, normals) for camera in cameras)
    weight = np.divide(1.0, density, out=np.zeros_like(density), where=density > 0.0)
    area, *sums = (np.bincount(instance, weight * part, len(mesh.instances)) for part in (1.0, *values))
    return dict(zip(MEASURED, sums, strict=True)), area


def check(scene, cameras, target_error):
    """Check pixels of leaves against the tables; and return their number."""
    sums, seen = integrals_of_pixels(scene, cameras)
    tracer = LightTracer(scene)
    classes = np.array([item.organ_class for item in scene.mesh.instances])[tracer.instances]
    for name, measured in MEASURED.items():
        light = tracer.trace(measured=measured, target_error=target_error)
        expected, error = light.amounts.watts[0], light.amounts.watts_error[0]
        # A leaf that others touch has places that no view sees.
        leaves = (classes == OrganClass.LEAF) & (seen[tracer.instances] > 0.98 * light.area_m2)
        found = sums[name][tracer.instances]
        difference = np.abs(found - expected)[leaves]
        assert (difference < np.maximum(0.01 * expected, 3.0 * error)[leaves]).all()
        assert np.median(difference / expected[leaves]) < 0.006
        assert np.median((error / expected)[leaves]) < 0.007
    return np.count_nonzero(leaves)


def test_pixels_of_leaves_are_those_of_the_tables():
    # Leaves that shade each other.
    rng, parts = np.random.default_rng(5), []
    corners = np.array([[-0.05, -0.05, 0], [0.05, -0.05, 0], [0.05, 0.05, 0], [-0.05, 0.05, 0]])
    for _ in range(6):
        leaf = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])
        leaf.apply_transform(trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
        parts.append(body(leaf.apply_translation(rng.uniform(-0.08, 0.08, 3)), "leaf"))
    scene = assemble_scene(concatenate_meshes(parts), {"leaf": grey("leaf")}, SKY)
    assert check(scene, views(np.zeros(3), 0.5, 24, 300, 300), 0.005) >= 4


@pytest.mark.long
def test_pixels_of_a_plant_are_those_of_the_tables():
    """Of leaves, of fruit, and of the rest, of whose surface a part is inside of other organs."""
    cultivar = ps.load_cultivar("kaite_february")
    plant = ps.mesh_plant(ps.grow(cultivar, np.random.default_rng(3)))
    surfaces = ps.organ_surfaces(cultivar, np.arange(380.0, 781.0, 5.0))
    scene = assemble_scene(plant, surfaces, SKY)
    sums, seen = integrals_of_pixels(scene, views(scene.mesh.vertices.mean(axis=0), 1.6, 24, 600, 600))
    light = LightTracer(scene).trace(target_error=0.01)
    classes = np.array([item.organ_class for item in scene.mesh.instances])[light.instances]
    leaves, fruit = classes == OrganClass.LEAF, classes == OrganClass.PEPPER
    for members, most in ((leaves, 0.01), (fruit, 0.02), (~leaves & ~fruit, 0.03)):
        assert members.sum() > 2
        table, pixels = (
            light.amounts.watts[0][members].sum(),
            sums["absorbed"][light.instances][members].sum(),
        )
        error = np.sqrt((light.amounts.watts_error[0][members] ** 2).sum())
        assert pixels == pytest.approx(table, abs=most * table + 3.0 * error)
    assert (seen[light.instances] < 0.9 * light.area_m2)[~leaves & ~fruit].any()


def test_sheet_in_the_open_is_the_closed_form():
    scene = assemble_scene(sheet(2.0, 2.0, 0.5, "leaf"), {"leaf": grey("leaf")}, SKY)
    frame = Renderer(scene).render(axis_camera(48, 36, flash=None), ["irradiance", "absorbed"])
    expected = 300.0 * (2.0 * np.pi * 0.3 + 0.8)
    assert frame["irradiance"].mean() == pytest.approx(expected, rel=0.003)
    assert frame["absorbed"] == pytest.approx(0.25 * frame["irradiance"], rel=1e-4)


def test_dark_scene_has_none():
    scene = assemble_scene(sheet(0.1, 0.1, 0.5, "leaf"), {"leaf": grey("leaf")})
    frame = Renderer(scene).render(axis_camera(48, 36), ["absorbed", "instance"])
    assert (frame["absorbed"][frame["instance"] > 0] == 0.0).all()
    assert np.isnan(frame["absorbed"][frame["instance"] == 0]).all()

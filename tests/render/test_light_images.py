"""The outputs `irradiance` and `absorbed`, against the tables of organs and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import RANGE_NM, axis_camera, body, sheet
from scipy.spatial import cKDTree

import pepperscene as ps
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
    flat = np.sqrt(1.0 - z**2)
    for forward in np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1):
        right = np.cross([0.0, 0.0, 1.0], -forward)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack(
            [right, np.cross(forward, right), forward, centre - distance_m * forward], axis=-1
        )
        yield replace(axis_camera(columns, rows, flash=None), pose=pose)


def means_of_pixels(scene, cameras, radius_m):
    """`(i,)` mean of each output over an instance's area, by name, and the part of the area that was seen.

    It is the mean over evenly spread points of the nearest pixels' values, because views see some places more
    often than others; places without a pixel within a radius are not seen.
    """
    renderer, mesh, places, values = Renderer(scene), scene.mesh, [], {name: [] for name in MEASURED}
    for seed, camera in enumerate(cameras):
        frame = renderer.render(camera, [*MEASURED, "instance", "position"], seed=seed)
        hit = frame["instance"] > 0
        # Instances are kept apart by a further coordinate.
        places.append(np.column_stack([frame["position"][hit], 10.0 * frame["instance"][hit]]))
        for name, parts in values.items():
            assert np.array_equal(np.isfinite(frame[name]), hit)
            parts.append(frame[name][hit])
    tree, pixels = cKDTree(np.concatenate(places)), {name: np.concatenate(values[name]) for name in values}
    means, seen = {name: [] for name in MEASURED}, []
    for k in range(len(mesh.instances)):
        faces = mesh.faces[mesh.face_instance == k]
        points = trimesh.sample.sample_surface(
            trimesh.Trimesh(mesh.vertices, faces, process=False), 4000, seed=k
        )[0]
        distance, nearest = tree.query(np.pad(points, ((0, 0), (0, 1)), constant_values=10.0 * (k + 1)), 4)
        near = distance[:, 0] < radius_m
        seen.append(near.mean())
        for name in MEASURED:
            means[name].append(pixels[name][nearest[near]].mean(dtype=float) if near.any() else np.nan)
    return {name: np.array(means[name]) for name in MEASURED}, np.array(seen)


def check(scene, cameras, radius_m, target_error):
    """Check pixels against the tables; the number of leaves that are seen well enough.

    Stems and calyces have parts inside of others, which no view sees.
    """
    means, seen = means_of_pixels(scene, cameras, radius_m)
    tracer = LightTracer(scene)
    is_leaf = [item.organ_class == OrganClass.LEAF for item in scene.mesh.instances]
    compared = (np.array(is_leaf) & (seen > 0.98))[tracer.instances]
    for name, measured in MEASURED.items():
        light = tracer.trace(measured=measured, target_error=target_error)
        expected, error = light.amounts.watts[0] / light.area_m2, light.amounts.watts_error[0] / light.area_m2
        difference = np.abs(means[name][tracer.instances] - expected)[compared]
        assert (difference < np.maximum(0.01 * expected, 3.0 * error)[compared]).all()
        assert np.median(difference / expected[compared]) < 0.006
        assert np.median((error / expected)[compared]) < 0.007
    return np.count_nonzero(compared)


def test_pixels_of_leaves_are_those_of_the_tables():
    # Leaves that shade each other.
    rng, parts = np.random.default_rng(5), []
    corners = np.array([[-0.05, -0.05, 0], [0.05, -0.05, 0], [0.05, 0.05, 0], [-0.05, 0.05, 0]])
    for _ in range(6):
        leaf = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])
        leaf.apply_transform(trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
        parts.append(body(leaf.apply_translation(rng.uniform(-0.08, 0.08, 3)), "leaf"))
    scene = assemble_scene(concatenate_meshes(parts), {"leaf": grey("leaf")}, SKY)
    assert check(scene, views(np.zeros(3), 0.4, 24, 100, 100), 0.003, 0.005) >= 4


@pytest.mark.long
def test_pixels_of_a_plant_are_those_of_the_tables():
    cultivar = ps.load_cultivar("kaite_february")
    plant = ps.mesh_plant(ps.grow(cultivar, np.random.default_rng(3)))
    surfaces = ps.organ_surfaces(cultivar, np.arange(380.0, 781.0, 5.0))
    scene = assemble_scene(plant, surfaces, SKY)
    centre = scene.mesh.vertices.mean(axis=0)
    assert check(scene, views(centre, 1.0, 24, 600, 600), 0.004, 0.005) > 10


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

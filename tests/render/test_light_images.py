"""The outputs `irradiance` and `absorbed`, against the tables of organs and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import RANGE_NM, axis_camera, body, sheet
from scipy.spatial import cKDTree

import pepperscene as ps
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


def means_of_pixels(scene, cameras):
    """`(i,)` mean of each output over an instance's area, by name, and the part of the area that was seen.

    Pixels are sorted by the triangle whose centroid is nearest, because some places are seen more often.
    """
    renderer, mesh = Renderer(scene), scene.mesh
    centroids, area = mesh.vertices[mesh.faces].mean(axis=1), trimesh_of(mesh).area_faces
    owner = mesh.face_instance.astype(int)
    tree = cKDTree(np.column_stack([centroids, 10.0 * owner]))
    count, sums = np.zeros(len(owner)), {name: np.zeros(len(owner)) for name in MEASURED}
    for seed, camera in enumerate(cameras):
        frame = renderer.render(camera, [*MEASURED, "instance", "position"], seed=seed)
        hit = frame["instance"] > 0
        assert np.array_equal(np.isfinite(frame["absorbed"]), hit)
        place = np.column_stack([frame["position"][hit], 10.0 * (frame["instance"][hit].astype(float) - 1.0)])
        _, face = tree.query(place)
        count += np.bincount(face, minlength=len(owner))
        for name, total in sums.items():
            total += np.bincount(face, frame[name][hit].astype(float), len(owner))
    seen = np.where(count > 0, area, 0.0)
    whole = np.bincount(owner, seen)
    means = {
        name: np.bincount(owner, seen * total / np.maximum(count, 1)) / whole for name, total in sums.items()
    }
    return means, whole / np.bincount(owner, area)


def trimesh_of(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def agrees(scene, cameras, target_error, least_seen):
    """Check pixels against the tables; the number of organs that were compared."""
    means, seen = means_of_pixels(scene, cameras)
    compared = np.flatnonzero(seen > least_seen)
    tracer = LightTracer(scene)
    for name, measured in MEASURED.items():
        light = tracer.trace(measured=measured, target_error=target_error)
        expected, error = (
            amount[0][compared] / light.area_m2[compared]
            for amount in (light.amounts.watts, light.amounts.watts_error)
        )
        difference = np.abs(means[name][compared] - expected)
        print(
            name,
            np.sort(difference / expected)[-5:],
            np.sort(error / expected)[-5:],
            len(compared),
            (means[name][compared] / expected).mean(),
        )
        assert (difference < np.maximum(0.01 * expected, 3.0 * error)).all()
    return len(compared)


def leaves():
    """Six square leaves that shade each other, of 512 triangles each."""
    rng, parts = np.random.default_rng(5), []
    square = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    for _ in range(4):
        square = square.subdivide()
    for _ in range(6):
        leaf = square.copy().apply_scale(0.05)
        leaf.apply_transform(trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
        parts.append(body(leaf.apply_translation(rng.uniform(-0.08, 0.08, 3)), "leaf"))
    return assemble_scene(concatenate_meshes(parts), {"leaf": grey("leaf")}, SKY)


def test_pixels_of_leaves_are_those_of_the_tables():
    assert agrees(leaves(), views(np.zeros(3), 0.4, 24, 100, 100), 0.005, 0.97) == 6


@pytest.mark.long
def test_pixels_of_a_plant_are_those_of_the_tables():
    cultivar = ps.load_cultivar("kaite_february")
    plant = ps.mesh_plant(ps.grow(cultivar, np.random.default_rng(3)))
    surfaces = ps.organ_surfaces(cultivar, np.arange(380.0, 781.0, 5.0))
    scene = assemble_scene(plant, surfaces, SKY)
    centre = scene.mesh.vertices.mean(axis=0)
    size = np.linalg.norm(np.ptp(scene.mesh.vertices, axis=0))
    print(size, len(scene.mesh.instances))
    assert agrees(scene, views(centre, 1.2 * size, 40, 400, 400), 0.01, 0.95) > 10


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

"""Random scenes of a few triangles: whatever stands, shines and looks however, pictures hold together.

Triangles lie about a point, as heaps, sheets, needles and specks, some without area or twice; surfaces,
lights, lens and pose are drawn with the ends of their ranges more often than not. Cameras stand outside,
among, on and in the triangles.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import RANGE_NM, bench_camera
from scipy.spatial.transform import Rotation
from strain import assert_sound, surface, triangles

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.render import Renderer, renderer
from pepperscene.scene import Scene, Sky, assemble_scene
from pepperscene.scene.sky import Sun
from pepperscene.spectra import Spectrum

OUTPUTS = ("electrons", "class", "instance", "distance", "normal")
EVEN = Spectrum(RANGE_NM, np.ones((1, 2)))
CAMERA = bench_camera(columns=6, rows=6)
POINT = replace(CAMERA.flash, radius_m=0.0, emitters_m=np.zeros((1, 2)), offset_m=(0.0, 0.0, 0.0))
CUTICLES = [(ior, alpha) for ior in (1.0, 1.0 + 1e-9, 1.4, 2.5) for alpha in (0.0, 1e-9, 0.01, 0.3, 1.0)]


def share(rng: np.random.Generator) -> float:
    """In [0, 1], its ends and their neighbourhoods more often than not."""
    return float(rng.choice([0.0, 1.0, 1e-9, 1.0 - 1e-9, rng.uniform(), rng.uniform()]))


def heap(rng: np.random.Generator, name: str) -> Mesh:
    """Up to eight triangles of one organ."""
    count = int(rng.integers(1, 9))
    size = 10.0 ** rng.uniform(-6.0, 0.5)
    corners = rng.normal(size=(count, 1, 3)) * 0.1 + rng.normal(size=(count, 3, 3)) * size
    form = rng.integers(6)
    if form == 0:  # needles
        corners[:, 2] = corners[:, 1] + rng.normal(size=(count, 3)) * size * 1e-6
    elif form == 1:  # no area
        corners[:, 2] = corners[:, 0]
    elif form == 2:  # in one plane
        corners[..., 2] = 0.0
    elif form == 3:  # one on the other
        corners[:] = corners[:1]
    mesh = triangles(corners, rng.uniform(size=(3 * count, 2)) if rng.uniform() < 0.5 else None, name)
    if rng.uniform() < 0.5:  # shading normals that know nothing of the triangles
        turned = rng.normal(size=mesh.normals.shape)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        mesh = replace(mesh, normals=turned.astype(np.float32))
    return replace(mesh, state=rng.uniform(size=len(mesh.state)).astype(np.float32))


def drawn(rng: np.random.Generator) -> tuple[Scene, Camera]:
    """A scene and a camera; each picture has 6 x 6 pixels."""
    names = ("one", "two")[: int(rng.integers(1, 3))]
    mesh = concatenate_meshes([heap(rng, name) for name in names])
    surfaces = {}
    for name in names:
        reflectance = share(rng)
        transmittance = (1.0 - reflectance) * share(rng)
        kind = surface(name, reflectance, transmittance, *CUTICLES[rng.integers(len(CUTICLES))])
        relief = rng.normal(size=(4, 4)).astype(np.float32) if rng.uniform() < 0.3 else None
        surfaces[name] = replace(kind, relief_mm=relief)

    sky = None
    if rng.uniform() < 0.6:
        direction = rng.normal(size=3)
        sun = None
        if rng.uniform() < 0.5:
            strength = Spectrum(RANGE_NM, np.full(2, 10.0 ** rng.uniform(-3.0, 1.0)))
            sun = Sun(direction / np.linalg.norm(direction), strength, 10.0 ** rng.uniform(-8.0, 0.0))
        weights = rng.uniform(size=(1, 4, 8)) * rng.choice([0.0, 1e-30, 0.1])
        sky = Sky(weights.astype(np.float32), EVEN, sun)

    # On a corner, between corners, or anywhere about; the whole somewhere else, and of some other size.
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces))]].astype(float)
    place = [corners[0], rng.dirichlet(np.ones(3)) @ corners, rng.normal(size=3) * 0.3][rng.integers(3)]
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    pose[:3, 3] = place
    if rng.uniform() < 0.7:  # looking at a triangle
        towards = corners.mean(axis=0) - place
        if np.linalg.norm(towards) > 0.0:
            turn, _ = Rotation.align_vectors(towards[None], pose[None, :3, 2])
            pose[:3, :3] = turn.as_matrix() @ pose[:3, :3]
    if rng.uniform() < 0.2:
        away = rng.normal(size=3) * 10.0 ** rng.uniform(0.0, 4.0)
        pose[:3, 3] += away
        mesh = mesh.moved(np.eye(3), away)
    flash = [None, CAMERA.flash, POINT][rng.integers(3)]
    camera = replace(CAMERA, pose=pose, flash=flash, focus_m=0.3 if rng.uniform() < 0.2 else None)
    return assemble_scene(mesh, surfaces, sky), camera


def assert_light_needs_a_hit(light) -> None:
    """Where no sample hit anything, nothing is reflected."""
    sharp, soft = light.covered[..., 0] == 0.0, light.covered[..., 1] == 0.0
    assert not light.flash[sharp].any()
    assert not light.albedo[sharp].any()
    assert not light.normal[sharp].any()
    assert not light.soft[soft].any()


def assert_pictures_hold(
    count: int, seed: int, monkeypatch: pytest.MonkeyPatch, quality: str = "draft"
) -> None:
    traced = []

    def watched(light):
        traced.append(light)
        return denoised(light)

    denoised = renderer.denoised
    monkeypatch.setattr(renderer, "denoised", watched)
    lit = hit = 0
    for number in range(count):
        scene, camera = drawn(np.random.default_rng((seed, number)))
        frame = Renderer(scene).render(camera, OUTPUTS, quality, number)
        try:
            assert_sound(frame)
            for light in traced:
                assert_light_needs_a_hit(light)
            if scene.sky is None and camera.flash is None:
                assert frame["electrons"].max() == 0.0
        except AssertionError as fault:
            raise AssertionError(f"scene {number} of seed {seed}") from fault
        traced.clear()
        lit += bool(frame["electrons"].any())
        hit += bool(frame["class"].any())
    # The scenes are worth looking at.
    assert lit > 0.4 * count
    assert hit > 0.2 * count


@pytest.mark.parametrize(("count", "quality"), [(300, "draft"), (100, "standard")])
def test_a_few_hundred_random_scenes(count, quality, monkeypatch):
    assert_pictures_hold(count, 1, monkeypatch, quality)


@pytest.mark.long
def test_ten_thousand_random_scenes(monkeypatch):
    assert_pictures_hold(10_000, 2, monkeypatch)

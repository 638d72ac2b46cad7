"""Random scenes of a few triangles with extreme surfaces, lights and poses give valid frames.

Triangles are scattered around a point, some of them needles, without area, coplanar or duplicate. Parameters
are drawn at the ends of their ranges more often than not. Cameras are outside, between, on and in the
triangles.
"""

from dataclasses import replace

import numpy as np
import pytest
from bodies import RANGE_NM, axis_camera, point_flash_camera
from scipy.spatial.transform import Rotation
from strain import OUTPUTS, assert_sound, surface, triangles

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.render import Renderer
from pepperscene.render.transport import strips
from pepperscene.scene import Scene, Sky, assemble_scene
from pepperscene.scene.sky import Sun
from pepperscene.spectra import Spectrum

pytestmark = pytest.mark.long

EVEN = Spectrum(RANGE_NM, np.ones((1, 2)))
CAMERA = axis_camera(6, 6)
CUTICLES = [(ior, alpha) for ior in (1.0, 1.0 + 1e-9, 1.4, 2.5) for alpha in (0.0, 1e-9, 0.01, 0.3, 1.0)]


def random_fraction(rng: np.random.Generator) -> float:
    """In [0, 1], mostly at or next to the ends."""
    return float(rng.choice([0.0, 1.0, 1e-9, 1.0 - 1e-9, rng.uniform(), rng.uniform()]))


def random_triangles(rng: np.random.Generator, name: str) -> Mesh:
    """Up to eight triangles of one organ."""
    count = int(rng.integers(1, 9))
    size = 10.0 ** rng.uniform(-6.0, 0.5)
    corners = rng.normal(size=(count, 1, 3)) * 0.1 + rng.normal(size=(count, 3, 3)) * size
    shape = rng.integers(6)
    if shape == 0:  # needles
        corners[:, 2] = corners[:, 1] + rng.normal(size=(count, 3)) * size * 1e-6
    elif shape == 1:  # no area
        corners[:, 2] = corners[:, 0]
    elif shape == 2:  # coplanar
        corners[..., 2] = 0.0
    elif shape == 3:  # duplicate
        corners[:] = corners[:1]
    mesh = triangles(corners, rng.uniform(size=(3 * count, 2)) if rng.uniform() < 0.5 else None, name)
    if rng.uniform() < 0.5:  # random shading normals
        normals = rng.normal(size=mesh.normals.shape)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        mesh = replace(mesh, normals=normals.astype(np.float32))
    return replace(mesh, state=rng.uniform(size=len(mesh.state)).astype(np.float32))


def random_scene(rng: np.random.Generator) -> tuple[Scene, Camera]:
    """A scene and a camera with 6 x 6 pixels."""
    names = ("one", "two")[: int(rng.integers(1, 3))]
    mesh = concatenate_meshes([random_triangles(rng, name) for name in names])
    surfaces = {}
    for name in names:
        reflectance = random_fraction(rng)
        transmittance = (1.0 - reflectance) * random_fraction(rng)
        smooth = surface(name, reflectance, transmittance, *CUTICLES[rng.integers(len(CUTICLES))])
        relief = rng.normal(size=(1, 4, 4)).astype(np.float32) if rng.uniform() < 0.3 else None
        surfaces[name] = replace(smooth, relief_mm=relief)

    sky = None
    if rng.uniform() < 0.6:
        direction = rng.normal(size=3)
        sun = None
        if rng.uniform() < 0.5:
            strength = Spectrum(RANGE_NM, np.full(2, 10.0 ** rng.uniform(-3.0, 1.0)))
            sun = Sun(direction / np.linalg.norm(direction), strength, 10.0 ** rng.uniform(-8.0, 0.0))
        weights = rng.uniform(size=(1, 4, 8)) * rng.choice([0.0, 1e-30, 0.1])
        sky = Sky(weights.astype(np.float32), EVEN, sun)

    # On a corner, inside a triangle, or anywhere near.
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces))]].astype(float)
    position = [corners[0], rng.dirichlet(np.ones(3)) @ corners, rng.normal(size=3) * 0.3][rng.integers(3)]
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    pose[:3, 3] = position
    if rng.uniform() < 0.7:  # looking at a triangle
        direction = corners.mean(axis=0) - position
        if np.linalg.norm(direction) > 0.0:
            rotation, _ = Rotation.align_vectors(direction[None], pose[None, :3, 2])
            pose[:3, :3] = rotation.as_matrix() @ pose[:3, :3]
    if rng.uniform() < 0.2:  # far away
        offset = rng.normal(size=3) * 10.0 ** rng.uniform(0.0, 4.0)
        pose[:3, 3] += offset
        mesh = mesh.moved(np.eye(3), offset)
    flash = [None, CAMERA.flash, point_flash_camera().flash][rng.integers(3)]
    camera = replace(CAMERA, pose=pose, flash=flash, focus_m=0.3 if rng.uniform() < 0.2 else None)
    return assemble_scene(mesh, surfaces, sky), camera


def assert_light_needs_a_hit(light) -> None:
    """Pixels without a hit reflect nothing."""
    empty, empty_indirect = (light.coverage[..., k] == 0.0 for k in (0, 1))
    assert not light.flash[empty].any()
    assert not light.albedo[empty].any()
    assert not light.normal[empty].any()
    assert not light.indirect[empty_indirect].any()


@pytest.mark.parametrize(
    ("count", "quality", "seed"),
    [(40, "draft", 1), (30, "standard", 1), pytest.param(60, "draft", 2, marks=pytest.mark.long)],
)
def test_random_scenes_give_valid_frames(count, quality, seed, monkeypatch):
    traced, denoised = [], strips.denoised
    monkeypatch.setattr(strips, "denoised", lambda light: (traced.append(light), denoised(light))[1])
    lit = hit = 0
    for number in range(count):
        scene, camera = random_scene(np.random.default_rng((seed, number)))
        frame = Renderer(scene).render(camera, OUTPUTS, quality, number)
        try:
            assert_sound(frame)
            for light in traced:
                assert_light_needs_a_hit(light)
            if scene.sky is None and camera.flash is None:
                assert frame["electrons"].max() == 0.0
        except AssertionError as error:
            raise AssertionError(f"scene {number} of seed {seed}") from error
        traced.clear()
        lit += bool(frame["electrons"].any())
        hit += bool(frame["class"].any())
    # Enough scenes show something.
    assert lit > 0.4 * count
    assert hit > 0.2 * count

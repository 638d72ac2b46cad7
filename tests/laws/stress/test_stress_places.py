"""Scenes far away, tiny and huge, and cameras inside, on and directly in front of surfaces.

Single precision has 24 bits. The kernel uses coordinates relative to the middle of the scene, so the position
of the scene does not matter; but a mesh's own vertices have 24 bits too, a millimetre at 10 km.
"""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, axis_camera, card, point_flash_camera, sheet, sphere
from greenhouse import camera as greenhouse_camera
from greenhouse import greenhouse
from scipy.spatial.transform import Rotation
from strain import OUTPUTS, grey, moved, render, scaled, surface

from pepperscene.geometry import concatenate_meshes
from pepperscene.render.arrays import WORLD, local_coordinates
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene, sky_tables
from pepperscene.render.quality import QUALITIES
from pepperscene.render.transport.trace import Sampling, frame_light, trace_rows
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import assemble_scene

pytestmark = pytest.mark.long

FAR = np.array([10_000.0, -10_000.0, 10_000.0])
PATHS = replace(QUALITIES["standard"], directions=0, soft_by_daylight=0, most_bounces=0)
"""The same paths whether daylight or the flash is brighter at half a metre; no cells of centimetres."""


@pytest.fixture(scope="module")
def plants():
    """Plants under a cloudy sky, a camera with few pixels, and their frame."""
    scene, camera = greenhouse(), greenhouse_camera(columns=40, rows=30)
    return scene, camera, render(scene, camera, "standard")


def assert_similar(result, expected, *, labels: float, pixels: float, mean: float) -> None:
    """Limit the fractions of pixels with another class and with light off by 5 %, and the mean's error."""
    agree = result["class"] == expected["class"]
    assert 1.0 - agree.mean() <= labels
    a, b = result["electrons"][agree], expected["electrons"][agree]
    assert (np.abs(a - b) > 0.05 * b).mean() <= pixels
    assert result["electrons"].mean((0, 1)) == pytest.approx(expected["electrons"].mean((0, 1)), rel=mean)


def average_frame(scene, camera, seeds=range(4)):
    """Classes of a frame, and the mean of its light over seeds."""
    frames = [render(scene, camera, "standard", seed=seed) for seed in seeds]
    light = np.mean([frame["electrons"] for frame in frames], axis=0, dtype=float)
    return {"class": frames[0]["class"], "electrons": light}


def test_frame_at_ten_kilometres_has_the_same_bits(plants):
    # The mesh is rounded there; moving it back rounds nothing.
    scene, camera, expected = plants
    far, far_camera = moved(scene, camera, FAR)
    near = replace(far, mesh=far.mesh.moved(np.eye(3), -FAR))
    assert local_coordinates(near.mesh) == WORLD
    assert local_coordinates(far.mesh).origin == tuple(FAR)
    frame, same = render(far, far_camera, "standard"), render(near, camera, "standard")
    assert all(np.array_equal(frame[name], same[name]) for name in OUTPUTS)
    # Vertices are rounded by up to half of 2^-10 m along each axis, .85 mm in all. A pixel covers 4.5 mm at
    # 40 cm: a fifth of a pixel at each outline, and thin stalks are up to a third thinner or thicker.
    assert_similar(frame, expected, labels=0.03, pixels=0.3, mean=0.03)


@pytest.mark.parametrize("offset", [(7.3, -3.1, 5.9), (1234.567, -987.654, 321.0), (9_999.1, 3.3, -20.0)])
def test_position_off_the_grid_changes_only_the_ray_offset(plants, offset):
    # The kernel's origin is then up to 4 m away along each axis, and rays start up to 1.8e-4 (1 + 4.5) m =
    # 1 mm off a surface instead of .3 mm: a little more light gets into creases.
    scene, camera, _ = plants
    far, far_camera = moved(scene, camera, np.array(offset))
    near = replace(far, mesh=far.mesh.moved(np.eye(3), -np.array(offset)))
    # Some rays then take other paths, which is noise: the mean of a frame differs by -.3 %, with a standard
    # deviation of .5 % over seeds. So the light is the mean of four.
    result, expected = average_frame(far, far_camera), average_frame(near, camera)
    assert_similar(result, expected, labels=0.002, pixels=0.03, mean=0.01)


@pytest.mark.parametrize("factor", [2.0**-10, 2.0**-5])
def test_tiny_scenes_have_their_own_unit(factor):
    # Two cards with a shadow; scaling by powers of two rounds nothing. In metres the smaller one would
    # vanish: rays start .2 mm off a surface, and the scene is .2 mm wide.
    scene, camera = grey(two_cards(), sky=EVEN_SKY), axis_camera(24, 18)
    expected = render(*scaled(scene, camera, 0.25), "standard")
    result = render(*scaled(scene, camera, 0.25 * factor), "standard")
    for name in ("class", "instance", "normal"):
        assert np.array_equal(result[name], expected[name])
    assert result["distance"] == pytest.approx(expected["distance"] * factor, rel=1e-5)
    assert_similar(result, expected, labels=0.0, pixels=0.01, mean=0.002)


@pytest.fixture(scope="module")
def along_paths(plants):
    scene, camera, _ = plants
    return render(scene, camera, PATHS)


@pytest.mark.parametrize("factor", [1e-3, 0.03, 1.0 / 3.0, 30.0, 1000.0])
def test_scaled_scenes_look_the_same(plants, along_paths, factor):
    # Vertices and poses are rounded once more, by 6e-8 of their size. Rays start 1.8e-4 (1 + |p|) units off a
    # surface: .04 % of a scene about a unit wide, .02 % of one a thousand wide. Paths that differ there are
    # noise: 1 % in the mean of 1,200 pixels.
    (scene, camera, _), expected = plants, along_paths
    result = render(*scaled(scene, camera, factor), PATHS)
    both = np.isfinite(result["distance"]) & (result["class"] == expected["class"])
    near = np.abs(result["distance"][both] / factor - expected["distance"][both]) < 1e-5
    assert near.mean() > 0.995
    assert_similar(result, expected, labels=0.002, pixels=0.05, mean=0.02)


def two_cards():
    """A narrow card in front of a wide one."""
    return concatenate_meshes([card(0.01, 0.0, 0.004, 0.2, "front", 0.4), sheet(0.2, 0.2, 0.5, "back")])


def pose_of(rotation: np.ndarray, position: tuple[float, float, float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def test_flash_follows_the_inverse_square_law_down_to_a_fifth_of_a_millimetre():
    camera = point_flash_camera(4, 4)

    def level(distance):
        return render(grey(sheet(0.2, 0.2, distance, "leaf")), camera, "standard")["electrons"].mean((0, 1))

    far = level(0.5)
    # Hits are exact to 1e-8 m, the rounding of the leaf's corners.
    for distance in (1e-2, 1e-3, 2e-4):
        assert level(distance) == pytest.approx(far * (0.5 / distance) ** 2, rel=1e-4 + 1e-8 / distance)


@pytest.mark.parametrize("depth", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("angle", [0.0, np.pi], ids=["inwards", "outwards"])
@pytest.mark.parametrize("by_cells", [False, True], ids=["paths", "cells"])
def test_no_light_enters_an_opaque_fruit(depth, angle, by_cells):
    # A camera without a flash below the skin sees black: no ray leaves between the normals of a triangle and
    # of the smooth surface. Embree's fast intersection has gaps between triangles, which one ray in two
    # million meets; the exact one has none.
    ball = sphere((0.0, 0.0, 0.04), 0.04, "fruit")
    scene = assemble_scene(ball, {"fruit": surface("fruit", 0.6, 0.0, 1.4)}, EVEN_SKY)
    rotation = Rotation.from_euler("x", angle).as_matrix()
    pose = pose_of(rotation, (0.0, 0.0, ball.vertices[:, 2].min() + depth))
    camera = axis_camera(16, 12, flash=False).at_pose(pose)
    response = spectral_response(camera, scene)
    grid, rays = response.grid_nm, camera_rays(camera, local_coordinates(scene.mesh))
    light = light_scene(scene, float(grid[0]), float(grid[-1]))
    exact = {"type": "scene", "plants": light.shape, "embree_use_robust_intersections": True}
    light = replace(light, scene=mitsuba_modules()[0].load_dict(exact))
    sky = sky_tables(scene, grid)
    quality = QUALITIES["standard"]
    gathering = quality.gathering(16 * 12) if by_cells else None
    traced = frame_light(light, rays, response, None, sky, (2, quality.most_bounces), 0, gathering)
    result = trace_rows(traced, Sampling(64, 64, 2, most_bounces=quality.most_bounces))
    assert result.total().max() == 0.0
    # The camera is inside: it sees a surface in each pixel, and the sky in none.
    assert (result.coverage == 1.0).all()

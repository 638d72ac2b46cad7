"""Scenes far away, tiny and huge, and cameras in, on and right before what they look at.

The kernel's numbers have 24 bits. It is given coordinates from near the scene's middle, so that a place does
not matter; what is left is that a mesh's own vertices have 24 bits too, a millimetre at 10 km.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import bench_camera, body, card, sheet, sphere
from greenhouse import camera as greenhouse_camera
from greenhouse import greenhouse
from strain import DAYLIGHT, OUTPUTS, grey, moved, picture, point_flash_camera, scaled, surface
from trimesh.creation import cylinder

from pepperscene.classes import OrganClass
from pepperscene.render.kernel.arrays import WORLD, local_coordinates
from pepperscene.scene import assemble_scene

FAR = np.array([10_000.0, -10_000.0, 10_000.0])


@pytest.fixture(scope="module")
def plants():
    """Plants under a cloudy sky, a camera with few pixels, and their picture."""
    scene, camera = greenhouse(), greenhouse_camera(columns=40, rows=30)
    return scene, camera, picture(scene, camera, "standard")


def same(a, b) -> bool:
    return all(np.array_equal(a[name], b[name]) for name in OUTPUTS)


def alike(found, expected, *, labels: float, pixels: float, mean: float) -> None:
    """At most the share `labels` of pixels has another class, and of the others at most the share `pixels`
    differs by more than a twentieth; the picture's mean differs by at most the share `mean`.
    """
    agree = found["class"] == expected["class"]
    assert 1.0 - agree.mean() <= labels
    a, b = found["electrons"][agree], expected["electrons"][agree]
    assert (np.abs(a - b) > 0.05 * b).mean() <= pixels
    assert found["electrons"].mean((0, 1)) == pytest.approx(expected["electrons"].mean((0, 1)), rel=mean)


# --- far away -------------------------------------------------------------------------------------------


def test_ten_kilometres_away_every_bit_is_the_same(plants):
    # The mesh as single precision rounds it there, once there and once brought back, which rounds nothing.
    scene, camera, _ = plants
    there, camera_there = moved(scene, camera, FAR)
    back = replace(there, mesh=there.mesh.moved(np.eye(3), -FAR))
    assert local_coordinates(back.mesh) == WORLD
    assert local_coordinates(there.mesh).origin == tuple(FAR)
    assert same(picture(there, camera_there, "standard"), picture(back, camera, "standard"))


def test_ten_kilometres_away_the_picture_is_the_same_but_for_the_vertices_millimetre(plants):
    # Vertices are rounded by up to half of 2^-10 m along each axis, .85 mm in all. A pixel covers 4.5 mm at
    # 40 cm: a fifth of a pixel at each outline, and thin stalks are up to a third thinner or thicker.
    scene, camera, expected = plants
    alike(picture(*moved(scene, camera, FAR), "standard"), expected, labels=0.03, pixels=0.3, mean=0.03)


@pytest.mark.parametrize("by", [(7.3, -3.1, 5.9), (1234.567, -987.654, 321.0), (9_999.1, 3.3, -20.0)])
def test_places_off_the_grid_change_only_how_far_rays_are_lifted(plants, by):
    # The kernel's origin then lies up to 4 m away along each axis, and rays are lifted off a surface by up to
    # 1.8e-4 (1 + 4.5) m = 1 mm where it was .3: light creeps a little farther into creases.
    scene, camera, _ = plants
    there, camera_there = moved(scene, camera, np.array(by))
    back = replace(there, mesh=there.mesh.moved(np.eye(3), -np.array(by)))
    found, expected = picture(there, camera_there, "standard"), picture(back, camera, "standard")
    alike(found, expected, labels=0.002, pixels=0.03, mean=0.01)


# --- tiny and huge --------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [2.0**-10, 2.0**-5])
def test_tiny_scenes_are_told_in_a_unit_of_their_own(factor):
    # Two cards, a shadow between them; scaled by powers of two nothing is rounded. In metres the smaller
    # would be gone: rays are lifted by .2 mm, and the whole is .2 mm wide.
    scene, camera = grey(both_cards(), sky=DAYLIGHT), bench_camera(columns=24, rows=18)
    expected = picture(*scaled(scene, camera, 0.25), "standard")
    found = picture(*scaled(scene, camera, 0.25 * factor), "standard")
    for name in ("class", "instance", "normal"):
        assert np.array_equal(found[name], expected[name])
    assert found["distance"] == pytest.approx(expected["distance"] * factor, rel=1e-5)
    alike(found, expected, labels=0.0, pixels=0.01, mean=0.002)


@pytest.mark.parametrize("factor", [1e-3, 0.03, 1.0 / 3.0, 30.0, 1000.0])
def test_scaled_scenes_look_the_same(plants, factor):
    # Vertices and poses are rounded once more, by 6e-8 of their size. Rays are lifted by 1.8e-4 (1 + |p|)
    # units: of a scene about a unit wide .04 %, of one a thousand wide .02 %. Paths that part there are
    # noise: in the mean of 1,200 pixels 1 %.
    scene, camera, expected = plants
    found = picture(*scaled(scene, camera, factor), "standard")
    both = np.isfinite(found["distance"]) & (found["class"] == expected["class"])
    near = np.abs(found["distance"][both] / factor - expected["distance"][both]) < 1e-5
    assert near.mean() > 0.995
    alike(found, expected, labels=0.002, pixels=0.05, mean=0.02)


def test_a_tiny_scene_far_from_the_origin_keeps_its_light():
    # A scene of 2 cm, 8 m along the row: its own grid is finer, so that rays are not lifted by its distance.
    scene, camera = scaled(grey(both_cards(), sky=DAYLIGHT), bench_camera(columns=24, rows=18), 0.125)
    expected = picture(scene, camera, "standard")
    found = picture(*moved(scene, camera, np.array([8.0, 4.0, -8.0])), "standard")
    alike(found, expected, labels=0.005, pixels=0.01, mean=0.002)


def both_cards():
    """A narrow card before a wide one."""
    from pepperscene.geometry import concatenate_meshes

    return concatenate_meshes([card(0.01, 0.0, 0.004, 0.2, "front", 0.4), sheet(0.2, 0.2, 0.5, "back")])


# --- cameras in, on and right before things -------------------------------------------------------------


@pytest.mark.parametrize("kind", ["point flash", "flash beside the lens"])
@pytest.mark.parametrize("turn", ["across the leaf", "along the leaf", "aslant"])
@pytest.mark.parametrize("shift", [0.0, 1e-7, -1e-7])
def test_a_camera_inside_a_leaf(kind, turn, shift):
    # The projection centre lies in a leaf's plane, to rounding: it may see the leaf or not.
    camera = point_flash_camera() if kind == "point flash" else bench_camera(columns=16, rows=12)
    pose = camera.pose.copy()
    angle = {"across the leaf": 0.0, "along the leaf": np.pi / 2, "aslant": 0.7}[turn]
    cosine, sine = np.cos(angle), np.sin(angle)
    pose[:3, :3] = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
    pose[2, 3] = 0.5 + shift
    scene = assemble_scene(sheet(0.2, 0.2, 0.5, "leaf"), {"leaf": surface("leaf", 0.4, 0.4, 1.4)}, DAYLIGHT)
    picture(scene, camera.at_pose(pose), "standard")


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.0, 1.5])
def test_a_camera_on_a_stem(turn):
    # On the surface of a stem of 5 mm radius, looking away from it, along it, and into it.
    stem = body(cylinder(0.005, 0.4, sections=64), "stem", OrganClass.STEM)
    scene = assemble_scene(stem, {"stem": surface("stem", 0.4, 0.0, 1.4)}, DAYLIGHT)
    for camera in (point_flash_camera(), bench_camera(columns=16, rows=12)):
        pose = camera.pose.copy()
        cosine, sine = np.cos(turn * np.pi), np.sin(turn * np.pi)
        # Its forward axis turns from +x, away from the stem, to -x.
        pose[:3, :3] = [[0.0, -sine, cosine], [0.0, cosine, sine], [-1.0, 0.0, 0.0]]
        pose[:3, 3] = [0.005, 0.0, 0.0]
        frame = picture(scene, camera.at_pose(pose), "standard")
        # In front of it there is only the sky, unless the stem's own surface is met at no distance.
        if turn == 0.0:
            met = frame["class"] > 0
            assert (frame["distance"][met] < 1e-6).all()
            assert frame["electrons"].max() > 0.0


def test_a_millimetre_before_a_leaf_the_flash_follows_its_law():
    # A point flash in the lens' place: straight ahead the light falls with the square of the distance.
    camera = point_flash_camera(columns=4, rows=4)

    def level(distance):
        return picture(grey(sheet(0.2, 0.2, distance, "leaf")), camera, "standard")["electrons"].mean((0, 1))

    far = level(0.5)
    # A hit's place is told to 1e-8 m, the rounding of the leaf's own corners.
    for distance in (1e-2, 1e-3, 2e-4):
        assert level(distance) == pytest.approx(far * (0.5 / distance) ** 2, rel=1e-4 + 1e-8 / distance)


@pytest.mark.parametrize("depth", [1e-3, 1e-4, 1e-5])
def test_no_light_gets_into_a_fruit(depth):
    # A camera below the skin of a closed, opaque fruit, in the open, without a flash: it sees black. (At a
    # micrometre a ray in a thousand finds a gap between two triangles.)
    ball = sphere((0.0, 0.0, 0.04), 0.04, "fruit", subdivisions=5)
    scene = assemble_scene(ball, {"fruit": surface("fruit", 0.6, 0.0, 1.4)}, DAYLIGHT)
    for looking_out in (False, True):
        camera = bench_camera(columns=16, rows=12, flash=False)
        pose = np.diag([1.0, -1.0, -1.0, 1.0]) if looking_out else np.eye(4)
        pose[2, 3] = ball.vertices[:, 2].min() + depth
        frame = picture(scene, camera.at_pose(pose), "standard")
        assert (frame["class"] == OrganClass.PEPPER).all()
        assert frame["electrons"].max() == 0.0


def test_a_flash_inside_a_fruit():
    # A millimetre inside, with the flash in there or out in the open. Out there a shading normal can see the
    # lamp where the triangle does not: a millionth of the light.
    ball = sphere((0.0, 0.0, 0.04), 0.04, "fruit")
    scene = assemble_scene(ball, {"fruit": surface("fruit", 0.6, 0.0, 1.4)})
    pose = np.eye(4)
    pose[2, 3] = 1e-3
    inside = picture(scene, point_flash_camera().at_pose(pose), "standard")
    assert inside["electrons"].min() > 0.0
    outside = point_flash_camera(offset_m=(0.0, 0.0, -0.01)).at_pose(pose)
    leaked = picture(scene, outside, "standard")["electrons"]
    assert leaked.max() < 1e-5 * inside["electrons"].min()

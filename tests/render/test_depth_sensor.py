"""Outputs of a depth camera: what they need, what they change, and what they cost."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from pepperscene.camera import (
    Camera,
    DepthCamera,
    Developing,
    Partners,
    StereoMatching,
    load_lens,
    load_projector,
    load_sensor,
)
from pepperscene.errors import ArgumentError, InputError
from pepperscene.geometry import rectangle
from pepperscene.materials import lambertian_surface
from pepperscene.render import QUALITIES, Renderer, render_scene
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.spectra import Spectrum

SKY = uniform_sky(Spectrum(np.array([300.0, 1100.0]), np.ones(2)), 200.0)
DEPTHS = ("depth_sensor", "depth_confidence", "imager_left", "imager_right")


def looking_along_y(lens, size, x=0.0):
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    pose[0, 3] = x
    sensor = load_sensor(f"realsense_d435_{lens}").with_size(*size)
    developing = Developing(white_balance="daylight")
    return Camera(load_lens(f"realsense_d435_{lens}"), sensor, pose, 5e-3, developing=developing)


@pytest.fixture(scope="module")
def scene():
    wall = rectangle((0.0, 0.6, 0.0), (4.0, 0.0, 0.0), (0.0, 0.0, 4.0), "matt")
    return assemble_scene(wall, {"matt": lambertian_surface("matt", 0.5)}, SKY)


@pytest.fixture(scope="module")
def depth_camera():
    projector = load_projector("realsense_d435")
    matching = StereoMatching(disparities=32)
    return DepthCamera(looking_along_y("infrared", (212, 120)), 0.05, projector, matching)


@pytest.fixture(scope="module")
def renderer(scene):
    return Renderer(scene)


@pytest.fixture(scope="module")
def colour():
    return looking_along_y("colour", (160, 90), -0.015)


@pytest.fixture(scope="module")
def frame(renderer, colour, depth_camera):
    outputs = ("colour", "depth_z", *DEPTHS)
    return renderer.render(colour, outputs, "draft", 3, partners=Partners(depth=depth_camera))


def test_depth_is_in_the_pixels_of_the_colour_camera(frame):
    assert frame["depth_sensor"].shape == frame["depth_z"].shape == (90, 160)
    assert frame["imager_left"].shape == frame["imager_right"].shape == (120, 212)
    assert frame["depth_sensor"].dtype == np.float32
    error = (frame["depth_sensor"] - frame["depth_z"])[10:-10, 30:-10]
    assert np.isfinite(error).mean() > 0.95
    assert abs(np.nanmedian(error)) < 0.01
    np.testing.assert_array_equal(np.isnan(frame["depth_sensor"]), frame["depth_confidence"] == 0)
    described = frame.metadata["depth_camera"]
    assert (described["width"], described["height"], described["baseline_m"]) == (212, 120, 0.05)
    assert described["projector"] == "Intel RealSense D435 pattern projector"


def test_depth_depends_on_the_seed_alone(renderer, colour, depth_camera, frame):
    again = renderer.render(colour, DEPTHS, "draft", 3, partners=Partners(depth=depth_camera))
    other = renderer.render(colour, DEPTHS, "draft", 4, partners=Partners(depth=depth_camera))
    for name in DEPTHS:
        np.testing.assert_array_equal(again[name], frame[name])
        assert not np.array_equal(other[name], frame[name], equal_nan=True)


def test_the_pattern_is_in_both_images(renderer, colour, depth_camera, frame):
    off, names = replace(depth_camera, projector=None), ("imager_left", "imager_right")
    passive = renderer.render(colour, names, "draft", 3, partners=Partners(depth=off))
    for name in names:
        # Of neighbours, because images are darker towards their corners.
        on, off = (np.diff(images[name][30:90, 60:150].astype(int)).std() for images in (frame, passive))
        assert on > 5 * off


def test_a_pair_of_colour_cameras_is_matched_as_well(renderer, colour):
    left = looking_along_y("colour", (160, 90))
    pair = Partners(depth=DepthCamera(left, 0.05, matching=StereoMatching(disparities=32)))
    frame = renderer.render(colour, ("depth_sensor",), "draft", 3, partners=pair)
    # A wall without texture has nothing to match.
    assert np.isnan(frame["depth_sensor"]).mean() > 0.8


def test_a_depth_camera_is_required(scene, colour):
    with pytest.raises(InputError, match="partners: depth: the output depth_sensor needs this camera"):
        render_scene(scene, colour, ("depth_sensor",), "draft")


def test_a_depth_camera_needs_our_integrator(renderer, colour, depth_camera):
    """Mitsuba's path tracer has no dots: the quality is rejected instead of being traced with ours."""
    paths = replace(QUALITIES["draft"], integrator="path", denoise=False)
    for output in ("depth_sensor", "imager_left"):
        with pytest.raises(ArgumentError, match='need the integrator "flash", not "path"'):
            renderer.render(colour, (output,), paths, 3, partners=Partners(depth=depth_camera))


@pytest.mark.long
def test_opencv_is_imported_only_to_match_images():
    code = """
import sys
import pepperscene.camera, pepperscene.render.renderer
from pepperscene.recipe.resolve.load import load_recipe
load_recipe("realsense_depth")
assert "cv2" not in sys.modules and "pepperscene.render.depth_sensor" not in sys.modules
assert "pepperscene.render.aov.traits" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)

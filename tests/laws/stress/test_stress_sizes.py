"""One sample to thousands, one pixel to millions."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, axis_camera, card, sheet
from processes import run_python
from strain import assert_sound, surface

from pepperscene.camera import Partners
from pepperscene.geometry import concatenate_meshes
from pepperscene.outputs import BAND_OUTPUTS, DEPTH_CAMERA_OUTPUTS, OUTPUTS, TRAIT_OUTPUTS
from pepperscene.render import Quality, Renderer
from pepperscene.scene import assemble_scene

pytestmark = pytest.mark.long

WIDE = (3840, 2160)


def leaf_and_wall():
    """A translucent, glossy leaf in front of a pale wall."""
    mesh = concatenate_meshes([card(0.01, 0.0, 0.02, 0.2, "leaf", 0.4), sheet(0.6, 0.6, 0.45, "wall")])
    surfaces = {"leaf": surface("leaf", 0.3, 0.4, 1.4), "wall": surface("wall", 0.6)}
    return assemble_scene(mesh, surfaces, EVEN_SKY)


def with_samples(samples: int) -> Quality:
    return Quality(samples=samples, soft=samples, most=samples, bounces=2, target=None, denoise=False)


def test_mean_of_single_samples_equals_that_of_thousands():
    # One sample in each of 8 x 6 pixels, 128 times, against 4,096 of each pixel: 5 % off each, .5 % together.
    renderer, camera = Renderer(leaf_and_wall()), axis_camera(8, 6)

    def mean(samples, seed):
        return renderer.render(camera, ["electrons"], with_samples(samples), seed)["electrons"].mean((0, 1))

    many, single = mean(4096, 1), np.array([mean(1, seed) for seed in range(128)])
    assert np.isfinite(many).all()
    error = single.std(axis=0, ddof=1) / np.sqrt(len(single))
    assert (error < 0.01 * many).all()
    assert (np.abs(single.mean(axis=0) - many) < 4.0 * error).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (5, 3)])
@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_accepts_any_image_size_for_all_outputs(size, quality):
    # Binned, so that each pixel has a complete mosaic cell.
    camera = axis_camera(*size)
    camera = replace(camera, sensor=replace(camera.sensor, binning=2))
    # Harvest needs plants; a depth camera has a size of its own, and bands need another sensor.
    left_out = {"harvest"} | DEPTH_CAMERA_OUTPUTS | BAND_OUTPUTS
    outputs = [name for name in OUTPUTS if name not in left_out]
    other = camera.at_pose(camera.pose + 0.01 * np.eye(4, k=3))
    frame = Renderer(leaf_and_wall()).render(
        camera, outputs, quality, partners=Partners(flow=other, stereo=other)
    )
    assert_sound(frame)
    for name, image in frame.images.items():
        assert OUTPUTS[name].fits(image)
        if not OUTPUTS[name].is_image:
            continue
        assert name == "raw" or image.shape[:2] == size[::-1]
        # Grey surfaces have no pigments.
        assert (np.isnan(image.astype(float)) == (name in TRAIT_OUTPUTS)).all()
    assert (frame["electrons"] > 0.0).all()


_WIDE_DRAFT = """
import json, resource
from test_stress_sizes import WIDE, axis_camera, leaf_and_wall
from pepperscene.render import Renderer
frame = Renderer(leaf_and_wall()).render(axis_camera(*WIDE), ("colour", "class"), "draft")
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([frame["colour"].shape, int(frame["colour"].min()), int(frame["colour"].max()), peak]))
"""


@pytest.mark.long
def test_memory_of_a_4k_frame_is_limited():
    # A wavefront has 2 million samples for any image size; images and denoiser need at most 1,024 bytes a
    # pixel (860 measured), everything else 600 MiB.
    shape, least, most, peak_mib = run_python(_WIDE_DRAFT)
    assert shape == [2160, 3840, 3]
    assert least < most
    assert peak_mib < 600.0 + WIDE[0] * WIDE[1] / 1024.0

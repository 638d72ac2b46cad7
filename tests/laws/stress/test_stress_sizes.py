"""One sample and thousands, one pixel and millions."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import bench_camera, card, sheet
from strain import DAYLIGHT, assert_sound, picture, surface

from pepperscene.camera import load_sensor
from pepperscene.frame import OUTPUTS
from pepperscene.geometry import concatenate_meshes
from pepperscene.render import Quality, Renderer
from pepperscene.scene import assemble_scene

WIDE = (3840, 2160)


def two_cards(sky=DAYLIGHT):
    """A translucent, glossy leaf before a pale wall."""
    mesh = concatenate_meshes([card(0.01, 0.0, 0.02, 0.2, "leaf", 0.4), sheet(0.6, 0.6, 0.45, "wall")])
    return assemble_scene(mesh, {"leaf": surface("leaf", 0.3, 0.4, 1.4), "wall": surface("wall", 0.6)}, sky)


def with_samples(samples: int) -> Quality:
    return Quality(samples=samples, soft=samples, most=samples, bounces=2, target=None, denoise=False)


# --- samples ------------------------------------------------------------------------------------------------


def test_one_sample_and_thousands_agree_in_the_mean():
    # One sample in each of 8 x 6 pixels, 128 times, against 4,096 of each pixel. A picture of one sample each
    # is off by 5 %; the mean of 128 by .5 %.
    renderer, camera = Renderer(two_cards()), bench_camera(columns=8, rows=6)
    many = renderer.render(camera, ["electrons"], with_samples(4096), 1)["electrons"].mean((0, 1))
    ones = np.array(
        [
            renderer.render(camera, ["electrons"], with_samples(1), seed)["electrons"].mean((0, 1))
            for seed in range(128)
        ]
    )
    assert np.isfinite(many).all()
    error = ones.std(axis=0, ddof=1) / np.sqrt(len(ones))
    assert (error < 0.01 * many).all()
    assert (np.abs(ones.mean(axis=0) - many) < 4.0 * error).all()


@pytest.mark.parametrize("samples", [1, 2, 3, 5, 4096])
def test_any_number_of_samples_makes_a_picture(samples):
    frame = Renderer(two_cards()).render(
        bench_camera(columns=3, rows=2), ("electrons", "class"), with_samples(samples)
    )
    assert np.isfinite(frame["electrons"]).all()
    assert (frame["electrons"] > 0.0).all()


# --- pixels -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (5, 3)])
@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_pictures_of_a_pixel_are_pictures(size, quality):
    # Binned photosites, so that there is a whole mosaic cell under each pixel; all outputs there are.
    sensor = replace(load_sensor("ueye_ui5250re"), columns=size[0], rows=size[1], binning=2)
    camera = replace(bench_camera(), sensor=sensor)
    outputs = [name for name in OUTPUTS if name != "harvest"]  # cards are no plants
    beside = camera.at_pose(camera.pose + 0.01 * np.eye(4, k=3))
    frame = Renderer(two_cards()).render(camera, outputs, quality, others={"flow": beside, "stereo": beside})
    assert_sound(frame)
    for name, image in frame.images.items():
        assert OUTPUTS[name].fits(image)
        if name != "raw":
            assert image.shape[:2] == size[::-1]
    assert (frame["electrons"] > 0.0).all()


def test_one_pixel_sees_what_the_middle_of_many_sees():
    scene, quality = two_cards(), with_samples(1024)
    (one,), many = (
        Renderer(scene).render(bench_camera(columns=n, rows=n), ["electrons"], quality)["electrons"]
        for n in (1, 3)
    )
    assert one[0] == pytest.approx(many[1, 1], rel=0.02)


def test_labels_of_millions_of_pixels_are_those_of_few():
    # A picture of 4k and one of every 15th of its pixels' centres.
    def labels(columns, rows, finer):
        sensor = load_sensor("ueye_ui5250re")
        sensor = replace(sensor, columns=columns, rows=rows, pitch_m=sensor.pitch_m / finer)
        camera = replace(bench_camera(), sensor=sensor)
        return picture(two_cards(), camera, outputs=("class", "instance", "distance", "normal"))

    wide, narrow = labels(*WIDE, 15), labels(WIDE[0] // 15, WIDE[1] // 15, 1)
    for name in ("class", "instance", "distance", "normal"):
        assert wide[name].shape[:2] == WIDE[::-1]
        assert wide[name][7::15, 7::15] == pytest.approx(narrow[name], rel=1e-5)


_WIDE_DRAFT = """
import json, resource, sys
import numpy as np
from test_stress_sizes import WIDE, bench_camera, two_cards
from pepperscene.render import Renderer
camera = bench_camera(columns=WIDE[0], rows=WIDE[1])
frame = Renderer(two_cards()).render(camera, ("colour", "class"), "draft")
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([frame["colour"].shape, int(frame["colour"].min()), int(frame["colour"].max()), peak]))
"""


@pytest.mark.long
def test_a_picture_of_millions_of_pixels_fits_into_memory():
    # A wavefront holds 2 million samples, whatever the picture's size: what grows with it are images and the
    # denoiser, by at most 1,024 bytes a pixel (860 measured), beside 600 MiB for all else.
    stress, laws, render = (
        Path(__file__).parent,
        Path(__file__).parents[1],
        Path(__file__).parents[2] / "render",
    )
    path = os.pathsep.join([str(stress), str(laws), str(render), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", _WIDE_DRAFT],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    shape, least, most, peak_mib = json.loads(done.stdout.splitlines()[-1])
    assert shape == [2160, 3840, 3]
    assert least < most
    assert peak_mib < 600.0 + WIDE[0] * WIDE[1] / 1024.0

"""The adaptive, denoised picture has no bias that shows.

Rationale: samples that are taken because of what earlier ones saw pull means (a pixel whose first samples
missed something keeps what it has), and a denoiser moves light about. Both hide in a single frame's noise.

Set-up: the mean over 64 seeds of frames of the standard quality, against a reference of many samples in
every pixel, six bounces and no denoiser. Differences are taken in codes after the tone curve, from the mean
of the light.

Expected: less than .3 code in the mean of each colour, and 1 % in the light of every class of the ground
truth; 1.5 % in a small picture, where more of each class lies at its edges. Pixel by pixel the denoiser's
smoothing stays: its root mean square is told as well, from two halves of frames and of the reference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from small_scenes import plants_shot

from pepperscene.camera import Camera, camera_rgb, correct_colours
from pepperscene.classes import OrganClass
from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.render import Quality, Renderer
from pepperscene.scene import Scene

SEEDS = 64


@dataclass(frozen=True)
class Bias:
    """What the mean of frames is off by.

    Attributes:
        mean: `(3,)` of the codes, signed.
        size: of the codes, root mean square over the picture without the noise.
        classes: share of a class' light that is too much, and its standard error, by name.
    """

    mean: np.ndarray
    size: float
    classes: dict[str, tuple[float, float]]


def codes_of(electrons: np.ndarray, camera: Camera) -> np.ndarray:
    """Codes of the picture that are not rounded (IEC 61966-2-1)."""
    smooth = replace(camera, developing=replace(camera.developing, quantise=False))
    value = np.clip(correct_colours(camera_rgb(electrons, smooth), smooth).astype(float), 0.0, 1.0)
    toe = value <= 0.0031308
    return 255.0 * np.where(toe, 12.92 * value, 1.055 * np.maximum(value, 1e-3) ** (1 / 2.4) - 0.055)


def bias_of(scene: Scene, camera: Camera, *, seeds: int, reference_frames: int, least_pixels: int) -> Bias:
    """Of standard frames.

    Args:
        scene: what is there.
        camera: what is seen of it.
        seeds: of frames.
        reference_frames: of 256 samples a pixel, for each half of the reference.
        least_pixels: of a class that is judged.
    """
    renderer = Renderer(scene)
    classes = renderer.render(camera, ["class"])["class"]

    def light(quality: str | Quality, seed: int) -> np.ndarray:
        return renderer.render(camera, ["electrons"], quality, seed)["electrons"].astype(float)

    halves = [
        np.mean([light("reference", 1000 * half + k) for k in range(reference_frames)], axis=0)
        for half in (1, 2)
    ]
    names = [k for k in np.unique(classes).tolist() if (classes == k).sum() >= least_pixels]
    sums, by_class = [0.0, 0.0], []
    for seed in range(seeds):
        frame = light("standard", seed)
        sums[seed % 2] = sums[seed % 2] + frame / (seeds // 2)
        by_class.append([frame[classes == k].mean() for k in names])
    first, second = (
        codes_of(mean, camera) - codes_of(half, camera) for mean, half in zip(sums, halves, strict=True)
    )
    wanted = np.array([np.mean([half[classes == k].mean() for half in halves]) for k in names])
    shares = np.array(by_class) / wanted - 1.0
    errors = shares.std(axis=0, ddof=1) / np.sqrt(seeds)
    return Bias(
        mean=0.5 * (first + second).mean(axis=(0, 1)),
        size=float(np.sqrt(max((first * second).mean(), 0.0))),
        classes={
            OrganClass(k).name: (float(share), float(error))
            for k, share, error in zip(names, shares.mean(axis=0), errors, strict=True)
        },
    )


def assert_hardly_any(bias: Bias, most: float) -> None:
    assert np.abs(bias.mean).max() < 0.3, bias
    for name, (share, error) in bias.classes.items():
        # What 64 seeds leave open is not held against the frames.
        assert abs(share) < most + 2.0 * error, (name, bias)


def test_small_frames_have_no_bias_that_shows():
    scene, camera = plants_shot()
    camera = replace(camera, sensor=replace(camera.sensor, columns=88, rows=66))
    bias = bias_of(scene, camera, seeds=SEEDS, reference_frames=1, least_pixels=150)
    assert len(bias.classes) >= 4, bias
    assert_hardly_any(bias, 0.015)


@pytest.mark.long
def test_standard_frames_have_no_bias_that_shows():
    # The standard scene, a quarter as wide and high.
    stage = FrameRenderer(load_recipe("barth2018"))
    shot = stage.recipe.plan.frame(125)
    camera = stage.camera(shot)
    sensor = replace(camera.sensor, columns=200, rows=150, binning=4 * camera.sensor.binning)
    scene = stage.scene(shot)
    bias = bias_of(scene, replace(camera, sensor=sensor), seeds=SEEDS, reference_frames=1, least_pixels=100)
    assert len(bias.classes) >= 4, bias
    assert_hardly_any(bias, 0.01)

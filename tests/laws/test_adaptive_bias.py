"""Adaptive sampling and denoising cause no visible bias.

Samples that depend on earlier ones bias means, and a denoiser redistributes light; both are hidden by the
noise of a single frame. The mean over 64 seeds of standard frames is compared with a reference of many
samples in every pixel, six bounces and no denoiser, in codes after the tone curve: less than .3 in the mean
of each colour, and 1 % in the light of every class. The smoothing that remains in pixels is reported.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera, camera_rgb, correct_colours
from pepperscene.classes import OrganClass
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Quality, Renderer
from pepperscene.scene import Scene

SEEDS = 64


@dataclass(frozen=True)
class Bias:
    """The error of the mean of frames.

    Attributes:
        mean: `(3,)` in codes, signed.
        rms: in codes over the image, without noise.
        classes: relative error of a class's light and its standard error, by name.
    """

    mean: np.ndarray
    rms: float
    classes: dict[str, tuple[float, float]]


def unrounded_codes(electrons: np.ndarray, camera: Camera) -> np.ndarray:
    """Codes of the image without rounding (IEC 61966-2-1)."""
    smooth = replace(camera, developing=replace(camera.developing, quantise=False))
    value = np.clip(correct_colours(camera_rgb(electrons, smooth), smooth).astype(float), 0.0, 1.0)
    toe = value <= 0.0031308
    return 255.0 * np.where(toe, 12.92 * value, 1.055 * np.maximum(value, 1e-3) ** (1 / 2.4) - 0.055)


def measure_bias(
    scene: Scene, camera: Camera, *, seeds: int, reference_frames: int, least_pixels: int
) -> Bias:
    """Measure the bias of standard frames.

    Args:
        scene: of the frames.
        camera: of the frames.
        seeds: number of frames.
        reference_frames: of 256 samples per pixel, for each half of the reference.
        least_pixels: of a class that is compared.
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
        unrounded_codes(mean, camera) - unrounded_codes(half, camera)
        for mean, half in zip(sums, halves, strict=True)
    )
    expected = np.array([np.mean([half[classes == k].mean() for half in halves]) for k in names])
    relative = np.array(by_class) / expected - 1.0
    errors = relative.std(axis=0, ddof=1) / np.sqrt(seeds)
    return Bias(
        mean=0.5 * (first + second).mean(axis=(0, 1)),
        rms=float(np.sqrt(max((first * second).mean(), 0.0))),
        classes={
            OrganClass(k).name: (float(bias), float(error))
            for k, bias, error in zip(names, relative.mean(axis=0), errors, strict=True)
        },
    )


def assert_invisible(bias: Bias, most: float) -> None:
    assert np.abs(bias.mean).max() < 0.3, bias
    for name, (relative, error) in bias.classes.items():
        # Within the noise of 64 seeds.
        assert abs(relative) < most + 2.0 * error, (name, bias)


@pytest.mark.long
def test_standard_frames_have_no_visible_bias():
    # The standard scene at a quarter of the resolution.
    frames = FrameRenderer(load_recipe("barth2018"))
    spec = frames.recipe.plan.frame(125)
    camera = frames.camera(spec)
    sensor = replace(camera.sensor, columns=200, rows=150, binning=4 * camera.sensor.binning)
    scene = frames.scene(spec)
    bias = measure_bias(
        scene, replace(camera, sensor=sensor), seeds=SEEDS, reference_frames=1, least_pixels=100
    )
    assert len(bias.classes) >= 4, bias
    assert_invisible(bias, 0.01)

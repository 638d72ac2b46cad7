"""Adaptive sampling and denoising cause no visible bias.

Samples that depend on earlier ones bias means, and a denoiser redistributes light; both are hidden by the
noise of a single frame. The mean over 64 seeds of standard frames is compared with a reference of many
samples in every pixel, six bounces and no denoiser, in codes after the tone curve: less than .3 in the mean
of each colour, and 1 % in the light of every class. The smoothing that remains in pixels is reported.
"""

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera, camera_rgb, correct_colours
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Renderer

SEEDS = 64


def unrounded_codes(electrons: np.ndarray, camera: Camera) -> np.ndarray:
    """Codes of the image without rounding (IEC 61966-2-1)."""
    smooth = replace(camera, developing=replace(camera.developing, quantise=False))
    value = np.clip(correct_colours(camera_rgb(electrons, smooth), smooth).astype(float), 0.0, 1.0)
    toe = value <= 0.0031308
    return 255.0 * np.where(toe, 12.92 * value, 1.055 * np.maximum(value, 1e-3) ** (1 / 2.4) - 0.055)


@pytest.mark.long
def test_standard_frames_have_no_visible_bias():
    # The standard scene at a quarter of the resolution; classes of at least 100 pixels.
    frames = FrameRenderer(load_recipe("barth2018"))
    spec = frames.recipe.plan.frame(125)
    camera = frames.camera(spec)
    sensor = replace(camera.sensor, columns=200, rows=150, binning=4 * camera.sensor.binning)
    renderer, camera = Renderer(frames.scene(spec)), replace(camera, sensor=sensor)
    classes = renderer.render(camera, ["class"])["class"]
    kinds = [k for k in np.unique(classes).tolist() if (classes == k).sum() >= 100]
    assert len(kinds) >= 4

    def light(quality: str, seed: int) -> np.ndarray:
        return renderer.render(camera, ["electrons"], quality, seed)["electrons"].astype(float)

    halves = [light("reference", seed) for seed in (1000, 2000)]
    sums, by_class = [0.0, 0.0], []
    for seed in range(SEEDS):
        frame = light("standard", seed)
        sums[seed % 2] = sums[seed % 2] + frame / (SEEDS // 2)
        by_class.append([frame[classes == k].mean() for k in kinds])
    first, second = (
        unrounded_codes(mean, camera) - unrounded_codes(half, camera)
        for mean, half in zip(sums, halves, strict=True)
    )
    # Root mean square over pixels without noise, from two halves of frames and of the reference.
    details = f"mean {0.5 * (first + second).mean(axis=(0, 1))}, rms {np.mean(first * second) ** 0.5}"
    assert np.abs(0.5 * (first + second).mean(axis=(0, 1))).max() < 0.3, details
    expected = np.array([np.mean([half[classes == k].mean() for half in halves]) for k in kinds])
    relative = np.array(by_class) / expected - 1.0
    error = relative.std(axis=0, ddof=1) / np.sqrt(SEEDS)
    assert (np.abs(relative.mean(axis=0)) < 0.01 + 2.0 * error).all(), details

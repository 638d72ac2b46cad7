"""A renderer with a known error and run time."""

from __future__ import annotations

import numpy as np

from pepperscene.frame import Frame
from pepperscene.render import QUALITIES


class NoisyRenderer:
    """Renders a constant with noise that falls with the root of the samples; its clock advances with them."""

    level_e, noise_e = 2_000.0, 200.0

    def __init__(self, scene):
        self.scene = scene
        self.now = 0.0
        self.calls = []

    def render(self, camera, outputs=(), quality="standard", seed=0):
        quality = QUALITIES[quality] if isinstance(quality, str) else quality
        self.calls.append((camera, quality, seed))
        self.now += 0.01 * quality.samples
        shape = (camera.height, camera.width, camera.sensor.channels)
        noise = np.random.default_rng(seed).normal(size=shape) * self.noise_e / np.sqrt(quality.samples)
        image = (self.level_e + noise).astype(np.float32)
        return Frame({"electrons": image}, {"variant": "noisy", "sampling": {"samples_per_pixel": 1.0}})

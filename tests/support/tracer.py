"""Traced light of one scene and camera, without a renderer."""

from __future__ import annotations

from pepperscene.camera import Camera
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene, sky_tables
from pepperscene.render.transport.accumulate import TracedLight
from pepperscene.render.transport.lights import FrameTables, frame_tables
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.scene import Scene


class Tracer:
    def __init__(self, scene: Scene, camera: Camera) -> None:
        self.camera = camera
        self.response = spectral_response(camera, scene)
        grid = self.response.grid_nm
        self.scene = light_scene(scene, float(grid[0]), float(grid[-1]))
        self.sky, self.rays = sky_tables(scene, grid), camera_rays(camera)

    def light(self, samples: int, indirect: int, required=None, seed: int = 3) -> TracedLight:
        """The light from a number of samples, and of samples of indirect light, with two bounces."""
        sampling = Sampling(samples, indirect, 2, required)
        return trace(self.scene, self.rays, self.response, self.camera.flash, self.sky, sampling, seed)

    def tables(self) -> FrameTables:
        return frame_tables(self.scene, self.rays, self.response, self.camera.flash, self.sky)

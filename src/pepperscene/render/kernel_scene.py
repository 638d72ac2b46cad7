"""A scene in the kernel's memory, kept between frames, and the tracing of light in it."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, Motion, Projector
from pepperscene.render.arrays import LocalCoordinates, local_coordinates
from pepperscene.render.kernel.camera import (
    CameraRays,
    SpectralResponse,
    camera_rays,
    moving_rays,
    spectral_response,
)
from pepperscene.render.kernel.scene import LightScene, check_surfaces, light_scene, sky_tables, truth_scene
from pepperscene.render.kernel.split_scene import SplitScene
from pepperscene.render.quality import Quality, check_depth_camera_quality
from pepperscene.render.reference.path_tracer import (
    PathScene,
    exposed_paths,
    path_scene,
    path_traced,
    samples_taken,
)
from pepperscene.render.transport.adaptive import AdaptiveSampler
from pepperscene.render.transport.denoise import denoised_indirect
from pepperscene.render.transport.path_lengths import (
    has_mainly_daylight,
    has_mainly_sun,
    needs_long_paths,
    surface_triangles,
)
from pepperscene.render.transport.projection import PROJECTED_SAMPLES, projected_light
from pepperscene.render.transport.strips import LightPart, trace_in_strips
from pepperscene.render.transport.trace import ExposurePart, Sampling, exposure_parts, frame_light, trace
from pepperscene.scene import Scene, Sky

TracedSignal = tuple[NDArray[np.float32], dict[str, Any]]
"""Light `(h, w, c)` in electrons s-1 m-2 sr-1, and the description of its samples for the metadata."""


class KernelScene:
    """A scene with what the kernel needs of it, made when first used.

    Args:
        scene: everything that can be seen.
        geometry: its triangles in parts, if they are in the kernel already.
    """

    def __init__(self, scene: Scene, geometry: SplitScene | None = None) -> None:
        self.scene = scene
        self._parts = geometry
        # The last kernel scene of each kind, by its arguments.
        self._light: dict[tuple[float, float], LightScene] = {}
        self._imagers: dict[tuple[float, float], LightScene] = {}
        self._path: dict[tuple[float, float, bool, Sky | None], PathScene] = {}
        self._slopes: dict[tuple[Any, ...], Any] = {}

    def trace(
        self, camera: Camera, quality: Quality, sampling: np.random.SeedSequence, scene: Scene
    ) -> TracedSignal:
        """Trace light with the integrator of the quality; `scene` is this one, under any sky.

        Raises:
            ValueError: the scene has no surfaces.
        """
        check_surfaces(scene)
        response = spectral_response(camera, scene)
        if not needs_long_paths(scene, response, self._surface_triangles):
            quality = dataclasses.replace(quality, most_bounces=0)
        has_daylight = scene.sky is not None or response.lamps is not None
        parts = exposure_parts(camera, has_daylight=has_daylight)
        if quality.integrator == "flash":
            return self._trace_samples(camera, quality, parts, response, sampling, scene)
        if parts:
            # The mean of images of cameras that stand still.
            signal, samples = exposed_paths(scene, camera, quality, sampling)
            return signal, {"samples_per_pixel": samples}
        return self._trace_paths(camera, quality, response, int(sampling.generate_state(1)[0]), scene)

    def _trace_samples(
        self,
        camera: Camera,
        quality: Quality,
        parts: list[ExposurePart],
        response: SpectralResponse,
        sampling: np.random.SeedSequence,
        scene: Scene,
    ) -> TracedSignal:
        """Trace light with our integrator: all together, or the parts of an exposure one by one."""
        grid, lights, response_without_lamps = response.grid_nm, [], dataclasses.replace(response, lamps=None)
        light_scene, sky = self.light_scene(float(grid[0]), float(grid[-1])), sky_tables(scene, grid)
        if response.by_band:
            quality = dataclasses.replace(quality, directions=0)  # bands are traced along paths
        quality = quality.for_light(mainly_daylight=has_mainly_daylight(scene, response))
        together: list[ExposurePart | None] = [None]
        streams, still = sampling.spawn(len(parts)) if parts else [sampling], self.rays(camera)
        for part, stream in zip(parts or together, streams, strict=True):
            motion = camera.motion or Motion()
            rays = still if part is None else moving_rays(still, motion, part.windows)
            light = frame_light(
                light_scene,
                rays,
                response if part is None or part.has_daylight else response_without_lamps,
                camera.flash if part is None or part.has_flash else None,
                sky if part is None or part.has_daylight else None,
                (quality.bounces, quality.most_bounces),
                int(stream.generate_state(1)[0]),
                quality.gathering(camera.width * camera.height, mainly_sun=has_mainly_sun(scene, response)),
            )
            lights.append(LightPart(light, None if part is None else part.share))
        return trace_in_strips(camera, quality, lights, is_divided=bool(parts))

    def imager_light(
        self,
        camera: Camera,
        projector: Projector | None,
        quality: Quality,
        sampling: np.random.SeedSequence,
        scene: Scene,
    ) -> TracedSignal:
        """Trace the light of an imager of a depth camera; a projector's place is in the imager's axes.

        The projector shines during the exposure, so all lights are traced together. Its light that is
        scattered more than once is that of a projector without dots.

        Raises:
            ArgumentError: the quality has another integrator than "flash".
            ValueError: the scene has no surfaces.
        """
        check_depth_camera_quality(quality)
        check_surfaces(scene)
        lit = camera if projector is None else dataclasses.replace(camera, flash=projector.flood())
        response = spectral_response(lit, scene)
        if not needs_long_paths(scene, response, self._surface_triangles):
            quality = dataclasses.replace(quality, most_bounces=0)
        # The light of imagers is traced along paths.
        quality = dataclasses.replace(quality, directions=0)
        quality = quality.for_light(mainly_daylight=projector is None)
        adaptive = AdaptiveSampler(camera, quality.target, quality.most, denoised=quality.denoise)
        light_scene = self.imager_scene(float(response.grid_nm[0]), float(response.grid_nm[-1]))
        rays = self.rays(camera)
        if camera.is_moving:
            rays = moving_rays(rays, camera.motion or Motion(), camera.shutter.exposures())
        seeds = sampling.generate_state(2).tolist()
        sky = sky_tables(scene, response.grid_nm)
        light = trace(light_scene, rays, response, lit.flash, sky, _sampling(quality, adaptive), seeds[0])
        signal = light.sky_and_sun + (denoised_indirect(light) if quality.denoise else light.indirect)
        if projector is not None:
            samples = max(quality.samples, PROJECTED_SAMPLES)
            signal += projected_light(light_scene, rays, response, projector, samples, seeds[1])
        return signal, adaptive.metadata(light)

    def _trace_paths(
        self, camera: Camera, quality: Quality, response: SpectralResponse, seed: int, scene: Scene
    ) -> TracedSignal:
        """Trace light with Mitsuba's path tracer."""
        grid = response.grid_nm
        # Here the sky is part of the kernel scene.
        key = (float(grid[0]), float(grid[-1]), camera.flash is not None, scene.sky)
        if key not in self._path:
            self._path = {key: path_scene(scene, camera)}
        signal = path_traced(
            scene,
            camera,
            spp=quality.samples,
            bounces=max(quality.bounces, quality.most_bounces),
            sampler=quality.sampler,
            seed=seed,
            kernel_scene=self._path[key],
        )
        return signal, {"samples_per_pixel": float(samples_taken(quality.sampler, quality.samples))}

    def any_light_scene(self, camera: Camera, scene: Scene) -> LightScene:
        """Geometry and materials over some wavelengths: those in memory, or those that a frame needs.

        `scene` is this one, under any sky.

        Raises:
            ValueError: the scene has no surfaces.
        """
        for light in self._light.values():
            return light
        check_surfaces(scene)
        grid = spectral_response(camera, scene).grid_nm
        return self.light_scene(float(grid[0]), float(grid[-1]))

    def rays(self, camera: Camera) -> CameraRays:
        """Rays of a camera; along a path only the pose changes, so the lens stays on the device."""
        sensor, matrix = camera.sensor, camera.intrinsics.tobytes()
        key = (camera.lens, camera.width, camera.height, sensor.name, sensor.line_scan, matrix)
        rays = camera_rays(camera, self.coordinates, self._slopes.get(key))
        self._slopes = {key: rays.slopes}
        return rays

    @functools.cached_property
    def coordinates(self) -> LocalCoordinates:
        """Of the scene in the kernel."""
        return local_coordinates(self.scene.mesh)

    @functools.cached_property
    def _surface_triangles(self) -> NDArray[np.int64]:
        return surface_triangles(self.scene)

    @functools.cached_property
    def _geometry(self) -> Any:
        if self._parts is not None and self._parts.coordinates == self.coordinates:
            return self._parts
        return truth_scene(self.scene)

    def truth_scene(self) -> Any:
        """A Mitsuba scene to intersect: the one with materials if it exists."""
        for light in (*self._light.values(), *self._imagers.values()):
            return light.scene
        return self._geometry

    def light_scene(self, first_nm: float, last_nm: float) -> LightScene:
        """Geometry and materials over a range of wavelengths, in nanometres."""
        key = (first_nm, last_nm)
        if key not in self._light:
            self._light = {key: light_scene(self.scene, *key)}
            # It serves the ground truth as well, so a copy of the geometry alone is not needed any more.
            self.__dict__.pop("_geometry", None)
        return self._light[key]

    def imager_scene(self, first_nm: float, last_nm: float) -> LightScene:
        """As `light_scene`, for the imagers of a depth camera or meters of light, beside that of the camera.

        Both are kept, because a frame traces both, and making one takes as long as a draft.
        """
        key = (first_nm, last_nm)
        if key in self._light:
            return self._light[key]
        if key not in self._imagers:
            self._imagers = {key: light_scene(self.scene, *key)}
        return self._imagers[key]


def _sampling(quality: Quality, adaptive: AdaptiveSampler) -> Sampling:
    bounces, most = quality.bounces, quality.most_bounces
    return Sampling(quality.samples, quality.soft, bounces, adaptive.required, most)

"""Render a scene and a camera to a frame; only what the requested outputs need is computed."""

from __future__ import annotations

import functools
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, develop, expected_electrons, raw_frame
from pepperscene.errors import InputError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, STEREO_OUTPUTS, Frame, check_outputs
from pepperscene.render.aov import labels
from pepperscene.render.kernel.arrays import LocalCoordinates, local_coordinates
from pepperscene.render.kernel.camera import CameraRays, camera_rays, spectral_response
from pepperscene.render.kernel.scene import LightScene, light_scene, sky_tables, truth_scene
from pepperscene.render.quality import Quality, resolve_quality
from pepperscene.render.reference.path_tracer import PathScene, path_scene, path_traced, samples_taken
from pepperscene.render.transport.adaptive import AdaptiveSampler
from pepperscene.render.transport.denoise import denoised
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.render.variant import mitsuba_modules, variant_name
from pepperscene.scene import Scene
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.render.aov.coverage import SceneCoverage
    from pepperscene.render.aov.harvest import SceneHarvest

TracedSignal = tuple[NDArray[np.float32], dict[str, Any]]
"""Light `(h, w, c)` in electrons s-1 m-2 sr-1, and the description of its samples for the metadata."""


def render_scene(
    scene: Scene,
    camera: Camera,
    outputs: Iterable[str] = DEFAULT_OUTPUTS,
    quality: str | Quality = "standard",
    seed: int = 0,
    target_error: float | None = None,
    others: Mapping[str, Camera] | None = None,
) -> Frame:
    """Render one frame of a scene; for several frames of the same scene keep a `Renderer`.

    Args:
        scene: everything that can be seen.
        camera: lens, sensor, flash and pose.
        outputs: names out of `OUTPUTS`.
        quality: one of `QUALITIES` by name, or a `Quality`.
        seed: of light transport and sensor noise.
        target_error: override the quality's target: the standard error of a pixel's light over the sensor
            noise at which sampling stops.
        others: further cameras of the same scene: "flow", the target of the output `flow` (without it there
            is no flow), and "stereo", the partner of `stereo` and `colour_stereo`.

    Raises:
        InputError: unknown output or quality, target out of range, or missing partner.
        SetupError: no JIT variant of Mitsuba runs on this machine.
    """
    return Renderer(scene).render(camera, outputs, quality, seed, target_error, others)


class Renderer:
    """Renders frames of a scene, and keeps it in the kernel between them.

    Args:
        scene: everything that can be seen.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        # The last kernel scene of each kind, by its arguments.
        self._light: dict[tuple[float, float], LightScene] = {}
        self._path: dict[tuple[float, float, bool], PathScene] = {}
        self._slopes: dict[tuple[Any, ...], Any] = {}

    def render(
        self,
        camera: Camera,
        outputs: Iterable[str] = DEFAULT_OUTPUTS,
        quality: str | Quality = "standard",
        seed: int = 0,
        target_error: float | None = None,
        others: Mapping[str, Camera] | None = None,
    ) -> Frame:
        """Render one frame; see `render_scene`."""
        requested = check_outputs(outputs)
        others = _check_others(requested, others or {})
        quality = resolve_quality(quality, target_error)
        images: dict[str, Any] = {}
        described: dict[str, Any] = {}

        # Light first: its kernel scene then serves the ground truth as well.
        if any(OUTPUTS[name].traced and name not in STEREO_OUTPUTS for name in requested):
            noise, sampling = np.random.SeedSequence(seed).spawn(2)
            signal, described["sampling"] = self._trace(camera, quality, sampling)
            images |= _photographs(requested, signal, camera, noise)
        if "colour_stereo" in requested:
            # The third branch of the frame's seed gives the partner its own noise and samples.
            noise, sampling = np.random.SeedSequence(seed).spawn(3)[2].spawn(2)
            partner = others["stereo"]
            signal, described["sampling_stereo"] = self._trace(partner, quality, sampling)
            images["colour_stereo"] = _photographs(("colour",), signal, partner, noise)["colour"]
        if set(requested) & STEREO_OUTPUTS:
            described["stereo_pose"] = others["stereo"].pose.tolist()

        # Ground truth, from one ray through each pixel.
        instances: dict[str, dict[str, Any]] = {}
        if any(not OUTPUTS[name].traced for name in requested):
            rays = self._rays(camera)
            hits = labels.first_hits(self._truth_scene(), rays)
            instance = labels.instance_ids(self.scene.mesh, hits)
            images |= labels.label_outputs(self.scene.mesh, hits, instance, camera, requested)
            instances = labels.visible_instances(self.scene.mesh, instance)
            if "coverage" in requested:
                images["coverage"] = self._coverage.image(self._truth_scene(), rays)
            for name in [name for name in ("flow", "stereo") if name in requested]:
                from pepperscene.render.aov.flow import optical_flow

                mitsuba_scene = self._truth_scene(), self._coordinates
                images[name] = optical_flow(*mitsuba_scene, hits, camera, others.get(name))
            if "harvest" in requested:
                images["harvest"] = self._harvest.truth(camera, rays, hits, instance)
        metadata = {"camera": camera.metadata(), "seed": seed, "variant": variant_name()}
        metadata |= {"versions": _library_versions(), **described, "instances": instances}
        return Frame({name: images[name] for name in requested}, metadata)

    def _trace(self, camera: Camera, quality: Quality, sampling: np.random.SeedSequence) -> TracedSignal:
        """Trace light with the integrator of the quality."""
        seed = int(sampling.generate_state(1)[0])
        trace_with = self._trace_paths if quality.integrator == "path" else self._trace_flash
        return trace_with(camera, quality, seed)

    def _trace_flash(self, camera: Camera, quality: Quality, seed: int) -> TracedSignal:
        """Trace light with our integrator."""
        response = spectral_response(camera, self.scene)
        adaptive = AdaptiveSampler(camera, quality.target, quality.most, denoised=quality.denoise)
        light = trace(
            self._light_scene(float(response.grid_nm[0]), float(response.grid_nm[-1])),
            self._rays(camera),
            response,
            camera.flash,
            sky_tables(self.scene, response.grid_nm),
            Sampling(quality.samples, quality.soft, quality.bounces, adaptive.required),
            seed,
        )
        signal = denoised(light) if quality.denoise else light.total()
        return signal, adaptive.metadata(light)

    def _trace_paths(self, camera: Camera, quality: Quality, seed: int) -> TracedSignal:
        """Trace light with Mitsuba's path tracer."""
        grid = spectral_response(camera, self.scene).grid_nm
        key = (float(grid[0]), float(grid[-1]), camera.flash is not None)
        if key not in self._path:
            self._path = {key: path_scene(self.scene, camera)}
        signal = path_traced(
            self.scene,
            camera,
            spp=quality.samples,
            bounces=quality.bounces,
            sampler=quality.sampler,
            seed=seed,
            kernel_scene=self._path[key],
        )
        return signal, {"samples_per_pixel": float(samples_taken(quality.sampler, quality.samples))}

    def _rays(self, camera: Camera) -> CameraRays:
        """Rays of a camera; along a path only the pose changes, so the lens stays on the device."""
        key = (camera.lens, camera.width, camera.height, camera.sensor.name, camera.intrinsics.tobytes())
        rays = camera_rays(camera, self._coordinates, self._slopes.get(key))
        self._slopes = {key: rays.slopes}
        return rays

    @functools.cached_property
    def _coordinates(self) -> LocalCoordinates:
        return local_coordinates(self.scene.mesh)

    @functools.cached_property
    def _geometry(self) -> Any:
        return truth_scene(self.scene)

    def _truth_scene(self) -> Any:
        """A Mitsuba scene to intersect: the one with materials if it exists."""
        for light in self._light.values():
            return light.scene
        return self._geometry

    def _light_scene(self, first_nm: float, last_nm: float) -> LightScene:
        key = (first_nm, last_nm)
        if key not in self._light:
            self._light = {key: light_scene(self.scene, *key)}
        return self._light[key]

    @functools.cached_property
    def _coverage(self) -> SceneCoverage:
        from pepperscene.render.aov.coverage import SceneCoverage

        return SceneCoverage(self.scene.mesh)

    @functools.cached_property
    def _harvest(self) -> SceneHarvest:
        from pepperscene.render.aov.harvest import SceneHarvest

        return SceneHarvest(self.scene)


def _check_others(requested: tuple[str, ...], others: Mapping[str, Camera]) -> Mapping[str, Camera]:
    """Reject unknown names of other cameras, and a missing stereo partner."""
    for name in others:
        if name not in ("flow", "stereo"):
            raise InputError("others", "unknown camera; allowed are flow, stereo", key=name)
    partnered = [name for name in requested if name in STEREO_OUTPUTS]
    if partnered and "stereo" not in others:
        raise InputError("others", f"the output {partnered[0]} needs this camera", key="stereo")
    return others


def _photographs(
    requested: tuple[str, ...], signal: NDArray[np.float32], camera: Camera, noise: np.random.SeedSequence
) -> dict[str, NDArray[Any]]:
    """The camera's outputs from the light that reaches its pixels."""
    electrons = expected_electrons(signal, camera)
    images: dict[str, NDArray[Any]] = {"electrons": electrons.astype(np.float32)}
    # Both start from the same generator state: the image is developed from exactly this raw frame.
    if "raw" in requested:
        images["raw"] = raw_frame(electrons, camera, np.random.default_rng(noise))
    if "colour" in requested:
        images["colour"] = develop(electrons, camera, np.random.default_rng(noise))
    return images


@functools.cache
def _library_versions() -> dict[str, str]:
    """Versions of all libraries that the numbers of a frame depend on."""
    mi, dr = mitsuba_modules()
    versions = {"pepperscene": __version__, "python": platform.python_version(), "mitsuba": mi.__version__}
    versions |= {name: version(name) for name in ("drjit", "numpy", "pyoidn")}
    if mi.variant().startswith("llvm"):
        versions["llvm"] = ".".join(str(part) for part in dr.detail.llvm_version())
    return versions

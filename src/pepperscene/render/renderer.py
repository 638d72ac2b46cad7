"""From a scene and a camera to a frame; nothing is computed that no output asks for."""

from __future__ import annotations

import functools
import platform
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, develop, expected_electrons, raw_frame, reference_correction
from pepperscene.errors import InputError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, PARTNERED, Frame, check_outputs
from pepperscene.render.aov import labels
from pepperscene.render.kernel.arrays import LocalCoordinates, local_coordinates
from pepperscene.render.kernel.camera import CameraRays, LensCache, response
from pepperscene.render.kernel.scene import LightScene, light_scene, sky_tables, truth_scene
from pepperscene.render.quality import Quality, resolve_quality
from pepperscene.render.reference.path_tracer import PathScene, path_scene, path_traced, samples_taken
from pepperscene.render.transport.adaptive import AdaptiveSampler
from pepperscene.render.transport.denoise import denoised
from pepperscene.render.transport.denoise import preload_denoiser as begin_denoising
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.render.variant import mitsuba_modules, variant_name
from pepperscene.scene import Scene
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.render.aov.coverage import Coverage
    from pepperscene.render.aov.harvest import Harvest


def warm_up(camera: Camera, quality: Quality) -> threading.Thread:
    """Mitsuba, the denoiser and the camera's colour matrix begin in a thread of their own, which is returned.

    Nothing depends on it but the time: what fails there fails again, and is told, where it is first needed.

    Args:
        camera: whose pictures will be developed.
        quality: of them.
    """

    def work() -> None:
        for step in _steps(camera, quality):
            with suppress(Exception):
                step()

    # No daemon: a process that ends meanwhile must not pull the libraries from under it.
    thread = threading.Thread(target=work, name="start of the renderer")
    thread.start()
    return thread


def _steps(camera: Camera, quality: Quality) -> Iterator[Callable[[], Any]]:
    yield mitsuba_modules
    if quality.denoise:
        yield begin_denoising
    if camera.sensor.channels > 1 and camera.developing.colour_matrix is True:
        yield lambda: reference_correction(camera)


Traced = tuple[NDArray[np.float32], dict[str, Any]]
"""Light `(h, w, c)` in electrons s-1 m-2 sr-1, and what a frame's facts say of its samples."""


def render_scene(
    scene: Scene,
    camera: Camera,
    outputs: Iterable[str] = DEFAULT_OUTPUTS,
    quality: str | Quality = "standard",
    seed: int = 0,
    target_error: float | None = None,
    others: Mapping[str, Camera] | None = None,
) -> Frame:
    """One frame of a scene; for several frames of the same scene keep a `Renderer`.

    Args:
        scene: what stands where.
        camera: lens, sensor, flash and pose.
        outputs: names of `OUTPUTS`.
        quality: one of `QUALITIES` by name, or one of your own.
        seed: of light transport and of the sensor's noise.
        target_error: standard error of a pixel's light over the sensor's noise at which sampling stops,
            instead of the quality's.
        others: cameras that look at the same scene: "flow", the one that the output `flow` leads to (without
            it there is no flow), and "stereo", the partner of `stereo` and `colour_stereo`.

    Raises:
        InputError: unknown output or quality, a target out of range, or a partner that is missing.
        SetupError: no JIT variant of Mitsuba runs here.
    """
    return Renderer(scene).render(camera, outputs, quality, seed, target_error, others)


class Renderer:
    """A scene inside the kernel, where it lives on from frame to frame with its compiled code."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._lens = LensCache()
        self._truth: Any = None
        self._light: LightScene | None = None
        self._light_range: tuple[float, float] | None = None
        self._path: tuple[tuple[float, float, bool], PathScene] | None = None
        self._coverage: Coverage | None = None
        self._harvest: Harvest | None = None

    def render(
        self,
        camera: Camera,
        outputs: Iterable[str] = DEFAULT_OUTPUTS,
        quality: str | Quality = "standard",
        seed: int = 0,
        target_error: float | None = None,
        others: Mapping[str, Camera] | None = None,
    ) -> Frame:
        """One frame; see `render`."""
        wanted = check_outputs(outputs)
        onto = _examined(wanted, others or {})
        effort = resolve_quality(quality, target_error)
        view = self._lens.view(camera, self._region)
        images: dict[str, Any] = {}
        told: dict[str, Any] = {}
        # Light first: its scene then serves the ground truth as well.
        if any(OUTPUTS[name].traced and name not in PARTNERED for name in wanted):
            noise, sampling = np.random.SeedSequence(seed).spawn(2)
            signal, told["sampling"] = self._light_through(view, camera, effort, sampling)
            images |= _photographs(wanted, signal, camera, noise)
        if "colour_stereo" in wanted:
            # Noise and samples of its own: a third branch of the frame's seed.
            noise, sampling = np.random.SeedSequence(seed).spawn(3)[2].spawn(2)
            partner = onto["stereo"]
            beside = self._lens.view(partner, self._region)
            signal, told["sampling_stereo"] = self._light_through(beside, partner, effort, sampling)
            images["colour_stereo"] = _photographs(("colour",), signal, partner, noise)["colour"]
        if set(wanted) & PARTNERED:
            told["stereo_pose"] = onto["stereo"].pose.tolist()
        seen: dict[str, dict[str, Any]] = {}
        if any(not OUTPUTS[name].traced for name in wanted):
            hits = labels.first_hits(self._truth_scene(), view)
            instance = labels.instance_ids(self.scene.mesh, hits)
            images |= labels.label_outputs(self.scene.mesh, hits, instance, camera, wanted)
            seen = labels.instances_in_view(self.scene.mesh, instance)
            if "coverage" in wanted:
                images["coverage"] = self._covered().image(self._truth_scene(), view)
            for name in [name for name in wanted if name in ("flow", "stereo")]:
                images[name] = self._motion(hits, camera, onto.get(name))
            if "harvest" in wanted:
                images["harvest"] = self._harvested().truth(camera, view, hits, instance)
        facts = {**self._facts(camera, seed), **told, "instances": seen}
        return Frame({name: images[name] for name in wanted}, facts)

    # --- passes -----------------------------------------------------------------------------------------

    def _light_through(
        self, view: CameraRays, camera: Camera, quality: Quality, sampling: np.random.SeedSequence
    ) -> Traced:
        """Light by the integrator that the quality asks for."""
        number = int(sampling.generate_state(1)[0])
        trace_with = self._path_traced if quality.integrator == "path" else self._traced
        return trace_with(view, camera, quality, number)

    def _motion(self, hits: labels.Hits, camera: Camera, other: Camera | None) -> NDArray[np.float32]:
        """Where what is hit lies for another camera."""
        from pepperscene.render.aov.flow import nowhere, optical_flow

        if other is None:
            return nowhere(hits)
        return optical_flow(self._truth_scene(), self._region, hits, camera, other)

    def _traced(self, view: CameraRays, camera: Camera, quality: Quality, seed: int) -> Traced:
        """Light by our own integrator, and what is to be said of its samples."""
        spectral = response(camera, self.scene)
        stop = AdaptiveSampler(camera, quality.target, quality.most, denoised=quality.denoise)
        light = trace(
            self._light_scene(float(spectral.grid_nm[0]), float(spectral.grid_nm[-1])),
            view,
            spectral,
            camera.flash,
            sky_tables(self.scene, spectral.grid_nm),
            Sampling(quality.samples, quality.soft, quality.bounces, stop.wanted),
            seed,
        )
        signal = denoised(light) if quality.denoise else light.total()
        return signal, stop.achieved(light)

    def _path_traced(self, view: CameraRays, camera: Camera, quality: Quality, seed: int) -> Traced:
        """Light by Mitsuba's own path tracer."""
        grid = response(camera, self.scene).grid_nm
        lit_by = (float(grid[0]), float(grid[-1]), camera.flash is not None)
        if self._path is None or self._path[0] != lit_by:
            self._path = (lit_by, path_scene(self.scene, camera))
        signal = path_traced(
            self.scene,
            camera,
            spp=quality.samples,
            bounces=quality.bounces,
            sampler=quality.sampler,
            seed=seed,
            kernel_scene=self._path[1],
        )
        return signal, {"samples_per_pixel": float(samples_taken(quality.sampler, quality.samples))}

    # --- scenes, made when first needed -----------------------------------------------------------------

    @functools.cached_property
    def _region(self) -> LocalCoordinates:
        return local_coordinates(self.scene.mesh)

    def _truth_scene(self) -> Any:
        """Any Mitsuba scene will do for hits: the one with materials where it is there already."""
        if self._light is not None:
            return self._light.scene
        if self._truth is None:
            self._truth = truth_scene(self.scene)
        return self._truth

    def _light_scene(self, first_nm: float, last_nm: float) -> LightScene:
        if self._light is None or self._light_range != (first_nm, last_nm):
            self._light = light_scene(self.scene, first_nm, last_nm)
            self._light_range = (first_nm, last_nm)
        return self._light

    def _covered(self) -> Coverage:
        """The classes of the scene's triangles inside the kernel."""
        if self._coverage is None:
            from pepperscene.render.aov.coverage import Coverage

            self._coverage = Coverage(self.scene.mesh)
        return self._coverage

    def _harvested(self) -> Harvest:
        """What the harvest truth keeps of the scene."""
        if self._harvest is None:
            from pepperscene.render.aov.harvest import Harvest

            self._harvest = Harvest(self.scene)
        return self._harvest

    # --- facts ------------------------------------------------------------------------------------------

    def _facts(self, camera: Camera, seed: int) -> dict[str, Any]:
        return {
            "camera": camera.metadata(),
            "seed": seed,
            "variant": variant_name(),
            "versions": {
                "pepperscene": __version__,
                "python": platform.python_version(),
                **_library_versions(),
            },
        }


def _examined(wanted: tuple[str, ...], others: Mapping[str, Camera]) -> Mapping[str, Camera]:
    """The other cameras, unless one that is needed is missing, or is none that is known."""
    for name in others:
        if name not in ("flow", "stereo"):
            raise InputError("others", "is no camera that is asked for; allowed are flow, stereo", key=name)
    missing = [name for name in wanted if name in PARTNERED]
    if missing and "stereo" not in others:
        raise InputError("others", f"must be a partner's camera for the output {missing[0]}", key="stereo")
    return others


def _photographs(
    wanted: tuple[str, ...], signal: NDArray[np.float32], camera: Camera, noise: np.random.SeedSequence
) -> dict[str, NDArray[Any]]:
    """What the camera makes of the light that reaches its pixels."""
    electrons = expected_electrons(signal, camera)
    images: dict[str, NDArray[Any]] = {"electrons": electrons.astype(np.float32)}
    # The same generator twice: the raw frame is the very one that the picture is developed from.
    if "raw" in wanted:
        images["raw"] = raw_frame(electrons, camera, np.random.default_rng(noise))
    if "colour" in wanted:
        images["colour"] = develop(electrons, camera, np.random.default_rng(noise))
    return images


@functools.cache
def _library_versions() -> dict[str, str]:
    """The versions of all that a frame's numbers pass through."""
    mi, dr = mitsuba_modules()
    found = {name: metadata.version(name) for name in ("drjit", "numpy", "pyoidn")}
    if mi.variant().startswith("llvm"):
        found["llvm"] = ".".join(str(part) for part in dr.detail.llvm_version())
    return {"mitsuba": mi.__version__, **found}

"""From a scene and a camera to a frame; nothing is computed that no output asks for."""

from __future__ import annotations

import functools
import platform
from collections.abc import Iterable
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, develop, expected_electrons, raw_frame
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, Frame, check_outputs
from pepperscene.render import labels
from pepperscene.render.denoise import denoised
from pepperscene.render.kernel import LightScene, light_scene, sky_tables, truth_scene
from pepperscene.render.quality import Quality, quality_named
from pepperscene.render.region import region_of
from pepperscene.render.response import response
from pepperscene.render.transport import Sampling, trace
from pepperscene.render.variant import kernel, variant_name
from pepperscene.render.view import LensCache, View
from pepperscene.scene import Scene
from pepperscene.version import __version__


def render(
    scene: Scene,
    camera: Camera,
    outputs: Iterable[str] = DEFAULT_OUTPUTS,
    quality: str = "standard",
    seed: int = 0,
) -> Frame:
    """One frame of a scene; for several frames of the same scene keep a `Renderer`.

    Args:
        scene: what stands where.
        camera: lens, sensor, flash and pose.
        outputs: names of `OUTPUTS`.
        quality: one of `QUALITIES`.
        seed: of light transport and of the sensor's noise.

    Raises:
        InputError: unknown output or quality.
        SetupError: no JIT variant of Mitsuba runs here.
    """
    return Renderer(scene).render(camera, outputs, quality, seed)


class Renderer:
    """A scene inside the kernel, where it lives on from frame to frame with its compiled code."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._lens = LensCache()
        self._truth: Any = None
        self._light: LightScene | None = None
        self._light_range: tuple[float, float] | None = None

    def render(
        self,
        camera: Camera,
        outputs: Iterable[str] = DEFAULT_OUTPUTS,
        quality: str = "standard",
        seed: int = 0,
    ) -> Frame:
        """One frame; see `render`."""
        wanted = check_outputs(outputs)
        effort = quality_named(quality)
        view = self._lens.view(camera, region_of(self.scene.mesh))
        images: dict[str, NDArray[Any]] = {}
        # Light first: its scene then serves the ground truth as well.
        if any(OUTPUTS[name].traced for name in wanted):
            images |= self._photographs(wanted, view, camera, effort, seed)
        seen: dict[str, dict[str, Any]] = {}
        if any(not OUTPUTS[name].traced for name in wanted):
            hits = labels.first_hits(self._truth_scene(), view)
            instance = labels.instance_ids(self.scene.mesh, hits)
            images |= labels.truths(self.scene.mesh, hits, instance, camera, wanted)
            seen = labels.instances_in_view(self.scene.mesh, instance)
        facts = {**self._facts(camera, seed), "instances": seen}
        return Frame({name: images[name] for name in wanted}, facts)

    # --- passes -----------------------------------------------------------------------------------------

    def _photographs(
        self, wanted: tuple[str, ...], view: View, camera: Camera, quality: Quality, seed: int
    ) -> dict[str, NDArray[Any]]:
        spectral = response(camera, self.scene)
        noise, sampling = np.random.SeedSequence(seed).spawn(2)
        light = trace(
            self._light_scene(float(spectral.grid_nm[0]), float(spectral.grid_nm[-1])),
            view,
            spectral,
            camera.flash,
            sky_tables(self.scene, spectral.grid_nm),
            Sampling(quality.samples, quality.soft, quality.bounces),
            int(sampling.generate_state(1)[0]),
        )
        signal = denoised(light) if quality.denoise else light.total()
        electrons = expected_electrons(signal, camera)
        images: dict[str, NDArray[Any]] = {"electrons": electrons.astype(np.float32)}
        # The same generator twice: the raw frame is the very one that the picture is developed from.
        if "raw" in wanted:
            images["raw"] = raw_frame(electrons, camera, np.random.default_rng(noise))
        if "colour" in wanted:
            images["colour"] = develop(electrons, camera, np.random.default_rng(noise))
        return images

    # --- scenes, made when first needed -----------------------------------------------------------------

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

    # --- facts ------------------------------------------------------------------------------------------

    def _facts(self, camera: Camera, seed: int) -> dict[str, Any]:
        return {
            "camera": camera.facts(),
            "seed": seed,
            "variant": variant_name(),
            "versions": {
                "pepperscene": __version__,
                "python": platform.python_version(),
                **_library_versions(),
            },
        }


@functools.cache
def _library_versions() -> dict[str, str]:
    """The versions of all that a frame's numbers pass through."""
    mi, dr = kernel()
    found = {name: metadata.version(name) for name in ("drjit", "numpy", "pyoidn")}
    if mi.variant().startswith("llvm"):
        found["llvm"] = ".".join(str(part) for part in dr.detail.llvm_version())
    return {"mitsuba": mi.__version__, **found}

"""Render a scene and a camera to a frame; only what the requested outputs need is computed."""

from __future__ import annotations

import dataclasses
import functools
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import (
    Camera,
    ChosenExposure,
    DepthCamera,
    ExposureControl,
    WhiteReference,
    choose_exposure,
    develop,
    image_electrons,
    raw_frame,
    with_exposure,
)
from pepperscene.errors import ArgumentError, InputError
from pepperscene.frame import Frame
from pepperscene.outputs import (
    BAND_OUTPUTS,
    DEFAULT_OUTPUTS,
    DEPTH_CAMERA_OUTPUTS,
    OUTPUTS,
    STEREO_OUTPUTS,
    TRAIT_OUTPUTS,
    check_band_outputs,
    check_outputs,
)
from pepperscene.render.aov import labels
from pepperscene.render.aov.label_strips import label_images
from pepperscene.render.kernel.camera import label_rays
from pepperscene.render.kernel_scene import KernelScene
from pepperscene.render.metering import metered_light
from pepperscene.render.quality import Quality, check_depth_camera_quality, resolve_quality
from pepperscene.render.variant import mitsuba_modules, variant_name
from pepperscene.scene import Scene, Sky
from pepperscene.truth.amodal import amodal_truth
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.render.aov.coverage import SceneCoverage
    from pepperscene.render.aov.harvest import SceneHarvest
    from pepperscene.render.aov.isolated import IsolatedOrgans
    from pepperscene.render.aov.traits import SceneTraits

FrameSky = Sky | Literal["scene"] | None
"""The sky of a frame, None for a frame without daylight, or "scene" for the sky of the scene."""


def render_scene(
    scene: Scene,
    camera: Camera,
    outputs: Iterable[str] = DEFAULT_OUTPUTS,
    quality: str | Quality = "standard",
    seed: int = 0,
    target_error: float | None = None,
    others: Mapping[str, Camera] | None = None,
    depth_camera: DepthCamera | None = None,
    white_reference: WhiteReference | None = None,
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
        depth_camera: of `depth_sensor` and the other `DEPTH_CAMERA_OUTPUTS`, at its pose.
        white_reference: of `reflectance`; None for a panel of 0.99 half a metre in front of the camera.

    Raises:
        InputError: unknown output or quality, target out of range, missing partner or depth camera.
        SetupError: no JIT variant of Mitsuba runs on this machine.
    """
    return Renderer(scene).render(
        camera,
        outputs,
        quality,
        seed,
        target_error,
        others,
        depth_camera=depth_camera,
        white_reference=white_reference,
    )


class Renderer:
    """Renders frames of a scene, and keeps it in the kernel between them.

    Args:
        scene: everything that can be seen.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._kernel = KernelScene(scene)

    def render(
        self,
        camera: Camera,
        outputs: Iterable[str] = DEFAULT_OUTPUTS,
        quality: str | Quality = "standard",
        seed: int = 0,
        target_error: float | None = None,
        others: Mapping[str, Camera] | None = None,
        *,
        sky: FrameSky = "scene",
        exposure_control: ExposureControl | None = None,
        depth_camera: DepthCamera | None = None,
        white_reference: WhiteReference | None = None,
    ) -> Frame:
        """Render one frame; see `render_scene` for the other arguments.

        `sky` replaces the sky of the scene, None removes it, and "scene" keeps it; the geometry stays on the
        device in all cases. With `exposure_control`, exposure time and gain are chosen
        automatically for `camera`, and used for the other cameras too; only where light is traced.
        `white_reference` is that of the output `reflectance`, by default the default one.

        Raises:
            InputError: as `render_scene`; or the camera's gain is above the highest of `exposure_control`, or
                its sensor does not have an output.
            SetupError: as `render_scene`.
        """
        requested = check_outputs(outputs)
        check_band_outputs(requested, camera.sensor.name, has_bands=camera.sensor.pattern == "bands")
        others = _check_others(requested, others or {})
        depths = DEPTH_CAMERA_OUTPUTS.intersection(requested)
        if depths and depth_camera is None:
            raise ArgumentError("depth_camera", f"is required for the output {min(depths)}")
        bands = BAND_OUTPUTS.intersection(requested)
        quality = resolve_quality(quality, target_error)
        if depths:
            check_depth_camera_quality(quality)
        scene = self._under(sky)
        images: dict[str, Any] = {}
        described: dict[str, Any] = {}

        # Labels do not depend on the exposure, nor does the depth camera.
        own = set(requested) - depths
        if exposure_control is not None and any(OUTPUTS[name].traced for name in own):
            chosen = self.meter(camera, exposure_control, seed, sky, quality)
            camera = with_exposure(camera, chosen)
            others = {name: with_exposure(other, chosen) for name, other in others.items()}
            target = {"target_grey": exposure_control.target_grey}
            described["auto_exposure"] = target | dataclasses.asdict(chosen)

        # Light first: its kernel scene then serves the ground truth as well.
        if any(OUTPUTS[name].traced for name in own - STEREO_OUTPUTS):
            noise, sampling = np.random.SeedSequence(seed).spawn(2)
            signal, described["sampling"] = self._kernel.trace(camera, quality, sampling, scene)
            if "radiance" in bands:
                from pepperscene.render.band_images import radiance_image

                images["radiance"] = radiance_image(signal, camera)
            # What bands measure follows from their electrons.
            names = (*requested, "electrons") if bands else requested
            images |= _photographs(names, signal, camera, noise)
            del signal  # large
            if bands:
                from pepperscene.render.band_images import measured_images

                panel, electrons = white_reference or WhiteReference(), images["electrons"]
                measured = measured_images(bands, electrons, camera, scene, panel, noise)
                images |= measured[0]
                described |= measured[1]
        if "colour_stereo" in requested:
            # The third branch of the frame's seed gives the partner its own noise and samples.
            noise, sampling = np.random.SeedSequence(seed).spawn(3)[2].spawn(2)
            partner = others["stereo"]
            signal, described["sampling_stereo"] = self._kernel.trace(partner, quality, sampling, scene)
            images["colour_stereo"] = _photographs(("colour",), signal, partner, noise)["colour"]
        if depths and depth_camera is not None:
            from pepperscene.render.depth_sensor import depth_camera_images

            # The fourth branch of the frame's seed.
            seeds = np.random.SeedSequence(seed).spawn(4)[3]
            measured = depth_camera_images(self._kernel, scene, camera, depth_camera, depths, quality, seeds)
            images |= measured[0]
            described |= measured[1]
        if set(requested) & STEREO_OUTPUTS:
            described["stereo_pose"] = others["stereo"].pose.tolist()

        # Ground truth, from one ray through each pixel.
        instances: dict[str, dict[str, Any]] = {}
        if any(not OUTPUTS[name].traced for name in requested):
            rays = label_rays(self._kernel.rays(camera), camera)
            if "albedo" in requested:
                from pepperscene.render.aov.albedo import albedo_image

                # Before the first hits, which then use its kernel scene.
                kernel_scene = self._kernel.any_light_scene(camera, scene)
                images["albedo"] = albedo_image(kernel_scene, scene, camera, rays)
            kernel_scene, coordinates = self._kernel.truth_scene(), self._kernel.coordinates
            traits = self._traits if TRAIT_OUTPUTS.intersection(requested) else None
            seen = label_images(
                self.scene.mesh, kernel_scene, coordinates, rays, camera, requested, others, traits
            )
            images |= seen.images
            instances = labels.visible_instances(self.scene.mesh, seen.instance)
            if "coverage" in requested:
                images["coverage"] = self._coverage.image(self._kernel.truth_scene(), rays)
            if "harvest" in requested:
                images["harvest"] = self._harvest.truth(camera, rays, seen.distance, seen.instance)
            if "amodal" in requested:
                visible = labels.visible_organs(instances)
                masks = self._organs.amodal_masks(visible, camera, rays, seen.instance)
                images["amodal"] = amodal_truth(masks, seen.instance, self.scene.mesh.instances)
        metadata = {"camera": camera.to_metadata(), "seed": seed, "variant": variant_name()}
        metadata |= {"versions": _library_versions(), **described, "instances": instances}
        return Frame({name: images[name] for name in requested}, metadata)

    def visible_points(
        self,
        camera: Camera,
        points: NDArray[np.float64],
        normals: NDArray[np.float64] | None = None,
        *,
        alone: int | None = None,
    ) -> NDArray[np.bool_]:
        """`(n,)` whether `(n, 3)` points are in a camera's image and not hidden; see `PointTest`."""
        from pepperscene.render.visibility import visible_points

        if alone is None:
            return visible_points(
                self._kernel.truth_scene(), self._kernel.coordinates, camera, points, normals
            )
        organ = self._organs.of([alone])[alone].scene
        return visible_points(organ, self._kernel.coordinates, camera, points, normals, has_borders=False)

    def meter(
        self,
        camera: Camera,
        control: ExposureControl,
        seed: int = 0,
        sky: FrameSky = "scene",
        quality: str | Quality = "standard",
    ) -> ChosenExposure:
        """Choose the exposure of a frame, from the light of a reduced image of it.

        Args:
            camera: its exposure has no effect; its gain is the lowest that is used.
            control: the wanted grey and the allowed settings.
            seed: of the frame.
            sky: as of `render`.
            quality: of the frame; only its bounces matter.

        Raises:
            InputError: the camera's gain is above the highest allowed.
            SetupError: no JIT variant of Mitsuba runs on this machine.
        """
        quality = resolve_quality(quality)
        light = metered_light(
            self._under(sky),
            self._kernel.light_scene,
            self._kernel.coordinates,
            camera,
            seed,
            quality.bounces,
            quality.most_bounces,
        )
        return choose_exposure(camera, *light, control)

    def _under(self, sky: FrameSky) -> Scene:
        """The scene under the sky of a frame."""
        return self.scene if isinstance(sky, str) else dataclasses.replace(self.scene, sky=sky)

    @functools.cached_property
    def _coverage(self) -> SceneCoverage:
        from pepperscene.render.aov.coverage import SceneCoverage

        return SceneCoverage(self.scene.mesh)

    @functools.cached_property
    def _traits(self) -> SceneTraits:
        from pepperscene.render.aov.traits import SceneTraits

        return SceneTraits(self.scene)

    @functools.cached_property
    def _harvest(self) -> SceneHarvest:
        from pepperscene.render.aov.harvest import SceneHarvest

        return SceneHarvest(self.scene, self._organs)

    @functools.cached_property
    def _organs(self) -> IsolatedOrgans:
        from pepperscene.render.aov.isolated import IsolatedOrgans

        return IsolatedOrgans(self.scene.mesh)


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
    """The camera's outputs from the light that reaches its pixels; that of a large image is overwritten."""
    electrons = image_electrons(signal, camera)
    images: dict[str, NDArray[Any]] = {}
    if "electrons" in requested:
        images["electrons"] = electrons.astype(np.float32, copy=False)
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

"""Render a scene and a camera to a frame; only what the requested outputs need is computed."""

from __future__ import annotations

import dataclasses
import functools
import platform
from collections.abc import Iterable
from importlib.metadata import version
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import (
    Camera,
    ChosenExposure,
    ExposureControl,
    Partners,
    choose_exposure,
    metering_camera,
    with_exposure,
)
from pepperscene.errors import InputError
from pepperscene.frame import Frame
from pepperscene.outputs import (
    DEFAULT_OUTPUTS,
    DEPTH_CAMERA_OUTPUTS,
    METER_OUTPUTS,
    OUTPUTS,
    STEREO_OUTPUTS,
    check_outputs,
)
from pepperscene.render.aov.label_images import SceneLabels
from pepperscene.render.kernel.camera import label_rays
from pepperscene.render.kernel.split_scene import SplitScene
from pepperscene.render.kernel_scene import KernelScene
from pepperscene.render.metering import metered_light, metered_subject
from pepperscene.render.photographs import photographs
from pepperscene.render.quality import Quality, check_depth_camera_quality, resolve_quality
from pepperscene.render.ray_casting import cast_rays
from pepperscene.render.variant import mitsuba_modules, variant_name
from pepperscene.scene import Scene, Sky
from pepperscene.truth.harvest import FruitTruth
from pepperscene.version import __version__

_ALONE: Final = Partners()

FrameSky = Sky | Literal["scene"] | None
"""The sky of a frame, None for a frame without daylight, or "scene" for the sky of the scene."""


def render_scene(
    scene: Scene,
    camera: Camera,
    outputs: Iterable[str] = DEFAULT_OUTPUTS,
    quality: str | Quality = "standard",
    seed: int = 0,
    target_error: float | None = None,
    partners: Partners = _ALONE,
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
        partners: further devices of the frame, which some outputs need.

    Raises:
        InputError: unknown output or quality, target out of range, missing partner or depth camera.
        SetupError: no JIT variant of Mitsuba runs on this machine.
    """
    return Renderer(scene).render(camera, outputs, quality, seed, target_error, partners)


@dataclasses.dataclass(frozen=True, eq=False)
class _Request:
    """The arguments of a frame, resolved."""

    requested: tuple[str, ...]
    camera: Camera
    partners: Partners
    quality: Quality
    seed: int
    scene: Scene  # under the sky of the frame

    def seeds(self, branch: int) -> np.random.SeedSequence:
        """A branch: 0 noise, 1 samples, 2 both of the partner, 3 of the depth camera, 4 of the meters."""
        return np.random.SeedSequence(self.seed).spawn(branch + 1)[branch]


_Made = tuple[dict[str, Any], dict[str, Any]]
"""Outputs by name, and entries of the metadata."""


class Renderer:
    """Renders frames of a scene, and keeps it in the kernel between them.

    Args:
        scene: everything that can be seen.
        geometry: its triangles in parts, if they are in the kernel already.
    """

    def __init__(self, scene: Scene, geometry: SplitScene | None = None) -> None:
        self.scene = scene
        self._kernel = KernelScene(scene, geometry)
        self._labels = SceneLabels(self._kernel)

    def render(
        self,
        camera: Camera,
        outputs: Iterable[str] = DEFAULT_OUTPUTS,
        quality: str | Quality = "standard",
        seed: int = 0,
        target_error: float | None = None,
        partners: Partners = _ALONE,
        *,
        sky: FrameSky = "scene",
        exposure_control: ExposureControl | ChosenExposure | None = None,
    ) -> Frame:
        """Render one frame; see `render_scene` for the other arguments.

        `sky` replaces the sky of the scene, None removes it, and "scene" keeps it; the geometry stays on the
        device in all cases. With `exposure_control`, exposure time and gain are chosen
        automatically for `camera`, unless it has them, and used for its stereo partner too; only where light
        is traced.

        Raises:
            InputError: as `render_scene`; or the camera's gain is above the highest of `exposure_control`, or
                its sensor does not have an output.
            SetupError: as `render_scene`.
        """
        requested = check_outputs(outputs)
        camera.sensor.check_outputs(requested)
        _check_partners(requested, partners)
        quality = resolve_quality(quality, target_error)
        if DEPTH_CAMERA_OUTPUTS.intersection(requested):
            check_depth_camera_quality(quality)
        described: dict[str, Any] = {}
        # Labels do not depend on the exposure, nor does the depth camera.
        if exposure_control is not None and _traced(requested) - DEPTH_CAMERA_OUTPUTS:
            if isinstance(exposure_control, ChosenExposure):
                chosen, target = exposure_control, {}
            else:
                chosen = self.meter(camera, exposure_control, seed, sky, quality)
                target = {"target_grey": exposure_control.target_grey}
            camera, partners = with_exposure(camera, chosen), _with_exposure(partners, chosen)
            described["auto_exposure"] = target | chosen.to_json()

        request = _Request(requested, camera, partners, quality, seed, self._under(sky))
        images: dict[str, Any] = {}
        # Light first: its kernel scene then serves the ground truth as well.
        light = self._photographs, self._stereo_photograph, self._depth_images, self._metered_light
        for make in (*light, self._ground_truth):
            made, notes = make(request)
            images |= made
            described |= notes
        metadata: dict[str, Any] = {"camera": camera.to_metadata(), "seed": seed, "variant": variant_name()}
        metadata |= {"versions": _library_versions(), **described}
        if request.camera.lamps or request.scene.lamps:
            placed = (("camera", request.camera.lamps), ("world", request.scene.lamps))
            metadata["lamps"] = [
                {"fixed": fixed, **lamp.to_metadata()} for fixed, lamps in placed for lamp in lamps
            ]
        metadata.setdefault("instances", {})
        return Frame({name: images[name] for name in requested}, metadata)

    def _photographs(self, request: _Request) -> _Made:
        """What the camera measures of the light."""
        if not _traced(request.requested) - DEPTH_CAMERA_OUTPUTS - STEREO_OUTPUTS:
            return {}, {}
        camera, scene = request.camera, request.scene
        signal, sampling = self._kernel.trace(camera, request.quality, request.seeds(1), scene)
        panel = request.partners.white_reference
        images, described = photographs(request.requested, signal, camera, scene, panel, request.seeds(0))
        return images, {"sampling": sampling, **described}

    def _stereo_photograph(self, request: _Request) -> _Made:
        """The photograph of the stereo partner, with noise and samples of its own, and the partner's pose."""
        partner, scene = request.partners.stereo, request.scene
        if partner is None or not STEREO_OUTPUTS.intersection(request.requested):
            return {}, {}
        described: dict[str, Any] = {"stereo_pose": partner.pose.tolist()}
        if "colour_stereo" not in request.requested:
            return {}, described
        noise, sampling = request.seeds(2).spawn(2)
        signal, described["sampling_stereo"] = self._kernel.trace(partner, request.quality, sampling, scene)
        panel = request.partners.white_reference
        images, _ = photographs(("colour",), signal, partner, scene, panel, noise)
        return {"colour_stereo": images["colour"]}, described

    def _depth_images(self, request: _Request) -> _Made:
        """What the depth camera measures."""
        names, depth = DEPTH_CAMERA_OUTPUTS.intersection(request.requested), request.partners.depth
        if not names or depth is None:
            return {}, {}
        from pepperscene.render.depth_sensor import depth_camera_images

        kernel, scene, quality = self._kernel, request.scene, request.quality
        return depth_camera_images(kernel, scene, request.camera, depth, names, quality, request.seeds(3))

    def _metered_light(self, request: _Request) -> _Made:
        """The light that surfaces get."""
        names = [name for name in request.requested if name in METER_OUTPUTS]
        if not names:
            return {}, {}
        from pepperscene.render.aov.light_images import PAR, light_images

        rays, seed = label_rays(self._kernel.rays(request.camera), request.camera), request.seeds(4)
        kernel = self._kernel.imager_scene(PAR.first_nm, PAR.last_nm)
        return light_images(kernel, request.scene, rays, names, int(seed.generate_state(1)[0])), {}

    def _ground_truth(self, request: _Request) -> _Made:
        """What rays through the pixels find, and the instances in view."""
        if all(OUTPUTS[name].traced or name in METER_OUTPUTS for name in request.requested):
            return {}, {}
        images, instances = self._labels.images(
            request.requested, request.camera, request.partners, request.scene
        )
        return images, {"instances": instances}

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
        organ = self._labels.organs.of([alone])[alone].scene
        return visible_points(organ, self._kernel.coordinates, camera, points, normals, has_borders=False)

    def cast_rays(
        self, origins: ArrayLike, directions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """The distance of the first surface that each ray meets, and its triangle; see `cast_rays`."""
        return cast_rays(self._kernel.truth_scene(), self._kernel.coordinates, origins, directions)

    def fruit_truths(self) -> list[FruitTruth]:
        """The truth of all fruit of the scene that have triangles, in world metres; needs its skeleton."""
        return self._labels.harvest.truths()

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
        subject = metered_subject(self._kernel, metering_camera(camera), control)
        return choose_exposure(camera, *light, control, subject)

    def _under(self, sky: FrameSky) -> Scene:
        """The scene under the sky of a frame."""
        return self.scene if isinstance(sky, str) else dataclasses.replace(self.scene, sky=sky)


def _traced(requested: Iterable[str]) -> set[str]:
    """The requested outputs that need light."""
    return {name for name in requested if OUTPUTS[name].traced}


def _check_partners(requested: tuple[str, ...], partners: Partners) -> None:
    """Raise `InputError` if an output needs a partner that is missing."""
    needed = ((partners.stereo, "stereo", STEREO_OUTPUTS), (partners.depth, "depth", DEPTH_CAMERA_OUTPUTS))
    for partner, key, outputs in needed:
        missing = [name for name in requested if name in outputs]
        if partner is None and missing:
            raise InputError("partners", f"the output {missing[0]} needs this camera", key=key)


def _with_exposure(partners: Partners, chosen: ChosenExposure) -> Partners:
    """The partners with the exposure of their camera, except the depth camera."""
    if partners.flow is not None:
        partners = dataclasses.replace(partners, flow=with_exposure(partners.flow, chosen))
    if partners.stereo is not None:
        partners = dataclasses.replace(partners, stereo=with_exposure(partners.stereo, chosen))
    return partners


@functools.cache
def _library_versions() -> dict[str, str]:
    """Versions of all libraries that the numbers of a frame depend on."""
    mi, dr = mitsuba_modules()
    versions = {"pepperscene": __version__, "python": platform.python_version(), "mitsuba": mi.__version__}
    versions |= {name: version(name) for name in ("drjit", "numpy", "pyoidn")}
    if mi.variant().startswith("llvm"):
        versions["llvm"] = ".".join(str(part) for part in dr.detail.llvm_version())
    return versions

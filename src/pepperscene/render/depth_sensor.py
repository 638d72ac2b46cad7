"""What a stereo depth camera measures in a scene: images of both imagers, and the depth matched from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import (
    Camera,
    DepthCamera,
    align_depth,
    choose_exposure,
    develop,
    image_electrons,
    match_depth,
    metering_camera,
    with_exposure,
)
from pepperscene.render.kernel_scene import KernelScene, TracedSignal
from pepperscene.render.metering import metered_light, metered_subject
from pepperscene.render.quality import Quality
from pepperscene.scene import Scene

_DEPTHS: Final = frozenset({"depth_sensor", "depth_confidence"})


def depth_camera_images(
    kernel: KernelScene,
    scene: Scene,
    camera: Camera,
    depth_camera: DepthCamera,
    requested: Collection[str],
    quality: Quality,
    seeds: np.random.SeedSequence,
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Outputs of a depth camera, and its description for the metadata.

    Args:
        kernel: the scene in the kernel.
        scene: the same under the sky of the frame.
        camera: of the frame, whose pixels the depth is given in.
        depth_camera: at its pose.
        requested: names of outputs.
        quality: of the light.
        seeds: of noise and samples.

    Raises:
        SetupError: OpenCV is not installed, and a depth is requested.
    """
    seed, left_seeds, right_seeds = seeds.spawn(3)
    control, unset = depth_camera.exposure_control, depth_camera.left
    if control is not None:
        depth_camera = depth_camera.with_left(_metered(kernel, scene, depth_camera, quality, seed))

    # Only the imagers that an output needs.
    has_depth = bool(_DEPTHS.intersection(requested))
    offsets = {"imager_left": 0.0, "imager_right": depth_camera.baseline_m}
    views = {
        name: _Imager.at(depth_camera, offset, stream)
        for (name, offset), stream in zip(offsets.items(), (left_seeds, right_seeds), strict=True)
        if has_depth or name in requested or name == "imager_left"
    }
    traced = {name: view.trace(kernel, quality, scene) for name, view in views.items()}
    if control is not None:
        # Now that the dots are known, which are brighter than their mean.
        light = traced["imager_left"][0]
        subject = metered_subject(kernel, views["imager_left"].camera, control)
        chosen = choose_exposure(unset, light, np.zeros_like(light), control, subject)
        views = {
            name: dataclasses.replace(view, camera=with_exposure(view.camera, chosen))
            for name, view in views.items()
        }
    pictures = {name: view.picture(traced[name][0]) for name, view in views.items()}

    images: dict[str, NDArray[Any]] = {name: _grey(pictures[name]) for name in views if name in requested}
    if has_depth:
        matched = match_depth(pictures["imager_left"], pictures["imager_right"], depth_camera)
        depth, confidence = align_depth(matched.depth_m, matched.confidence, depth_camera.left, camera)
        images |= {"depth_sensor": depth, "depth_confidence": confidence}
    described = depth_camera.with_left(views["imager_left"].camera).to_metadata()
    described["sampling"] = traced["imager_left"][1]
    return {name: image for name, image in images.items() if name in requested}, {"depth_camera": described}


@dataclasses.dataclass(frozen=True, eq=False)
class _Imager:
    """One imager of a depth camera.

    Attributes:
        camera: at its pose.
        depth_camera: that it belongs to, with the projector at its place in the axes of this imager.
        noise, sampling: seeds of its noise and its samples.
    """

    camera: Camera
    depth_camera: DepthCamera
    noise: np.random.SeedSequence
    sampling: np.random.SeedSequence

    @classmethod
    def at(cls, depth_camera: DepthCamera, right_m: float, seeds: np.random.SeedSequence) -> _Imager:
        """The imager at a distance to the right of the left one."""
        projector = depth_camera.projector
        if projector is not None:
            right, down, forward = projector.offset_m
            projector = dataclasses.replace(projector, offset_m=(right - right_m, down, forward))
        camera = depth_camera.left_with_offset((right_m, 0.0, 0.0))
        return cls(camera, dataclasses.replace(depth_camera, projector=projector), *seeds.spawn(2))

    def trace(self, kernel: KernelScene, quality: Quality, scene: Scene) -> TracedSignal:
        """Its light `(h, w, c)`, and the description of the samples."""
        return kernel.imager_light(self.camera, self.depth_camera.projector, quality, self.sampling, scene)

    def picture(self, signal: NDArray[np.float32]) -> NDArray[np.uint8]:
        """`(h, w, 3)` its developed image of that light, with noise."""
        electrons = image_electrons(signal, self.camera)
        return develop(electrons, self.camera, np.random.default_rng(self.noise))


def _metered(
    kernel: KernelScene,
    scene: Scene,
    depth_camera: DepthCamera,
    quality: Quality,
    seeds: np.random.SeedSequence,
) -> Camera:
    """The left imager with an exposure for the mean light of the projector, and daylight."""
    left, projector, control = depth_camera.left, depth_camera.projector, depth_camera.exposure_control
    assert control is not None
    lit = left if projector is None else dataclasses.replace(left, flash=projector.flood())
    light = metered_light(
        scene,
        kernel.imager_scene,
        kernel.coordinates,
        lit,
        int(seeds.generate_state(1)[0]),
        quality.bounces,
        quality.most_bounces,
    )
    # The projector is on for as long as the imagers are exposed, as daylight is.
    total = light[0] + light[1]
    subject = metered_subject(kernel, metering_camera(left), control)
    return with_exposure(left, choose_exposure(left, total, np.zeros_like(total), control, subject))


def _grey(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """`(h, w)` the mean of the colours, which are equal behind no colour filter."""
    return np.rint(picture.mean(axis=-1)).astype(np.uint8)

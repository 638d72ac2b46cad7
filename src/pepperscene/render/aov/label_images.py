"""Ground truth of whole images: how each output that traces no light is made.

Most follow from the first hits behind the pixels' centres, which are computed in strips of rows, so that
large images take little memory.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, Partners
from pepperscene.camera.sensor.rows import row_strips
from pepperscene.outputs import TRAIT_OUTPUTS
from pepperscene.render.aov import labels
from pepperscene.render.kernel.camera import CameraRays, label_rays
from pepperscene.render.kernel_scene import KernelScene
from pepperscene.scene import Scene
from pepperscene.truth import class_colour, distance_code
from pepperscene.truth.amodal import amodal_truth

if TYPE_CHECKING:
    from pepperscene.render.aov.coverage import SceneCoverage
    from pepperscene.render.aov.harvest import SceneHarvest
    from pepperscene.render.aov.isolated import IsolatedOrgans
    from pepperscene.render.aov.traits import SceneTraits


class SceneLabels:
    """The ground truth of a scene, with what is kept of it between frames, made when first used.

    Args:
        kernel: the scene in the kernel.
    """

    def __init__(self, kernel: KernelScene) -> None:
        self.kernel, self.mesh = kernel, kernel.scene.mesh

    def images(
        self, requested: tuple[str, ...], camera: Camera, partners: Partners, scene: Scene
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """The requested outputs that trace no light, and the instances in view; other names are ignored.

        `scene` is that of the kernel, under the sky of the frame.
        """
        rays = label_rays(self.kernel.rays(camera), camera)
        frame = LabelFrame(self, camera, partners, rays, requested, scene)
        images = {name: make(frame) for name, make in _OF_FRAME.items() if name in requested}
        return images | {name: frame.joined[name] for name in _OF_STRIP if name in requested}, frame.instances

    @cached_property
    def coverage(self) -> SceneCoverage:
        """The classes of the scene's triangles."""
        from pepperscene.render.aov.coverage import SceneCoverage

        return SceneCoverage(self.mesh)

    @cached_property
    def traits(self) -> SceneTraits:
        """The traits of the scene's tissue."""
        from pepperscene.render.aov.traits import SceneTraits

        return SceneTraits(self.kernel.scene)

    @cached_property
    def harvest(self) -> SceneHarvest:
        """The scene's fruit."""
        from pepperscene.render.aov.harvest import SceneHarvest

        return SceneHarvest(self.kernel.scene, self.organs)

    @cached_property
    def organs(self) -> IsolatedOrgans:
        """The scene's organs, each alone."""
        from pepperscene.render.aov.isolated import IsolatedOrgans

        return IsolatedOrgans(self.mesh)


@dataclass(frozen=True, eq=False)
class LabelFrame:
    """One frame, and what its labels are made of.

    Attributes:
        of_scene: what is kept of the scene.
        camera: that takes the image.
        partners: of the camera.
        rays: of the camera's labels.
        requested: names of outputs.
        scene: under the sky of the frame.
    """

    of_scene: SceneLabels
    camera: Camera
    partners: Partners
    rays: CameraRays
    requested: tuple[str, ...]
    scene: Scene

    @cached_property
    def joined(self) -> dict[str, NDArray[Any]]:
        """The requested images that follow from first hits, with instance and distance in any case."""
        names = [name for name in _OF_STRIP if name in (*self.requested, "instance", "distance")]
        images: dict[str, NDArray[Any]] = {}
        for rows in row_strips(self.camera.width, self.camera.height):
            strip = LabelStrip(self, labels.first_hits(self.of_scene.kernel.truth_scene(), self.rays, rows))
            part = {name: _OF_STRIP[name](strip) for name in names}
            if rows.stop - rows.start == self.camera.height:
                return part
            for name, image in part.items():
                if name not in images:
                    images[name] = np.empty((self.camera.height, *image.shape[1:]), image.dtype)
                images[name][rows] = image
        return images

    @cached_property
    def instances(self) -> dict[str, dict[str, Any]]:
        """The instances in view."""
        return labels.visible_instances(self.of_scene.mesh, self.joined["instance"])

    def albedo(self) -> NDArray[Any]:
        """The output `albedo`."""
        from pepperscene.render.aov.albedo import albedo_image

        kernel_scene = self.of_scene.kernel.any_light_scene(self.camera, self.scene)
        return albedo_image(kernel_scene, self.scene, self.camera, self.rays)

    def coverage(self) -> NDArray[np.float16]:
        """The output `coverage`."""
        return self.of_scene.coverage.image(self.of_scene.kernel.truth_scene(), self.rays)

    def harvest(self) -> dict[str, Any]:
        """The output `harvest`."""
        seen = self.joined
        return self.of_scene.harvest.truth(self.camera, self.rays, seen["distance"], seen["instance"])

    def amodal(self) -> dict[str, Any]:
        """The output `amodal`."""
        visible, instance = labels.visible_organs(self.instances), self.joined["instance"]
        masks = self.of_scene.organs.amodal_masks(visible, self.camera, self.rays, instance)
        return amodal_truth(masks, instance, self.of_scene.mesh.instances)


@dataclass(frozen=True, eq=False)
class LabelStrip:
    """Some rows of a frame, with the first hits there."""

    frame: LabelFrame
    hits: labels.Hits

    @cached_property
    def instance(self) -> NDArray[np.uint16]:
        """The output `instance`."""
        return labels.instance_ids(self.frame.of_scene.mesh, self.hits)

    @cached_property
    def classes(self) -> NDArray[np.uint8]:
        """The output `class`."""
        return labels.class_ids(self.frame.of_scene.mesh, self.instance)

    @cached_property
    def traits(self) -> dict[str, NDArray[np.float32]]:
        """The requested ones of `TRAIT_OUTPUTS`."""
        names = TRAIT_OUTPUTS.intersection(self.frame.requested)
        return self.frame.of_scene.traits.images(self.hits, self.frame.camera, names)

    def flow(self, other: Camera | None) -> NDArray[np.float32]:
        """The displacement to another camera; see `optical_flow`."""
        from pepperscene.render.aov.flow import optical_flow

        kernel = self.frame.of_scene.kernel
        return optical_flow(kernel.truth_scene(), kernel.coordinates, self.hits, self.frame.camera, other)


def _trait(strip: LabelStrip, name: str) -> NDArray[np.float32]:
    return strip.traits[name]


_OF_FRAME: Final[Mapping[str, Callable[[LabelFrame], Any]]] = {
    # Before the first hits, which then use its kernel scene.
    "albedo": LabelFrame.albedo,
    "coverage": LabelFrame.coverage,
    "harvest": LabelFrame.harvest,
    "amodal": LabelFrame.amodal,
}
"""Outputs of whole images."""

_OF_STRIP: Final[Mapping[str, Callable[[LabelStrip], NDArray[Any]]]] = {
    "class": lambda strip: strip.classes,
    "class_colour": lambda strip: class_colour(strip.classes),
    "instance": lambda strip: strip.instance,
    "distance": lambda strip: strip.hits.distance,
    "distance_code": lambda strip: distance_code(strip.hits.distance),
    "depth_z": lambda strip: labels.depth_z(strip.hits, strip.frame.camera),
    "normal": lambda strip: labels.normals(strip.frame.of_scene.mesh, strip.hits, strip.frame.camera),
    "position": lambda strip: labels.positions(strip.hits, strip.frame.camera).astype(np.float32),
    "uv": lambda strip: labels.surface_coordinates(strip.frame.of_scene.mesh, strip.hits, strip.frame.camera),
    "flow": lambda strip: strip.flow(strip.frame.partners.flow),
    "stereo": lambda strip: strip.flow(strip.frame.partners.stereo),
    **{name: functools.partial(_trait, name=name) for name in sorted(TRAIT_OUTPUTS)},
}
"""Outputs of the first hits in some rows."""

"""Ground truth of whole images, computed in strips of rows, so that large images take little memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.camera.sensor.rows import row_strips
from pepperscene.geometry import Mesh
from pepperscene.outputs import TRAIT_OUTPUTS
from pepperscene.render.aov import labels
from pepperscene.render.arrays import LocalCoordinates
from pepperscene.render.kernel.camera import CameraRays

if TYPE_CHECKING:
    from pepperscene.render.aov.traits import SceneTraits


@dataclass(frozen=True, eq=False)
class LabelImages:
    """What follows from the first hits of an image.

    Attributes:
        images: the requested outputs by name.
        instance: `(h, w)` see `labels.instance_ids`.
        distance: `(h, w)` see `labels.Hits`.
    """

    images: Mapping[str, NDArray[Any]]
    instance: NDArray[np.uint16]
    distance: NDArray[np.float32]


def label_images(
    mesh: Mesh,
    scene: Any,
    coordinates: LocalCoordinates,
    rays: CameraRays,
    camera: Camera,
    requested: tuple[str, ...],
    others: Mapping[str, Camera],
    traits: SceneTraits | None = None,
) -> LabelImages:
    """Trace first hits and compute outputs: those of `labels.label_outputs`, flow, stereo, and traits.

    Args:
        mesh: of the scene.
        scene: Mitsuba's.
        coordinates: of that scene.
        rays: of the camera's labels.
        camera: that takes the image.
        requested: names of outputs; others are ignored.
        others: the target cameras of `flow` and `stereo`.
        traits: of the scene, if some of them are requested.
    """
    joined: dict[str, NDArray[Any]] = {}
    for rows in row_strips(camera.width, camera.height):
        hits = labels.first_hits(scene, rays, rows)
        instance = labels.instance_ids(mesh, hits)
        part = labels.label_outputs(mesh, hits, instance, camera, (*requested, "instance", "distance"))
        if traits is not None:
            part |= traits.images(hits, camera, TRAIT_OUTPUTS.intersection(requested))
        for target in [name for name in ("flow", "stereo") if name in requested]:
            from pepperscene.render.aov.flow import optical_flow

            part[target] = optical_flow(scene, coordinates, hits, camera, others.get(target))
        if rows.stop - rows.start == camera.height:
            joined = part
            break
        for name, image in part.items():
            if name not in joined:
                joined[name] = np.empty((camera.height, *image.shape[1:]), image.dtype)
            joined[name][rows] = image
    images = {name: image for name, image in joined.items() if name in requested}
    return LabelImages(images, joined["instance"], joined["distance"])

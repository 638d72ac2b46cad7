"""Rerun: recordings with camera, photograph, depth, classes and boxes on a timeline, for its viewer.

Format: https://rerun.io/docs/reference/types. Rerun has pinhole cameras only, so images of a distorting lens
are resampled to the pinhole camera with the same focal lengths and principal point.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, IGNORE_CLASS, IGNORE_COLOUR, OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.dataset.store.images import png_bytes
from pepperscene.export.job import ExportJob, open_groups, sequence_groups
from pepperscene.export.pinhole import PinholeImages
from pepperscene.export.surface import MOST_STEPS, read_colour, read_label, read_surface
from pepperscene.libraries import import_library

TIMELINE: Final = "frame"
RECORDING: Final = "recording.rrd"
_IMAGE: Final = "world/camera/image"
_PLANE_M: Final = 0.1  # chosen: distance from the camera at which the viewer shows its image


def write_rerun(job: ExportJob, folder: Path) -> None:
    """Write `recording.rrd` of each sequence: a scene as one camera of one split sees it.

    The timeline `frame` has the index of each frame. Depths are along the optical axis, in millimetres, 0 for
    none. Boxes are those of the organs that are objects, numbered as in the instance image.
    """
    rerun = import_library("rerun")
    name = job.dataset.info["recipe"]["name"]
    for place, _, frames in open_groups(job, folder, sequence_groups(job)):
        # A fixed id, so that the viewer replaces a recording that is exported again.
        sequence = place.relative_to(folder).as_posix()
        identity = name if sequence == "." else f"{name} {sequence}"
        recording = rerun.RecordingStream(f"pepperscene {name}", recording_id=identity)
        recording.save(place / RECORDING)
        _log_constants(rerun, recording)
        for frame in frames:
            recording.set_time(TIMELINE, sequence=frame.index)
            _log_frame(rerun, recording, frame, job.selection)
        recording.flush()
        recording.disconnect()


def _log_constants(rerun: Any, recording: Any) -> None:
    """Axes of the world, and names and colours of the classes."""
    recording.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    classes = [
        (int(organ_class), organ_class.name.lower(), CLASS_COLOURS[organ_class]) for organ_class in OrganClass
    ]
    classes.append((IGNORE_CLASS, "ignored", IGNORE_COLOUR))
    recording.log("world", rerun.AnnotationContext(classes), static=True)


def _log_frame(rerun: Any, recording: Any, frame: DatasetFrame, selection: Selection) -> None:
    surface = read_surface(frame)
    camera = surface.camera
    matrix, pose = camera.intrinsics, camera.pose
    recording.log("world/camera", rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    recording.log(
        _IMAGE,
        rerun.Pinhole(
            image_from_camera=matrix,
            resolution=[camera.width, camera.height],
            camera_xyz=rerun.ViewCoordinates.RDF,
            image_plane_distance=_PLANE_M,
        ),
    )
    pinhole = PinholeImages(camera)
    colour = frame.content("colour")
    if not pinhole.is_identity:
        colour = png_bytes(pinhole.resample_colour(read_colour(frame, surface)))
    recording.log(f"{_IMAGE}/colour", rerun.EncodedImage(contents=colour, media_type="image/png"))
    per_metre = 1.0 / surface.depth_unit_m
    steps = pinhole.resample(np.rint(per_metre * surface.depth_z), 0.0)
    depth = np.where(steps <= MOST_STEPS, steps, 0.0).astype(np.uint16)
    recording.log(f"{_IMAGE}/depth", rerun.DepthImage(depth, meter=per_metre))
    classes = pinhole.resample(read_label(frame, "class", surface), np.uint8(0))
    recording.log(f"{_IMAGE}/classes", rerun.SegmentationImage(classes))
    instance = pinhole.resample(read_label(frame, "instance", surface), np.uint16(0))
    recording.log(f"{_IMAGE}/boxes", _boxes(rerun, frame, selection, instance))


def _boxes(rerun: Any, frame: DatasetFrame, selection: Selection, instance: NDArray[np.uint16]) -> Any:
    """Boxes of the objects of a frame that are visible in the resampled image."""
    from scipy.ndimage import find_objects

    objects, entries = frame.objects(selection, frame.image("instance")), frame.metadata["instances"]
    slices = find_objects(instance)
    boxes = {value: box for value, box in enumerate(slices, start=1) if box is not None and value in objects}
    corners = [
        (columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
        for rows, columns in boxes.values()
    ]
    return rerun.Boxes2D(
        array=np.array(corners, dtype=float).reshape(-1, 4),
        array_format=rerun.Box2DFormat.XYWH,
        class_ids=[entries[str(value)]["class"] for value in boxes],
        labels=[f"{entries[str(value)]['kind']} {value}" for value in boxes],
        show_labels=False,
    )

"""Rerun recordings, read by Rerun itself."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

IMAGE = "/world/camera/image"
DTYPES = {"depth": np.uint16, "classes": np.uint8}


class Recording:
    """What a recording holds, by frame."""

    def __init__(self, path):
        from rerun import chunk

        self.columns = {}
        for part in chunk.RrdReader(path).stream():
            batch = part.to_record_batch()
            frames = batch.column("frame").to_pylist() if "frame" in batch.schema.names else [None]
            for name in batch.schema.names:
                for frame, value in zip(frames, batch.column(name).to_pylist(), strict=False):
                    self.columns[part.entity_path, name, frame] = value
        self.frames = sorted({key[2] for key in self.columns if key[2] is not None})

    def get(self, entity, name, frame=None):
        return self.columns[entity, name, frame]

    def image(self, name, frame):
        component = {"depth": "DepthImage", "classes": "SegmentationImage"}[name]
        values = self.get(f"{IMAGE}/{name}", f"{component}:buffer", frame)[0]
        width, height = self.size(frame)
        return np.array(values, np.uint8).view(DTYPES[name]).reshape(height, width)

    def colour(self, frame):
        content = bytes(self.get(f"{IMAGE}/colour", "EncodedImage:blob", frame)[0])
        return np.asarray(Image.open(io.BytesIO(content)))

    def size(self, frame):
        """Width and height of the camera's image."""
        return tuple(int(number) for number in self.get(IMAGE, "Pinhole:resolution", frame)[0])

    def camera(self, frame):
        """Intrinsic matrix and pose, from columns."""
        matrix, turn = (
            np.array(self.get(entity, name, frame)[0]).reshape(3, 3).T
            for entity, name in (
                (IMAGE, "Pinhole:image_from_camera"),
                ("/world/camera", "Transform3D:mat3x3"),
            )
        )
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = self.get("/world/camera", "Transform3D:translation", frame)[0]
        return matrix, pose

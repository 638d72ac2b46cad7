"""COCO panoptic: every pixel belongs to exactly one segment.

Format: https://cocodataset.org/#format-data, panoptic segmentation: a PNG whose pixels hold a segment's id
as R + 256 G + 65536 B, and a JSON that tells each segment's category, area and box.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.export.segments import Segment
from pepperscene.dataset.png import png_bytes


def write_panoptic(path: Path, ids: NDArray[np.uint32]) -> None:
    """Write the PNG of `(h, w)` segment ids, which are below 2^24."""
    little = ids.astype("<u4", copy=False)
    path.write_bytes(png_bytes(np.ascontiguousarray(little.view(np.uint8).reshape(*ids.shape, 4)[..., :3])))


def panoptic_record(image: Mapping[str, Any], found: Sequence[Segment]) -> dict[str, Any]:
    """The annotation of a picture.

    The background is stuff. What has an organ's class and is no segment of its own is a crowd, which
    evaluation ignores.
    """
    segments_info = [
        {
            "id": segment.id,
            "category_id": int(segment.organ_class),
            "area": segment.area,
            "bbox": segment.box,
            "iscrowd": int(not segment.is_organ and segment.organ_class != OrganClass.BACKGROUND),
        }
        for segment in found
    ]
    return {"image_id": image["id"], "file_name": image["file_name"], "segments_info": segments_info}

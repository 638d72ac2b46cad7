"""COCO: instances with masks, boxes and attributes of each organ, and panoptic segments.

Format: https://cocodataset.org/#format-data, and pycocotools, which reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.export.job import REST, ExportFrame, ExportJob, import_library
from pepperscene.dataset.store.images import png_bytes

_CENTRE: Final = 0.5
"""Coordinate of the first pixel's centre here; in COCO's keypoints it is 0."""

_FRUIT_KEYS: Final = ("ripeness", "length_m", "diameter_m", "visible_fraction", "truncated")


def write_coco(job: ExportJob, folder: Path) -> None:
    """Write `train/000110.png`, `annotations/instances_train.json` and `panoptic_train.json` per split.

    An annotation is one organ of a plant. The rest of each class (see `ExportFrame.segment_ids`) is one
    annotation with `iscrowd` 1, which evaluation ignores. Category ids are class ids. If all frames have the
    output harvest, fruit get amodal masks and cut points.
    """
    annotations = folder / "annotations"
    annotations.mkdir()
    thing_categories = [_category(organ) for organ in OrganClass if organ != OrganClass.BACKGROUND]
    # COCO declares keypoints per category, so either all frames have them or none.
    harvest = bool(job.common_outputs(["harvest"]))
    if harvest:
        thing_categories[OrganClass.PEPPER - 1] |= {"keypoints": ["cut"], "skeleton": []}
    segmented = [
        {**_category(organ), "isthing": int(organ > 0), "color": list(CLASS_COLOURS[organ])}
        for organ in OrganClass
    ]
    for split, frames in job.frames_by_split():
        images, panoptic_images = folder / split, annotations / f"panoptic_{split}"
        images.mkdir()
        panoptic_images.mkdir()
        with (
            _open_json(
                annotations / f"instances_{split}.json", job.dataset.info, thing_categories
            ) as instances,
            _open_json(annotations / f"panoptic_{split}.json", job.dataset.info, segmented) as panoptic,
        ):
            for frame in frames:
                ids = frame.segment_ids(job.smallest_px)
                segments = find_segments(frame, ids)
                image = _image_record(frame, ids.shape)
                (images / image["file_name"]).write_bytes(frame.content("colour"))
                # The three low bytes of each id are the channels of the panoptic image.
                channels = ids.astype("<u4", copy=False).view(np.uint8).reshape(*ids.shape, 4)[..., :3]
                content = png_bytes(np.ascontiguousarray(channels))
                (panoptic_images / image["file_name"]).write_bytes(content)
                instances.add(image, _instance_records(frame, segments, harvest))
                panoptic.add(image, [_panoptic_record(image, segments)])


@dataclass(frozen=True, eq=False)
class Segment:
    """The pixels of one organ, or of the rest of a class."""

    id: int  # above 0, unique in its image
    organ_class: OrganClass
    entry: Mapping[str, Any]  # of the instance in the frame's JSON; empty for the rest of a class
    mask: dict[str, Any]  # `size` (rows, columns) and `counts`, the run lengths as text
    area: int
    box: tuple[int, int, int, int]  # left, top, width, height

    @property
    def is_crowd(self) -> bool:
        """Whether it is the rest of an organ's class."""
        return not self.entry and self.organ_class != OrganClass.BACKGROUND


def find_segments(frame: ExportFrame, ids: NDArray[np.uint32]) -> list[Segment]:
    """The segments of a frame with its `segment_ids` `(h, w)`, by ascending id."""
    coder = import_library("pycocotools.mask")
    height, width = ids.shape
    lengths = segment_run_lengths(ids)
    masks = coder.frPyObjects(
        [{"size": [height, width], "counts": runs} for runs in lengths.values()], height, width
    )
    boxes = coder.toBbox(masks).astype(int).tolist()
    entries = frame.metadata["instances"]
    segments = []
    for (segment_id, runs), mask, box in zip(lengths.items(), masks, boxes, strict=True):
        entry = entries[str(segment_id)] if segment_id < REST else {}
        organ_class = OrganClass(entry["class"] if entry else segment_id - REST)
        area = sum(runs[1::2])
        segments.append(Segment(segment_id, organ_class, entry, _json_mask(mask), area, tuple(box)))
    return segments


def segment_run_lengths(ids: NDArray[np.integer[Any]]) -> dict[int, list[int]]:
    """COCO's uncompressed run lengths of the mask of every id, by ascending id.

    Run lengths go down the columns, alternating between pixels of other ids and of this one. All masks are
    made in one pass: separate masks would read the image hundreds of times.
    """
    # Runs of equal ids down the columns, sorted by id; those of an id stay in order.
    column = ids.ravel(order="F")
    starts = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1])
    ends = np.concatenate([starts[1:], [column.size]])
    values = column[starts]
    order = np.argsort(values, kind="stable")
    starts, ends, values = starts[order], ends[order], values[order]

    # Gap between a run and the previous one of the same id, or the start of the image.
    first = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    previous_end = np.concatenate([[0], ends[:-1]])
    previous_end[first] = 0
    lengths = np.stack([starts - previous_end, ends - starts], axis=1).ravel()
    last = np.concatenate([first[1:], [len(values)]])
    counts = {}
    for begin, end in zip(first.tolist(), last.tolist(), strict=True):
        after = int(column.size - ends[end - 1])
        counts[int(values[begin])] = [*lengths[2 * begin : 2 * end].tolist(), *([after] if after else [])]
    return counts


def _json_mask(mask: Mapping[str, Any]) -> dict[str, Any]:
    return {"size": [int(side) for side in mask["size"]], "counts": mask["counts"].decode("ascii")}


class _JsonFile:
    """Writer of images and annotations; image records, a few hundred bytes each, stay in memory."""

    def __init__(self, file: IO[str]) -> None:
        self.file, self.images, self.separator = file, list[str](), "\n"

    def add(self, image: Mapping[str, Any], annotations: Iterable[Mapping[str, Any]]) -> None:
        self.images.append(_json_line(image))
        for annotation in annotations:
            self.file.write(self.separator + _json_line(annotation))
            self.separator = ",\n"


@contextmanager
def _open_json(
    path: Path, info: Mapping[str, Any], categories: Sequence[Mapping[str, Any]]
) -> Iterator[_JsonFile]:
    """A JSON file with one record per line: `info`, `licenses`, `categories`, `annotations`, `images`."""
    # Without a date, so that the same frames give the same bytes.
    source = {key: info[key] for key in ("quality", "recipe_sha256", "version") if key in info}
    description = f"pepperscene data set {info['recipe'].get('name', '')}".rstrip()
    head = {"info": {"description": description, **source}, "licenses": [], "categories": categories}
    with path.open("w", encoding="utf-8") as file:
        file.write(f'{_json_line(head)[:-1]},"annotations":[')
        writer = _JsonFile(file)
        yield writer
        file.write('\n],"images":[\n' + ",\n".join(writer.images) + "\n]}\n")


def _json_line(record: Mapping[str, Any]) -> str:
    return json.dumps(record, separators=(",", ":"), allow_nan=False)


def _category(organ_class: OrganClass) -> dict[str, Any]:
    return {"id": int(organ_class), "name": organ_class.name.lower(), "supercategory": "sweet pepper"}


def _image_record(frame: ExportFrame, shape: tuple[int, ...]) -> dict[str, Any]:
    height, width = shape
    return {
        "id": frame.index,
        "file_name": f"{frame.name}.png",
        "width": width,
        "height": height,
        **{key: frame.metadata[key] for key in ("set", "rotation", "step")},
    }


def _annotation_id(index: int, segment_id: int) -> int:
    """Id of an annotation: above 0, unique in the data set, and independent of its other frames."""
    return index * 2 * REST + segment_id


def _instance_records(frame: ExportFrame, segments: Sequence[Segment], harvest: bool) -> list[dict[str, Any]]:
    """One annotation for each visible organ, and one for the rest of each class."""
    fruit = {}
    if harvest:
        fruit = {entry["instance"]: entry for entry in frame.image("harvest")["fruit"]}
    visible = {segment.id for segment in segments}
    records = []
    for segment in segments:
        if segment.organ_class == OrganClass.BACKGROUND:
            continue
        record: dict[str, Any] = {
            "id": _annotation_id(frame.index, segment.id),
            "image_id": frame.index,
            "category_id": int(segment.organ_class),
            "iscrowd": int(segment.is_crowd),
            "area": segment.area,
            "bbox": segment.box,
            "segmentation": segment.mask,
        }
        if entry := segment.entry:
            # The parent is the annotation of the organ that this one grows out of.
            parent = _annotation_id(frame.index, entry["parent"]) if entry["parent"] in visible else None
            attributes = {key: entry[key] for key in ("kind", "plant", "phytomer")}
            record["attributes"] = {**attributes, "instance": segment.id, "parent": parent}
        if harvest and segment.organ_class == OrganClass.PEPPER:
            known = fruit.get(segment.id, {})
            record |= _keypoint((known.get("peduncle") or {}).get("cut"))
            if known:
                record["attributes"] |= _fruit_attributes(known)
        records.append(record)
    return records


def _fruit_attributes(fruit: Mapping[str, Any]) -> dict[str, Any]:
    """Further attributes of a fruit; `amodal` describes its mask without what hides it."""
    coder = import_library("pycocotools.mask")
    mask = coder.frPyObjects(dict(fruit["amodal"]), *fruit["amodal"]["size"])
    amodal = {
        "segmentation": _json_mask(mask),
        "area": int(coder.area(mask)),
        "bbox": [int(value) for value in coder.toBbox(mask)],
    }
    return {**{key: fruit[key] for key in _FRUIT_KEYS if key in fruit}, "amodal": amodal}


def _keypoint(cut: Mapping[str, Any] | None) -> dict[str, Any]:
    """COCO's `keypoints` of a cut: x, y, and 2 if it is visible, 1 if hidden, 0 if outside the image."""
    if cut is None or cut["px"] is None:
        return {"keypoints": [0, 0, 0], "num_keypoints": 0}
    x, y = (round(value - _CENTRE, 2) for value in cut["px"])
    return {"keypoints": [x, y, 2 if cut["visible"] else 1], "num_keypoints": 1}


def _panoptic_record(image: Mapping[str, Any], segments: Sequence[Segment]) -> dict[str, Any]:
    """Annotation of an image. The background is stuff, the rest of an organ's class a crowd."""
    segments_info = [
        {
            "id": segment.id,
            "category_id": int(segment.organ_class),
            "area": segment.area,
            "bbox": segment.box,
            "iscrowd": int(segment.is_crowd),
        }
        for segment in segments
    ]
    return {"image_id": image["id"], "file_name": image["file_name"], "segments_info": segments_info}

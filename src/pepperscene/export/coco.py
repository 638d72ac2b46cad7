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

from pepperscene.classes import OrganClass
from pepperscene.dataset.dataset_frame import IGNORED, REST, DatasetFrame
from pepperscene.dataset.selection import Category, Selection
from pepperscene.dataset.store.images import png_bytes
from pepperscene.dataset.store.recorded_values import crop_name
from pepperscene.export.job import ExportJob
from pepperscene.libraries import import_library
from pepperscene.truth.keypoints import KEYPOINTS, SKELETON, fruit_keypoints

_CENTRE: Final = 0.5
"""Coordinate of the first pixel's centre here; in COCO's keypoints it is 0, and that of the last one is the
number of pixels minus 1. Points nearer to the border than these centres are moved to them: tools that read
COCO take others for points outside the image."""

_METRE_DECIMALS: Final = 6  # as in the harvest truth

_VARIATION_KEYS: Final = ("moment", "twin", "rig_camera", "drawn")
"""Keys of a frame's JSON that only recipes with variation, twins or a rig have."""

_FRUIT_KEYS: Final = ("ripeness", "length_m", "diameter_m")
_WHOLE_KEYS: Final = ("visible_fraction", "truncated")


def write_coco(job: ExportJob, folder: Path) -> None:
    """Write `train/000110.png`, `annotations/instances_train.json` and `panoptic_train.json` per split.

    An annotation is one organ of a plant. The rest of each class (see `DatasetFrame.segment_ids`) is one
    annotation with `iscrowd` 1, which evaluation ignores. Category ids are class ids, of a merged category
    the lowest one; if ripe and unripe fruit are two categories, the rest of the fruit is a crowd of both, and
    void in panoptic images. If all frames have the output harvest, fruit get amodal masks, poses and
    keypoints; if all have the output amodal, all organs get amodal masks.

    The ignored pixels of a frame are one more annotation with `iscrowd` 1 in each category, all with the same
    mask, because evaluation compares only within a category. In panoptic images they are 0: void.
    """
    annotations = folder / "annotations"
    annotations.mkdir()
    crop = crop_name(job.dataset.info)
    thing_categories = [_category_record(category, crop) for category in job.selection.categories]
    # COCO declares keypoints per category, so either all frames have them or none.
    harvest, amodal = (bool(job.common_outputs([output])) for output in ("harvest", "amodal"))
    background = Category("background", frozenset({int(OrganClass.BACKGROUND)}))
    segmented = [
        {
            **_category_record(category, crop),
            "isthing": int(category is not background),
            "color": category.colour,
        }
        for category in (background, *job.selection.categories)
    ]
    if harvest:
        for record, category in zip(thing_categories, job.selection.categories, strict=True):
            if category.has_fruit:
                record |= {"keypoints": KEYPOINTS, "skeleton": SKELETON}
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
                ids = frame.segment_ids(job.selection)
                segments = find_segments(frame, ids, job.selection)
                image = _image_record(frame, ids.shape)
                (images / image["file_name"]).write_bytes(frame.content("colour"))
                # The three low bytes of each id are the channels of the panoptic image.
                void = [segment.id for segment in segments if segment.is_void]
                visible = np.where(np.isin(ids, void), 0, ids).astype("<u4", copy=False)
                channels = visible.view(np.uint8).reshape(*ids.shape, 4)[..., :3]
                content = png_bytes(np.ascontiguousarray(channels))
                (panoptic_images / image["file_name"]).write_bytes(content)
                records = _instance_records(frame, segments, ids.shape, harvest=harvest, amodal=amodal)
                instances.add(image, records)
                panoptic.add(image, [_panoptic_record(image, segments)])


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


def _category_record(category: Category, crop: str) -> dict[str, Any]:
    return {"id": category.id, "name": category.name, "supercategory": crop}


def _image_record(frame: DatasetFrame, shape: tuple[int, ...]) -> dict[str, Any]:
    height, width = shape
    return {
        "id": frame.index,
        "file_name": f"{frame.name}.png",
        "width": width,
        "height": height,
        **{key: frame.metadata[key] for key in ("set", "rotation", "step")},
        **{key: frame.metadata[key] for key in _VARIATION_KEYS if key in frame.metadata},
    }


def _annotation_id(index: int, segment_id: int) -> int:
    """Id of an annotation: above 0, unique in the data set, and independent of its other frames."""
    return index * 2 * REST + segment_id


def _instance_records(
    frame: DatasetFrame, segments: Sequence[Segment], shape: tuple[int, ...], *, harvest: bool, amodal: bool
) -> list[dict[str, Any]]:
    """One annotation for each visible organ of an image `(h, w)`, and one for the rest of each class."""
    fruit, whole_organs = frame.fruit if harvest else {}, frame.whole_organs if amodal else {}
    visible = {segment.id for segment in segments}
    records = []
    for segment in segments:
        if segment.id == IGNORED or segment.is_crowd:
            records += _crowd_records(frame, segment, harvest)
            continue
        if segment.organ_class == OrganClass.BACKGROUND:
            continue
        record = _record(frame, segment, segment.categories[0], segment.id)
        if entry := segment.entry:
            # The parent is the annotation of the organ that this one grows out of.
            parent = _annotation_id(frame.index, entry["parent"]) if entry["parent"] in visible else None
            attributes = {key: entry[key] for key in ("kind", "plant", "phytomer", "far") if key in entry}
            record["attributes"] = {**attributes, "instance": segment.id, "parent": parent}
        if harvest and segment.categories[0].has_fruit:
            known = fruit.get(segment.id, {})
            record |= _keypoints(known, shape)
            if known:
                record["attributes"] |= _fruit_attributes(known)
        # The harvest truth has the same mask of a fruit.
        if segment.id in whole_organs and segment.id not in fruit:
            record["attributes"] |= _whole_attributes(whole_organs[segment.id])
        records.append(record)
    return records


def _record(frame: DatasetFrame, segment: Segment, category: Category, number: int) -> dict[str, Any]:
    """What all annotations have; a `number` above those of instances is that of a crowd."""
    return {
        "id": _annotation_id(frame.index, number),
        "image_id": frame.index,
        "category_id": category.id,
        "iscrowd": int(number >= REST),
        "area": segment.area,
        "bbox": segment.box,
        "segmentation": segment.mask,
    }


def _crowd_records(frame: DatasetFrame, segment: Segment, harvest: bool) -> list[dict[str, Any]]:
    """A crowd annotation in each category that the rest of a class, or the ignored pixels, can have."""
    return [
        _record(frame, segment, category, _crowd_id(segment, category))
        | (_keypoints({}, (1, 1)) if harvest and category.has_fruit else {})
        for category in segment.categories
    ]


def _crowd_id(segment: Segment, category: Category) -> int:
    """Id above those of instances for the crowd of a segment and a category, unique in its image.

    A merged category can have several: ripe fruit and peduncles as one, for example, a crowd of peduncles and
    one of fruit of unknown ripeness.
    """
    if segment.id == IGNORED:
        return IGNORED + category.id
    return REST + 16 * ((segment.organ_class - category.organ_class) % len(OrganClass)) + category.id


def _fruit_attributes(fruit: Mapping[str, Any]) -> dict[str, Any]:
    """Further attributes of a fruit in the harvest truth."""
    attributes = {key: fruit[key] for key in _FRUIT_KEYS if key in fruit} | _whole_attributes(fruit)
    amodal = attributes.pop("amodal")
    if box := fruit.get("box_3d"):
        attributes["distance_m"] = round(float(np.linalg.norm(box["centre"])), _METRE_DECIMALS)
    return {**attributes, "pose": fruit["pose"], "amodal": amodal}


def _whole_attributes(organ: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of an organ with its hidden parts; `amodal` describes its mask without what hides it."""
    coder = import_library("pycocotools.mask")
    mask = coder.frPyObjects(dict(organ["amodal"]), *organ["amodal"]["size"])
    amodal = {
        "segmentation": _json_mask(mask),
        "area": int(coder.area(mask)),
        "bbox": [int(value) for value in coder.toBbox(mask)],
    }
    return {**{key: organ[key] for key in _WHOLE_KEYS}, "amodal": amodal}


def _keypoints(fruit: Mapping[str, Any], shape: tuple[int, ...]) -> dict[str, Any]:
    """COCO's `keypoints`, x, y and visibility of each in one list, of an entry in the harvest truth.

    The `shape` (h, w) is that of the image.
    """
    flat: list[float] = []
    height, width = shape
    points = fruit_keypoints(fruit)
    for x, y, flag in points:
        # Zeros of a point that is unknown.
        flat += (_coordinate(x, width), _coordinate(y, height), flag) if flag else (0, 0, 0)
    return {"keypoints": flat, "num_keypoints": sum(flag > 0 for *_, flag in points)}


def _coordinate(value: float, pixels: int) -> float:
    """COCO's coordinate of a point along a side of so many pixels."""
    return min(max(round(value - _CENTRE, 2), 0.0), pixels - 1.0)


def _panoptic_record(image: Mapping[str, Any], segments: Sequence[Segment]) -> dict[str, Any]:
    """Annotation of an image. The background is stuff, the rest of an organ's class a crowd."""
    segments_info = [
        {
            "id": segment.id,
            "category_id": segment.categories[0].id if segment.categories else int(OrganClass.BACKGROUND),
            "area": segment.area,
            "bbox": segment.box,
            "iscrowd": int(segment.is_crowd),
        }
        for segment in segments
        if not segment.is_void
    ]
    return {"image_id": image["id"], "file_name": image["file_name"], "segments_info": segments_info}


@dataclass(frozen=True, eq=False)
class Segment:
    """The pixels of one organ, of the rest of a class, or all ignored pixels of an image."""

    id: int  # above 0, unique in its image
    organ_class: OrganClass  # the background for ignored pixels
    categories: tuple[Category, ...]  # one for an organ; all possible ones for other segments
    is_void: bool  # whether panoptic images cannot show it, because it may be of several categories or none
    entry: Mapping[str, Any]  # of the instance in the frame's JSON; empty for the rest of a class
    mask: dict[str, Any]  # `size` (rows, columns) and `counts`, the run lengths as text
    area: int
    box: tuple[int, int, int, int]  # left, top, width, height

    @property
    def is_crowd(self) -> bool:
        """Whether it is the rest of an organ's class."""
        return not self.entry and self.organ_class != OrganClass.BACKGROUND


def find_segments(frame: DatasetFrame, ids: NDArray[np.uint32], selection: Selection) -> list[Segment]:
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
        organ_class, categories, is_void = _segment_categories(segment_id, entry, frame, selection)
        area = sum(runs[1::2])
        mask = _json_mask(mask)
        segments.append(Segment(segment_id, organ_class, categories, is_void, entry, mask, area, tuple(box)))
    return segments


def _segment_categories(
    segment_id: int, entry: Mapping[str, Any], frame: DatasetFrame, selection: Selection
) -> tuple[OrganClass, tuple[Category, ...], bool]:
    """`organ_class`, `categories` and `is_void` of a segment."""
    if segment_id == IGNORED:
        return OrganClass.BACKGROUND, selection.categories, True
    if not entry:
        rest = OrganClass(segment_id - REST)
        is_void = rest != OrganClass.BACKGROUND and selection.category(rest) is None
        return rest, selection.possible(rest), is_void
    organ_class = OrganClass(entry["class"])
    category = selection.category(organ_class, frame.fruit_for(selection).get(segment_id))
    return organ_class, () if category is None else (category,), False


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
    """A mask of pycocotools with its run lengths as text, which JSON can hold."""
    return {"size": [int(side) for side in mask["size"]], "counts": mask["counts"].decode("ascii")}

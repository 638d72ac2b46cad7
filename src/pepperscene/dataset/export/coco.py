"""COCO: instances with masks, boxes and what is known of each organ, and panoptic segments.

Format: https://cocodataset.org/#format-data, and pycocotools, which reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.export.run import ExportResult
from pepperscene.dataset.export.segments import REST, Segment, as_text, library, segment_ids, segments
from pepperscene.dataset.export.source import ExportSource, OnFrame, export_sources, new_folder, wanted_frames
from pepperscene.dataset.export.splits import Splits
from pepperscene.dataset.store.dataset import Dataset, file_name
from pepperscene.dataset.store.images import png_bytes

_CENTRE: Final = 0.5
"""Here the first pixel's centre is at .5, in COCO's keypoints at 0."""

_KNOWN: Final = ("ripeness", "length_m", "diameter_m", "visible_fraction", "truncated")


def fruit_of(source: ExportSource) -> dict[int, dict[str, Any]]:
    """By instance: `attributes` of a fruit, and the harvest truth's `cut` point or None.

    The attribute `amodal` holds `segmentation`, `area` and `bbox` of all that the picture would show of the
    fruit if nothing hid it.
    """
    return {fruit["instance"]: _told(fruit) for fruit in source.image("harvest")["fruit"]}


def keypoint(cut: Mapping[str, Any] | None) -> dict[str, Any]:
    """COCO's `keypoints` of a cut: x, y, and 2 where it is seen, 1 where hidden, 0 outside the picture."""
    if cut is None or cut["px"] is None:
        return {"keypoints": [0, 0, 0], "num_keypoints": 0}
    x, y = (round(value - _CENTRE, 2) for value in cut["px"])
    return {"keypoints": [x, y, 2 if cut["visible"] else 1], "num_keypoints": 1}


def _told(fruit: Mapping[str, Any]) -> dict[str, Any]:
    coder = library("pycocotools.mask")
    size = fruit["amodal"]["size"]
    mask = coder.frPyObjects(dict(fruit["amodal"]), *size)
    amodal = {
        "segmentation": as_text(mask),
        "area": int(coder.area(mask)),
        "bbox": [int(value) for value in coder.toBbox(mask)],
    }
    known = {key: fruit[key] for key in _KNOWN if key in fruit}
    return {"attributes": {**known, "amodal": amodal}, "cut": (fruit.get("peduncle") or {}).get("cut")}


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


class CocoWriter:
    """One JSON file with a record a line: `info`, `licenses`, `categories`, `annotations`, `images`.

    Args:
        path: of the file.
        about: of the data set.
        categories: what annotations refer to.
    """

    def __init__(self, path: Path, about: Mapping[str, Any], categories: Sequence[Mapping[str, Any]]) -> None:
        self._images: list[str] = []
        self._between = "\n"
        self._file = path.open("w", encoding="utf-8")
        head = {"info": _info(about), "licenses": [], "categories": categories}
        self._file.write(f'{_line(head)[:-1]},"annotations":[')

    def __enter__(self) -> CocoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the file; a broken export's is left as it is, to be removed."""
        if kind is None:
            self._file.write('\n],"images":[\n' + ",\n".join(self._images) + "\n]}\n")
        self._file.close()

    def image(self, record: Mapping[str, Any]) -> None:
        """Add a picture; the few bytes are kept until the end."""
        self._images.append(_line(record))

    def annotation(self, record: Mapping[str, Any]) -> None:
        """Add an annotation."""
        self._file.write(self._between + _line(record))
        self._between = ",\n"


def category(organ_class: OrganClass) -> dict[str, Any]:
    """A class as COCO's files tell it."""
    return {"id": int(organ_class), "name": organ_class.name.lower(), "supercategory": "sweet pepper"}


def panoptic_category(organ_class: OrganClass) -> dict[str, Any]:
    """A class as COCO's panoptic files tell it; the background is no thing that could be counted."""
    is_thing = int(organ_class != OrganClass.BACKGROUND)
    return {**category(organ_class), "isthing": is_thing, "color": list(CLASS_COLOURS[organ_class])}


def _info(about: Mapping[str, Any]) -> dict[str, Any]:
    """Whence the data set comes; no date, so that the same frames make the same bytes."""
    name = about["recipe"].get("name", "")
    kept = {key: about[key] for key in ("quality", "recipe_sha256", "version") if key in about}
    return {"description": f"pepperscene data set {name}".rstrip(), **kept}


def _line(record: Mapping[str, Any]) -> str:
    return json.dumps(record, separators=(",", ":"), allow_nan=False)


ANNOTATIONS: Final = "annotations"
CUT: Final = "cut"  # the name of a fruit's keypoint


def export_coco(
    dataset: Dataset,
    out: Path,
    splits: Splits,
    *,
    indices: Sequence[int] | None = None,
    on_frame: OnFrame | None = None,
    smallest_px: int = 1,
) -> ExportResult:
    """Write `train/000110.png`, `annotations/instances_train.json` and `panoptic_train.json`, a set a split.

    An annotation is one organ of a plant. What else has an organ's class is one annotation of that class with
    `iscrowd` 1, which evaluation ignores. Category ids are class ids.

    Args:
        dataset: with the outputs colour and instance; with harvest fruit get amodal masks and cut points.
        out: a new or an empty folder.
        splits: frames in none are left out.
        indices: of the frames wanted; None for all.
        on_frame: called after every frame.
        smallest_px: organs of which fewer pixels are seen belong to the crowd of their class.

    Raises:
        InputError: an output is missing, or a file is damaged.
        OutputError: the folder holds something, or cannot be written to.
        SetupError: pycocotools is not installed.
    """
    library("pycocotools.mask")
    wanted = wanted_frames(dataset, splits, indices, ("colour", "instance"))
    # Keypoints belong to a category, so that they are told of all frames or of none.
    harvest = all((dataset.folder / file_name(index, "harvest")).is_file() for index in wanted)
    names = list(splits.members(wanted))
    with new_folder(out, dataset.folder) as folder, ExitStack() as files:
        (folder / ANNOTATIONS).mkdir()
        parts = {name: files.enter_context(_part(folder, name, dataset.info, harvest)) for name in names}
        for source in export_sources(dataset, wanted, on_frame):
            parts[splits.named(source.index)].add(source, harvest, smallest_px)
    return ExportResult(out, len(wanted), 2 * len(wanted) + 2 * len(names))


@dataclass(frozen=True)
class _Part:
    """The folders and files of one split."""

    pictures: Path
    panoptics: Path
    instances: CocoWriter
    panoptic: CocoWriter

    def add(self, source: ExportSource, harvest: bool, smallest_px: int) -> None:
        """Write what belongs to a frame."""
        ids = segment_ids(source, smallest_px)
        found = segments(source, ids)
        image = image_record(source, ids.shape)
        (self.pictures / image["file_name"]).write_bytes(source.content("colour"))
        write_panoptic(self.panoptics / image["file_name"], ids)
        self.instances.image(image)
        for record in instance_records(source, found, harvest):
            self.instances.annotation(record)
        self.panoptic.image(image)
        self.panoptic.annotation(panoptic_record(image, found))


@contextmanager
def _part(folder: Path, split: str, about: Mapping[str, Any], harvest: bool) -> Iterator[_Part]:
    """Make the folders of a split, and keep its files open meanwhile."""
    pictures, panoptics = folder / split, folder / ANNOTATIONS / f"panoptic_{split}"
    pictures.mkdir()
    panoptics.mkdir()
    things = [category(one) for one in OrganClass if one != OrganClass.BACKGROUND]
    for one in things:
        if harvest and one["id"] == OrganClass.PEPPER:
            one |= {"keypoints": [CUT], "skeleton": []}
    segmented = [panoptic_category(one) for one in OrganClass]
    with (
        CocoWriter(folder / ANNOTATIONS / f"instances_{split}.json", about, things) as instances,
        CocoWriter(folder / ANNOTATIONS / f"panoptic_{split}.json", about, segmented) as panoptic,
    ):
        yield _Part(pictures, panoptics, instances, panoptic)


def image_record(source: ExportSource, shape: tuple[int, ...]) -> dict[str, Any]:
    """What COCO's files say of a picture; its id is the frame's index."""
    height, width = shape
    place = {key: source.facts[key] for key in ("set", "rotation", "step")}
    return {
        "id": source.index,
        "file_name": f"{source.name}.png",
        "width": width,
        "height": height,
        **place,
    }


def annotation_id(index: int, segment: int) -> int:
    """An annotation's id: unique in the whole data set, above 0, and told by frame and segment alone."""
    return index * 2 * REST + segment


def instance_records(source: ExportSource, found: Sequence[Segment], harvest: bool) -> list[dict[str, Any]]:
    """One annotation for each organ in view, and one for the rest of each class."""
    fruit = fruit_of(source) if harvest else {}
    in_view = {segment.id for segment in found}
    records = []
    for segment in found:
        if segment.organ_class == OrganClass.BACKGROUND:
            continue
        record: dict[str, Any] = {
            "id": annotation_id(source.index, segment.id),
            "image_id": source.index,
            "category_id": int(segment.organ_class),
            "iscrowd": int(not segment.is_organ),
            "area": segment.area,
            "bbox": segment.box,
            "segmentation": segment.mask,
        }
        if segment.is_organ:
            record["attributes"] = _attributes(source.index, segment, in_view)
        if harvest and segment.organ_class == OrganClass.PEPPER:
            known: Mapping[str, Any] = fruit.get(segment.id, {})
            record |= keypoint(known.get("cut"))
            record.get("attributes", {}).update(known.get("attributes", {}))
        records.append(record)
    return records


def _attributes(index: int, segment: Segment, in_view: set[int]) -> dict[str, Any]:
    """What the frame's JSON says of an organ; `parent` is the annotation of what it grows out of."""
    about = segment.about
    parent = annotation_id(index, about["parent"]) if about["parent"] in in_view else None
    return {
        "kind": about["kind"],
        "plant": about["plant"],
        "phytomer": about["phytomer"],
        "instance": segment.id,
        "parent": parent,
    }

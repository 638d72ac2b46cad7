"""COCO: instances with masks, boxes and what is known of each organ, and panoptic segments.

Format: https://cocodataset.org/#format-data, and pycocotools, which reads it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pepperscene.classes import OrganClass
from pepperscene.dataset.export.amodal import fruit_of, keypoint
from pepperscene.dataset.export.formats import Exported
from pepperscene.dataset.export.libraries import library
from pepperscene.dataset.export.panoptic import panoptic_record, write_panoptic
from pepperscene.dataset.export.records import Records, category, panoptic_category
from pepperscene.dataset.export.segments import REST, Segment, segment_ids, segments
from pepperscene.dataset.export.source import OnFrame, Source, sources, wanted_frames
from pepperscene.dataset.export.splits import Splits
from pepperscene.dataset.export.target import new_folder
from pepperscene.dataset.store import Dataset, file_name

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
) -> Exported:
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
        parts = {name: files.enter_context(_part(folder, name, dataset.about, harvest)) for name in names}
        for source in sources(dataset, wanted, on_frame):
            parts[splits.named(source.index)].add(source, harvest, smallest_px)
    return Exported(out, len(wanted), 2 * len(wanted) + 2 * len(names))


@dataclass(frozen=True)
class _Part:
    """The folders and files of one split."""

    pictures: Path
    panoptics: Path
    instances: Records
    panoptic: Records

    def add(self, source: Source, harvest: bool, smallest_px: int) -> None:
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
        Records(folder / ANNOTATIONS / f"instances_{split}.json", about, things) as instances,
        Records(folder / ANNOTATIONS / f"panoptic_{split}.json", about, segmented) as panoptic,
    ):
        yield _Part(pictures, panoptics, instances, panoptic)


def image_record(source: Source, shape: tuple[int, ...]) -> dict[str, Any]:
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


def instance_records(source: Source, found: Sequence[Segment], harvest: bool) -> list[dict[str, Any]]:
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

"""Reading instances in the format of COCO, https://cocodataset.org/#format-data, own exports included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.dataset_frame import IGNORED, REST
from pepperscene.dataset.readers.coco_masks import decode_segmentation
from pepperscene.dataset.readers.folder import natural_sort_key
from pepperscene.dataset.readers.image_set import VOID, ImageSet, LabelledImage
from pepperscene.dataset.readers.labels import LABEL_FILE, parse_class
from pepperscene.dataset.readers.pictures import (
    EXIF_KEY,
    Exif,
    mark_orientation,
    parse_exif,
    photo_shape,
    read_photo,
    turn_image,
)
from pepperscene.dataset.store.frame_json import read_json
from pepperscene.document import read_toml
from pepperscene.errors import ArgumentError, InputError, short_repr
from pepperscene.truth.encodings import mask_box

ANNOTATIONS: Final = "annotations"
OTHERWISE: Final = "otherwise"
"""Key of a table of categories: the class of pixels without an annotation."""

_PREFIX: Final = "instances_"
_OTHER_KINDS: Final = ("panoptic_", "captions_", "person_keypoints_", "stuff_")
"""First words of the names of other annotation files beside the instances."""

_PICTURE_FOLDERS: Final = ("", "images", "data")
_CROPS: Final = ("tomato", "cucumber", "eggplant")
_RIPENESSES: Final = tuple(
    f"{state} {fruit}" for fruit in ("pepper", *_CROPS, "fruit") for state in ("ripe", "unripe")
)
_FRUIT_NAMES: Final = ("fruit", "sweet pepper", "bell pepper", *_CROPS, *_RIPENESSES)
_CATEGORIES: Final[Mapping[str, int]] = {
    **{organ.name.lower(): int(organ) for organ in OrganClass},
    **dict.fromkeys(_FRUIT_NAMES, int(OrganClass.PEPPER)),
}
"""Class id by the name of a category."""

_OWN_KEY: Final = "recipe_sha256"
"""Key of `info` in exports of this package."""

_MOST_INSTANCES: Final = np.iinfo(np.uint16).max
_MOST_MASK_BYTES: Final = 500_000_000
"""Chosen: of the masks of an image, eight pixels a byte: 65,535 masks of 250 x 250 pixels."""


@dataclass(frozen=True)
class CocoAnnotation:
    """One annotation of an image.

    Attributes:
        id: in the file.
        class_id: of its pixels, or `VOID`.
        is_crowd: whether it is several objects, which have no instance number.
        segmentation: as in the file.
    """

    id: int
    class_id: int
    is_crowd: bool
    segmentation: Any


@dataclass(frozen=True, eq=False)
class _PackedMask:
    """The mask of an annotation."""

    box: tuple[slice, slice]  # its rows and columns
    bits: NDArray[np.uint8]  # eight pixels of the box a byte
    area: int  # number of its pixels

    @property
    def mask(self) -> NDArray[np.bool_]:
        """`(h, w)` of the box."""
        height, width = (side.stop - side.start for side in self.box)
        pixels = np.unpackbits(self.bits, count=height * width)
        return pixels.view(np.bool_).reshape(height, width)


@dataclass(frozen=True)
class CocoImage:
    """One image and its annotations, in the order of the file."""

    name: str
    file: Path
    size: tuple[int, int]  # height, width
    annotations: tuple[CocoAnnotation, ...]


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class CocoSet(ImageSet):
    """Images with annotations in the format of COCO.

    Larger annotations are painted first, so that where two overlap, the smaller one counts; crowds are
    painted before all others. Instances are numbered from 1 in the order of the file; crowds have none.
    Where crowds of different classes overlap, the class is unknown: `VOID`.

    Pixels without an annotation are `VOID`, unless a table of categories defines `otherwise`. In an export of
    this package with all organ classes they are the background, and its ignored pixels are `VOID`; with fewer
    classes, the rest may be organs, and is `VOID`.

    Attributes:
        source: the annotation file.
        items: images in natural order of their names.
        otherwise: class id of pixels without an annotation.
        exif: which pixels of photographs with an EXIF orientation are marked; None if only sizes tell.
    """

    source: Path
    items: tuple[CocoImage, ...]
    otherwise: int = VOID
    exif: Exif | None = None

    @classmethod
    def from_file(cls, source: Path, labels: Mapping[Any, Any] | None = None) -> Self:
        """The images of an annotation file; `labels` as in `open_images`."""
        content = read_json(source, "annotations")
        root = source.parent.parent if source.parent.name == ANNOTATIONS else source.parent
        if labels is None and (root / LABEL_FILE).exists():
            table, where = read_toml(root / LABEL_FILE), str(root / LABEL_FILE)
        else:
            table, where = dict(labels or {}), "labels"
        records = {key: _records(content, key, source) for key in ("images", "annotations", "categories")}
        info = content.get("info")
        is_own = isinstance(info, dict) and _OWN_KEY in info
        exif = parse_exif(table.pop(EXIF_KEY), where) if EXIF_KEY in table else None
        otherwise = table.pop(OTHERWISE, None)
        if otherwise is not None:
            unlabelled = parse_class(otherwise, OTHERWISE, where)
        else:
            unlabelled = _own_background(records["categories"]) if is_own else VOID
        classes = _category_classes(records["categories"], table, where, source)
        annotations = _annotations_by_image(records["annotations"], classes, is_own, source)
        items = _images(records["images"], annotations, root, source)
        if not items:
            raise InputError(source, "lists no images")
        name = root.resolve().name
        if source.parent.name == ANNOTATIONS:
            name = f"{name} {source.stem.removeprefix(_PREFIX)}"
        return cls(name=name, source=source, items=items, otherwise=unlabelled, exif=exif)

    def names(self) -> tuple[str, ...]:
        """Names of the picture files, without suffix."""
        return tuple(item.name for item in self.items)

    def read(self, item: CocoImage) -> LabelledImage:
        """Read one image, and paint its annotations."""
        marked = {"classes", "instances"} & set(self.fields)
        shape = photo_shape(item.file)
        # Without marks, either size is right.
        exif = self.exif if marked and item.annotations else "displayed" if shape == item.size else "stored"
        # Label Studio writes the stored size, but marks the displayed picture (its issue 6608).
        orientation = mark_orientation(item.size, item.file, exif, self.source, by_size=False)
        if orientation is None:
            sizes = f"{shape[1]}x{shape[0]} pixels, but {self.source.name} says {item.size[1]}x{item.size[0]}"
            raise InputError(item.file, f"has {sizes}")
        colour = read_photo(item.file) if "colour" in self.fields else None
        files = {"image": str(item.file), "annotations": str(self.source)}
        metadata = files if "metadata" in self.fields else {}
        if not marked:
            return LabelledImage(item.name, colour, None, metadata=metadata)
        classes, instances = (turn_image(image, orientation) for image in self._paint(item))
        return LabelledImage(
            item.name,
            colour,
            classes if "classes" in self.fields else None,
            instances if "instances" in self.fields else None,
            metadata=metadata,
        )

    def _paint(self, item: CocoImage) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        classes = np.full(item.size, self.otherwise, np.uint8)
        instances = np.zeros(item.size, np.uint16)
        parts, packed = [], 0
        for annotation in item.annotations:
            parts.append(self._decode(annotation, item))
            packed += parts[-1].bits.size
            if packed > _MOST_MASK_BYTES:
                problem = f"has annotations whose masks take more than {_MOST_MASK_BYTES // 10**6} MB"
                raise InputError(self.source, problem, key=f"image {item.name}")

        # Crowds of different classes leave it open which one a pixel has.
        crowded = np.zeros(item.size, bool)
        for annotation, part in zip(item.annotations, parts, strict=True):
            if annotation.is_crowd:
                box, mask = part.box, part.mask
                conflicts = mask & crowded[box] & (classes[box] != annotation.class_id)
                classes[box][mask] = annotation.class_id
                classes[box][conflicts] = VOID
                crowded[box] |= mask

        # Objects, from large to small.
        pairs = zip(item.annotations, parts, strict=True)
        objects = [(annotation.class_id, part) for annotation, part in pairs if not annotation.is_crowd]
        for number, (class_id, part) in sorted(enumerate(objects, 1), key=lambda item: -item[1][1].area):
            box, mask = part.box, part.mask
            classes[box][mask] = class_id
            instances[box][mask] = 0 if class_id == VOID else number
        return classes, instances

    def _decode(self, annotation: CocoAnnotation, item: CocoImage) -> _PackedMask:
        """The mask of an annotation; whole masks would fill the memory."""
        try:
            mask = decode_segmentation(annotation.segmentation, item.size)
        except ValueError as error:
            key = f"segmentation of annotation {annotation.id}"
            raise InputError(self.source, str(error), key=key) from None
        left, top, right, bottom = mask_box(mask) or (0, 0, 0, 0)
        box = slice(top, bottom), slice(left, right)
        return _PackedMask(box, np.packbits(mask[box]), int(mask.sum()))


def coco_files(folder: Path) -> tuple[Path, ...]:
    """Files of instances in a folder: `annotations.json`, or those in `annotations/`."""
    if (folder / f"{ANNOTATIONS}.json").is_file():
        return (folder / f"{ANNOTATIONS}.json",)
    paths = sorted((folder / ANNOTATIONS).glob("*.json"))
    return tuple(path for path in paths if not path.name.startswith((".", *_OTHER_KINDS)))


def open_coco(path: Path, labels: Any = None) -> CocoSet:
    """Open an annotation file, or a folder that holds exactly one; `labels` as in `open_images`.

    Raises:
        InputError: the folder holds several files, or a file is no such file.
    """
    if labels is not None and not isinstance(labels, Mapping):
        raise ArgumentError("labels", "must be a table from names of categories to classes for COCO files")
    files = (path,) if path.is_file() else coco_files(path)
    if len(files) != 1:
        names = ", ".join(file.name for file in files)
        problem = f"holds several annotation files ({names}); open one of them instead of the folder"
        raise InputError(path, problem)
    return CocoSet.from_file(files[0], labels)


def _records(content: Mapping[str, Any], key: str, source: Path) -> list[dict[str, Any]]:
    """A list of objects, each with an integer `id`, which is unique."""
    records = content.get(key)
    if not isinstance(records, list) or not all(isinstance(record, dict) for record in records):
        raise InputError(source, "must be a list of objects, as in COCO's instances", key=key)
    ids = set()
    for record in records:
        number = record.get("id")
        if type(number) is not int or number in ids:
            raise InputError(source, "must be an integer that occurs once", key=f"{key}.id", value=number)
        ids.add(number)
    return records


def _own_background(categories: Sequence[Mapping[str, Any]]) -> int:
    """Class of pixels without an annotation in an export: the background if no organ class is missing."""
    classes = {_CATEGORIES.get(str(category.get("name"))) for category in categories}
    organs = {int(organ) for organ in OrganClass if organ != OrganClass.BACKGROUND}
    return int(OrganClass.BACKGROUND) if organs <= classes else VOID


def _category_classes(
    categories: Sequence[Mapping[str, Any]], table: Mapping[Any, Any], where: str, source: Path
) -> dict[int, int]:
    """Class id of each category, by the table or by its name."""
    own = {str(name): parse_class(organ_class, str(name), where) for name, organ_class in table.items()}
    names = {category["id"]: str(category.get("name")) for category in categories}
    for name in own:
        if name not in names.values():
            raise InputError(where, f"is no category of {source}: {', '.join(names.values())}", key=name)
    classes = {}
    for number, name in names.items():
        class_id = own.get(name, _CATEGORIES.get(name.lower()))
        if class_id is None:
            known = ", ".join(_CATEGORIES)
            problem = f"the category {short_repr(name)} has no known class ({known})"
            hint = f"name its class in labels= or in a {LABEL_FILE} of the folder"
            raise InputError(source, f"{problem}; {hint}")
        classes[number] = class_id
    return classes


def _annotations_by_image(
    records: Sequence[Mapping[str, Any]], classes: Mapping[int, int], is_own: bool, source: Path
) -> dict[int, list[CocoAnnotation]]:
    by_image: dict[int, list[CocoAnnotation]] = {}
    for record in records:
        number, category, image = (record.get(key) for key in ("id", "category_id", "image_id"))
        assert isinstance(number, int)
        where = f"annotation {number}"
        if type(category) is not int or category not in classes:
            raise InputError(source, "is no category", key=f"{where}.category_id", value=category)
        if type(image) is not int:
            raise InputError(source, "must be an integer", key=f"{where}.image_id", value=image)
        is_crowd = bool(record.get("iscrowd", 0))
        # The ids of an export say which crowds are its ignored pixels.
        is_ignored = is_own and is_crowd and number % (2 * REST) >= IGNORED
        class_id = VOID if is_ignored else classes[category]
        annotation = CocoAnnotation(number, class_id, is_crowd, record.get("segmentation"))
        by_image.setdefault(image, []).append(annotation)
    return by_image


def _images(
    records: Sequence[Mapping[str, Any]],
    annotations: Mapping[int, Sequence[CocoAnnotation]],
    root: Path,
    source: Path,
) -> tuple[CocoImage, ...]:
    """The images of a file, in natural order of their names."""
    split = source.stem.removeprefix(_PREFIX) if source.stem.startswith(_PREFIX) else ""
    folders = [root / split, *(root / name for name in _PICTURE_FOLDERS)]
    images: dict[str, CocoImage] = {}
    for record in records:
        key = f"image {record['id']}"
        path = record.get("file_name")
        inside = PurePosixPath(path) if isinstance(path, str) else PurePosixPath("..")
        if inside.is_absolute() or ".." in inside.parts:
            raise InputError(source, "must be a path inside the folder", key=f"{key}.file_name", value=path)
        height, width = record.get("height"), record.get("width")
        if type(height) is not int or type(width) is not int or min(height, width) < 1:
            raise InputError(source, "must have a height and a width in pixels", key=key)
        file = next((folder / inside for folder in folders if (folder / inside).is_file()), None)
        if file is None:
            raise InputError(folders[0] / inside, f"is missing, although {source} lists it")
        own = tuple(annotations.get(record["id"], ()))
        if sum(not annotation.is_crowd for annotation in own) > _MOST_INSTANCES:
            raise InputError(source, f"has more than {_MOST_INSTANCES:,} annotations", key=key)
        name = inside.with_suffix("").as_posix()
        if name in images:
            raise InputError(source, f"{path} has the same name as {images[name].file.name}")
        images[name] = CocoImage(name, file, (height, width), own)
    unknown = sorted(set(annotations) - {record["id"] for record in records})
    if unknown:
        raise InputError(source, "is the id of no image", key="annotations.image_id", value=unknown[0])
    return tuple(sorted(images.values(), key=lambda image: natural_sort_key(image.name)))

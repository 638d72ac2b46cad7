"""Checks of labels, by themselves and against the frame's JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.truth import class_colour, class_pixel_counts, distance_code
from pepperscene.truth.encodings import is_class_id

Problem = tuple[str, str, str]
"""Kind, output and description."""

_UNKNOWN: Final = 254  # no class id
_INSTANCES: Final = 1 << 16  # instance images have 16 bits
_MAX_NAMES: Final = 5  # chosen: in a sentence


_WHOLE_ORGANS: Final = {"harvest": ("fruit", "fruit"), "amodal": ("organs", "organ")}
"""Key of the list of organs in an output with their hidden parts, and the name of one of them."""


def check_labels(
    images: Mapping[str, Any], metadata: Mapping[str, Any], *, ignored: bool = False
) -> Iterator[Problem]:
    """Yield the problems of a frame's classes and instances.

    The images, by output name, have the right type and all one size; the metadata are the frame's JSON, of
    valid types. Only with `ignored` may pixels have `IGNORE_CLASS`.
    """
    classes, instances = images.get("class"), images.get("instance")
    if classes is not None:
        yield from _check_classes(classes, metadata, ignored)
    if instances is not None:
        yield from _check_instances(instances, metadata)
        yield from _check_instance_classes(instances, classes, metadata, ignored)
    if "distance" in images:
        yield from _check_unlabelled(classes, instances, images["distance"])
    yield from _check_derived(images)


def _check_classes(
    classes: NDArray[np.uint8], metadata: Mapping[str, Any], ignored: bool
) -> Iterator[Problem]:
    invalid = classes >= len(OrganClass)
    if ignored:
        invalid &= classes != IGNORE_CLASS
    if invalid.any():
        ids = _list_ids(np.unique(classes[invalid]))
        last = len(OrganClass) - 1
        yield "label", "class", f"{_pixels(invalid)} with class {ids}; the last class is {last}"
        return
    expected = metadata.get("class_pixels", {})
    for name, count in class_pixel_counts(classes).items():
        if expected.get(name) != count:
            problem = f"{count} pixels are {name}, but class_pixels is {expected.get(name)}"
            yield "contradiction", "class", problem
            return


def _check_instances(instances: NDArray[np.uint16], metadata: Mapping[str, Any]) -> Iterator[Problem]:
    """Compare the image with the JSON: which instances there are, their pixels and boxes."""
    from scipy import ndimage

    counts = np.bincount(instances.ravel())
    visible = {int(number) for number in np.flatnonzero(counts) if number}
    entries = {int(number): entry for number, entry in metadata["instances"].items()}
    if unknown := sorted(visible - entries.keys()):
        pixels = int(counts[unknown].sum())
        problem = f"{pixels} pixels with instance {_list_ids(unknown)}, which the JSON does not list"
        yield "instance", "instance", problem
    if absent := sorted(entries.keys() - visible):
        yield "contradiction", "instance", f"the JSON lists instance {_list_ids(absent)}, without any pixel"
    common = sorted(visible & entries.keys())
    areas = {number: int(counts[number]) for number in common}
    yield from _compare(entries, "pixels", areas, "{found} pixels have instance {number}")
    if any(entries[number].get("box") for number in common):
        windows = ndimage.find_objects(instances)
        boxes = {number: _window_box(windows[number - 1]) for number in common}
        yield from _compare(entries, "box", boxes, "the box of instance {number} is {found}")


def _compare(
    entries: Mapping[int, Mapping[str, Any]], key: str, found: Mapping[int, Any], text: str
) -> Iterator[Problem]:
    """Compare a value of instances with what the image shows; `text` describes the first that differs."""
    if wrong := [number for number, value in found.items() if entries[number].get(key) != value]:
        problem = text.format(number=wrong[0], found=found[wrong[0]])
        others = f"; likewise {len(wrong) - 1} more" if len(wrong) > 1 else ""
        said = entries[wrong[0]].get(key)
        yield "contradiction", "instance", f"{problem}, the JSON says {said}{others}"


def _check_instance_classes(
    instances: NDArray[np.uint16],
    classes: NDArray[np.uint8] | None,
    metadata: Mapping[str, Any],
    ignored: bool,
) -> Iterator[Problem]:
    """Every pixel must have the class of its instance in the JSON; the sky has none."""
    allowed = [*OrganClass, IGNORE_CLASS] if ignored else [*OrganClass]
    class_of = np.full(int(instances.max()) + 1, _UNKNOWN, np.uint8)
    class_of[0] = OrganClass.BACKGROUND
    for key, entry in metadata["instances"].items():
        number, organ_class = int(key), entry["class"]
        if organ_class not in allowed:
            problem = f"the JSON gives instance {number} the class {organ_class}"
            yield "contradiction", "instance", problem
        elif number < len(class_of):
            class_of[number] = organ_class
    if classes is None:
        return
    expected = class_of[instances]
    wrong = (expected != classes) & (expected != _UNKNOWN)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        number = int(instances[row, column])
        problem = f"class {classes[row, column]}, instance {number} has {class_of[number]}"
        yield "instance", "class", f"{_pixels(wrong)} of another class than their instance: {problem}"


def _check_unlabelled(classes: Any, instances: Any, distance: Any) -> Iterator[Problem]:
    """Pixels with a finite distance must have an instance, and pixels with a label a finite distance."""
    sky = np.isinf(distance)
    if instances is not None:
        if (pixels := ~sky & (instances == 0)).any():
            yield "unlabelled", "instance", f"{_pixels(pixels)} without an instance, but a finite distance"
        if (pixels := sky & (instances != 0)).any():
            yield "unlabelled", "distance", f"{_pixels(pixels)} without a distance, but an instance"
    elif classes is not None and (pixels := sky & (classes != OrganClass.BACKGROUND)).any():
        yield "unlabelled", "distance", f"{_pixels(pixels)} without a distance, but a class"


def _check_derived(images: Mapping[str, Any]) -> Iterator[Problem]:
    """Compare the published encodings with what they encode."""
    classes, distance = images.get("class"), images.get("distance")
    if "class_colour" in images and classes is not None and is_class_id(classes).all():
        wrong = (class_colour(classes) != images["class_colour"]).any(-1)
        if wrong.any():
            yield "encoding", "class_colour", f"{_pixels(wrong)} in another colour than that of their class"
    if "distance_code" in images and distance is not None and (distance >= 0).all():
        wrong = distance_code(distance) != images["distance_code"]
        if wrong.any():
            yield (
                "encoding",
                "distance_code",
                f"{_pixels(wrong)} with another code than that of their distance",
            )


def check_whole_organs(images: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield the problems of organs with their hidden parts: of a frame's harvest truth and amodal masks."""
    instances, masks = images.get("instance"), dict[int, Any]()
    counts = None if instances is None else np.bincount(instances.ravel(), minlength=_INSTANCES)
    for output, (key, name) in _WHOLE_ORGANS.items():
        for entry in images.get(output, {key: ()})[key]:
            for problem in _check_entry(name, entry, counts):
                yield "contradiction", output, problem
            number, mask = entry["instance"], entry["amodal"]
            if masks.setdefault(number, mask) != mask:
                yield "contradiction", "amodal", f"fruit {number}: another mask than that of harvest"


def _check_entry(name: str, entry: Mapping[str, Any], counts: NDArray[np.int64] | None) -> Iterator[str]:
    number, visible, amodal = entry["instance"], entry["visible_pixels"], entry["amodal_pixels"]
    if counts is not None and counts[number] != visible:
        yield f"{name} {number} has {counts[number]} visible pixels, the JSON says {visible}"
    if not 0 <= visible <= amodal:
        yield f"{name} {number} has {visible} visible pixels of {amodal}"
    # COCO's run lengths: every second one belongs to the organ.
    if (pixels := sum(entry["amodal"]["counts"][1::2])) != amodal:
        yield f"the amodal mask of {name} {number} has {pixels} pixels, the JSON says {amodal}"


def _window_box(window: tuple[slice, slice]) -> list[int]:
    """`[x0, y0, x1, y1]`, half open."""
    rows, columns = window
    return [columns.start, rows.start, columns.stop, rows.stop]


def _pixels(mask: NDArray[np.bool_]) -> str:
    """The number of pixels, and the position of the first."""
    row, column = np.unravel_index(int(mask.argmax()), mask.shape)
    count = np.count_nonzero(mask)
    return f"{count} pixel{'' if count == 1 else 's'} (the first at column {column}, row {row})"


def _list_ids(numbers: Any) -> str:
    names = ", ".join(str(number) for number in numbers[:_MAX_NAMES])
    return f"{names} and {len(numbers) - _MAX_NAMES} more" if len(numbers) > _MAX_NAMES else names

"""Labels that cannot be right, or that the frame's JSON tells otherwise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.check.findings import instances as listed
from pepperscene.dataset.check.findings import table
from pepperscene.truth import class_colour, class_pixel_counts, distance_code

Fault = tuple[str, str, str]
"""Kind, output and description."""

_UNKNOWN: Final = 255
_MOST: Final = 5  # chosen: names that a sentence holds


def label_faults(images: Mapping[str, Any], facts: Mapping[str, Any]) -> Iterator[Fault]:
    """What is wrong with a frame's classes and instances.

    Args:
        images: the frame's, by output name, those that are there; of the right type, all of one size.
        facts: the frame's JSON.
    """
    classes, instances = images.get("class"), images.get("instance")
    if classes is not None:
        yield from _classes(classes, facts)
    if instances is not None:
        yield from _instances(instances, facts)
        yield from _classes_of_instances(instances, classes, facts)
    yield from _unlabelled(classes, instances, images.get("distance"))
    yield from _derived(images)


def _classes(classes: NDArray[np.uint8], facts: Mapping[str, Any]) -> Iterator[Fault]:
    wrong = classes >= len(OrganClass)
    if wrong.any():
        ids = _named(np.unique(classes[wrong]))
        yield "label", "class", f"{_pixels(wrong)} with class {ids}; the last class is {len(OrganClass) - 1}"
        return
    told, found = table(facts, "class_pixels"), class_pixel_counts(classes)
    for name, count in found.items():
        if told.get(name) != count:
            yield "contradiction", "class", f"{count} pixels are {name}, class_pixels says {told.get(name)}"
            return


def _instances(instances: NDArray[np.uint16], facts: Mapping[str, Any]) -> Iterator[Fault]:
    """The image's instances against the JSON's: which there are, their pixels and boxes."""
    from scipy import ndimage

    counts = np.bincount(instances.ravel())
    seen = {int(number) for number in np.flatnonzero(counts) if number}
    known = listed(facts)
    if strange := sorted(seen - known.keys()):
        pixels = int(counts[strange].sum())
        yield (
            "instance",
            "instance",
            f"{pixels} pixels with instance {_named(strange)}, which the JSON does not list",
        )
    if absent := sorted(known.keys() - seen):
        yield (
            "contradiction",
            "instance",
            f"the JSON lists instance {_named(absent)}, of which there is no pixel",
        )
    both = sorted(seen & known.keys())
    wrong = [number for number in both if known[number].get("pixels") != int(counts[number])]
    if wrong:
        first = wrong[0]
        yield (
            "contradiction",
            "instance",
            f"{counts[first]} pixels have instance {first}, the JSON says {known[first].get('pixels')}"
            f"{_more(wrong)}",
        )
    if any("box" in known[number] for number in both):
        places = ndimage.find_objects(instances)
        boxes = {number: _box(places[number - 1]) for number in both}
        if wrong := [number for number in both if known[number].get("box") != boxes[number]]:
            first = wrong[0]
            yield (
                "contradiction",
                "instance",
                f"the box of instance {first} is {boxes[first]}, the JSON says {known[first].get('box')}"
                f"{_more(wrong)}",
            )


def _classes_of_instances(
    instances: NDArray[np.uint16], classes: NDArray[np.uint8] | None, facts: Mapping[str, Any]
) -> Iterator[Fault]:
    """Every pixel has the class of its instance, as the JSON tells it; the sky has none."""
    class_of = np.full(int(instances.max()) + 1, _UNKNOWN, np.uint8)
    class_of[0] = OrganClass.BACKGROUND
    for number, entry in listed(facts).items():
        organ = entry.get("class")
        if not isinstance(organ, int) or not 0 <= organ < len(OrganClass):
            yield "contradiction", "instance", f"the JSON says class {organ!r} of instance {number}"
        elif number < len(class_of):
            class_of[number] = organ
    if classes is None:
        return
    meant = class_of[instances]
    wrong = (meant != classes) & (meant != _UNKNOWN)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        number = int(instances[row, column])
        yield (
            "instance",
            "class",
            f"{_pixels(wrong)} of another class than their instance: class {classes[row, column]}, "
            f"instance {number} has {class_of[number]}",
        )


def _unlabelled(classes: Any, instances: Any, distance: Any) -> Iterator[Fault]:
    """Where something is hit it has an instance, and the other way round; what has a class was hit."""
    if distance is None:
        return
    nothing = np.isinf(distance)
    if instances is not None:
        if (bare := ~nothing & (instances == 0)).any():
            yield (
                "unlabelled",
                "instance",
                f"{_pixels(bare)} without an instance, though their distance is finite",
            )
        if (lost := nothing & (instances != 0)).any():
            yield (
                "unlabelled",
                "distance",
                f"{_pixels(lost)} without a distance, though they have an instance",
            )
    elif classes is not None and (lost := nothing & (classes != OrganClass.BACKGROUND)).any():
        yield "unlabelled", "distance", f"{_pixels(lost)} without a distance, though they have a class"


def _derived(images: Mapping[str, Any]) -> Iterator[Fault]:
    """The published encodings, made again of what they encode."""
    classes, distance = images.get("class"), images.get("distance")
    if "class_colour" in images and classes is not None and classes.max() < len(OrganClass):
        wrong = (class_colour(classes) != images["class_colour"]).any(-1)
        if wrong.any():
            yield "encoding", "class_colour", f"{_pixels(wrong)} not in the colour of their class"
    if "distance_code" in images and distance is not None and (distance >= 0).all():
        wrong = distance_code(distance) != images["distance_code"]
        if wrong.any():
            yield "encoding", "distance_code", f"{_pixels(wrong)} not with the code of their distance"


def _box(place: tuple[slice, slice]) -> list[int]:
    """`[x0, y0, x1, y1]`, half open."""
    rows, columns = place
    return [columns.start, rows.start, columns.stop, rows.stop]


def _pixels(wrong: NDArray[np.bool_]) -> str:
    """How many pixels are wrong, and where the first of them is."""
    row, column = np.unravel_index(int(wrong.argmax()), wrong.shape)
    count = np.count_nonzero(wrong)
    return f"{count} pixel{'' if count == 1 else 's'} (the first at column {column}, row {row})"


def _named(numbers: Any) -> str:
    names = ", ".join(str(number) for number in numbers[:_MOST])
    return f"{names} and {len(numbers) - _MOST} more" if len(numbers) > _MOST else names


def _more(wrong: list[int]) -> str:
    return f"; likewise {len(wrong) - 1} more" if len(wrong) > 1 else ""


FORMAT = "pepperscene harvest 1"


def harvest_faults(images: Mapping[str, Any], facts: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Kind, output and description of what of a frame's harvest JSON cannot be.

    Args:
        images: the frame's, by output name, those that are there.
        facts: the frame's JSON.
    """
    harvest, instances = images.get("harvest"), images.get("instance")
    if harvest is None:
        return
    if harvest.get("format") != FORMAT or not isinstance(harvest.get("fruit"), list):
        yield "damaged", "harvest", f"is no {FORMAT!r}"
        return
    counts = None if instances is None else np.bincount(instances.ravel())
    for fruit in harvest["fruit"]:
        try:
            yield from (("contradiction", "harvest", what) for what in _fruit_faults(fruit, counts))
        except (KeyError, TypeError, IndexError) as fault:
            yield "damaged", "harvest", f"tells a fruit without its {fault}"
            return


def _fruit_faults(fruit: Mapping[str, Any], counts: Any) -> Iterator[str]:
    number, visible, amodal = fruit["instance"], fruit["visible_pixels"], fruit["amodal_pixels"]
    if counts is not None:
        seen = int(counts[number]) if number < len(counts) else 0
        if seen != visible:
            yield f"fruit {number} has {seen} visible pixels, the JSON says {visible}"
    if not 0 <= visible <= amodal:
        yield f"fruit {number} has {visible} visible pixels of {amodal}"
    # COCO's run lengths: together they are the picture, every second one is the fruit.
    size, runs = fruit["amodal"]["size"], fruit["amodal"]["counts"]
    if sum(runs) != size[0] * size[1] or sum(runs[1::2]) != amodal:
        yield f"the amodal mask of fruit {number} has {sum(runs[1::2])} pixels, the JSON says {amodal}"

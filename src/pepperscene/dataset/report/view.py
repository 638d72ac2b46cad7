"""One picture of a set as it is shown: its images in colours for people, and what is told of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.labelled import Labelled
from pepperscene.dataset.report.display import class_colours, distance_colours, instance_colours

TITLES: Final[Mapping[str, str]] = {
    "colour": "Colour",
    "class": "Class",
    "instance": "Organ instance",
    "distance": "Distance along the ray",
}
"""Images that are shown, in this order, and what they are called."""


@dataclass(frozen=True, eq=False)
class View:
    """One picture as it is shown.

    Attributes:
        name: of the picture in its set; a frame's index with six digits.
        facts: what its set tells of it, a frame's JSON; may be empty.
        pictures: `(h, w, 3)` uint8 by the keys of `TITLES`, in their order.
        pixels: number of pixels of each class by its id; empty when it has no labels.
        area: number of all its pixels, of those without a label as well.
    """

    name: str
    facts: Mapping[str, Any]
    pictures: Mapping[str, NDArray[np.uint8]]
    pixels: Mapping[int, int]
    area: int

    @property
    def rendered(self) -> bool:
        """Whether it is a frame of ours."""
        return "step" in self.facts

    @property
    def title(self) -> str:
        """What it is called."""
        return f"Frame {self.name}" if self.rendered else self.name

    @property
    def place(self) -> str:
        """Where in its data set it belongs, in one line; empty when nothing is known."""
        if not self.rendered:
            return ""
        place = "set {set} · rotation {rotation} · step {step}".format(**self.facts)
        height = self.height_m
        return place if height is None else f"{place} · camera at {height:.2f} m"

    @property
    def height_m(self) -> float | None:
        """Of the camera above the ground, metres."""
        pose = self.facts.get("camera", {}).get("pose")
        return None if pose is None else float(pose[2][3])


def view(picture: Labelled, near_m: float, far_m: float) -> View:
    """A picture's images as colours.

    Args:
        picture: with whatever images it has.
        near_m: distance shown brightest.
        far_m: distance shown darkest.
    """
    shown: dict[str, NDArray[np.uint8]] = {}
    pixels: dict[int, int] = {}
    if picture.colour is not None:
        shown["colour"] = picture.colour
    if picture.classes is not None:
        shown["class"] = class_colours(picture.classes)
        counts = np.bincount(picture.classes.ravel(), minlength=len(OrganClass))
        pixels = {int(one): int(counts[one]) for one in OrganClass}
    if picture.instances is not None:
        shown["instance"] = instance_colours(picture.instances)
    if picture.distance_m is not None:
        shown["distance"] = distance_colours(picture.distance_m, near_m, far_m)
    height, width = picture.size
    return View(picture.name, picture.facts, shown, pixels, height * width)

"""One image in a report: its panels in colours, its HTML card, and its row in the contact sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.review.report.colours import (
    class_colours,
    distance_colours,
    instance_colours,
    jpeg_data_uri,
    png_data_uri,
)
from pepperscene.review.report.label_regions import packed_labels
from pepperscene.review.report.markup import Html, element, fragment, joined

TITLES: Final[Mapping[str, str]] = {
    "colour": "Colour",
    "class": "Class",
    "instance": "Organ instance",
    "distance": "Distance along the ray",
}
"""Titles of the panels, in the order of display."""

TABLE_COLUMNS: Final = (
    *("", "set", "rotation", "step", "height, m", "error, codes"),
    *(f"{organ.name.lower()}, %" for organ in OrganClass),
)

_MOST_RELATIVES: Final = 12  # chosen: links below an image; some lines on a phone
_IMAGES_LENGTH: Final = 11_500_000
"""Characters of all images of a page. Chosen: with all the rest, a page stays below 15 MB."""
_LABELS_PART, _DISTANCE_PART = 0.5, 0.2
"""Parts of an image's characters that its labels and its distances may take. Chosen: labels stay complete in
pages of 100 frames of 800 x 600 pixels."""
_PLACEHOLDER: Final = "data:image/gif;base64,R0lGODlhAQABAIAAAAAAAP///yH5BAEAAAAALAAAAAABAAEAAAIBRAA7"
"""One transparent pixel: images of labels until the page's script draws them."""
_LABELS: Final = {"colour": "Colour", "class": "Class", "instance": "Instance", "distance": "Distance"}


@dataclass(frozen=True, eq=False)
class ImageView:
    """One image as a report shows it."""

    name: str
    metadata: Mapping[str, Any]
    panels: Mapping[str, NDArray[np.uint8]]  # (h, w, 3) by the keys of `TITLES`, in their order
    class_pixels: Mapping[OrganClass, int]  # empty without labels
    area: int  # number of all pixels, labelled or not
    labels: str | None = None  # as of `packed_labels`
    max_length: int | None = None  # of all its data in the page, characters

    @property
    def is_frame(self) -> bool:
        """Whether it is a frame of a data set of this package."""
        return "step" in self.metadata

    @property
    def title(self) -> str:
        """Title of the card."""
        return f"Frame {self.name}" if self.is_frame else self.name

    @property
    def location(self) -> str:
        """Place in the plan and height of the camera, one line; empty if it is not a frame."""
        if not self.is_frame:
            return ""
        location = "set {set} · rotation {rotation} · step {step}".format(**self.metadata)
        twin, camera = self.metadata.get("twin"), self.metadata.get("rig_camera")
        location += "" if twin is None else f" · twin {twin}"
        location += "" if camera is None else f" · camera {camera}"
        height = self.camera_height_m
        return location if height is None else f"{location} · camera at {height:.2f} m"

    @property
    def camera_height_m(self) -> float | None:
        """Height of the camera above the ground, metres."""
        pose = self.metadata.get("camera", {}).get("pose")
        return None if pose is None else float(pose[2][3])


def max_image_length(images: int) -> int:
    """Characters that each of some images may take in a page."""
    return _IMAGES_LENGTH // max(images, 1)


def image_view(image: LabelledImage, near_m: float, far_m: float, max_length: int | None = None) -> ImageView:
    """The view of an image.

    Args:
        image: with what is to be shown.
        near_m: distance of the brightest colour, metres.
        far_m: distance of the darkest colour, metres.
        max_length: characters of its data in the page: quality and size are reduced to keep it.
    """
    panels: dict[str, NDArray[np.uint8]] = {}
    class_pixels: dict[OrganClass, int] = {}
    if image.colour is not None:
        panels["colour"] = image.colour
    if image.classes is not None:
        panels["class"] = class_colours(image.classes)
        counts = np.bincount(image.classes.ravel(), minlength=len(OrganClass))
        class_pixels = {organ: int(counts[organ]) for organ in OrganClass}
    if image.instances is not None:
        panels["instance"] = instance_colours(image.instances)
    if image.distance_m is not None:
        panels["distance"] = distance_colours(image.distance_m, near_m, far_m)
    height, width = image.size
    labels = packed_labels(image, None if max_length is None else round(_LABELS_PART * max_length))
    return ImageView(image.name, image.metadata, panels, class_pixels, height * width, labels, max_length)


@dataclass(frozen=True)
class Relative:
    """Another image of the same moment.

    Attributes:
        name: of the image.
        difference: the differing twin and camera, such as "twin 1, right".
        is_shown: whether the page shows it.
    """

    name: str
    difference: str
    is_shown: bool


def card_html(view: ImageView, set_key: str, relatives: Sequence[Relative] = ()) -> Html:
    """A card with the panels of an image, its class fractions as one bar, and a description.

    `relatives` that the page shows are links; the others are only named.
    """
    buttons = _panel_buttons(view)
    # Two panels have the same size; of more, the first is large and the others are small below it.
    images = joined(buttons)
    if len(buttons) > 2:
        images = fragment(buttons[0], element("div", *buttons[1:], class_="thumbs"))
    elif len(buttons) == 2:
        images = element("div", images, class_="thumbs")
    lines = joined(element("p", line) for line in (view.location, _describe_organs(view)) if line)
    content = (images, _class_bar(view), element("h3", view.title), lines, _links(relatives, set_key))
    return element(
        "article", *content, class_="card", id=card_id(view.name, set_key), data_labels=view.labels
    )


def _links(relatives: Sequence[Relative], set_key: str) -> Html:
    """Links to the other images of a moment, or their names; empty if there are none."""
    if not relatives:
        return fragment()
    names = [
        element("a", item.name, href=f"#{card_id(item.name, set_key)}") if item.is_shown else item.name
        for item in relatives[:_MOST_RELATIVES]
    ]
    texts = [fragment(name, f" ({item.difference})") for name, item in zip(names, relatives, strict=False)]
    more = len(relatives) - len(texts)
    return element("p", "Same moment: ", joined(texts, ", "), f" and {more} more" if more else "")


def table_row(view: ImageView, set_key: str) -> tuple[Html, list[str]]:
    """Head and cells of a table row: place in the plan, camera height, error of the light, percentages.

    The cells are text.
    """
    metadata = view.metadata
    height, error = view.camera_height_m, metadata.get("sampling", {}).get("error_codes")
    cells = [
        *(str(metadata.get(key, "")) for key in ("set", "rotation", "step")),
        "" if height is None else f"{height:.2f}",
        "" if error is None else f"{error:.2f}",
        *(f"{100 * count / view.area:.2f}" for count in view.class_pixels.values()),
    ]
    cells += [""] * (len(TABLE_COLUMNS) - 1 - len(cells))
    return element("a", view.name, href=f"#{card_id(view.name, set_key)}"), cells


def image_button(
    kind: str, uri: str, alt: str, size: tuple[int, int], label: str = "", *, has_overlay: bool = False
) -> Html:
    """An image that opens large on click.

    Args:
        kind: of image; the arrow keys up and down go to the next one of the same kind.
        uri: of the image.
        alt: its description.
        size: width and height in pixels.
        label: text below the image.
        has_overlay: whether the page's script can draw labels over it.
    """
    width, height = size
    image = element("img", src=uri, class_=kind, data_kind=kind, alt=alt, width=width, height=height)
    if has_overlay:
        canvas = element("canvas", class_="overlay", aria_hidden="true")
        image = element("span", image, canvas, class_="layers")
    below = element("span", label) if label else ""
    return element("button", image, below, type="button", class_="picture", aria_label=f"{alt}: open large")


def class_colour_code(organ_class: OrganClass) -> str:
    """The published colour of a class in CSS."""
    return css_colour(CLASS_COLOURS[organ_class])


def css_colour(rgb: tuple[int, int, int]) -> str:
    """An 8-bit RGB colour in CSS."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def card_id(name: str, set_key: str) -> str:
    """An id without spaces, which differs for every name."""
    codes = (letter if letter.isalnum() else f"-{ord(letter):x}-" for letter in name)
    return f"{set_key}-{''.join(codes)}"


def _panel_buttons(view: ImageView) -> list[Html]:
    """The panels of an image; labels and distances first limit what is left for the photograph."""
    uris = dict.fromkeys(view.panels, _PLACEHOLDER)
    limit = view.max_length
    if "distance" in view.panels:
        part = None if limit is None else round(_DISTANCE_PART * limit)
        uris["distance"] = png_data_uri(view.panels["distance"], max_length=part)
    if "colour" in view.panels:
        others = len(view.labels or "") + len(uris.get("distance", ""))
        uris["colour"] = jpeg_data_uri(view.panels["colour"], None if limit is None else limit - others)
    return [_panel_button(view, key, uri) for key, uri in uris.items()]


def _panel_button(view: ImageView, key: str, uri: str) -> Html:
    panel = view.panels[key]
    is_large = next(iter(view.panels)) == key and len(view.panels) != 2
    alt = f"{TITLES[key]} of {'frame ' if view.is_frame else ''}{view.name}"
    label = "" if is_large else _LABELS[key]
    has_overlay = key == "colour" and view.labels is not None
    return image_button(key, uri, alt, (panel.shape[1], panel.shape[0]), label, has_overlay=has_overlay)


def _class_bar(view: ImageView) -> Html:
    """The fractions of the classes as one bar."""
    if not view.class_pixels:
        return fragment()
    parts, left = [], 0.0
    for organ, percentage in ((organ, 100 * count / view.area) for organ, count in view.class_pixels.items()):
        place = {"x": f"{left:.3f}%", "width": f"{percentage:.3f}%", "height": "100%"}
        title = element("title", f"{organ.name.lower()} {percentage:.1f} %")
        if percentage > 0:
            parts.append(element("rect", title, **place, fill=class_colour_code(organ)))
        left += percentage
    return element("svg", *parts, class_="stack")


def _describe_organs(view: ImageView) -> str:
    """Numbers of visible organs and of contacts; empty if they are unknown."""
    sentences = []
    if instances := view.metadata.get("instances"):
        # The greenhouse and the far rows belong to no plant.
        classes = [entry["class"] for entry in instances.values() if entry["plant"] >= 0]
        fruit, leaves = classes.count(OrganClass.PEPPER), classes.count(OrganClass.LEAF)
        sentences.append(f"{len(classes)} visible organs: {leaves} leaves, {fruit} fruit.")
    contacts = view.metadata.get("contacts")
    if contacts and (touching := contacts["fruit_touching"] + contacts["blades_touching"]):
        sentences.append(f"{touching} fruit and leaves of the scene touch other organs.")
    return " ".join(sentences)

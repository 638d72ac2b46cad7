"""One image in a report: its panels in colours, and its card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.indices import INDICES, has_index, spectral_index
from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.dataset.store.images import recorded_bands
from pepperscene.errors import ArgumentError, InputError
from pepperscene.review.report.colours import (
    BACKGROUND,
    class_colours,
    distance_colours,
    instance_colours,
    jpeg_data_uri,
    png_data_uri,
)
from pepperscene.review.report.label_regions import packed_labels

TITLES: Final[Mapping[str, str]] = {
    "colour": "Colour",
    **{name: f"Spectral index {name.upper()}" for name in INDICES},
    "class": "Class",
    "instance": "Organ instance",
    "distance": "Distance along the ray",
}
"""Titles of the panels, in the order of display."""

TABLE_COLUMNS: Final = (
    *("", "set", "rotation", "step", "height, m", "error, codes"),
    *(f"{organ.name.lower()}, %" for organ in OrganClass),
)

_IMAGES_LENGTH: Final = 11_500_000
"""Characters of all images of a page. Chosen: with all the rest, a page stays below 15 MB."""
_LABELS_PART, _DISTANCE_PART, _INDEX_PART = 0.5, 0.2, 0.15
"""Parts of an image's characters that its labels, its distances and each index may take. Chosen: labels stay
complete in pages of 100 frames of 800 x 600 pixels."""
_PLACEHOLDER: Final = "data:image/gif;base64,R0lGODlhAQABAIAAAAAAAP///yH5BAEAAAAALAAAAAABAAEAAAIBRAA7"
"""One transparent pixel: images of labels until the page's script draws them."""
_LABELS: Final = {
    "colour": "Colour",
    "class": "Class",
    "instance": "Instance",
    "distance": "Distance",
    **{name: name.upper() for name in INDICES},
}


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
    for name in available_indices(image):
        panels[name] = index_picture(image, name)
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
class Picture:
    """An image of the page that opens large on click."""

    kind: str  # the arrow keys up and down go to the next one of the same kind
    uri: str
    alt: str  # description
    width: int  # pixels
    height: int
    label: str = ""  # text below it
    has_overlay: bool = False  # whether the page's script can draw labels over it


@dataclass(frozen=True)
class Relative:
    """Another image of the same moment: a link, if the page shows it."""

    name: str
    difference: str  # the differing twin and camera, such as "twin 1, right"
    card_id: str | None  # of its card in the page


@dataclass(frozen=True)
class Card:
    """An image in the page: panels, class fractions as one bar, a description, and its row in the table."""

    id: str
    name: str
    title: str
    lines: list[str]
    pictures: list[Picture]
    bar: list[tuple[OrganClass, float, float]] | None  # class, start and length in percent
    relatives: Sequence[Relative]
    labels: str | None
    cells: list[str]  # of `TABLE_COLUMNS` without the first


def make_card(view: ImageView, set_key: str, relatives: Sequence[Relative] = ()) -> Card:
    """The card of an image of the set with this key."""
    bar, left = [], 0.0
    for organ, count in view.class_pixels.items():
        percentage = 100 * count / view.area
        if percentage > 0:
            bar.append((organ, left, percentage))
        left += percentage
    return Card(
        card_id(view.name, set_key),
        view.name,
        view.title,
        [line for line in (view.location, _describe_organs(view)) if line],
        _pictures(view),
        bar if view.class_pixels else None,
        relatives,
        view.labels,
        _table_cells(view),
    )


def card_id(name: str, set_key: str) -> str:
    """An id without spaces, which differs for every name."""
    codes = (letter if letter.isalnum() else f"-{ord(letter):x}-" for letter in name)
    return f"{set_key}-{''.join(codes)}"


def _table_cells(view: ImageView) -> list[str]:
    """Place in the plan, camera height, error of the light, percentages of the classes."""
    metadata = view.metadata
    height, error = view.camera_height_m, metadata.get("sampling", {}).get("error_codes")
    cells = [
        *(str(metadata.get(key, "")) for key in ("set", "rotation", "step")),
        "" if height is None else f"{height:.2f}",
        "" if error is None else f"{error:.2f}",
        *(f"{100 * count / view.area:.2f}" for count in view.class_pixels.values()),
    ]
    return cells + [""] * (len(TABLE_COLUMNS) - 1 - len(cells))


def _pictures(view: ImageView) -> list[Picture]:
    """The panels of an image; labels and distances first limit what is left for the photograph."""
    uris = dict.fromkeys(view.panels, _PLACEHOLDER)
    limit = view.max_length
    if "distance" in view.panels:
        part = None if limit is None else round(_DISTANCE_PART * limit)
        uris["distance"] = png_data_uri(view.panels["distance"], max_length=part)
    for name in (name for name in INDICES if name in view.panels):
        uris[name] = jpeg_data_uri(view.panels[name], None if limit is None else round(_INDEX_PART * limit))
    if "colour" in view.panels:
        others = len(view.labels or "") + len(uris.get("distance", ""))
        uris["colour"] = jpeg_data_uri(view.panels["colour"], None if limit is None else limit - others)
    pictures = []
    for number, (kind, uri) in enumerate(uris.items()):
        height, width = view.panels[kind].shape[:2]
        alt = f"{TITLES[kind]} of {'frame ' if view.is_frame else ''}{view.name}"
        label = "" if number == 0 and len(uris) != 2 else _LABELS[kind]
        has_overlay = kind == "colour" and view.labels is not None
        pictures.append(Picture(kind, uri, alt, width, height, label, has_overlay))
    return pictures


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


Palette = Literal["viridis", "red-green"]
_MAPS: Final = {"viridis": "viridis", "red-green": "RdYlGn"}
_RANGES: Final = {"ndvi": (0.0, 1.0), "ndre": (0.0, 0.6), "pri": (-0.1, 0.1)}
"""Of the colours. Chosen: from soil, and stressed leaves, to the greenest leaves."""
_WIDTH_PX: Final = 320  # least width, at which the scale can be read: chosen
_MARGIN_PX, _BAR_PX, _SCALE_PX = 40, 10, 36
_INK, _PAPER = (236, 238, 242), (22, 24, 29)


def available_indices(image: LabelledImage) -> tuple[str, ...]:
    """Names of the indices that can be computed from the reflectance of a frame."""
    bands = [band.centre_nm for band in recorded_bands(image.metadata)]
    reflectance = image.reflectance
    if reflectance is None or reflectance.shape[2] != len(bands):
        return ()
    return tuple(name for name in INDICES if has_index(name, bands))


def index_picture(
    image: LabelledImage, name: str = "ndvi", palette: Palette = "viridis"
) -> NDArray[np.uint8]:
    """A frame's spectral index in colours, with a scale bar below; nearly black where it is not a number.

    Small images are enlarged by a whole number, so that the scale can be read.

    Args:
        image: of a sensor with bands, with its reflectance and metadata.
        name: "ndvi", "ndre" or "pri".
        palette: colours from low to high: "viridis", or "red-green" over yellow, as agronomists use it.

    Returns:
        `(h, w, 3)` uint8, sRGB.

    Raises:
        ArgumentError: there is no such index or palette.
        InputError: the image has no reflectance, or not the bands of the index.
    """
    bands = [band.centre_nm for band in recorded_bands(image.metadata)]
    if image.reflectance is None or not bands:
        raise InputError(image.name, "has no reflectance in bands")
    if palette not in _MAPS:
        raise ArgumentError("palette", f"must be one of {', '.join(_MAPS)}", value=palette)
    values, (low, high) = spectral_index(name, image.reflectance, bands), _RANGES[name]
    rgb = _colours((values - low) / (high - low), palette)
    factor = -(-_WIDTH_PX // rgb.shape[1])
    rgb = rgb.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.concatenate([rgb, _scale(name, low, high, rgb.shape[1], palette)])


def _colours(fraction: NDArray[np.floating[Any]], palette: Palette) -> NDArray[np.uint8]:
    from matplotlib import colormaps

    known = np.nan_to_num(np.clip(fraction, 0.0, 1.0))
    rgb = np.rint(255.0 * colormaps[_MAPS[palette]](known)[..., :3]).astype(np.uint8)
    rgb[np.isnan(fraction)] = BACKGROUND
    return rgb


def _scale(name: str, low: float, high: float, width: int, palette: Palette) -> NDArray[np.uint8]:
    """A scale bar `(_SCALE_PX, width, 3)`, with the index's name."""
    from PIL import Image, ImageDraw, ImageFont

    left, right = 2 * _MARGIN_PX, width - _MARGIN_PX // 2
    sheet = Image.new("RGB", (width, _SCALE_PX), _PAPER)
    bar = _colours(np.linspace(0.0, 1.0, right - left)[None].repeat(_BAR_PX, axis=0), palette)
    sheet.paste(Image.fromarray(bar), (left, 4))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    draw.text((8, 9), name.upper(), fill=_INK, font=font)
    for fraction in (0.0, 0.25, 0.5, 0.75, 1.0):
        text, x = f"{low + fraction * (high - low):g}", left + fraction * (right - left)
        draw.text((x, 5 + _BAR_PX), text, fill=_INK, font=font, anchor="ma")
    return np.asarray(sheet)

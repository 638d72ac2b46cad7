"""The switches by which the reader of a page shows labels over photographs; they also explain the colours."""

from __future__ import annotations

from typing import Final

from pepperscene.classes import CLASS_COLOURS, IGNORE_COLOUR, OrganClass
from pepperscene.review.report.image_view import css_colour
from pepperscene.review.report.label_regions import colour_code
from pepperscene.review.report.markup import Html, element, fragment, joined
from pepperscene.review.report.sections import colour_patch, swatch

SWITCHES: Final = (
    ("class-masks", "Class masks", "c"),
    ("instance-masks", "Instance masks", "i"),
    ("boxes", "Boxes", "b"),
    ("keypoints", "Keypoints", "k"),
)
"""Id, label and key of each switch."""


def switches_html(*, ignored: bool) -> Html:
    """The switches of the overlays, and one for each class; `ignored`: whether there are ignored pixels."""
    overlays = [_switch(label, key, id=name) for name, label, key in SWITCHES]
    classes = [
        _switch(
            fragment(swatch(organ), organ.name.lower()),
            str(int(organ)),
            name="class",
            value=int(organ),
            data_colour=colour_code(CLASS_COLOURS[organ]),
            data_name=organ.name.lower(),
            checked=None if organ == OrganClass.BACKGROUND else "",
        )
        for organ in OrganClass
    ]
    if ignored:
        classes.append(element("span", colour_patch(css_colour(IGNORE_COLOUR)), "ignored"))
    every = element(
        "button",
        "All classes",
        element("kbd", "A"),
        type="button",
        id="all-classes",
        aria_label="Switch all classes on or off",
        aria_keyshortcuts="a",
    )
    return element(
        "div",
        element("p", joined(overlays), class_="legend"),
        element("p", joined(classes), every, class_="legend"),
        id="overlays",
        role="group",
        aria_label="Overlays on photographs",
        data_ignored=colour_code(IGNORE_COLOUR),
    )


def _switch(label: str, key: str, **attributes: object) -> Html:
    box = element("input", type="checkbox", aria_keyshortcuts=key, **attributes)
    return element("label", box, label, element("kbd", key.upper()))

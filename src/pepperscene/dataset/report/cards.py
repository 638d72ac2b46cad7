"""A shown picture of a set as a card of the page, and as a row of its table."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.report.embedding import drawing, photograph
from pepperscene.dataset.report.view import TITLES, View


def card(view: View, key: str) -> str:
    """A picture's images, the first of them large, its class shares as one bar, and what is told of it.

    Args:
        view: the picture.
        key: of its set, "a" or "b".
    """
    buttons = [_button(view, name) for name in view.pictures]
    # Two pictures stand side by side; of more the first is large and the others small below it.
    images = "".join(buttons)
    if len(buttons) > 2:
        images = f'{buttons[0]}<div class="thumbs">{"".join(buttons[1:])}</div>'
    elif len(buttons) == 2:
        images = f'<div class="thumbs">{images}</div>'
    place = f"<p>{escape(view.place)}</p>" if view.place else ""
    told = _told(view.facts)
    return (
        f'<article class="card" id="{anchor(view, key)}">{images}{_stack(view)}'
        f"<h3>{escape(view.title)}</h3>{place}{f'<p>{escape(told)}</p>' if told else ''}</article>"
    )


def anchor(view: View, key: str) -> str:
    """The card's identity in the page."""
    return f"{key}-" + "".join(letter if letter.isalnum() else "-" for letter in view.name)


def line(view: View, key: str) -> str:
    """The same as a row of a table: name, place, height of the camera, error of its light, class shares."""
    facts = view.facts
    height, error = view.height_m, facts.get("sampling", {}).get("error_codes")
    cells = [
        *(str(facts.get(name, "")) for name in ("set", "rotation", "step")),
        "" if height is None else f"{height:.2f}",
        "" if error is None else f"{error:.2f}",
        *(f"{100 * count / view.area:.2f}" for count in view.pixels.values()),
    ]
    cells += [""] * (5 + len(OrganClass) - len(cells))
    first = f'<th scope="row"><a href="#{anchor(view, key)}">{escape(view.name)}</a></th>'
    return f"<tr>{first}{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def picture_button(name: str, address: str, alt: str, size: tuple[int, int], label: str = "") -> str:
    """A picture that opens large when it is clicked.

    Args:
        name: of the kind of picture; those of the same kind are walked through with the arrows up and down.
        address: of the embedded picture.
        alt: what it shows, in words.
        size: width and height in pixels.
        label: below the picture, or "".
    """
    below = f"<span>{escape(label)}</span>" if label else ""
    return (
        f'<button type="button" class="picture" aria-label="{escape(alt)}: open large">'
        f'<img src="{address}" class="{name}" data-kind="{name}" alt="{escape(alt)}" '
        f'width="{size[0]}" height="{size[1]}">{below}</button>'
    )


def hexadecimal(organ_class: OrganClass) -> str:
    """The published colour of a class, as CSS writes it."""
    return "#{:02x}{:02x}{:02x}".format(*CLASS_COLOURS[organ_class])


def _button(view: View, name: str) -> str:
    picture = view.pictures[name]
    address = photograph(picture) if name == "colour" else drawing(picture)
    alone = next(iter(view.pictures)) == name and len(view.pictures) != 2
    label = "" if alone else TITLES[name].split(" ")[-1 if name == "instance" else 0].capitalize()
    alt = f"{TITLES[name]} of {'frame ' if view.rendered else ''}{view.name}"
    return picture_button(name, address, alt, (picture.shape[1], picture.shape[0]), label)


def _stack(view: View) -> str:
    """The picture's class shares as one bar."""
    if not view.pixels:
        return ""
    parts = "".join(
        f'<b style="width:{100 * view.pixels[one] / view.area:.3f}%;background:{hexadecimal(one)}"'
        f' title="{one.name.lower()} {100 * view.pixels[one] / view.area:.1f} %"></b>'
        for one in OrganClass
        if view.pixels[one]
    )
    return f'<div class="stack">{parts}</div>'


def _told(facts: Mapping[str, Any]) -> str:
    """What is in view, in a sentence; empty where the set tells nothing of it."""
    parts = []
    instances = facts.get("instances") or {}
    if instances:
        # Greenhouse and far rows belong to no plant.
        classes = [item["class"] for item in instances.values() if item["plant"] >= 0]
        fruit, leaves = classes.count(OrganClass.PEPPER), classes.count(OrganClass.LEAF)
        parts.append(f"{len(classes)} organs in view: {leaves} leaves, {fruit} fruit")
    contacts = facts.get("contacts")
    if contacts and (touching := contacts["fruit_touching"] + contacts["blades_touching"]):
        parts.append(f"{touching} of the scene's fruit and leaves touch what they should not")
    return ". ".join(parts) + "." if parts else ""

"""The page's figures: class shares, where classes lie, their hues, the light; Figs. 10 to 13 of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.report.charts import Axis, Curve, line_chart
from pepperscene.dataset.report.colours import drawing, photograph, share_colours
from pepperscene.dataset.report.contact_sheet import TITLES, ShownImage
from pepperscene.dataset.report.data import Side
from pepperscene.truth import HUE_BINS, centre_falloff, hue_spectrum_correlation, mean_hue


def card(view: ShownImage, key: str) -> str:
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


def anchor(view: ShownImage, key: str) -> str:
    """The card's identity in the page."""
    return f"{key}-" + "".join(letter if letter.isalnum() else "-" for letter in view.name)


def line(view: ShownImage, key: str) -> str:
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


def _button(view: ShownImage, name: str) -> str:
    picture = view.pictures[name]
    address = photograph(picture) if name == "colour" else drawing(picture)
    alone = next(iter(view.pictures)) == name and len(view.pictures) != 2
    label = "" if alone else TITLES[name].split(" ")[-1 if name == "instance" else 0].capitalize()
    alt = f"{TITLES[name]} of {'frame ' if view.rendered else ''}{view.name}"
    return picture_button(name, address, alt, (picture.shape[1], picture.shape[0]), label)


def _stack(view: ShownImage) -> str:
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


_HUES: Final = np.arange(HUE_BINS) * (360.0 / HUE_BINS)
_HUE_AXIS: Final = Axis("hue, degrees", 0.0, 360.0, (0, 60, 120, 180, 240, 300, 360))
_FALLOFF_AXIS: Final = Axis("from the middle (0) to the corners (1)", 0.0, 1.0, (0, 0.25, 0.5, 0.75, 1))
_RINGS: Final = 40  # chosen: each 12 pixels wide in a picture of 800 x 600
_MAP_PX: Final = 400  # chosen: twice as wide as a map is shown


def class_shares(sides: Sequence[Side]) -> str:
    """Share of each class in all pixels, as a table with a bar for each set (Fig. 10)."""
    shares = {side.key: side.shares() for side in sides}
    known = [share for share in shares.values() if np.isfinite(share).all()]
    if not known:
        return "<p>No frame has class labels yet.</p>"
    widest = max(float(share.max()) for share in known)
    heads = "".join(f'<th scope="col">{name_of(side)}</th>' for side in sides)
    rows = "".join(
        f'<tr><th scope="row">{swatch(one)}{one.name.lower()}<small>{one:d}</small></th>'
        + "".join(f"<td>{_percent(_labelled_share(side, one))}</td>" for side in sides)
        + f'<td class="bars">{_bars([(side.key, shares[side.key][one]) for side in sides], widest)}</td></tr>'
        for one in OrganClass
    )
    counted = " and ".join(f"{plural(side.counted(), 'picture')} of {escape(side.name)}" for side in sides)
    return (
        f'<table class="shares" style="--sets: {len(sides)}"><thead>'
        f'<tr><th scope="col">Class</th>{heads}<th class="bars"></th></tr></thead>'
        f"<tbody>{rows}{_unlabelled(sides)}</tbody></table><p>Share of all pixels, in {counted}.</p>"
    )


def class_places(sides: Sequence[Side]) -> str:
    """Where in the picture each class lies: the mean of its masks over its greatest value (Fig. 11)."""
    masks = {side.key: side.statistics.mean_masks() for side in sides}
    panels = []
    for one in OrganClass:
        maps = []
        for side in sides:
            mask = masks[side.key]
            maps.append(_place_map(side, one, None if mask is None else mask[one]))
        panels.append(f"<section class=\"panel\"><h3>{swatch(one)}{one.name.lower()}</h3>"
                      f'<div class="pair">{"".join(maps)}</div></section>')  # fmt: skip
    return f'<div class="grid{" wide" if len(sides) > 1 else ""}">{"".join(panels)}</div>'


def hue_spectra(sides: Sequence[Side]) -> str:
    """Which hues the pixels of each class have, in the middle of the pictures (Fig. 12)."""
    spectra = {side.key: side.statistics.hue_spectra() for side in sides}
    panels = []
    for one in OrganClass:
        seen = [side for side in sides if np.isfinite(spectra[side.key][one]).all()]
        if not seen:
            continue
        curves = [Curve(side.key, side.name, _HUES, spectra[side.key][one]) for side in seen]
        title = f"Hues of the class {one.name.lower()}"
        chart = line_chart(f"hue{one:d}", title, curves, _HUE_AXIS, "% of its pixels", hues=True)
        panels.append(
            f'<section class="panel"><h3>{swatch(one)}{one.name.lower()}</h3>{chart}'
            f"{_hue_numbers(seen, [spectra[side.key][one] for side in seen], one)}</section>"
        )
    return f'<div class="grid">{"".join(panels)}</div>' if panels else "<p>No photograph has labels yet.</p>"


def light(sides: Sequence[Side]) -> str:
    """The mean intensity image of each set, its fall towards the corners, intensities (Fig. 13)."""
    lit = [(side, mean) for side in sides if (mean := side.statistics.mean_intensity()) is not None]
    if not lit:
        return "<p>There are no photographs yet.</p>"
    # All are brightened alike, as far as none is cut off: what differs is what one sees.
    factor = 255.0 / max(1.0, max(float(np.percentile(mean, 99.5)) for _, mean in lit))
    factor = max(1.0, np.floor(10.0 * factor) / 10.0)
    images = "".join(_intensity(side, mean, factor) for side, mean in lit)
    curves = [_falloff(side, mean) for side, mean in lit]
    chart = line_chart(
        "falloff", "Mean intensity by distance from the middle", curves, _FALLOFF_AXIS, "grey value"
    )
    return (
        f'<div class="grid">{images}'
        f'<section class="panel"><h3>Fall towards the corners</h3>{chart}</section></div>'
        '<div class="scroll" tabindex="0" role="region" aria-label="Intensities">'
        f"{_intensity_table(sides)}</div>"
    )


def swatch(organ_class: OrganClass) -> str:
    """A patch of a class's colour."""
    return (
        '<svg class="swatch" viewBox="0 0 10 10" aria-hidden="true">'
        f'<rect width="10" height="10" rx="2" fill="{hexadecimal(organ_class)}"/></svg>'
    )


def name_of(side: Side) -> str:
    """A set's name in its colour."""
    return f'<span class="key {side.key}">{escape(side.name)}</span>'


def plural(count: int, noun: str) -> str:
    """A number of things."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def _labelled_share(side: Side, organ_class: OrganClass) -> float:
    """A class's share; not known where pixels have no label and none that has is the class's."""
    share = float(side.shares()[organ_class])
    return float("nan") if share == 0.0 and side.statistics.unlabelled else share


def _bars(shares: Sequence[tuple[str, float]], widest: float) -> str:
    """Bars below each other; their lengths stand as numbers beside them."""
    bars = "".join(
        f'<rect class="{key}" y="{9 * row}" height="7" rx="1.5" width="{100 * share / widest:.2f}%"/>'
        for row, (key, share) in enumerate(shares)
        if share > 0
    )
    return f'<svg class="length" height="{9 * len(shares)}" aria-hidden="true">{bars}</svg>'


def _unlabelled(sides: Sequence[Side]) -> str:
    """A row for pixels without any label, where a set has such."""
    if not any(side.statistics.unlabelled for side in sides):
        return ""
    cells = "".join(f"<td>{_percent(side.unlabelled())}</td>" for side in sides)
    return f'<tr><th scope="row">no label</th>{cells}<td class="bars"></td></tr>'


def _place_map(side: Side, organ_class: OrganClass, mask: NDArray[np.float64] | None) -> str:
    greatest = 0.0 if mask is None else float(mask.max())
    if mask is None or greatest == 0.0:
        return f'<div class="absent"><p>{name_of(side)}<br>has no such label</p></div>'
    picture = share_colours(mask / greatest)
    alt = f"Where {organ_class.name.lower()} lies in {side.name}"
    button = picture_button("map", drawing(picture, _MAP_PX), alt, (picture.shape[1], picture.shape[0]))
    return f"<div>{button}<p>{name_of(side)} up to {_percent(greatest, 0)}</p></div>"


def _hue_numbers(
    sides: Sequence[Side], spectra: Sequence[NDArray[np.float64]], organ_class: OrganClass
) -> str:
    rows = []
    for side, spectrum in zip(sides, spectra, strict=True):
        hue = mean_hue(spectrum)
        cells = (
            "–" if np.isnan(hue) else f"{hue:.0f}°",
            _percent(side.statistics.grey_shares()[organ_class], 1),
            f"{side.statistics.hue_pictures[organ_class]:,}",
        )
        rows.append(
            f'<tr><th scope="row">{name_of(side)}</th>{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'
        )
    head = "".join(f'<th scope="col">{name}</th>' for name in ("", "mean hue", "grey", "pictures"))
    table = f'<table class="small"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    if len(spectra) == 2 and np.isfinite(correlation := hue_spectrum_correlation(*spectra)):
        table += f"<p>Correlation of the two: <b>r = {correlation:.2f}</b></p>"
    return table


def _intensity(side: Side, mean: NDArray[np.float64], factor: float) -> str:
    grey = np.rint(np.minimum(factor * mean, 255.0)).astype(np.uint8)
    picture = np.repeat(grey[..., None], 3, axis=-1)
    alt = f"Mean intensity of {side.name}"
    button = picture_button("mean", drawing(picture), alt, (grey.shape[1], grey.shape[0]))
    bright = f", shown {factor:g} times as bright" if factor > 1.0 else ""
    return (
        f'<section class="panel"><h3>{name_of(side)}</h3>{button}'
        f"<p>Mean of {plural(side.statistics.photographs, 'photograph')}: "
        f"<b>{float(np.mean(side.statistics.intensities)):.1f}</b> of 255{bright}.</p></section>"
    )


def _falloff(side: Side, mean: NDArray[np.float64]) -> Curve:
    """Mean intensity in rings around the middle, where the picture has pixels in them."""
    radii = np.linspace(0.0, 1.0, _RINGS + 1)
    rings = centre_falloff(mean, radii)
    held = np.isfinite(rings)
    return Curve(side.key, side.name, ((radii[1:] + radii[:-1]) / 2.0)[held], rings[held])


def _intensity_table(sides: Sequence[Side]) -> str:
    heads = ("Photographs", "Mean", "Deviation between them", "Darkest", "Brightest", "Saturated pixels")
    rows = []
    for side in sides:
        values = np.array(side.statistics.intensities)
        if values.size:
            cells = [plural(values.size, "photograph").split(" ")[0], *(
                f"{value:.1f}" for value in (values.mean(), values.std(), values.min(), values.max())
            ), _percent(float(np.mean(side.statistics.saturated)))]  # fmt: skip
            rows.append(
                f'<tr><th scope="row">{name_of(side)}</th>{"".join(f"<td>{c}</td>" for c in cells)}</tr>'
            )
    head = "".join(f'<th scope="col">{name}</th>' for name in ("Set", *heads))
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _percent(share: float, digits: int = 2) -> str:
    """A share as a percentage; a dash where it is not known."""
    if not np.isfinite(share):
        return "–"
    least = 10.0**-digits
    return f"< {least:g}\u00a0%" if 0 < 100 * share < least / 2 else f"{100 * share:.{digits}f}\u00a0%"

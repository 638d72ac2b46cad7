"""Sections of the page: Figs. 10 to 13 of Barth et al. 2018."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_COLOUR, OrganClass
from pepperscene.review.report.charts import Curve, line_chart
from pepperscene.review.report.colours import png_data_uri, viridis_colours
from pepperscene.review.report.data import SetSummary
from pepperscene.review.report.image_view import class_colour_code, css_colour, image_button
from pepperscene.review.report.markup import Html, element, fragment, joined
from pepperscene.truth import HUE_BINS, centre_falloff, hue_spectrum_correlation, mean_hue

_HUES: Final = np.arange(HUE_BINS) * (360.0 / HUE_BINS)
_HUE_AXIS: Final = ("hue, degrees", (0, 60, 120, 180, 240, 300, 360))
_FALLOFF_AXIS: Final = ("from the centre (0) to the corners (1)", (0, 0.25, 0.5, 0.75, 1))
_RINGS: Final = 40  # chosen: each 12 pixels wide in an image of 800 x 600
_MAP_PX: Final = 400  # chosen: twice the displayed width of a map


def class_fractions_html(sets: Sequence[SetSummary]) -> Html:
    """Fraction of each class in all pixels, as a table with a bar for each set (Fig. 10)."""
    fractions = {item.key: item.class_fractions() for item in sets}
    known = [values for values, _ in fractions.values() if np.isfinite(values).all()]
    if not known:
        return element("p", "No frame has class labels yet.")
    scale = max(float(values.max()) for values in known)
    rows = []
    for organ in OrganClass:
        values = {item.key: float(fractions[item.key][0][organ]) for item in sets}
        # Zero is unknown if the set has unlabelled pixels.
        displayed = [
            float("nan")
            if values[item.key] == 0.0 and item.statistics.unlabelled_pixels
            else values[item.key]
            for item in sets
        ]
        head = fragment(swatch(organ), organ.name.lower(), element("small", f"{organ:d}"))
        bars = fraction_bars(list(values.items()), scale)
        rows.append(_fraction_row(head, map(format_percent, displayed), bars))
    if any(item.statistics.unlabelled_pixels for item in sets):
        unlabelled = (format_percent(item.unlabelled_fraction()) for item in sets)
        rows.append(_fraction_row("no label", unlabelled))
    heads = (_head("Class", "col"), *(_head(set_label(item), "col") for item in sets))
    header = element("thead", element("tr", *heads, element("th", class_="bars")))
    counts = " and ".join(f"{plural(fractions[item.key][1], 'image')} of {item.name}" for item in sets)
    return fragment(
        element("table", header, element("tbody", *rows), class_="fractions", data_sets=len(sets)),
        element("p", f"Fraction of all pixels, in {counts}."),
    )


def class_maps_html(sets: Sequence[SetSummary]) -> Html:
    """Mean mask of each class, relative to its maximum (Fig. 11)."""
    masks = {item.key: item.statistics.mean_masks() for item in sets}
    panels = []
    for organ in OrganClass:
        maps = [_class_map(item, organ, masks[item.key]) for item in sets]
        panels.append(_class_panel(organ, element("div", *maps, class_="pair")))
    return element("div", *panels, class_="grid wide" if len(sets) > 1 else "grid")


def hue_spectra_html(sets: Sequence[SetSummary]) -> Html:
    """Distribution of the hues of each class's pixels, in the centre of the images (Fig. 12)."""
    spectra = {item.key: item.statistics.hue_spectra() for item in sets}
    panels = []
    for organ in OrganClass:
        known = [item for item in sets if np.isfinite(spectra[item.key][organ]).all()]
        if not known:
            continue
        curves = [Curve(item.key, item.name, _HUES, spectra[item.key][organ]) for item in known]
        title = f"Hues of the class {organ.name.lower()}"
        chart = line_chart(f"hue{organ:d}", title, curves, _HUE_AXIS, "% of its pixels", hue_strip=True)
        table = _hue_table(known, [curve.y for curve in curves], organ)
        panels.append(_class_panel(organ, fragment(chart, table)))
    if not panels:
        return element("p", "No photograph has labels yet.")
    return element("div", *panels, class_="grid")


def intensity_html(sets: Sequence[SetSummary]) -> Html:
    """Mean intensity image of each set, its falloff to the corners, and a table (Fig. 13)."""
    known = [(item, mean) for item in sets if (mean := item.statistics.mean_intensity()) is not None]
    if not known:
        return element("p", "There are no photographs yet.")
    # One factor for all images, so that they can be compared, and without clipping.
    factor = 255.0 / max(1.0, max(float(np.percentile(mean, 99.5)) for _, mean in known))
    factor = max(1.0, np.floor(10.0 * factor) / 10.0)
    images = joined(_mean_image(item, mean, factor) for item, mean in known)
    curves = [_falloff(item, mean) for item, mean in known]
    title = "Mean intensity by distance from the centre"
    chart = line_chart("falloff", title, curves, _FALLOFF_AXIS, "grey value")
    table = _intensity_table([item for item, _ in known])
    return fragment(
        element("div", images, panel("Falloff to the corners", chart), class_="grid"),
        element("div", table, class_="scroll", tabindex=0, role="region", aria_label="Intensities"),
    )


def legend_html(*, ignored: bool) -> Html:
    """The colours of the classes, and with `ignored` that of ignored pixels."""
    entries = [element("span", swatch(organ), organ.name.lower()) for organ in OrganClass]
    if ignored:
        entries.append(element("span", colour_patch(css_colour(IGNORE_COLOUR)), "ignored"))
    return element("p", joined(entries, " "), class_="legend")


def swatch(organ_class: OrganClass) -> Html:
    """A patch of a class's colour."""
    return colour_patch(class_colour_code(organ_class))


def colour_patch(colour: str) -> Html:
    """A patch of a colour in CSS."""
    patch = element("rect", width=10, height=10, rx=2, fill=colour)
    return element("svg", patch, class_="swatch", viewBox="0 0 10 10", aria_hidden="true")


def set_label(item: SetSummary) -> Html:
    """The name of a set with its colour."""
    return element("span", item.name, class_=f"key {item.key}")


def plural(count: int, noun: str) -> str:
    """A count with its noun."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def html_table(css_class: str, heads: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]]) -> Html:
    """A table from its column heads, and the head and the cells of each row: text or HTML."""
    header = element("thead", element("tr", *(_head(head, "col") for head in heads)))
    body = (element("tr", _head(head, "row"), _table_cells(cells)) for head, cells in rows)
    return element("table", header, element("tbody", *body), class_=css_class)


def _head(content: str, scope: str) -> Html:
    return element("th", content, scope=scope)


def _table_cells(values: Iterable[str]) -> Html:
    return joined(element("td", value) for value in values)


def _fraction_row(head: str, percentages: Iterable[str], bars: str = "") -> Html:
    """A row of the table of class fractions."""
    return element("tr", _head(head, "row"), _table_cells(percentages), element("td", bars, class_="bars"))


def panel(title: str, *contents: str) -> Html:
    """A panel with a title."""
    return element("section", element("h3", title), *contents, class_="panel")


def _class_panel(organ_class: OrganClass, content: Html) -> Html:
    return panel(fragment(swatch(organ_class), organ_class.name.lower()), content)


def format_percent(fraction: float, digits: int = 2) -> str:
    """A fraction as a percentage; a dash if it is unknown."""
    if not np.isfinite(fraction):
        return "–"
    smallest = 10.0**-digits
    is_small = 0 < 100 * fraction < smallest / 2
    return f"< {smallest:g}\u00a0%" if is_small else f"{100 * fraction:.{digits}f}\u00a0%"


def fraction_bars(fractions: Sequence[tuple[str, float]], scale: float) -> Html:
    """A bar for the fraction of each set."""
    bars = [
        element("rect", class_=key, y=9 * row, height=7, rx=1.5, width=f"{100 * fraction / scale:.2f}%")
        for row, (key, fraction) in enumerate(fractions)
        if fraction > 0
    ]
    return element("svg", *bars, class_="length", height=9 * len(fractions), aria_hidden="true")


def _class_map(item: SetSummary, organ_class: OrganClass, masks: NDArray[np.float64] | None) -> Html:
    if masks is None or not masks[organ_class].any():
        return element(
            "div", element("p", set_label(item), element("br"), "has no such label"), class_="absent"
        )
    maximum = float(masks[organ_class].max())
    picture = viridis_colours(masks[organ_class] / maximum)
    alt = f"Locations of {organ_class.name.lower()} in {item.name}"
    button = image_button("map", png_data_uri(picture, _MAP_PX), alt, (picture.shape[1], picture.shape[0]))
    return element("div", button, element("p", set_label(item), f" up to {format_percent(maximum, 0)}"))


def _hue_table(
    sets: Sequence[SetSummary], spectra: Sequence[NDArray[np.floating]], organ_class: OrganClass
) -> Html:
    rows = []
    for item, hue in zip(sets, map(mean_hue, spectra), strict=True):
        grey = format_percent(item.statistics.grey_fractions()[organ_class], 1)
        images = f"{item.statistics.hue_image_counts[organ_class]:,}"
        rows.append((set_label(item), ["–" if np.isnan(hue) else f"{hue:.0f}°", grey, images]))
    table = html_table("small", ("", "mean hue", "grey", "images"), rows)
    if len(spectra) == 2 and np.isfinite(correlation := hue_spectrum_correlation(*spectra)):
        text = element("p", "Correlation of the two: ", element("b", f"r = {correlation:.2f}"))
        return fragment(table, text)
    return table


def _mean_image(item: SetSummary, mean: NDArray[np.float64], factor: float) -> Html:
    grey = np.rint(np.minimum(factor * mean, 255.0)).astype(np.uint8)
    uri = png_data_uri(np.repeat(grey[..., None], 3, axis=-1))
    button = image_button("mean", uri, f"Mean intensity of {item.name}", (grey.shape[1], grey.shape[0]))
    brightness = f", shown {factor:g} times as bright" if factor > 1.0 else ""
    text = element(
        "p",
        f"Mean of {plural(item.statistics.photograph_count, 'photograph')}: ",
        element("b", f"{float(np.mean(item.statistics.intensities)):.1f}"),
        f" of 255{brightness}.",
    )
    return panel(set_label(item), button, text)


def _falloff(item: SetSummary, mean: NDArray[np.float64]) -> Curve:
    """Mean intensity of rings around the centre, as far as they contain pixels."""
    radii = np.linspace(0.0, 1.0, _RINGS + 1)
    rings = centre_falloff(mean, radii)
    known = np.isfinite(rings)
    return Curve(item.key, item.name, ((radii[1:] + radii[:-1]) / 2.0)[known], rings[known])


def _intensity_table(sets: Sequence[SetSummary]) -> Html:
    heads = ("Set", "Photographs", "Mean", "Standard deviation", "Darkest", "Brightest", "Saturated pixels")
    rows = []
    for item in sets:
        values = np.array(item.statistics.intensities)
        statistics = (values.mean(), values.std(), values.min(), values.max())
        saturated = format_percent(float(np.mean(item.statistics.saturated_fractions)))
        cells = [f"{values.size:,}", *(f"{value:.1f}" for value in statistics), saturated]
        rows.append((set_label(item), cells))
    return html_table("intensities", heads, rows)

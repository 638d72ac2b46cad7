"""Parts of the pages of evaluations and experiments: document, tables, pictures with a legend."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, IGNORE_COLOUR
from pepperscene.colour.comparison.tables import TextTable
from pepperscene.learning.class_table import ClassTable
from pepperscene.review.report.markup import Html, csp_hash, element, fragment, joined

_STYLE: Final = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; }
main { max-width: 75rem; margin: 0 auto; padding: 1rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem 1.1rem .25rem 0; text-align: right; border-bottom: 1px solid #ccc; }
th:first-child { text-align: left; font-weight: 500; }
td { white-space: nowrap; }
.scroll { overflow-x: auto; }
.chart { width: 100%; height: auto; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 1rem; }
.row { display: grid; grid-auto-flow: column; grid-auto-columns: minmax(0, 1fr); gap: .4rem; }
figure { margin: 0; }
img { display: block; width: 100%; height: auto; }
.legend { display: flex; flex-wrap: wrap; gap: .3rem 1.2rem; }
.swatch { width: .9em; height: .9em; margin-right: .4em; outline: 1px solid #888; }
"""

_IGNORED: Final = "no label"


def page_document(title: str, *sections: Html) -> Html:
    """A complete page, which needs no other file and loads none."""
    policy = fragment("default-src 'none'; img-src data:; style-src ", csp_hash(_STYLE))
    head = element(
        "head",
        Html('<meta charset="utf-8">'),
        Html('<meta name="viewport" content="width=device-width, initial-scale=1">'),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
        element("title", title),
        element("style", Html(_STYLE)),
    )
    body = element("body", element("main", element("h1", title), *sections))
    return fragment(Html("<!DOCTYPE html>\n"), element("html", head, body, lang="en"))


def table_section(table: TextTable) -> Html:
    """A text table as a section of the page."""
    content = data_table(table.title, table.heads, table.rows)
    notes = (element("p", note) for note in table.notes)
    return element("section", element("h2", table.title), content, *notes)


def data_table(label: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Html:
    """A table that scrolls where the window is narrow; `label` is read out for it."""
    header = element("tr", *(element("th", head, scope="col") for head in heads))
    lines = [
        element("tr", element("th", name, scope="row"), *(element("td", cell) for cell in cells))
        for name, *cells in rows
    ]
    content = element("table", element("thead", header), element("tbody", *lines))
    return element("div", content, class_="scroll", tabindex=0, role="region", aria_label=label)


def picture_row(panels: Sequence[tuple[str, str]], name: str, size: tuple[int, int]) -> Html:
    """Pictures of one image beside each other.

    Args:
        panels: title and data URI of each.
        name: of the image.
        size: height and width in pixels.
    """
    figures = [
        element(
            "figure",
            element("img", src=uri, alt=f"{title} of {name}", height=size[0], width=size[1]),
            element("figcaption", title),
        )
        for title, uri in panels
    ]
    return element("div", *figures, class_="row")


def ranked_examples(mean_iou: NDArray[np.float64]) -> list[tuple[str, int]]:
    """The best, the median and the worst image by mean IoU `(n,)`: word and position; fewer of fewer images."""
    order = [int(at) for at in np.argsort(-mean_iou, kind="stable") if np.isfinite(mean_iou[at])]
    if not order:
        return []
    # Of one or two images, later words replace earlier ones.
    words = {len(order) // 2: "median", len(order) - 1: "worst", 0: "best"}
    return [(words[place], order[place]) for place in sorted(words)]


def class_legend(classes: ClassTable, *indices: NDArray[np.uint8]) -> Html:
    """Names and colours of the classes that occur in index images."""
    palette = class_palette_of(classes)
    names = {**dict(enumerate(classes.names)), IGNORE_CLASS: _IGNORED}
    present = sorted({int(index) for image in indices for index in np.unique(image)})
    return legend([("#" + bytes(palette[index].tolist()).hex(), names[index]) for index in present])


def legend(entries: Sequence[tuple[str, str]]) -> Html:
    """Colours ("#rrggbb") with what they stand for."""
    items = []
    for colour, name in entries:
        patch = element("rect", width=10, height=10, fill=colour)
        swatch = element("svg", patch, viewBox="0 0 10 10", class_="swatch", aria_hidden="true")
        items.append(element("span", swatch, name))
    return element("p", joined(items, " "), class_="legend")


def class_palette_of(classes: ClassTable) -> NDArray[np.uint8]:
    """8-bit RGB `(256, 3)` of the indices of a table; grey for pixels without a label."""
    palette = np.full((256, 3), IGNORE_COLOUR, np.uint8)
    palette[: len(classes)] = classes.colours
    return palette

"""Parts of the pages of evaluations and experiments: document, tables, pictures with a legend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, IGNORE_COLOUR
from pepperscene.colour.comparison.tables import TextTable
from pepperscene.dataset.report.markup import Html, csp_hash, element, fragment, joined
from pepperscene.learning.class_table import ClassTable

_STYLE: Final = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 0 auto; padding: 1rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .9rem .2rem 0; text-align: right; border-bottom: 1px solid #8886; }
th:first-child { text-align: left; font-weight: 500; }
.scroll { overflow-x: auto; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(14rem, 1fr)); gap: .5rem; }
figure { margin: 0; }
img { display: block; width: 100%; height: auto; }
.legend { display: flex; flex-wrap: wrap; gap: .3rem 1.1rem; }
.legend svg { width: .9em; height: .9em; margin-right: .4em; outline: 1px solid #8886; }
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
    header = element("tr", *(element("th", head, scope="col") for head in table.heads))
    rows = [
        element("tr", element("th", name, scope="row"), *(element("td", cell) for cell in cells))
        for name, *cells in table.rows
    ]
    content = element("table", element("thead", header), element("tbody", *rows))
    region = element("div", content, class_="scroll", tabindex=0, role="region", aria_label=table.title)
    return element(
        "section", element("h2", table.title), region, *(element("p", note) for note in table.notes)
    )


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


def class_legend(classes: ClassTable, *indices: NDArray[np.uint8]) -> Html:
    """Names and colours of the classes that occur in index images."""
    palette = class_palette_of(classes)
    names = {**dict(enumerate(classes.names)), IGNORE_CLASS: _IGNORED}
    present = sorted({int(index) for image in indices for index in np.unique(image)})
    entries = [element("span", _swatch(palette[index]), names[index]) for index in present]
    return element("p", joined(entries, " "), class_="legend")


def class_palette_of(classes: ClassTable) -> NDArray[np.uint8]:
    """8-bit RGB `(256, 3)` of the indices of a table; grey for pixels without a label."""
    palette = np.full((256, 3), IGNORE_COLOUR, np.uint8)
    palette[: len(classes)] = classes.colours
    return palette


def _swatch(colour: NDArray[np.uint8]) -> Html:
    """A patch of a class's colour."""
    code = "#" + bytes(colour.tolist()).hex()
    patch = element("rect", width=10, height=10, fill=code)
    return element("svg", patch, viewBox="0 0 10 10", aria_hidden="true")

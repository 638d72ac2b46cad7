"""The library three.js, from the template of trimesh's viewer, so that this package holds no copy of it."""

from __future__ import annotations

import re
from typing import Final

from pepperscene.review.report.markup import Html

_LIBRARY: Final = re.compile(
    r"<script>\s*(/\*\*\s+\* @license\s+\* Copyright [^\n]*Three\.js Authors\n.*?\*/\n[^\n]+)\n", re.DOTALL
)
"""The first script of the template starts with the licence and one line, the minified library."""


def three_js() -> Html | None:
    """The library with its licence notice (MIT), as a script that defines `THREE`.

    None if the installed trimesh does not contain it: versions before 4.8.3 have one of 2020 without its
    licence notice.
    """
    try:
        from trimesh.resources import get_bytes
        from trimesh.util import decompress

        (template,) = decompress(get_bytes("templates/viewer.zip"), file_type="zip").values()
        page = template.read().decode("utf-8")
    except (ImportError, OSError, KeyError, ValueError):
        return None
    found = _LIBRARY.search(page)
    return None if found is None else Html(found[1])

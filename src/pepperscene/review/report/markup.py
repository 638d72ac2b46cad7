"""HTML from elements: text becomes HTML only by escaping, so that data cannot add elements or attributes.

A function that returns `Html` has escaped all data in it. A plain string is text, wherever it comes from;
`element` and `fragment` escape it. HTML that is mistaken for text is visible on the page as text.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable
from html import escape
from typing import Final, final

_VOID: Final = frozenset({"br", "img", "input"})
"""The elements without an end tag, of those that the page uses."""


@final
class Html(str):
    """HTML in which all data are escaped; made of constants, or by the functions of this module."""

    __slots__ = ()


def as_html(content: str) -> Html:
    """The content itself if it is HTML; otherwise it is text, which is escaped."""
    return content if isinstance(content, Html) else Html(escape(content))


def fragment(*contents: str) -> Html:
    """Text and HTML, one after the other."""
    return joined(contents)


def joined(contents: Iterable[str], separator: str = "") -> Html:
    """Text and HTML, with a separator between them, which is text or HTML too."""
    return Html(as_html(separator).join(map(as_html, contents)))


def element(tag: str, *contents: str, **attributes: object) -> Html:
    """An element with text and HTML in it.

    Args:
        tag: its name, a constant.
        contents: text, which is escaped, and HTML, which is not.
        attributes: by name, with "_" instead of "-", and with a "_" at the end of Python's keywords; all
            values are escaped, and attributes whose value is None are omitted.
    """
    values = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(str(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    end = "" if tag in _VOID else f"</{tag}>"
    return Html(f"<{tag}{values}>{joined(contents)}{end}")


def csp_hash(text: str) -> Html:
    """Source of a content security policy that allows the script or style element with exactly this text.

    A hash, unlike 'unsafe-inline', does not allow any other script, event handler or style attribute.
    """
    return Html(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'")

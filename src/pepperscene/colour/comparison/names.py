"""Names of image sets, as text that files and figures can hold."""

from __future__ import annotations


def printable_name(name: str) -> str:
    """A name with escape sequences instead of characters that a text file, or XML, cannot hold."""
    letters = (
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in name
    )
    return "".join(letters)

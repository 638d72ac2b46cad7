"""TOML as people write it here: tables under headings, small ones in one line, a comment behind a value.

No library that is needed anyway writes comments, and what was tuned is to be told beside the number.
"""

from __future__ import annotations

import datetime
import json
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

_DIGITS: Final = 12
"""Chosen: six more than any fit can tell, and a last digit that no rounding of sums reaches."""
_WIDTH: Final = 116  # chosen: of comment lines


def document(
    tables: Mapping[str, Any], comments: Mapping[str, str] | None = None, head: str = "", deep: int = 1
) -> str:
    """A whole file.

    Args:
        tables: its keys; tables among them come behind the rest, `deep` levels of them under headings.
        comments: by dotted key, what to say behind a value.
        head: paragraphs to say at the top.
        deep: levels of tables that get headings.
    """
    lines = list(_commented(head))
    if lines:
        lines.append("")
    lines += _table(tables, (), dict(comments or {}), deep)
    return "\n".join(lines).rstrip() + "\n"


def rounded(value: float) -> float:
    """The number as a file says it."""
    return float(f"{float(value):.{_DIGITS}g}")


def inline(value: Any) -> str:
    """A value on one line.

    Raises:
        ValueError: TOML has no such value, or a number is not finite.
    """
    if isinstance(value, np.ndarray | np.generic):
        return inline(value.tolist())
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        if not np.isfinite(value):
            raise ValueError(f"{value} has no place in a file")
        text = repr(rounded(value))
        return (
            text.removesuffix(".0") if "." in text and text.removesuffix(".0").lstrip("-").isdigit() else text
        )
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        # JSON's strings are TOML's, but for one control character.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {inline(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(inline(one) for one in value) + "]"
    raise ValueError(f"TOML has no {type(value).__name__}")


def _table(
    table: Mapping[str, Any], above: tuple[str, ...], comments: Mapping[str, str], deep: int
) -> Iterator[str]:
    headed = {key: value for key, value in table.items() if isinstance(value, Mapping) and deep > 0}
    for key, value in table.items():
        if key in headed:
            continue
        comment = comments.get(".".join((*above, key)))
        behind = f"  # {' '.join(comment.split())}" if comment else ""
        if isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple):
            yield f"{_key(key)} = [{behind}"
            yield from (f"    {inline(row)}," for row in value)
            yield "]"
        else:
            yield f"{_key(key)} = {inline(value)}{behind}"
    for key, value in headed.items():
        inner = tuple(_table(value, (*above, key), comments, deep - 1))
        # A table of tables alone, which begins with the empty line before one, needs no heading of its own.
        if not inner or inner[0]:
            yield from ("", f"[{'.'.join(_key(part) for part in (*above, key))}]")
        yield from inner


def _commented(head: str) -> Iterator[str]:
    for paragraph in head.splitlines():
        indent = paragraph[: len(paragraph) - len(paragraph.lstrip())]
        yield from (
            f"# {line}"
            for line in textwrap.wrap(
                paragraph.strip(),
                _WIDTH,
                initial_indent=indent,
                subsequent_indent=2 * indent,
                break_long_words=False,
            )
        )


def _key(key: str) -> str:
    bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if bare else inline(key)

"""Data for the page's script: JSON, deflated, as text of an attribute."""

from __future__ import annotations

import base64
import json
import zlib
from typing import Any


def pack(value: Any) -> str:
    """A JSON value as base64 of its zlib stream; the page's function `unpack` reads it.

    Raises:
        ValueError: a number is not finite.
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def unpack(text: str) -> Any:
    """The value that `pack` was given, with lists for tuples."""
    return json.loads(zlib.decompress(base64.b64decode(text)))

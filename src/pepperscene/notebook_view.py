"""HTML by which notebooks show objects: a line of text, and small pictures beside each other."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.user_files import open_file

_SHOWN: Final = 6  # chosen: frames of a data set; two rows in a notebook

VIEWABLE: Final = ("colour", "class_colour", "class", "instance", "distance_code", "raw")
"""Outputs that any viewer shows, the best first."""

WIDTH_PX: Final = 200
"""Chosen: width of a picture; four fit beside each other in a notebook."""


def picture_html(picture: NDArray[np.uint8] | BinaryIO, caption: str) -> str:
    """A small picture with a caption.

    Args:
        picture: `(h, w)` or `(h, w, 3)` uint8, or an open PNG file.
        caption: plain text.
    """
    from PIL import Image

    # Only here: the import takes a tenth of a second.
    image: Any = (
        Image.fromarray(picture) if isinstance(picture, np.ndarray) else Image.open(picture, formats=("PNG",))
    )
    with image:
        small = image.convert("RGB")
        small.thumbnail((WIDTH_PX, 2 * WIDTH_PX))
        file = BytesIO()
        small.save(file, "PNG")
    source = f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
    image_tag = f'<img src="{source}" width="{small.width}" height="{small.height}" alt="">'
    return figure_html(image_tag, caption)


def object_html(text: str, figures: Iterable[str] = (), notes: Iterable[str] = ()) -> str:
    """An object as its line of text, figures beside each other, and a line for each note."""
    row = "".join(figures)
    parts = [f"<p><code>{html.escape(text)}</code></p>"]
    parts += [f'<div style="display:flex;flex-wrap:wrap;gap:8px">{row}</div>'] if row else []
    parts += [f"<p>{html.escape(note)}</p>" for note in notes]
    return "".join(parts)


def figure_html(content: str, caption: str) -> str:
    """A picture or a drawing, as HTML or SVG, with a caption."""
    label = f'<figcaption style="font-size:smaller">{html.escape(caption)}</figcaption>'
    return f'<figure style="margin:0">{content}{label}</figure>'


def frames_html(
    text: str, indices: Sequence[int], path: Callable[[int, str], Path], notes: Sequence[str] = ()
) -> str:
    """HTML of some of a data set's frames, evenly spaced: a line, pictures, and a line for each note.

    `indices` are those of all frames; `path` leads from index and output to its file.
    """
    return object_html(text, _pictures(indices, path), notes)


def _pictures(indices: Sequence[int], path: Callable[[int, str], Path]) -> Iterator[str]:
    """A picture for each of some frames; a frame without one, or with a damaged one, is left out."""
    step = max(1, -(-len(indices) // _SHOWN))
    for index in indices[::step]:
        files = (path(index, output) for output in VIEWABLE)
        file = next((file for file in files if file.exists()), None)
        if file is not None:
            # Files are in the folders of the outputs.
            with (
                suppress(InputError, OSError, ValueError),
                open_file(file, "image", within=file.parents[1]) as content,
            ):
                yield picture_html(content, f"frame {index}")

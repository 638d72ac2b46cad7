"""How notebooks show the frames of a data set: small pictures beside each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from pepperscene.errors import InputError
from pepperscene.notebook_view import object_html, picture_html
from pepperscene.user_files import open_file

VIEWABLE: Final = ("colour", "class_colour", "class", "instance", "distance_code", "raw")
"""Outputs that any viewer shows, the best first."""

_SHOWN: Final = 6  # chosen: pictures; two rows in a notebook


def frames_html(
    text: str, indices: Sequence[int], path: Callable[[int, str], Path], notes: Sequence[str] = ()
) -> str:
    """HTML of some of a data set's frames, evenly spaced.

    Args:
        text: line above the pictures.
        indices: of all frames.
        path: from index and output to its file.
        notes: lines below the pictures.
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

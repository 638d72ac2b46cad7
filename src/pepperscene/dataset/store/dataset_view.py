"""How notebooks show a data set: some of its frames as small pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from pepperscene.notebook_view import object_html, picture_html

if TYPE_CHECKING:
    from pepperscene.dataset.store.dataset import Dataset

VIEWABLE: Final = ("colour", "class_colour", "class", "instance", "distance_code", "raw")
"""Outputs that any viewer shows, the best first."""

_SHOWN: Final = 6  # chosen: pictures; two rows in a notebook


def dataset_html(dataset: Dataset, text: str | None = None, notes: Sequence[str] = ()) -> str:
    """HTML of a data set.

    Args:
        dataset: whose frames are shown, evenly spaced over those that exist.
        text: the line above the pictures; None for the data set's own.
        notes: lines below them.
    """
    return object_html(repr(dataset) if text is None else text, _pictures(dataset), notes)


def _pictures(dataset: Dataset) -> Iterator[str]:
    """A picture for each of some frames; a frame without one, or with a damaged one, is left out."""
    indices = dataset.indices()
    step = max(1, -(-len(indices) // _SHOWN))
    for index in indices[::step]:
        paths = (dataset.path(index, output) for output in VIEWABLE)
        path = next((path for path in paths if path.exists()), None)
        if path is not None:
            with suppress(OSError, ValueError):
                yield picture_html(path, f"frame {index}")

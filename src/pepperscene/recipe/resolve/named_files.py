"""Files that recipes name, each read once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, Final, TypeVar

from pepperscene.errors import InputError

_MAX_KEPT: Final = 64
"""Chosen: more files than most recipes name. A cultivar takes 0.3 MB, and a recipe can vary its values in
every frame."""

Content = TypeVar("Content")


class NamedFiles:
    """Loads files that recipes name, and keeps the latest of them."""

    def __init__(self) -> None:
        self._contents: dict[tuple[Hashable, str], Any] = {}

    def load(
        self,
        load: Callable[[str], Content],
        where: str | Path,
        key: str,
        name: str,
        content: Hashable | None = None,
    ) -> Content:
        """Load a file by its name; if there is none, the error names the recipe, `where`, and its key.

        The same function loads all files of a kind, unless `content` identifies what is loaded.
        """
        index = (content or load, name)
        if index in self._contents:
            kept: Content = self._contents[index]
            return kept
        try:
            loaded = load(name)
        except InputError as error:
            if error.key or error.where != name:
                raise
            raise InputError(where, error.problem, key=key, value=name) from None
        if len(self._contents) >= _MAX_KEPT:
            del self._contents[next(iter(self._contents))]
        self._contents[index] = loaded
        return loaded

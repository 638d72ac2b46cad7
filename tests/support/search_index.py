"""The search index of built documentation, queried as the page's own script does."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sphinx.search.en import SearchEnglish


class SearchIndex:
    """The index of a built website.

    Args:
        html: folder of the website.
    """

    def __init__(self, html: Path) -> None:
        text = (html / "searchindex.js").read_text(encoding="utf-8")
        self._content: dict[str, Any] = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))
        self._language = SearchEnglish({})

    def pages(self, query: str) -> set[str]:
        """The pages that have all words of a query, in their text or in headings."""
        return self._with_all_words(query, self._content["terms"], self._content["titleterms"])

    def pages_by_heading(self, query: str) -> set[str]:
        """Those that have all words in headings: they are the first results."""
        return self._with_all_words(query, self._content["titleterms"])

    def _with_all_words(self, query: str, *tables: Mapping[str, int | list[int]]) -> set[str]:
        words = [word for word in query.lower().split() if word not in self._language.stopwords]
        assert words
        found = [set().union(*(self._documents(table, word) for table in tables)) for word in words]
        return {self._content["docnames"][number] for number in set.intersection(*found)}

    def _documents(self, table: Mapping[str, int | list[int]], word: str) -> set[int]:
        numbers = table.get(self._language.stem(word), [])
        return {numbers} if isinstance(numbers, int) else set(numbers)

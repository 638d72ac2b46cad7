"""Pages of reports, parsed."""

from __future__ import annotations

import re
from html.parser import HTMLParser

VOID = ("meta", "img", "input", "br", "link")


class Page(HTMLParser):
    """A page whose elements are closed in order.

    Attributes:
        text: its source.
        elements: tag and attributes of each element.
        texts: by tag, the texts in elements of it.
    """

    def __init__(self, path):
        super().__init__()
        self.text, self.elements, self.texts, self.open = path.read_text(encoding="utf-8"), [], {}, []
        self.feed(self.text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.setdefault(self.open[-1] if self.open else "", []).append(data)

    def of(self, tag, **expected):
        """Attributes of the elements of a tag that have the expected ones."""
        return [attrs for name, attrs in self.elements if name == tag and expected.items() <= attrs.items()]

    def scripts(self):
        return [text for text in self.texts["script"] if text.strip()]

    def links(self):
        """Targets of the links within the page, all of which exist; ids are unique and without spaces."""
        ids = [attrs["id"] for _, attrs in self.elements if "id" in attrs]
        assert len(ids) == len(set(ids))
        assert not [name for name in ids if re.search(r"\s", name)]
        targets = [attrs["href"][1:] for _, attrs in self.elements if attrs.get("href", "").startswith("#")]
        assert set(targets) <= set(ids)
        return targets

    def policy(self):
        """The sources that the page's security policy allows, by directive."""
        (content,) = (attrs["content"] for _, attrs in self.elements if "http-equiv" in attrs)
        return {name: values for name, *values in (part.split() for part in content.split(";"))}

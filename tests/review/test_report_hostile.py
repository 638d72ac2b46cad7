"""The page of a data set from a stranger: no element, attribute or script comes from its files."""

from __future__ import annotations

import base64
import hashlib
import re
import shutil
from html.parser import HTMLParser

import pytest
from hostile_set import (
    FILE_NAME,
    NUMBERS,
    TEXT,
    edit_frame,
    edit_json,
    make_hostile,
    make_photographs,
    make_plain_set,
    set_number,
)

from pepperscene.errors import PepperError
from pepperscene.review.report import write_report
from pepperscene.version import __version__

URL_ATTRIBUTES = ("href", "src", "xlink:href")


class Elements(HTMLParser):
    """Elements of a page as tag and attributes, and the text in elements of each tag."""

    def __init__(self, page):
        super().__init__()
        self.elements, self.texts, self.open = [], {}, []
        self.text = page.read_text(encoding="utf-8")
        self.feed(self.text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self.open.append(tag)

    def handle_endtag(self, tag):
        while self.open.pop() != tag:
            pass

    def handle_data(self, data):
        tag = self.open[-1] if self.open else ""
        self.texts[tag] = self.texts.get(tag, "") + data

    def structure(self):
        """Tags and names of attributes in order."""
        return [(tag, sorted(attrs)) for tag, attrs in self.elements]

    def policy(self):
        (content,) = [attrs["content"] for _, attrs in self.elements if "http-equiv" in attrs]
        return {name: values for name, *values in (part.split() for part in content.split(";"))}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A data set, photographs, and their page."""
    parent = tmp_path_factory.mktemp("plain")
    folder, photographs = make_plain_set(parent), make_photographs(parent, "photographs", "photo")
    return folder, Elements(write_report(folder, beside=photographs, limit=2).page)


@pytest.fixture(scope="module")
def hostile(plain, tmp_path_factory):
    """The page of the same data set and photographs with hostile texts and names."""
    parent = tmp_path_factory.mktemp("hostile")
    folder = shutil.copytree(plain[0], parent / FILE_NAME)
    make_hostile(folder)
    photographs = make_photographs(parent, f"{FILE_NAME}2", FILE_NAME)
    return Elements(write_report(folder, beside=photographs, limit=2).page)


def assert_harmless(page):
    """No scripts but the page's, no event handlers, styles, or links to elsewhere."""
    tags = [tag for tag, _ in page.elements]
    assert (tags.count("script"), tags.count("style"), tags.count("meta")) == (1, 1, 4)
    assert not {"iframe", "object", "embed", "base", "form"} & set(tags)
    for _, attrs in page.elements:
        assert not [name for name in attrs if name.startswith("on") or name == "style"]
        assert all(attrs.get(name, "#").startswith(("#", "data:")) for name in URL_ATTRIBUTES)


def test_no_element_or_attribute_comes_from_data(plain, hostile):
    assert hostile.structure() == plain[1].structure()
    assert_harmless(hostile)


def test_hostile_texts_are_shown_as_they_are(hostile):
    assert hostile.texts["title"].startswith(f"{TEXT} · pepperscene")
    assert hostile.texts["h1"] == TEXT
    assert f"cultivar {TEXT}, with exact labels" in hostile.texts["p"]
    # Quality and version.
    assert hostile.texts["dd"].count(TEXT) == 2
    alts = [attrs["alt"] for tag, attrs in hostile.elements if tag == "img"]
    assert f"Colour of 0{FILE_NAME}" in alts
    assert f"Mean intensity of {FILE_NAME}2" in alts
    assert f"Images of {FILE_NAME}" in [attrs.get("aria-label") for _, attrs in hostile.elements]
    assert f"{FILE_NAME}: maximum" in hostile.texts["desc"]


def test_links_of_hostile_names_have_targets(hostile):
    ids = [attrs["id"] for _, attrs in hostile.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    links = {attrs["href"][1:] for _, attrs in hostile.elements if attrs.get("href", "").startswith("#")}
    assert links <= set(ids)
    assert not [name for name in ids if re.search(r"\s", name)]


def test_policy_allows_exactly_the_script_and_the_style_of_the_page(hostile):
    policy = hostile.policy()
    assert policy.keys() == {"default-src", "img-src", "style-src", "script-src", "base-uri", "form-action"}
    assert policy["default-src"] == policy["base-uri"] == policy["form-action"] == ["'none'"]
    assert policy["img-src"] == ["data:"]
    for tag in ("script", "style"):
        digest = hashlib.sha256(hostile.texts[tag].encode()).digest()
        assert policy[f"{tag}-src"] == [f"'sha256-{base64.b64encode(digest).decode()}'"]


@pytest.mark.parametrize("version", [TEXT, __version__])
def test_scene_of_a_hostile_recipe_is_refused_in_words(plain, tmp_path, version):
    folder = shutil.copytree(plain[0], tmp_path / "set")
    make_hostile(folder)
    edit_json(folder / "dataset.json", lambda content: {**content, "version": version})
    files = write_report(folder, limit=2, scene=True)
    page = Elements(files.page)
    assert_harmless(page)
    assert f"There is no 3D view: {files.missing_scene}." in page.texts["p"]
    assert (TEXT in files.missing_scene) == (version == TEXT)


@pytest.fixture(scope="module")
def one_frame(plain, tmp_path_factory):
    """One frame without photograph, whose page has few charts."""
    folder = shutil.copytree(plain[0], tmp_path_factory.mktemp("one") / "set")
    for path in (*folder.glob("frames/*[1-8].json"), *folder.glob("*.parquet"), folder / "index.html"):
        path.unlink()
    edit_frame(folder, 0, lambda content: content | {"outputs": {"class": content["outputs"]["class"]}})
    assert_harmless(Elements(write_report(folder).page))
    (folder / "index.html").unlink()
    return folder


@pytest.mark.parametrize("field", NUMBERS, ids=".".join)
def test_number_is_refused_or_escaped(one_frame, tmp_path, field):
    folder = shutil.copytree(one_frame, tmp_path / "set")
    set_number(folder, field, TEXT)
    try:
        page = write_report(folder).page
    except PepperError:
        assert not (folder / "index.html").exists()
    else:
        assert_harmless(Elements(page))

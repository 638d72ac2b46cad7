"""The page of a data set from a stranger: no element, attribute or script comes from its files."""

from __future__ import annotations

import base64
import hashlib
import shutil

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
from report_page import Page

from pepperscene.errors import PepperError
from pepperscene.review.report import write_report
from pepperscene.version import __version__

URL_ATTRIBUTES = ("href", "src", "xlink:href")


def structure(page):
    """Tags and names of attributes in order."""
    return [(tag, sorted(attrs)) for tag, attrs in page.elements]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A data set, photographs, and their page."""
    parent = tmp_path_factory.mktemp("plain")
    folder, photographs = make_plain_set(parent), make_photographs(parent, "photographs", "photo")
    return folder, Page(write_report(folder, beside=photographs, limit=2).page)


@pytest.fixture(scope="module")
def hostile(plain, tmp_path_factory):
    """The page of the same data set and photographs with hostile texts and names."""
    parent = tmp_path_factory.mktemp("hostile")
    folder = shutil.copytree(plain[0], parent / FILE_NAME)
    make_hostile(folder)
    photographs = make_photographs(parent, f"{FILE_NAME}2", FILE_NAME)
    return Page(write_report(folder, beside=photographs, limit=2).page)


def assert_harmless(page):
    """No scripts but the page's, no event handlers, styles, or links to elsewhere."""
    tags = [tag for tag, _ in page.elements]
    assert (tags.count("script"), tags.count("style"), tags.count("meta")) == (1, 1, 4)
    assert not {"iframe", "object", "embed", "base", "form"} & set(tags)
    for _, attrs in page.elements:
        assert not [name for name in attrs if name.startswith("on") or name == "style"]
        assert all(attrs.get(name, "#").startswith(("#", "data:")) for name in URL_ATTRIBUTES)


def test_no_element_or_attribute_comes_from_data(plain, hostile):
    assert structure(hostile) == structure(plain[1])
    assert_harmless(hostile)


def test_hostile_texts_are_shown_as_they_are(hostile):
    texts = {tag: "".join(parts) for tag, parts in hostile.texts.items()}
    assert texts["title"].startswith(f"{TEXT} · pepperscene")
    assert texts["h1"] == TEXT
    assert f"cultivar {TEXT}, with exact labels" in texts["p"]
    # Quality and version.
    assert texts["dd"].count(TEXT) == 2
    alts = [attrs["alt"] for attrs in hostile.of("img")]
    assert f"Colour of 0{FILE_NAME}" in alts
    assert f"Mean intensity of {FILE_NAME}2" in alts
    assert f"Images of {FILE_NAME}" in [attrs.get("aria-label") for _, attrs in hostile.elements]
    assert f"{FILE_NAME}: maximum" in texts["desc"]
    assert hostile.links()


def test_policy_allows_exactly_the_script_and_the_style_of_the_page(hostile):
    policy = hostile.policy()
    assert policy.keys() == {"default-src", "img-src", "style-src", "script-src", "base-uri", "form-action"}
    assert policy["default-src"] == policy["base-uri"] == policy["form-action"] == ["'none'"]
    assert policy["img-src"] == ["data:"]
    for tag in ("script", "style"):
        digest = hashlib.sha256("".join(hostile.texts[tag]).encode()).digest()
        assert policy[f"{tag}-src"] == [f"'sha256-{base64.b64encode(digest).decode()}'"]


@pytest.mark.parametrize("version", [TEXT, __version__])
def test_scene_of_a_hostile_recipe_is_refused_in_words(plain, tmp_path, version):
    folder = shutil.copytree(plain[0], tmp_path / "set")
    make_hostile(folder)
    edit_json(folder / "dataset.json", lambda content: {**content, "version": version})
    files = write_report(folder, limit=2, scene=True)
    page = Page(files.page)
    assert_harmless(page)
    assert f"There is no 3D view: {files.missing_scene}." in "".join(page.texts["p"])
    assert (TEXT in files.missing_scene) == (version == TEXT)


@pytest.fixture(scope="module")
def one_frame(plain, tmp_path_factory):
    """One frame without photograph, whose page has few charts."""
    folder = shutil.copytree(plain[0], tmp_path_factory.mktemp("one") / "set")
    for path in (*folder.glob("frames/*[1-8].json"), *folder.glob("*.parquet"), folder / "index.html"):
        path.unlink()
    edit_frame(folder, 0, lambda content: content | {"outputs": {"class": content["outputs"]["class"]}})
    assert_harmless(Page(write_report(folder).page))
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
        assert_harmless(Page(page))

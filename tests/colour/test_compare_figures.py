"""The figure of a comparison, as the elements that it is made of."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from painted_pictures import flat, noisy, painted

from pepperscene.colour import PatchSet, compare, open_patches

SVG = "{http://www.w3.org/2000/svg}"
ONE, OTHER = noisy(1, 3, name="ours & <mine>"), noisy(2, 4, name="theirs")


def drawn(found):
    return ElementTree.fromstring(found.figure())


def words(root):
    return [element.text or "" for element in root.iter(f"{SVG}text")]


@pytest.fixture(scope="module")
def found():
    return compare(ONE, OTHER)


def test_both_sets_are_named_and_all_four_figures_are_there(found):
    text = words(drawn(found))
    assert "ours & <mine>: 3 of 3 pictures" in text
    assert "theirs: 4 of 4 pictures" in text
    assert [one[:7] for one in text if one.startswith("Fig.")] == ["Fig. 10", "Fig. 11", "Fig. 12", "Fig. 13"]


def test_every_kind_has_both_hue_spectra_where_they_belong(found):
    root = drawn(found)
    charts = [svg for svg in root.iter(f"{SVG}svg") if "Hues of" in (svg.findtext(f"{SVG}title") or "")]
    assert [svg.findtext(f"{SVG}title") for svg in charts] == [f"Hues of {kind}" for kind in found.kinds]
    for svg, kind in zip(charts, found.kinds, strict=True):
        lines = list(svg.iter(f"{SVG}polyline"))
        assert [line.get("class") for line in lines] == ["a", "b"]
        for line, side in zip(lines, (found.one, found.other), strict=True):
            heights = -np.array([float(pair.split(",")[1]) for pair in line.get("points").split()])
            spectrum = side.statistics.hue_spectra()[list(found.kinds).index(kind)]
            assert np.corrcoef(heights, spectrum)[0, 1] > 0.999


def test_bars_are_as_long_as_shares(found):
    root = drawn(found)
    for key, side in (("a", "one"), ("b", "other")):
        bars = [
            bar for bar in root.iter(f"{SVG}rect") if bar.get("class") == key and bar.get("height") == "12"
        ]
        shares = [getattr(kind, side).share.value for kind in found.kinds.values()]
        lengths = np.array([float(bar.get("width")) for bar in bars])
        np.testing.assert_allclose(lengths / lengths.sum(), np.array(shares) / np.sum(shares), atol=1e-3)


def test_it_stands_alone(found):
    text = found.figure()
    assert re.findall(r'(?:href|src)="(?!data:image/png)', text) == []
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text).lower()
    root = drawn(found)
    identities = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(set(identities)) == len(identities)
    # All colours are told in the drawing: no class without a style, and no style that a page would have.
    assert "var(" not in text


def test_a_figure_of_a_set_and_patches_has_what_both_can_tell():
    patches = replace(open_patches(OTHER), name="patches")
    text = words(drawn(compare(ONE, patches)))
    assert any(one.startswith("Fig. 12") for one in text)
    text = words(drawn(compare(patches, patches)))
    assert [one[:7] for one in text if one.startswith("Fig.")] == ["Fig. 12"]
    assert isinstance(patches, PatchSet)


def test_sets_without_labels_or_without_light_can_be_drawn():
    bare = painted((flat((90, 90, 90))[0], None), name="bare")
    dark = painted((None, flat((0, 0, 0))[1]), name="dark")
    for one, other in ((bare, bare), (dark, dark), (bare, dark), (ONE, bare), (dark, ONE)):
        drawn(compare(one, other))

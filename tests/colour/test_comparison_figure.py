"""The figure of a comparison: its artists and its bytes."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from image_sets import image_set, noisy_set, uniform
from matplotlib.figure import Figure

from pepperscene.colour import compare, comparison_figure, open_patches

FIRST, SECOND = noisy_set(1, 3, name="ours & <mine>"), noisy_set(2, 4, name="theirs")


def words(svg):
    root = ElementTree.fromstring(svg)
    return ["".join(element.itertext()) for element in root.iter("{http://www.w3.org/2000/svg}text")]


def figures_of_paper(svg):
    return [text[:7] for text in words(svg) if text.startswith("Fig.")]


@pytest.fixture(scope="module")
def comparison():
    return compare(FIRST, SECOND)


@pytest.fixture(scope="module")
def drawn(comparison):
    """The figure as SVG, and all its axes."""
    figures, save = [], Figure.savefig
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda self, *a, **k: (figures.append(self), save(self, *a, **k)))
        svg = comparison_figure(comparison)
    return svg, [axes for part in figures[0].subfigs for axes in part.axes]


@pytest.fixture(scope="module")
def axes(drawn):
    return drawn[1]


def test_names_both_sets_and_has_all_four_figures_without_links(drawn):
    svg = drawn[0]
    assert "ours & <mine>: 3 of 3 images" in words(svg)
    assert "theirs: 4 of 4 images" in words(svg)
    assert figures_of_paper(svg) == ["Fig. 10", "Fig. 11", "Fig. 12", "Fig. 13"]
    assert re.findall(r'(?:href|src)="(?!data:image/png|#)', svg.decode()) == []
    assert not any("nan" in word.lower() for word in words(svg))


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        ((r"$\frac{$", "_old"), (r"$\frac{$", "_old")),
        (("line\nfeed\x01 $x$", "not UTF-8 \udcff"), (r"line\nfeed\x01 $x$", r"not UTF-8 \udcff")),
    ],
)
def test_names_of_folders_are_shown_as_they_are_in_the_same_bytes(names, shown):
    comparison = compare(*(image_set(uniform((9, 90, 9)), name=name) for name in names))
    svg = comparison_figure(comparison)
    texts = words(svg)
    assert " and ".join(shown) in texts
    for name in shown:
        assert f"{name}: 1 of 1 images" in texts
    assert comparison_figure(comparison) == svg


def test_each_kind_has_both_hue_spectra(comparison, axes):
    charts = [one for one in axes if one.get_ylabel() == "% of its pixels"]
    assert [chart.get_title(loc="left") for chart in charts] == list(comparison.kinds)
    # The first one is that of the whole centre.
    for number, chart in enumerate(charts[1:]):
        for line, side in zip(chart.lines, (comparison.first, comparison.second), strict=True):
            np.testing.assert_allclose(line.get_ydata(), side.statistics.hue_spectra()[number], atol=1e-9)


def test_bars_have_the_class_fractions(comparison, axes):
    (chart,) = (one for one in axes if one.get_xlabel().startswith("correlation of the class fractions"))
    widths = [bar.get_width() for bar in chart.patches]
    kinds = comparison.classes
    fractions = [100.0 * side.share.value for kind in kinds for side in (kind.first, kind.second)]
    np.testing.assert_allclose(widths, fractions, atol=1e-9)


def test_each_class_has_both_mean_masks(comparison, axes):
    images = [one.images[0].get_array() for one in axes if "up to" in one.get_xlabel()]
    for index, side in enumerate((comparison.first, comparison.second)):
        for image, mask in zip(images[index::2], side.statistics.mean_masks(), strict=True):
            np.testing.assert_allclose(image, mask / mask.max())


def test_patches_have_hues_only():
    patches = replace(open_patches(SECOND), name="patches")
    assert "Fig. 12" in figures_of_paper(comparison_figure(compare(FIRST, patches)))
    assert figures_of_paper(comparison_figure(compare(patches, patches))) == ["Fig. 12"]


def test_draws_sets_without_labels_or_photographs():
    bare = image_set((uniform((90, 90, 90))[0], None), name="bare")
    dark = image_set((None, uniform((0, 0, 0))[1]), name="dark")
    assert comparison_figure(compare(bare, dark), "png").startswith(b"\x89PNG")
    comparison_figure(compare(dark, FIRST))


def test_saturation_of_whole_images_and_leaves_is_drawn(comparison, axes):
    charts = {one.get_title(loc="left"): one for one in axes if one.get_ylabel() == "% of pixels"}
    assert list(charts) == ["image", "leaf"]
    for kind, chart in charts.items():
        measured = comparison.appearance[kind]
        for line, side in zip(chart.lines, (measured.first, measured.second), strict=True):
            assert line.get_ydata().sum() == pytest.approx(100.0)
            bin_of_median = line.get_xdata()[np.searchsorted(np.cumsum(line.get_ydata()), 50.0)]
            assert bin_of_median == pytest.approx(side.saturation[1].value, abs=0.0051)

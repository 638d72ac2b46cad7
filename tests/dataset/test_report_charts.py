from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from pepperscene.dataset.report.charts import Axis, Curve, line_chart, value_chart

AXIS = Axis("hue, degrees", 0.0, 360.0, (0, 120, 240, 360))


def drawn(text):
    """The drawing as elements; it must be well formed."""
    return ElementTree.fromstring(text)


def points(element):
    return np.array([[float(v) for v in pair.split(",")] for pair in element.get("points").split()])


def scale(root, edge):
    """Places of the marks of an axis, and what they say."""
    texts = [t for t in root.iter("text") if t.get("class") == edge and re.fullmatch(r"[-\d.e]+", t.text)]
    return np.array([float(t.get("x" if edge == "mid" else "y")) for t in texts]), [
        float(t.text) for t in texts
    ]


@pytest.mark.parametrize("top", [0.003, 1.0, 7.3, 4200.0])
def test_curves_lie_where_the_marks_of_the_axes_say(top):
    x = np.arange(0.0, 360.0, 2.0)
    y = top * np.exp(-(((x - 90.0) / 30.0) ** 2))
    root = drawn(line_chart("one", "Hues", [Curve("a", "first", x, y)], AXIS, "%", hues=True))
    found = points(next(root.iter("polyline")))
    across, degrees = scale(root, "mid")
    up, values = scale(root, "end")
    np.testing.assert_allclose(np.interp(found[:, 0], across, degrees), x, atol=0.2)
    # The marks of the vertical axis stand a little below their lines.
    np.testing.assert_allclose(np.interp(found[:, 1] + 4, up[::-1], values[::-1]), y, atol=0.01 * top)
    assert 3 <= len(values) <= 7
    assert values[-1] >= top


def test_a_second_curve_and_words_for_those_who_cannot_see():
    x = np.array([0.0, 180.0, 360.0])
    curves = [Curve("a", "ours & <others>", x, np.array([0.0, 2.0, 1.0])), Curve("b", "theirs", x, x / 360)]
    root = drawn(line_chart("two", "Hues of leaf", curves, AXIS, "%"))
    assert [line.get("class") for line in root.iter("polyline")] == ["a", "b"]
    assert root.get("role") == "img"
    identities = {element.get("id"): element for element in root.iter() if element.get("id")}
    assert set(root.get("aria-labelledby").split()) == set(identities)
    assert identities["two-t"].text == "Hues of leaf"
    assert "ours & <others>: greatest 2 at 180" in identities["two-d"].text


def test_flat_curves_and_empty_charts_can_be_drawn():
    drawn(line_chart("none", "Nothing", [], AXIS, "%"))
    drawn(line_chart("flat", "Zeros", [Curve("a", "zeros", np.array([0.0, 1.0]), np.zeros(2))], AXIS, "%"))


def test_few_values_are_drawn_one_by_one():
    values = np.array([1.61, 1.65, 1.7])
    root = drawn(value_chart("few", "Errors", [("a", "ours", values), ("b", "theirs", values[:1])], "codes"))
    dots = [(dot.get("class"), float(dot.get("cx"))) for dot in root.iter("circle")]
    across, marks = scale(root, "mid")
    np.testing.assert_allclose(
        [np.interp(x, across, marks) for key, x in dots if key == "a"], values, atol=1e-3
    )
    assert sum(key == "b" for key, _ in dots) == 1


def test_many_values_are_drawn_as_shares_that_add_up():
    values = np.random.default_rng(8).normal(10.0, 1.0, 500)
    root = drawn(value_chart("many", "Times", [("a", "ours", values)], "s"))
    found = points(next(root.iter("polyline")))
    up, marks = scale(root, "end")
    shares = np.interp(found[1:-1:2, 1] + 4, up[::-1], marks[::-1])
    assert shares.sum() == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("value", [0.0, 3.0, -2.0, 1e9])
def test_values_that_are_all_the_same_can_be_drawn(value):
    for count in (1, 100):
        root = drawn(value_chart("same", "Same", [("a", "ours", np.full(count, value))], "s"))
        places = [float(place) for text in root.iter("text") for place in (text.get("x"),)]
        assert np.isfinite(places).all()

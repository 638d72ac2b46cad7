"""Charts as SVG: their curves, dots and ticks."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from pepperscene.dataset.report.charts import Curve, line_chart, value_chart

TICKS = (0, 120, 240, 360)
XLINK = "{http://www.w3.org/1999/xlink}href"


def parse(text):
    """The chart as elements, which must be well formed."""
    assert "nan" not in text
    return ElementTree.fromstring(
        text.replace("<svg ", '<svg xmlns:xlink="http://www.w3.org/1999/xlink" ', 1)
    )


def curves_of(root):
    """Style and points of each curve."""
    paths = [path for path in root.iter("path") if "stroke-width: 1.8" in (path.get("style") or "")]
    return [
        (path.get("style"), np.array(re.findall(r"[ML] (\S+) (\S+)", path.get("d")), float)) for path in paths
    ]


def ticks_of(root, anchor):
    """Positions and values of the ticks of the horizontal ("middle") or vertical ("end") axis."""
    texts = [text for text in root.iter("text") if f"text-anchor: {anchor}" in text.get("style")]
    ticks = [text for text in texts if re.fullmatch(r"[-\d.e+]+", text.text)]
    positions = [float(text.get("x" if anchor == "middle" else "y")) for text in ticks]
    return np.array(positions), [float(text.text) for text in ticks]


@pytest.mark.parametrize("top", [0.003, 1.0, 7.3, 4200.0])
def test_curves_match_the_ticks(top):
    x = np.arange(0.0, 360.0, 2.0)
    y = top * np.exp(-(((x - 90.0) / 30.0) ** 2))
    root = parse(line_chart("one", "Hues", [Curve("a", "first", x, y)], ("hue", TICKS), "%", hue_strip=True))
    ((style, points),) = curves_of(root)
    assert "stroke: var(--a)" in style
    x_positions, degrees = ticks_of(root, "middle")
    y_positions, values = ticks_of(root, "end")
    # Labels are a little below their grid lines; matplotlib omits points on nearly straight lines.
    drawn_x = np.interp(points[:, 0], x_positions, degrees)
    drawn_y = np.interp(points[:, 1] + y_positions[0] - 150, y_positions[::-1], values[::-1])
    assert (drawn_x[0], drawn_x[-1]) == pytest.approx((x[0], x[-1]), abs=0.2)
    np.testing.assert_allclose(np.interp(x, drawn_x, drawn_y), y, atol=0.01 * top)
    assert 3 <= len(values) <= 7
    assert values[-1] >= top
    assert len(list(root.iter("image"))) == 1


def test_second_curve_and_description_for_screen_readers():
    x = np.array([0.0, 180.0, 360.0])
    curves = [Curve("a", "ours & <others>", x, np.array([0.0, 2.0, 1.0])), Curve("b", "theirs", x, x / 360)]
    text = line_chart("two", "Hues of leaf", curves, ("hue", TICKS), "%")
    root = parse(text)
    first, second = (style for style, _ in curves_of(root))
    assert "dasharray" not in first
    assert "stroke: var(--b)" in second
    assert "dasharray" in second
    assert root.get("role") == "img"
    elements = {element.get("id"): element for element in root.iter() if element.get("id")}
    assert set(root.get("aria-labelledby").split()) <= set(elements)
    assert elements["two-t"].text == "Hues of leaf"
    assert "ours & <others>: maximum 2 at 180" in elements["two-d"].text
    # All colours are those of the page, and its styles are not changed.
    assert not re.search(r"#[0-9a-f]{6}[;\"]", text)
    assert "<style" not in text


def test_flat_curve_can_be_drawn():
    curve = Curve("a", "zeros", np.array([0.0, 1.0]), np.zeros(2))
    ((_, points),) = curves_of(parse(line_chart("flat", "Zeros", [curve], ("x", (0, 1)), "%")))
    np.testing.assert_allclose(points[:, 1], 150)


def test_few_values_are_dots():
    values = np.array([1.61, 1.65, 1.7])
    root = parse(value_chart("few", "Errors", [("a", "ours", values), ("b", "theirs", values[:1])], "codes"))
    dots = {key: [dot for dot in root.iter("use") if f"var(--{key})" in dot.get("style")] for key in "ab"}
    positions, ticks = ticks_of(root, "middle")
    x = [float(dot.get("x")) for dot in dots["a"]]
    np.testing.assert_allclose(np.interp(x, positions, ticks), values, atol=1e-3)
    assert len(dots["b"]) == 1
    assert dots["b"][0].get("y") != dots["a"][0].get("y")


def test_many_values_are_percentages_that_sum_to_100():
    values = np.random.default_rng(8).normal(10.0, 1.0, 500)
    root = parse(value_chart("many", "Times", [("a", "ours", values)], "s"))
    ((_, points),) = curves_of(root)
    y_positions, ticks = ticks_of(root, "end")
    heights = np.interp(points[:, 1] + y_positions[0] - 150, y_positions[::-1], ticks[::-1])
    # Every bin is a horizontal line between its edges.
    bins = (points[1:, 1] == points[:-1, 1]) & (points[1:, 0] > points[:-1, 0])
    widths = np.diff(points[:, 0])[bins]
    assert (heights[1:][bins] * widths).sum() / widths.min() == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("value", [0.0, 3.0, -2.0, 1e9])
@pytest.mark.parametrize("count", [1, 100])
def test_equal_values_can_be_drawn(value, count):
    root = parse(value_chart("same", "Same", [("a", "ours", np.full(count, value))], "s"))
    positions, ticks = ticks_of(root, "middle")
    assert np.isfinite(positions).all()
    assert ticks[0] < ticks[-1]

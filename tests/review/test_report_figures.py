"""Charts as SVG, labels and distances in colours, and images as data URIs."""

from __future__ import annotations

import base64
import colorsys
import io
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from pepperscene.classes import CLASS_COLOURS
from pepperscene.review.report.charts import Curve, line_chart, value_chart
from pepperscene.review.report.colours import (
    VIRIDIS,
    class_colours,
    distance_colours,
    instance_colours,
    jpeg_data_uri,
    png_data_uri,
    viridis_colours,
)

TICKS = (0, 120, 240, 360)
XLINK = "{http://www.w3.org/1999/xlink}href"


def parse(text):
    """The chart as elements, which must be well formed."""
    assert "nan" not in text
    # `Markup.replace` would escape what is put in.
    return ElementTree.fromstring(
        str.replace(text, "<svg ", '<svg xmlns:xlink="http://www.w3.org/1999/xlink" ', 1)
    )


def curves_of(root):
    """Attributes and points of each curve."""
    paths = [path for path in root.iter("path") if path.get("stroke-width") == "1.8"]
    return [(path.attrib, np.array(re.findall(r"[ML] (\S+) (\S+)", path.get("d")), float)) for path in paths]


def ticks_of(root, anchor):
    """Positions and values of the ticks of the horizontal ("middle") or vertical ("end") axis."""
    texts = [text for text in root.iter("text") if text.get("text-anchor") == anchor]
    ticks = [text for text in texts if re.fullmatch(r"[-\d.e+]+", text.text)]
    positions = [float(text.get("x" if anchor == "middle" else "y")) for text in ticks]
    return np.array(positions), [float(text.text) for text in ticks]


@pytest.mark.parametrize("top", [0.003, 1.0, 7.3, 4200.0])
def test_curves_match_the_ticks(top):
    x = np.arange(0.0, 360.0, 2.0)
    y = top * np.exp(-(((x - 90.0) / 30.0) ** 2))
    root = parse(line_chart("one", "Hues", [Curve("a", "first", x, y)], ("hue", TICKS), "%", hue_strip=True))
    ((attributes, points),) = curves_of(root)
    assert attributes["stroke"] == "var(--a)"
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
    first, second = (attributes for attributes, _ in curves_of(root))
    assert "stroke-dasharray" not in first
    assert second["stroke"] == "var(--b)"
    assert second["stroke-dasharray"]
    assert root.get("role") == "img"
    elements = {element.get("id"): element for element in root.iter() if element.get("id")}
    assert set(root.get("aria-labelledby").split()) <= set(elements)
    assert elements["two-t"].text == "Hues of leaf"
    assert "ours & <others>: maximum 2 at 180" in elements["two-d"].text
    # All colours are those of the page, and its styles are not changed.
    assert not re.search(r"#[0-9a-f]{6}[;\"]", text)
    assert "<style" not in text
    assert not [element.tag for element in root.iter() if "style" in element.attrib]


def test_flat_curve_can_be_drawn():
    curve = Curve("a", "zeros", np.array([0.0, 1.0]), np.zeros(2))
    ((_, points),) = curves_of(parse(line_chart("flat", "Zeros", [curve], ("x", (0, 1)), "%")))
    np.testing.assert_allclose(points[:, 1], 150)


def test_few_values_are_dots():
    values = np.array([1.61, 1.65, 1.7])
    root = parse(value_chart("few", "Errors", [("a", "ours", values), ("b", "theirs", values[:1])], "codes"))
    dots = {key: [dot for dot in root.iter("use") if dot.get("fill") == f"var(--{key})"] for key in "ab"}
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


def decode(uri):
    kind, _, data = uri.removeprefix("data:image/").partition(";base64,")
    with Image.open(io.BytesIO(base64.b64decode(data)), formats=[kind.upper()]) as image:
        return image.mode, np.asarray(image.convert("RGB"))


def test_distances_follow_viridis_from_near_to_far():
    distance = np.linspace(0.2, 1.0, 9)[None]
    colours = distance_colours(distance, 0.2, 1.0)[0]
    assert ["#{:02X}{:02X}{:02X}".format(*colour) for colour in colours[::-1].tolist()] == list(VIRIDIS)
    # Nearer is always lighter, so that the map is readable in grey.
    luma = distance_colours(np.linspace(0.1, 1.2, 200)[None], 0.2, 1.0)[0] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luma) <= 0.51).all()


def test_background_is_darkest():
    background, far = distance_colours(np.array([[np.inf, 5.0]]), 0.2, 1.0)[0].astype(int)
    assert background.sum() < far.sum()


def test_fractions_are_clipped_and_reversed_distances():
    fractions = np.linspace(-0.5, 1.5, 41)[None]
    np.testing.assert_array_equal(viridis_colours(fractions), distance_colours(1.0 - fractions, 0.0, 1.0))


def test_neighbouring_instances_have_different_hues():
    colours = instance_colours(np.arange(1, 500)[None])[0]
    hue = np.array([colorsys.rgb_to_hsv(*(c / 255))[0] for c in colours])
    step = np.abs(np.diff(hue))
    assert np.minimum(step, 1 - step).min() > 0.3
    np.testing.assert_array_equal(instance_colours(np.array([[7, 0], [0, 7]]))[0, 0], colours[6])


def test_unlabelled_pixels_have_another_colour():
    colours = class_colours(np.array([[0, 1, 2, 3, 4, 5, 6, 7, 8, 255]], np.uint8))[0]
    assert tuple(map(tuple, colours[:8].tolist())) == CLASS_COLOURS
    assert tuple(colours[9]) not in CLASS_COLOURS
    np.testing.assert_array_equal(colours[8], colours[9])


def test_drawings_are_lossless_and_have_a_palette_if_possible():
    rng = np.random.default_rng(6)
    # All colours of viridis and the background fit into a palette.
    distance = np.append(np.linspace(0.1, 1.1, 1199), np.inf).reshape(30, 40)
    for picture, expected_mode in (
        (class_colours(rng.integers(0, 8, (30, 40)).astype(np.uint8)), "P"),
        (distance_colours(distance, 0.2, 1.0), "P"),
        (rng.integers(0, 256, (30, 40, 3)).astype(np.uint8), "RGB"),
    ):
        mode, decoded = decode(png_data_uri(picture))
        assert mode == expected_mode
        np.testing.assert_array_equal(decoded, picture)


def test_large_images_shrink_without_new_label_colours():
    classes = class_colours(np.random.default_rng(7).integers(0, 8, (90, 200)).astype(np.uint8))
    _, decoded = decode(png_data_uri(classes, max_size_px=100))
    assert decoded.shape == (45, 100, 3)
    np.testing.assert_array_equal(decoded, classes[::2, ::2])
    _, decoded = decode(jpeg_data_uri(np.zeros((40, 4000, 3), np.uint8)))
    assert decoded.shape == (16, 1600, 3)


def test_photographs_are_hardly_changed():
    rows, columns = np.mgrid[0:60, 0:80]
    picture = np.stack([3 * rows, 2 * columns, rows + columns], axis=-1).astype(np.uint8)
    mode, decoded = decode(jpeg_data_uri(picture))
    assert mode == "RGB"
    assert np.abs(decoded.astype(int) - picture).mean() == pytest.approx(0.0, abs=2.0)

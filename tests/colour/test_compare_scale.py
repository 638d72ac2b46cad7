"""Which part of the images is compared, at which scale, and what a comparison says about missing data."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from image_sets import image_set, noisy_set, saturated, uniform

from pepperscene.classes import OrganClass
from pepperscene.colour import (
    compare,
    comparison_figure,
    comparison_json,
    comparison_tables,
    format_tables,
    open_patches,
)
from pepperscene.colour.comparison.appearance import Scale
from pepperscene.colour.comparison.measure import measure_set
from pepperscene.colour.comparison.tables import missing_parts
from pepperscene.errors import ArgumentError

LABELLED = noisy_set(1, 2, size=(60, 80), name="labelled")


def scene(height, width, middle=0.5):
    """A red square in the middle of a green image, with sides of a fraction of the image's root area."""
    side = round(middle * np.sqrt(height * width) / 2)
    colour, classes = uniform(saturated(120), OrganClass.LEAF, (height, width))
    centre = np.s_[height // 2 - side : height // 2 + side, width // 2 - side : width // 2 + side]
    colour[centre], classes[centre] = saturated(0), OrganClass.PEPPER
    return colour, classes


def unlabelled(images, name="photographs"):
    return image_set(*((image.colour, None) for image in images.items), name=name)


@pytest.mark.parametrize("size", [(346, 613), (200, 150)])
def test_images_of_all_sizes_are_compared_in_the_same_fraction(size):
    first, second = (image_set(scene(*shape), name=name) for name, shape in (("a", (150, 200)), ("b", size)))
    comparison = compare(first, second)
    whole = comparison.kinds["image"]
    # The square of half of the root area is 0.25 of the image; all of the central 3/16 is red.
    assert whole.first.hue_mean_deg.value == whole.second.hue_mean_deg.value == pytest.approx(0.0, abs=1e-9)
    assert [kind.kind for kind in comparison.coloured_kinds] == ["image", "pepper"]
    for side in (comparison.first, comparison.second):
        ((shape, centre),) = side.centres.items()
        assert centre**2 / (shape[0] * shape[1]) == pytest.approx(3 / 16, rel=0.005)
    # A smaller square: red has the same fraction of both centres, to a row of pixels.
    first, second = (image_set(scene(*shape, 0.3)) for shape in ((150, 200), size))
    kinds = compare(first, second).kinds
    red, all_pixels = (np.array([kinds[k].first.pixels, kinds[k].second.pixels]) for k in ("pepper", "image"))
    assert np.ptp(red / all_pixels) < 0.03


def test_with_known_scales_the_same_area_of_plants_is_compared():
    near = far = image_set(uniform((9, 90, 9), size=(60, 80)))
    comparison = compare(near, far, pixel_mm=(0.5, 2.0))
    # The near images show the smaller area: 30 of their pixels are 15 mm, as 7.5 of the others are.
    assert comparison.first.centres == {(60, 80): 30}
    assert comparison.second.centres == {(60, 80): 8}
    sets = comparison_tables(comparison)[0]
    assert sets.rows[0][4] == "centre, 30 x 30 (15 x 15 mm, 19 % of the image)"
    assert sets.rows[0][5] == "whole image, reduced to 25 %, 2 mm per pixel"
    assert sets.rows[1][4] == "centre, 8 x 8 (16 x 16 mm, 1 % of the image)"
    assert sets.rows[1][5] == "whole image, as it is, 2 mm per pixel"
    with pytest.raises(ArgumentError, match="must be two sizes above 0"):
        compare(near, far, pixel_mm=(0.0, 1.0))


def test_sizes_and_scale_are_stated():
    pictures = [uniform((9, 90, 9), size=size) for size in ((346, 592), (346, 613))]
    comparison = compare(image_set(*pictures, name="phone"), image_set(uniform((9, 90, 9), size=(30, 40))))
    rows = comparison_tables(comparison)[0].rows
    centre = "centre, 196 x 196 to 199 x 199 (19 % of the image)"
    assert rows[0] == ("A", "phone", "2 of 2", "592 x 346 to 613 x 346", centre, "whole image, 580 wide")
    assert rows[1][3:] == ("40 x 30", "centre, 15 x 15 (19 % of the image)", "whole image, as it is")
    sizes = comparison_json(comparison)["one"]["sizes"]
    assert sizes == [
        {"width": 592, "height": 346, "centre": 196, "texture_width": 580},
        {"width": 613, "height": 346, "centre": 199, "texture_width": 580},
    ]


@pytest.fixture(scope="module")
def without_masks():
    """Comparison of images with the same ones without masks."""
    return compare(unlabelled(LABELLED), LABELLED, width_px=80)


def test_images_without_masks_are_compared_as_a_whole(without_masks):
    tables = comparison_tables(without_masks)
    titles = [table.title.split(" ")[0].rstrip(":") for table in tables]
    assert titles == ["Sets", "Hues", "CIELAB", "Light", "Saturation", "Texture"]
    assert not any("-" in row for table in tables[1:] for row in table.rows)
    assert {row[0] for row in tables[1].rows} == {"image"}
    # The same colours, with labels or without.
    whole = without_masks.kinds["image"]
    assert whole.hue_correlation.value == pytest.approx(1.0)
    assert whole.delta_e_2000.value == pytest.approx(0.0, abs=1e-9)
    lines = format_tables(tables).splitlines()
    (reason,) = (line for line in lines if "no masks" in line)
    assert reason.startswith(
        "Classes (their colours, fractions and places) are not compared, because photogr"
    )
    assert any(line.startswith("To compare them, put a mask beside each image") for line in lines)


def test_each_missing_part_is_one_sentence():
    bare, masks = (
        unlabelled(LABELLED),
        image_set(*((None, one.classes) for one in LABELLED.items), name="masks"),
    )

    def measured(images, width_px=80):
        return measure_set(images, None, scale=Scale(width_px))

    labelled = measured(LABELLED)
    assert missing_parts(labelled, labelled) == []
    (texture,) = missing_parts(labelled, measured(LABELLED, 580))
    assert "no image of labelled is 580 pixels wide" in texture
    assert "Choose a width of at most 80" in texture
    both = missing_parts(measured(bare), measured(replace(bare, name="others")))
    assert "photographs and others have no masks" in both[0]
    (dark,) = missing_parts(labelled, measured(masks))
    assert "masks has no photographs" in dark
    (patches,) = missing_parts(labelled, measured(open_patches(LABELLED)))
    assert "patches instead of images" in patches


def test_classes_of_one_set_only_are_named_once():
    classes = np.zeros((60, 80), np.uint8)
    classes[20:40] = OrganClass.PEPPER
    void = np.where(classes == OrganClass.PEPPER, classes, 255).astype(np.uint8)
    colour = np.full((60, 80, 3), (9, 90, 9), np.uint8)
    comparison = compare(LABELLED, image_set((colour, void), name="fruit"), width_px=80)
    hues, lab, fractions = comparison_tables(comparison)[1:4]
    assert [row[0] for row in hues.rows] == ["image", "pepper"] == [row[0] for row in lab.rows]
    assert [row[0] for row in fractions.rows] == ["pepper"]
    missing = "background, leaf, peduncle, stem, shoot, wire, cut (not labelled in fruit)"
    assert hues.notes[-1] == fractions.notes[-1] == f"not measured: {missing}"


def test_figure_of_images_without_masks_has_no_empty_charts(without_masks):
    svg = comparison_figure(without_masks).decode()
    assert re.findall(r"Fig\. \d+", svg) == ["Fig. 12", "Fig. 13"]
    assert "because photographs has no masks." in svg
    assert "80 x 60 pixels; hues and CIELAB: centre, 30 x 30 (19 % of the image)" in svg
    assert "no labels" not in svg
    # Matplotlib's formulas are not drawn.
    assert "mathdefault" not in svg

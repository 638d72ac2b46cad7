"""Comparisons of synthetic sets whose similarity is known."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from image_sets import flatten, image_set, noisy_set, saturated, uniform
from PIL import Image

from pepperscene.camera import decode_tone
from pepperscene.classes import OrganClass
from pepperscene.colour import (
    MeasuredSpectrum,
    PatchSet,
    compare,
    comparison_figure,
    comparison_json,
    comparison_tables,
    delta_e_2000,
    format_tables,
    linear_srgb_to_lab,
    open_patches,
)
from pepperscene.colour.comparison.appearance import Scale
from pepperscene.colour.comparison.measure import measure_set
from pepperscene.colour.comparison.tables import missing_parts
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import VOID
from pepperscene.errors import ArgumentError
from pepperscene.spectra import Spectrum
from pepperscene.truth import centre_side

A, B = noisy_set(1, 5, name="ours"), noisy_set(2, 7, name="theirs")


def to_json(comparison):
    """The comparison as strict JSON, read back."""
    return json.loads(json.dumps(comparison_json(comparison), allow_nan=False))


def is_angle(key):
    """Whether a number is an angle, whose interval may contain 0."""
    return "hue_mean_deg" in key or "hue_median_deg" in key


@pytest.fixture(scope="module")
def numbers():
    """All numbers of the comparison of A with B by their path."""
    return flatten(to_json(compare(A, B)))


def test_set_is_identical_to_itself():
    comparison = compare(A, A)
    classes = [organ_class.name.lower() for organ_class in OrganClass]
    assert list(comparison.kinds) == ["image", *classes]
    assert [kind.kind for kind in comparison.classes] == classes
    for kind in comparison.kinds.values():
        places = () if kind.kind == "image" else (kind.place_correlation, kind.place_ssim)
        for measure in (kind.hue_correlation, *places):
            assert (measure.value, measure.low, measure.high) == pytest.approx((1.0, 1.0, 1.0), abs=1e-12)
        for measure in (kind.hue_emd_deg, kind.delta_e_2000):
            assert (measure.value, measure.low, measure.high) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    light = comparison.light
    correlations = light.correlation, light.ssim, light.falloff_correlation
    for measure in (comparison.hue_correlation, comparison.share_correlation, *correlations):
        assert measure.value == pytest.approx(1.0, abs=1e-12)


def assert_same_numbers(numbers, others):
    assert numbers.keys() == others.keys()
    assert list(numbers.values()) == pytest.approx([others[key] for key in numbers], rel=1e-12, abs=1e-12)


def test_comparison_is_symmetric(numbers):
    text = json.dumps(to_json(compare(B, A)))
    swapped = text.replace('"one', '"left').replace('"other', '"one').replace('"left', '"other')
    assert_same_numbers(numbers, flatten(json.loads(swapped)))


def test_order_and_names_of_pictures_do_not_matter(numbers):
    items = tuple(replace(item, name=f"x{k}") for k, item in enumerate(reversed(B.items)))
    other = flatten(to_json(compare(A, replace(B, items=items))))
    assert_same_numbers(numbers, other)
    # Sums of integers are the same to the bit.
    for key in numbers:
        if key.endswith(("/share/value", "/pixels", "/pictures")):
            assert numbers[key] == other[key]


def test_intervals_contain_their_value_and_need_several_pictures(numbers):
    few = flatten(to_json(compare(A[:2], B[:2])))
    for values in (numbers, few):
        lows = [key for key in values if key.endswith("/low") and not is_angle(key)]
        assert lows
        for key in lows:
            stem = key.removesuffix("low")
            assert values[key] <= values[f"{stem}value"] <= values[f"{stem}high"]
    single = flatten(to_json(compare(A[:1], B[:1])))
    assert not [key for key in single if key.endswith(("/low", "/high"))]


@pytest.mark.parametrize("rotation", [140, 350, 360])
def test_earth_movers_distance_of_rotated_hues(rotation):
    # Two hues, the first of which is three times as frequent.
    first = image_set(*(uniform(saturated(hue)) for hue in (40, 40, 40, 80)))
    second = image_set(*(uniform(saturated(hue + rotation)) for hue in (40, 40, 40, 80)))
    leaf = compare(first, second).kinds["leaf"]
    assert leaf.hue_emd_deg.value == pytest.approx(min(rotation, 360 - rotation), abs=1e-9)
    expected = (leaf.first.hue_mean_deg.value + rotation) % 360
    assert leaf.second.hue_mean_deg.value == pytest.approx(expected, abs=1e-9)
    assert leaf.second.hue_spread_deg.value == pytest.approx(leaf.first.hue_spread_deg.value, abs=1e-9)
    if rotation == 360:
        assert leaf.hue_correlation.value == pytest.approx(1.0, abs=1e-12)


def test_hue_spectra_equal_those_of_the_report():
    sums = measure_set(A, None)
    spectra = sums.statistics.hue_spectra()
    for organ_class in OrganClass:
        fractions = sums.totals(organ_class.name.lower())[0, :180] / len(A)
        np.testing.assert_allclose(100 * fractions, spectra[organ_class], atol=1e-12)


def test_mean_colours_are_averaged_in_linear_light():
    dark, bright, other = (40, 90, 30), (120, 200, 90), (200, 60, 30)
    # Three pixels in four are dark.
    mixed = uniform(dark, size=(48, 64))
    mixed[0][:, ::4] = bright
    leaf = compare(image_set(mixed), image_set(uniform(other))).kinds["leaf"]
    dark_linear, bright_linear, other_linear = (decode_tone(np.uint8(c)) for c in (dark, bright, other))
    mean = linear_srgb_to_lab(0.75 * dark_linear + 0.25 * bright_linear)
    np.testing.assert_allclose([channel.value for channel in leaf.first.lab], mean, atol=1e-9)
    expected = delta_e_2000(mean, linear_srgb_to_lab(other_linear))
    assert leaf.delta_e_2000.value == pytest.approx(float(expected), abs=1e-9)
    difference = linear_srgb_to_lab(bright_linear) - linear_srgb_to_lab(dark_linear)
    spread = [channel.value for channel in leaf.first.lab_spread]
    np.testing.assert_allclose(spread, np.abs(difference) * np.sqrt(0.75 * 0.25), atol=1e-6)
    # Colours do not depend on the size of the pictures.
    same = compare(image_set(uniform(dark)), image_set(uniform(dark, size=(12, 17))))
    assert same.kinds["leaf"].delta_e_2000.value == pytest.approx(0.0, abs=1e-9)


def test_class_fractions_are_of_all_pixels():
    classes = np.zeros((40, 40), np.uint8)
    classes[:10], classes[10:12], classes[12:] = OrganClass.LEAF, OrganClass.STEM, OrganClass.PEPPER
    void = classes.copy()
    void[12:] = VOID
    colour = np.zeros((40, 40, 3), np.uint8)
    comparison = compare(image_set((colour, classes)), image_set((colour, void), name="half"))
    # Unlabelled pixels may be fruit.
    for kind, expected in (("leaf", (0.25, 0.25)), ("stem", (0.05, 0.05)), ("pepper", (0.7, None))):
        one = comparison.kinds[kind]
        assert (one.first.share.value, one.second.share.value) == expected
    assert comparison.kinds["pepper"].second.share.why == "not labelled in half"
    # With two classes every correlation would be 1 or -1.
    assert comparison.share_correlation.value is None
    assert "three" in comparison.share_correlation.why


def test_mean_masks_of_disjoint_places_and_other_sizes():
    left, right = np.zeros((60, 80), np.uint8), np.zeros((60, 80), np.uint8)
    left[:, :40] = right[:, 40:] = OrganClass.PEPPER
    first, second = image_set((None, left)), image_set((None, right))
    pepper = compare(first, second).kinds["pepper"]
    assert pepper.place_correlation.value == pytest.approx(-1.0, abs=1e-12)
    assert pepper.place_ssim.value < 0.1
    assert pepper.hue_correlation.value is None
    assert "no photographs" in pepper.hue_correlation.why
    for resized in (np.repeat(np.repeat(left, 3, 0), 3, 1), left[::10, ::10]):
        pepper = compare(first, image_set((None, resized))).kinds["pepper"]
        assert pepper.place_correlation.value == pytest.approx(1.0, abs=1e-12)
        assert pepper.place_ssim.value == pytest.approx(1.0, abs=1e-12)


def test_light_is_compared_by_place_and_level():
    rows, columns = np.mgrid[-1:1:60j, -1:1:80j]
    intensity = np.rint(200 * np.exp(-(rows**2) - columns**2))
    bright = np.repeat(intensity[..., None], 3, -1).astype(np.uint8)
    dark = np.repeat((intensity / 2)[..., None], 3, -1).astype(np.uint8)
    light = compare(image_set((bright, None)), image_set((dark, None))).light
    assert light.correlation.value == pytest.approx(1.0, abs=1e-3)
    assert light.falloff_correlation.value == pytest.approx(1.0, abs=1e-3)
    # Structural similarity sees the difference in level.
    assert 0.3 < light.ssim.value < 0.95
    assert light.first.value == pytest.approx(bright.mean(), abs=1e-9)
    assert light.first.value == pytest.approx(2 * light.second.value, abs=1.0)
    inverted = compare(image_set((bright, None)), image_set((255 - bright, None))).light
    assert inverted.correlation.value == pytest.approx(-1.0, abs=1e-9)


def test_unknown_values_have_a_reason_and_are_never_nan():
    grey = image_set(uniform((90, 90, 90)), name="grey")
    unlabelled = image_set((np.full((30, 40, 3), 90, np.uint8), None), name="bare")
    leaf = compare(grey, image_set(uniform((20, 90, 30)))).kinds["leaf"]
    assert leaf.hue_correlation.value is None
    assert leaf.hue_emd_deg.value is None
    assert leaf.first.hue_mean_deg.value is None
    assert leaf.first.grey_share.value == 1.0
    assert leaf.delta_e_2000.value > 10
    comparison = compare(grey, unlabelled)
    assert comparison.kinds["leaf"].second.lab[0].why == "no labels in bare"
    assert comparison.light.first.value == comparison.light.second.value == 90.0
    # Constant pictures have no correlation.
    assert comparison.light.correlation.value is None
    for one in (comparison, compare(unlabelled, unlabelled), compare(grey, grey)):
        to_json(one)
        assert "nan" not in format_tables(comparison_tables(one)).lower()


def test_limit_samples_pictures_evenly():
    grey = image_set(*(uniform((10 * k, 10 * k, 10 * k)) for k in range(21)))
    comparison = compare(grey, grey, limit=3)
    assert (comparison.first.units, comparison.first.available) == (3, 21)
    assert comparison.light.first.value == pytest.approx(100.0)
    assert "3 of 21" in format_tables(comparison_tables(comparison))


def test_patches_of_a_set_have_its_colours():
    comparison = compare(A, open_patches(A, centre_px=centre_side(48, 64)))
    assert comparison.first.name != comparison.second.name
    for name, kind in comparison.kinds.items():
        if name != "background":
            assert kind.hue_correlation.value == pytest.approx(1.0, abs=1e-12)
            assert kind.hue_emd_deg.value == pytest.approx(0.0, abs=1e-9)
            assert kind.delta_e_2000.value == pytest.approx(0.0, abs=1e-9)
        assert kind.place_correlation.value is None
    assert "patches, not images" in comparison.light.correlation.why
    to_json(comparison)


def test_spectra_are_seen_under_d65():
    nm = np.arange(400.0, 701.0, 10.0)
    white, grey, green = (
        PatchSet("set", (), (MeasuredSpectrum("set", "leaf", Spectrum(nm, values + 0.0 * nm)),))
        for values in (1.0, 0.184187, np.exp(-(((nm - 550) / 40) ** 2)))
    )
    leaf = compare(white, grey).kinds["leaf"]
    assert [channel.value for channel in leaf.first.lab] == pytest.approx([100.0, 0.0, 0.0], abs=0.05)
    # A reflectance of 0.184 has a lightness of 50, by the definition of L*.
    assert [channel.value for channel in leaf.second.lab] == pytest.approx([50.0, 0.0, 0.0], abs=0.05)
    assert str(compare(green, grey).kinds["leaf"].first.hue_spread_deg.value) == "0.0"


def test_stages_are_compared_if_both_sets_have_them(tmp_path):
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        for number in (1, 2):
            mask = np.zeros((48, 64), np.uint8)
            mask[14:24], mask[24:34] = 1, 2
            colour = np.zeros((48, 64, 3), np.uint8)
            colour[14:24], colour[24:34] = saturated(110), saturated(4 if folder == "one" else 34)
            Image.fromarray(colour).save(tmp_path / folder / f"img{number}.png")
            Image.fromarray(mask).save(tmp_path / folder / f"mask{number}.png")
    first, second = (open_images(tmp_path / name, labels="montoya2021") for name in ("one", "other"))
    kinds = compare(first, second).kinds
    assert list(kinds) == ["image", "pepper", "pepper.ripe", "pepper.unripe"]
    distances = {name: kind.hue_emd_deg.value for name, kind in kinds.items() if name != "image"}
    assert distances == pytest.approx({"pepper": 15.0, "pepper.ripe": 30.0, "pepper.unripe": 0.0})
    # Otherwise fruit of any ripeness are compared.
    unstaged = image_set(uniform(saturated(4), OrganClass.PEPPER))
    assert list(compare(first, unstaged).kinds) == ["image", "pepper"]


@pytest.mark.long
def test_bootstrap_weights_of_staged_patches_do_not_depend_on_the_hash_seed():
    code = (
        "import numpy as np\n"
        "from pepperscene.colour import Patch, PatchSet\n"
        "from pepperscene.colour.comparison.measure import measure_set\n"
        "codes = np.arange(60, dtype=np.uint8).reshape(20, 3)\n"
        "patches = [Patch(s, f'pepper.{s}', 'p', codes / 255, codes + np.uint8(len(s)))\n"
        "           for s in ('ripe', 'unripe')]\n"
        "print(measure_set(PatchSet('set', tuple(patches)), None).totals('pepper').sum())\n"
    )
    outputs = set()
    for seed in ("1", "4"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        outputs.add(subprocess.check_output([sys.executable, "-c", code], env=environment))
    assert len(outputs) == 1


@pytest.mark.long
def test_memory_does_not_grow_with_the_set():
    sums, rng = measure_set(B, None), np.random.default_rng(5)

    def add(count):
        for _ in range(count):
            picture = B.items[0].colour.astype(int) + rng.integers(-3, 4)
            sums.add_image(np.clip(picture, 0, 255).astype(np.uint8), B.items[0].classes)

    add(32)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    add(160)
    growth = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    # At most the pending vectors, of 10 thousand numbers each.
    assert growth < 16 * 11_000 * 8 + 200_000


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

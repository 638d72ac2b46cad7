"""What a comparison says of painted sets whose likeness is known."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from painted_pictures import flat, hue, noisy, numbers, painted
from PIL import Image

from pepperscene.camera import decode_tone
from pepperscene.classes import OrganClass
from pepperscene.colour import (
    MeasuredSpectrum,
    PatchSet,
    compare,
    delta_e_2000,
    linear_srgb_to_lab,
    open_patches,
)
from pepperscene.colour.comparison.measure import measure_set
from pepperscene.dataset import VOID, open_images
from pepperscene.spectra import Spectrum

A, B = noisy(1, 5, name="ours"), noisy(2, 7, name="theirs")


def told(found):
    """The comparison as strict JSON, read back."""
    return json.loads(json.dumps(found.json(), allow_nan=False))


def swapped(found):
    """The JSON with its sides exchanged."""
    text = json.dumps(found).replace('"one', '"left').replace('"other', '"one').replace('"left', '"other')
    return json.loads(text)


def test_a_set_is_perfectly_like_itself():
    found = compare(A, A)
    assert list(found.kinds) == [one.name.lower() for one in OrganClass]
    for kind in found.kinds.values():
        for measure in (kind.hue_correlation, kind.place_correlation, kind.place_ssim):
            assert (measure.value, measure.low, measure.high) == pytest.approx((1.0, 1.0, 1.0), abs=1e-12)
        for measure in (kind.hue_emd_deg, kind.delta_e_2000):
            assert (measure.value, measure.low, measure.high) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    light = found.light
    for measure in (found.hue_correlation, found.share_correlation, light.correlation, light.ssim,
                    light.falloff_correlation):  # fmt: skip
        assert measure.value == pytest.approx(1.0, abs=1e-12)


def test_nothing_depends_on_which_side_is_which():
    forth, back = numbers(told(compare(A, B))), numbers(swapped(told(compare(B, A))))
    assert forth.keys() == back.keys()
    assert [forth[key] for key in forth] == pytest.approx([back[key] for key in forth], rel=1e-12, abs=1e-12)


def test_nothing_depends_on_the_order_or_the_names_of_pictures():
    order = np.random.default_rng(3).permutation(len(B))
    other = replace(B, items=tuple(replace(B.items[place], name=f"x{k}") for k, place in enumerate(order)))
    one, two = numbers(told(compare(A, B))), numbers(told(compare(A, other)))
    assert one.keys() == two.keys()
    assert [one[key] for key in one] == pytest.approx([two[key] for key in one], rel=1e-12, abs=1e-12)
    # Sums of whole numbers are the same to the bit.
    for key in one:
        if key.endswith(("/share/value", "/pixels", "/pictures")):
            assert one[key] == two[key]


@pytest.mark.parametrize("turn", [10, 30, 90, 140, 270, 350, 360])
def test_a_hue_that_is_turned_is_that_far_away(turn):
    # Two hues, of which one is shown three times as often.
    one = painted(flat(hue(40)), flat(hue(40)), flat(hue(40)), flat(hue(80)))
    other = painted(*(flat(hue(degrees + turn)) for degrees in (40, 40, 40, 80)))
    leaf = compare(one, other).kinds["leaf"]
    # The bins are two degrees wide.
    assert leaf.hue_emd_deg.value == pytest.approx(min(turn, 360 - turn), abs=1e-9)
    assert leaf.other.hue_mean_deg.value == pytest.approx(
        (leaf.one.hue_mean_deg.value + turn) % 360, abs=1e-9
    )
    assert leaf.other.hue_spread_deg.value == pytest.approx(leaf.one.hue_spread_deg.value, abs=1e-9)
    if turn == 360:
        assert leaf.hue_correlation.value == pytest.approx(1.0, abs=1e-12)


def test_opposite_hues_are_as_far_apart_as_hues_can_be():
    leaf = compare(painted(flat(hue(20))), painted(flat(hue(200)))).kinds["leaf"]
    assert leaf.hue_emd_deg.value == pytest.approx(180.0, abs=1e-9)
    # Of two spectra of one bin each: the covariance is -1/n^2, both variances are (n - 1)/n^2.
    assert leaf.hue_correlation.value == pytest.approx(-1 / 179, abs=1e-12)


def test_the_hues_are_those_of_the_paper():
    """The sums in which a bootstrap is done are the spectra that the report shows."""
    sums = measure_set(A, None)
    spectra = sums.statistics.hue_spectra()
    for organ in OrganClass:
        shares = sums.totals(organ.name.lower())[0, :180] / len(A)
        np.testing.assert_allclose(100 * shares, spectra[organ], atol=1e-12)


def test_mean_colours_are_means_of_light():
    dark, bright, other = (40, 90, 30), (120, 200, 90), (200, 60, 30)
    # Three pixels in four are dark.
    mixed = flat(dark)
    mixed[0][:, ::4] = bright
    leaf = compare(painted(mixed), painted(flat(other))).kinds["leaf"]
    light = 0.75 * decode_tone(np.uint8(dark)) + 0.25 * decode_tone(np.uint8(bright))
    found = [measure.value for measure in leaf.one.lab]
    np.testing.assert_allclose(found, linear_srgb_to_lab(light), atol=1e-9)
    expected = delta_e_2000(linear_srgb_to_lab(light), linear_srgb_to_lab(decode_tone(np.uint8(other))))
    assert leaf.delta_e_2000.value == pytest.approx(float(expected), abs=1e-9)
    apart = linear_srgb_to_lab(decode_tone(np.uint8(bright))) - linear_srgb_to_lab(
        decode_tone(np.uint8(dark))
    )
    spread = [measure.value for measure in leaf.one.lab_spread]
    np.testing.assert_allclose(spread, np.abs(apart) * np.sqrt(0.75 * 0.25), atol=1e-6)


def test_equal_colours_differ_by_nothing_whatever_their_places():
    shares = compare(painted(flat((40, 90, 30))), painted(flat((40, 90, 30), size=(12, 17))))
    assert shares.kinds["leaf"].delta_e_2000.value == pytest.approx(0.0, abs=1e-9)


def test_class_shares_are_of_all_pixels():
    classes = np.zeros((40, 40), np.uint8)
    classes[:10], classes[10:12], classes[12:] = OrganClass.LEAF, OrganClass.STEM, OrganClass.PEPPER
    void = classes.copy()
    void[12:] = VOID
    colour = np.zeros((40, 40, 3), np.uint8)
    found = compare(painted((colour, classes)), painted((colour, void), name="half"))
    shares = {kind: (one.one.share.value, one.other.share.value) for kind, one in found.kinds.items()}
    assert shares["leaf"] == (0.25, 0.25)
    assert shares["stem"] == (0.05, 0.05)
    # Nobody says that there is no fruit in what has no label.
    assert shares["pepper"] == (0.7, None)
    assert found.kinds["pepper"].other.share.why == "not labelled in half"
    # Of two classes alone every correlation would be 1 or -1.
    assert found.share_correlation.value is None
    assert "three" in found.share_correlation.why


def test_places_that_exclude_each_other_and_places_in_another_size():
    left, right = np.zeros((60, 80), np.uint8), np.zeros((60, 80), np.uint8)
    left[:, :40] = right[:, 40:] = OrganClass.PEPPER
    one, other = painted((None, left)), painted((None, right))
    pepper = compare(one, other).kinds["pepper"]
    assert pepper.place_correlation.value == pytest.approx(-1.0, abs=1e-12)
    assert pepper.place_ssim.value < 0.1
    assert pepper.hue_correlation.value is None
    assert "no photographs" in pepper.hue_correlation.why
    # The same places in pictures of another size are the same places.
    for larger in (np.repeat(np.repeat(left, 3, 0), 3, 1), left[::10, ::10]):
        pepper = compare(one, painted((None, larger))).kinds["pepper"]
        assert pepper.place_correlation.value == pytest.approx(1.0, abs=1e-12)
        assert pepper.place_ssim.value == pytest.approx(1.0, abs=1e-12)


def test_light_is_compared_by_place():
    rows, columns = np.mgrid[-1:1:60j, -1:1:80j]
    bright = np.rint(200 * np.exp(-(rows**2) - columns**2))
    grey = np.repeat(bright[..., None], 3, -1).astype(np.uint8)
    half = np.repeat((bright / 2)[..., None], 3, -1).astype(np.uint8)
    light = compare(painted((grey, None)), painted((half, None))).light
    assert light.correlation.value == pytest.approx(1.0, abs=1e-3)
    assert light.falloff_correlation.value == pytest.approx(1.0, abs=1e-3)
    # Structural similarity sees that one is darker.
    assert 0.3 < light.ssim.value < 0.95
    assert light.one.value == pytest.approx(float(grey[..., 0].mean()), abs=1e-9)
    assert light.one.value == pytest.approx(2 * light.other.value, abs=1.0)
    inverted = compare(painted((grey, None)), painted((255 - grey, None))).light
    assert inverted.correlation.value == pytest.approx(-1.0, abs=1e-9)


def test_what_cannot_be_told_says_why_and_no_number_is_lost_to_nan():
    grey = painted(flat((90, 90, 90)), name="grey")
    unlabelled = painted((np.full((30, 40, 3), 90, np.uint8), None), name="bare")
    leaf = compare(grey, painted(flat((20, 90, 30)))).kinds["leaf"]
    assert leaf.hue_correlation.value is None
    assert leaf.hue_emd_deg.value is None
    assert leaf.one.hue_mean_deg.value is None
    assert leaf.one.grey_share.value == 1.0
    assert leaf.delta_e_2000.value > 10
    found = compare(grey, unlabelled)
    assert found.kinds["leaf"].other.lab[0].why == "no labels in bare"
    assert found.light.one.value == found.light.other.value == 90.0
    # A flat picture is like no other.
    assert found.light.correlation.value is None
    for one in (found, compare(unlabelled, unlabelled), compare(grey, grey)):
        told(one)
        assert "nan" not in one.table().lower()


def test_of_single_pictures_nothing_is_known_but_the_numbers():
    found = told(compare(A[:1], B[:1]))
    assert not [key for key in numbers(found) if key.endswith(("/low", "/high"))]
    assert [key for key in numbers(told(compare(A, B))) if key.endswith("/low")]


def test_intervals_hold_their_number():
    for found in (told(compare(A, B)), told(compare(A[:2], B[:2]))):
        values = numbers(found)
        for key in (key for key in values if key.endswith("/low") and "hue_mean_deg" not in key):
            stem = key.removesuffix("low")
            assert values[key] <= values[f"{stem}value"] <= values[f"{stem}high"]


def test_a_set_with_too_many_pictures_is_thinned_evenly():
    grey = painted(*(flat((10 * k, 10 * k, 10 * k)) for k in range(21)))
    found = compare(grey, grey, limit=3)
    assert (found.one.units, found.one.of) == (3, 21)
    assert found.light.one.value == pytest.approx(100.0)
    assert "3 of 21" in found.table()


def test_patches_of_a_set_have_its_colours():
    found = compare(A, open_patches(A))
    assert found.names[0] != found.names[1]
    for name, kind in found.kinds.items():
        if name != "background":
            assert kind.hue_correlation.value == pytest.approx(1.0, abs=1e-12)
            assert kind.hue_emd_deg.value == pytest.approx(0.0, abs=1e-9)
            assert kind.delta_e_2000.value == pytest.approx(0.0, abs=1e-9)
        assert kind.place_correlation.value is None
    assert "patches, not pictures" in found.light.correlation.why
    told(found)


def test_spectra_are_seen_under_daylight():
    nm = np.arange(400.0, 701.0, 10.0)
    white = MeasuredSpectrum("white", "leaf", Spectrum(nm, np.ones_like(nm)))
    grey = MeasuredSpectrum("grey", "leaf", Spectrum(nm, np.full_like(nm, 0.184187)))
    leaf = compare(PatchSet("card", (), (white,)), PatchSet("grey", (), (grey,))).kinds["leaf"]
    # Of a reflectance of .184 the lightness is 50, by the definition of L*.
    assert [one.value for one in leaf.one.lab] == pytest.approx([100.0, 0.0, 0.0], abs=0.05)
    green = MeasuredSpectrum("green", "leaf", Spectrum(nm, np.exp(-(((nm - 550) / 40) ** 2))))
    narrow = compare(PatchSet("green", (), (green,)), PatchSet("grey", (), (grey,)))
    assert str(narrow.kinds["leaf"].one.hue_spread_deg.value) == "0.0"
    assert [one.value for one in leaf.other.lab] == pytest.approx([50.0, 0.0, 0.0], abs=0.05)


def test_stages_stand_apart_where_both_sides_tell_them(tmp_path):
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        for number in (1, 2):
            mask = np.zeros((30, 40), np.uint8)
            mask[:10], mask[10:20] = 1, 2
            colour = np.zeros((30, 40, 3), np.uint8)
            colour[:10], colour[10:20] = hue(110), hue(4 if folder == "one" else 34)
            Image.fromarray(colour).save(tmp_path / folder / f"img{number}.png")
            Image.fromarray(mask).save(tmp_path / folder / f"mask{number}.png")
    one, other = (open_images(tmp_path / name, labels="montoya2021") for name in ("one", "other"))
    found = compare(one, other)
    assert list(found.kinds) == ["pepper", "pepper.ripe", "pepper.unripe"]
    distances = {kind: one.hue_emd_deg.value for kind, one in found.kinds.items()}
    assert distances == pytest.approx({"pepper": 15.0, "pepper.ripe": 30.0, "pepper.unripe": 0.0})
    # A set without stages has fruit, of whatever ripeness.
    assert list(compare(one, painted(flat(hue(4), OrganClass.PEPPER))).kinds) == ["pepper"]


def test_memory_does_not_grow_with_the_set():
    colour, classes = B.items[0].colour, B.items[0].classes
    rng = np.random.default_rng(5)

    def many(count):
        for _ in range(count):
            yield np.clip(colour.astype(int) + rng.integers(-3, 4), 0, 255).astype(np.uint8)

    sums = measure_set(B, None)
    for picture in many(32):
        sums.add_picture(picture, classes)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for picture in many(160):
        sums.add_picture(picture, classes)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    # At most the vectors that wait to be added, of 10 thousand numbers each.
    assert grown < 16 * 11_000 * 8 + 200_000

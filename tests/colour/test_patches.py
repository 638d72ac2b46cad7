"""Patches of pictures: pixels, kinds, borders, clipping and ripeness."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from pepperscene import OrganClass, Spectrum, open_images, open_patches
from pepperscene.camera import decode_tone
from pepperscene.colour import MeasuredSpectrum, Patch, PatchSet
from pepperscene.colour.patches.extraction import Extraction, erode
from pepperscene.colour.patches.open import organ_regions
from pepperscene.colour.patches.patch import even_indices, is_organ_kind, matches_kind
from pepperscene.colour.statistics import hue_histogram, srgb_codes
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.errors import InputError
from pepperscene.truth.statistics import ImageStatistics

RNG = np.random.default_rng(20180103)


def random_patch(name, kind, picture, n=20):
    codes = RNG.integers(1, 255, (n, 3), dtype=np.uint8)
    return Patch(name, kind, picture, decode_tone(codes), codes)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three labelled pictures of 40 x 60 pixels: halves of leaf and fruit, and an unlabelled strip."""
    path = tmp_path_factory.mktemp("labelled")
    rng = np.random.default_rng(1)
    for k in (1, 2, 10):
        colour = rng.integers(0, 256, (40, 60, 3), dtype=np.uint8)
        mask = np.ones((40, 60), np.uint8)
        mask[:, 30:] = 2
        mask[:4] = 255
        Image.fromarray(colour).save(path / f"img{k}.png")
        Image.fromarray(mask).save(path / f"mask{k}.png")
    (path / "classes.toml").write_text('1 = "leaf"\n2 = "pepper"\n255 = "void"\n')
    return path


def test_kinds_are_classes_with_optional_stages():
    assert all(map(is_organ_kind, ("leaf", "pepper.ripe", "shoot.young_2")))
    assert not any(map(is_organ_kind, ("Leaf", "fruit", "pepper.", "pepper.Ripe", "pepper.a.b", "")))
    assert matches_kind("pepper.ripe", "pepper")
    assert not matches_kind("pepper", "pepper.ripe")
    assert not matches_kind("peppery", "pepper")


@pytest.mark.parametrize(("count", "limit"), [(10, 3), (7, 7), (5, None), (0, 4)])
def test_even_indices_have_equal_gaps(count, limit):
    indices = even_indices(count, limit)
    assert len(indices) == min(count, limit or count)
    gaps = np.diff(np.concatenate([indices, [count + indices[0]]])) if count else np.zeros(1)
    assert gaps.max() - gaps.min() <= 1


def test_set_pools_and_selects_patches():
    unripe, ripe = random_patch("a", "pepper.unripe", "one"), random_patch("b", "pepper.ripe", "two", 7)
    leaf = random_patch("c", "leaf", "two")
    reflectance = MeasuredSpectrum("r", "peduncle", Spectrum([400.0, 700.0], [0.1, 0.2], "hold"))
    patch_set = PatchSet("set", (unripe, ripe, leaf), (reflectance,))
    assert patch_set.kinds == ("leaf", "peduncle", "pepper.ripe", "pepper.unripe")
    assert patch_set.pictures == ("one", "two")
    assert patch_set.pixels("pepper").shape == (27, 3)
    assert patch_set.pixels("pepper", 5).shape == (5, 3)
    assert patch_set.pixels("stem").shape == (0, 3)
    assert (patch_set.pixels("pepper") == np.concatenate([unripe.linear, ripe.linear])).all()
    assert patch_set.without(["one"]).patches == patch_set.select(["two"]).patches == (ripe, leaf)
    assert patch_set.without(["one"]).spectra == (reflectance,)
    with pytest.raises(ValueError, match="three"):
        patch_set.select(["three"])
    with pytest.raises(ValueError, match="'a'"):
        PatchSet("set", (unripe, random_patch("a", "leaf", "one")))
    with pytest.raises(ValueError, match="must be a class"):
        random_patch("d", "fruit", "one")


@pytest.mark.parametrize("centre_px", [21, None])
def test_hue_spectra_equal_image_statistics(folder, centre_px):
    """As in the paper: percentage of a class's pixels in the centre of each picture, averaged."""
    images = open_images(folder)
    sums = ImageStatistics()
    for picture in images:
        height, width = picture.size
        size = centre_px or 100
        top, left = max(0, (height - size) // 2), max(0, (width - size) // 2)
        part = (slice(top, top + size), slice(left, left + size))
        sums.add(picture.colour[part], picture.classes[part], size)
    patch_set = open_patches(folder, centre_px=centre_px)
    for organ in (OrganClass.LEAF, OrganClass.PEPPER):
        statistics = patch_set.statistics(organ.name.lower())
        assert statistics.hue_spectrum == pytest.approx(sums.hue_spectra()[organ], abs=1e-12)
        assert statistics.grey_share == pytest.approx(sums.grey_fractions()[organ], abs=1e-12)
    assert patch_set.pictures == ("img1", "img2", "img10")
    assert len(open_patches(open_images(folder), limit=2).pictures) == 2
    assert patch_set.kinds == ("leaf", "pepper")


def test_erosion_leaves_borders_out_and_counts_them(folder):
    full, eroded = open_patches(folder), open_patches(folder, erode_px=2)
    for before, after in zip(full.patches, eroded.patches, strict=True):
        assert before.border == 0
        # 36 rows of 30 columns; two rows below the void and two columns at the other class go.
        assert (before.pixels, after.pixels, after.border) == (1080, 34 * 28, 1080 - 34 * 28)
        assert after.hues.sum() == after.pixels


def test_erosion_uses_rows_and_columns():
    region = np.zeros((9, 9), bool)
    region[2:7, 3:9] = True
    assert erode(region, 1).sum() == 3 * 5  # the border of the picture is not eroded
    assert erode(region, 0) is region
    assert not erode(region, 3).any()


def test_clipped_pixels_are_counted_and_can_be_left_out(folder):
    full_set, reduced_set = open_patches(folder), open_patches(folder, clipped="leave_out")
    for full, reduced in zip(full_set.patches, reduced_set.patches, strict=True):
        codes = full.codes
        clipped = ((codes == 0) | (codes == 255)).any(axis=1)
        assert full.clipped == reduced.clipped == clipped.sum() > 0
        assert (reduced.codes == codes[~clipped]).all()
        assert (reduced.linear == decode_tone(codes[~clipped])).all()
        assert (reduced.hues == full.hues).all()


def test_large_patches_are_thinned_but_all_hues_are_counted():
    codes = RNG.integers(0, 256, (200, 300, 3), dtype=np.uint8)
    region = np.ones((200, 300), bool)
    patch = Extraction(limit_px=1000).patch(codes, region, name="n", kind="leaf", picture="p")
    assert patch.linear.shape == patch.codes.shape == (1000, 3)
    assert patch.pixels == 60_000
    assert (patch.hues == hue_histogram(codes)).all()
    few = codes[:5, :6]
    linear = Extraction(tone="linear").patch(few, region[:5, :6], name="n", kind="leaf", picture="p")
    assert linear.linear == pytest.approx(few.reshape(-1, 3) / 255.0)
    assert (linear.codes == srgb_codes(linear.linear)).all()


def rendered_frame(instances, metadata):
    classes = np.where(instances > 0, np.uint8(OrganClass.PEPPER), np.uint8(OrganClass.BACKGROUND))
    classes[0] = OrganClass.LEAF
    colour = np.zeros((*classes.shape, 3), np.uint8)
    return LabelledImage("000001", colour, classes, instances, metadata=metadata)


def test_ripeness_of_rendered_fruit_comes_from_harvest(folder):
    instances = np.array([[0, 7, 7, 8, 9, 3]] * 4, np.uint16)
    fruit = [{"instance": k, "ripeness": ripeness} for k, ripeness in ((7, 0.49), (8, 0.5), (9, 1.0))]
    images, frame = open_images(folder), rendered_frame(instances, {"harvest": {"fruit": fruit}})
    regions = dict(organ_regions(images, frame))
    assert set(regions) == {"leaf", "pepper.unripe", "pepper.ripe", "pepper"}
    assert (regions["pepper.unripe"][1:] == (instances[1:] == 7)).all()
    assert (regions["pepper.ripe"][1:] == (instances[1:] >= 8)).all()
    # A fruit that the harvest does not list; the leaf in the first row is no fruit.
    assert (regions["pepper"][1:] == (instances[1:] == 3)).all()
    assert all(regions[kind][0].any() == (kind == "leaf") for kind in regions)
    assert set(dict(organ_regions(images, rendered_frame(instances, {})))) == {"leaf", "pepper"}


def test_montoya_masks_separate_ripe_from_unripe(tmp_path):
    mask = np.array([[0, 1, 2, 3, 4, 5, 255]] * 3, np.uint8)
    colour = np.repeat(mask[..., None] * np.uint8(20) + np.uint8(50), 3, axis=-1)
    Image.fromarray(colour).save(tmp_path / "img1.png")
    Image.fromarray(mask).save(tmp_path / "mask1.png")
    patch_set = open_patches(tmp_path, labels="montoya2021")
    assert {patch.kind: sorted(set(patch.codes[:, 0].tolist())) for patch in patch_set.patches} == {
        "pepper.unripe": [70],
        "pepper.ripe": [90, 130],
        "peduncle": [110, 150],
    }


def test_rejects_arguments_that_do_not_apply(folder, tmp_path):
    for source, options, message in (
        (folder, {"pictures": tmp_path}, "applies only to a patches file"),
        ("fruit/vrhel_fruit_vegetable_reflectance", {"limit": 3}, "applies only to a set"),
        ("nothing_like_it", {}, "no such file"),
        (folder, {"erode_px": -1}, "erode_px"),
    ):
        with pytest.raises(InputError, match=message):
            open_patches(source, **options)
    for name, message in (("img1", "no picture is labelled"), ("mask1", "no organ")):
        Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / f"{name}.png")
        with pytest.raises(InputError, match=message):
            open_patches(tmp_path)

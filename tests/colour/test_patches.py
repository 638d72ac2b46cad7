"""Patches of pictures: pixels, kinds, borders, clipping and ripeness."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pepperscene import OrganClass, Spectrum, open_images, open_patches
from pepperscene.camera import decode_tone, encode_tone
from pepperscene.colour import MeasuredSpectrum, Patch, PatchSet, delta_e_2000, linear_srgb_to_lab
from pepperscene.colour.patches.chart import chart_linear
from pepperscene.colour.patches.extraction import Extraction, erode, open_reflectances, read_reflectance
from pepperscene.colour.patches.open import organ_regions
from pepperscene.colour.patches.patch import even_indices, is_organ_kind, matches_kind
from pepperscene.colour.statistics import hue_histogram, srgb_codes
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.errors import InputError
from pepperscene.spectra import read_spectrum
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


CAMERA = np.array([[0.6, 0.2, 0.05], [0.1, 0.7, 0.1], [0.05, 0.2, 0.5]])

PEPPER = """
[[spectrum]]
file = "vrhel_fruit_vegetable_reflectance"
column = "green_pepper_136"
kind = "pepper.unripe"
"""


@pytest.fixture
def pictures(tmp_path) -> Path:
    """`p1.png` and `days/p2.png`, 20 x 30 pixels whose red is the column and green the row, and a mask."""
    (tmp_path / "days").mkdir()
    rows, columns = np.meshgrid(np.arange(20), np.arange(30), indexing="ij")
    for k, name in enumerate(("p1.png", "days/p2.png")):
        codes = np.stack([columns + 100, rows + 100, np.full_like(rows, 50 + k)], axis=-1)
        Image.fromarray(codes.astype(np.uint8)).save(tmp_path / name)
    Image.fromarray((columns // 10).astype(np.uint8)).save(tmp_path / "mask.png")
    return tmp_path


def write_patches_file(folder, text):
    path = folder / "patches.toml"
    path.write_text(text)
    return path


REGIONS = """
[[patch]]
picture = "p1.png"
kind = "leaf"
box = [3, 5, 9, 7]

[[patch]]
picture = "days/p2.png"
kind = "pepper.ripe"
name = "triangle"
polygon = [[0, 0], [10, 0], [0, 10]]

[[patch]]
picture = "p1.png"
kind = "stem"
mask = { file = "mask.png", value = 2 }
"""


def test_regions_select_their_pixels(pictures):
    patch_set = open_patches(write_patches_file(pictures, REGIONS))
    patches = {patch.kind: patch for patch in patch_set.patches}
    box, stem, triangle = (patches[kind] for kind in ("leaf", "stem", "pepper.ripe"))
    assert sorted(map(tuple, box.codes[:, :2].tolist())) == [
        (100 + x, 100 + y) for x in range(3, 9) for y in range(5, 7)
    ]
    assert box.linear == pytest.approx(decode_tone(box.codes))
    assert stem.codes[:, 0].min() == 120
    assert stem.pixels == 200
    # Pixels whose centres are below the diagonal; those on it may count or not.
    inside = triangle.codes[:, 0].astype(int) + triangle.codes[:, 1] - 200
    assert inside.max() <= 9
    assert 45 <= triangle.pixels <= 55
    assert (box.picture, triangle.picture) == ("p1", "days/p2")
    assert triangle.name == "triangle"
    assert patch_set.name == "patches"
    # Pictures may be in another folder.
    moved = pictures.parent / f"{pictures.name}_toml"
    moved.mkdir()
    again = open_patches(write_patches_file(moved, REGIONS), pictures=pictures)
    assert [patch.pixels for patch in again.patches] == [patch.pixels for patch in patch_set.patches]


def test_settings_of_the_file_and_overrides(pictures):
    text = '\n[[patch]]\npicture = "p1.png"\nkind = "leaf"\nbox = [0, 0, 20, 10]\n'

    def patch(setting, **options):
        return open_patches(write_patches_file(pictures, setting + text), **options).patches[0]

    assert patch("").pixels == 200
    assert patch("erode_px = 1").pixels == 19 * 9  # the border of the picture is not eroded
    assert patch("erode_px = 1", erode_px=3).pixels == 17 * 7
    assert patch("centre_px = 6").pixels == 6 * 3
    assert patch('tone = "linear"').linear.mean() > 2.0 * patch("").linear.mean()


def test_reads_measured_reflectances(tmp_path):
    patch_set = open_patches(write_patches_file(tmp_path, PEPPER))
    (pepper,) = patch_set.spectra
    assert (pepper.name, pepper.kind) == ("green_pepper_136", "pepper.unripe")
    shipped = read_spectrum("fruit/vrhel_fruit_vegetable_reflectance", "green_pepper_136")
    assert (pepper.spectrum.values == shipped.values).all()
    assert patch_set.kinds == ("pepper.unripe",)
    assert patch_set.pictures == ()


def test_reads_a_csv_file_with_kinds(tmp_path):
    table, about = tmp_path / "mine.csv", 'title = "t"\nsource = "s"\nlicence = "CC0"\nkind = "measured"\n'

    def opened(kinds, values="400,0.1,0.2\n700,0.3,0.4\n"):
        table.write_text(f"wavelength_nm,a,b\n{values}")
        table.with_suffix(".toml").write_text(about + kinds)
        return open_patches(table)

    (leaf,) = opened('[kinds]\na = "leaf"\n').spectra
    assert leaf.spectrum.at(550.0) == pytest.approx([0.2])
    for kinds, message in (
        ("", "patches file"),
        ('[kinds]\nc = "leaf"\n', "must be one of a, b"),
        ('[kinds]\na = "tree"\n', r"kinds\.a"),
    ):
        with pytest.raises(InputError, match=message):
            opened(kinds)
    with pytest.raises(InputError, match=r"reflectances in \[0, 1\]"):
        opened('[kinds]\na = "leaf"\n', "400,10,20\n700,30,40\n")
    table.with_suffix(".toml").unlink()
    with pytest.raises(InputError, match=r"mine\.toml"):
        open_patches(table)


def write_chart(path, scale=1.0):
    """Write a picture of a chart of 240 x 160 pixels without a frame, as the camera sees it."""
    linear = chart_linear().reshape(4, 6, 3).repeat(40, axis=0).repeat(40, axis=1)
    Image.fromarray(encode_tone((scale * linear @ CAMERA.T).astype(np.float32))).save(path)


CHARTED = """
[[patch]]
picture = "p1.png"
kind = "leaf"
box = [0, 0, 10, 10]

[chart]
picture = "chart.png"
corners = [[0, 0], [240, 0], [240, 160], [0, 160]]
"""


def test_chart_calibrates_the_pictures(tmp_path):
    leaf = np.array([0.08, 0.16, 0.03])
    picture = encode_tone(np.tile((CAMERA @ leaf).astype(np.float32), (12, 12, 1)))
    Image.fromarray(picture).save(tmp_path / "p1.png")
    write_chart(tmp_path / "chart.png")
    (patch,) = open_patches(write_patches_file(tmp_path, CHARTED)).patches
    assert delta_e_2000(linear_srgb_to_lab(patch.linear.mean(axis=0)), linear_srgb_to_lab(leaf)) < 1.0
    # Hues are counted in the calibrated colours.
    assert patch.codes[0] == pytest.approx(encode_tone(leaf.astype(np.float32)), abs=3)
    text = CHARTED.replace("[chart]", '[[chart]]\npictures = ["p7.png"]')
    (other,) = open_patches(write_patches_file(tmp_path, text)).patches
    assert delta_e_2000(linear_srgb_to_lab(other.linear.mean(axis=0)), linear_srgb_to_lab(leaf)) > 3.0


def test_chart_in_every_picture_removes_exposure(tmp_path):
    """Two exposures of the same scene become one colour."""
    for k, scale in ((1, 1.0), (2, 0.4)):
        write_chart(tmp_path / f"p{k}.png", scale)
    text = "".join(
        f'[[patch]]\npicture = "p{k}.png"\nkind = "leaf"\nbox = [125, 5, 155, 35]\n' for k in (1, 2)
    )
    text += "[chart]\ncorners = [[0, 0], [240, 0], [240, 160], [0, 160]]\n"
    foliage = linear_srgb_to_lab(chart_linear()[3])
    for patch in open_patches(write_patches_file(tmp_path, text)).patches:
        assert delta_e_2000(linear_srgb_to_lab(patch.linear.mean(axis=0)), foliage) < 1.0


BOX = '[[patch]]\npicture = "p1.png"\nkind = "leaf"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOX, "one of box, polygon and mask"),
        (BOX + "box = [0, 0, 4, 4]\npolygon = [[0, 0], [1, 0], [1, 1]]", "box and polygon"),
        (BOX + "box = [0, 0, 400, 4]", r"patch\.0\.box.* 30"),
        (BOX + "box = [5, 5, 5, 9]", "x0 < x1"),
        (BOX + "polygon = [[0, 0], [1, 0], [99, 1]]", "within the 30x20"),
        (BOX + 'mask = { file = "mask.png", value = 9 }', "leaves no pixel"),
        (BOX + 'mask = { file = "p1.png", value = 9 }', "colours, not values"),
        (BOX + 'mask = { file = "mask.png", value = "#ff0000" }', "values, not colours"),
        (BOX.replace("leaf", "tree") + "box = [0, 0, 4, 4]", r"patch\.0\.kind.*stage"),
        (BOX + 'box = [0, 0, 4, 4]\nname = "n"\n' + BOX + 'box = [0, 0, 4, 4]\nname = "n"', "'n'.*one patch"),
        ("erode_px = 9\n" + BOX + "box = [5, 5, 9, 9]", "leaves no pixel"),
        (PEPPER.replace("green_pepper_136", "blue_pepper"), "must be one of"),
        (PEPPER.replace("vrhel", "no"), "nor one of the shipped"),
        (PEPPER + "[chart]\ndetect = false", "corners or detect"),
        (PEPPER + "[[chart]]\ndetect = true\n[[chart]]\ndetect = true", "may omit pictures"),
        (BOX + "box = [0, 0, 4, 4]\n[chart]\ndetect = true", "shows no ColorChecker"),
    ],
)
def test_errors_name_key_and_allowed_values(pictures, text, message):
    with pytest.raises(InputError, match=message):
        open_patches(write_patches_file(pictures, text))


def test_reflectances_need_no_provenance(tmp_path):
    table = tmp_path / "mine.csv"
    table.write_text("wavelength_nm,a\n400,0.1\n700,0.5\n")
    assert read_reflectance(table, "a", "leaf").name == "a"
    table.with_suffix(".toml").write_text('[kinds]\na = "leaf"\n')
    assert open_reflectances(table).kinds == ("leaf",)

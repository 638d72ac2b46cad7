"""Patches files: regions, charts and reflectances; errors name the key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pepperscene import open_patches
from pepperscene.camera import decode_tone, encode_tone
from pepperscene.colour import delta_e_2000, linear_srgb_to_lab
from pepperscene.colour.patches.chart import chart_linear
from pepperscene.colour.patches.extraction import open_reflectances, read_reflectance
from pepperscene.errors import InputError
from pepperscene.spectra import read_spectrum

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

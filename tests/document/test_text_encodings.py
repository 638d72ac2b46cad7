"""Text files as the programs of Windows and old Macs save them, and files in other encodings."""

from __future__ import annotations

import pytest

from pepperscene import open_patches
from pepperscene.document import read_text, read_toml
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import read_spectra

MATERIALS = shipped_folder("materials")
MARK = b"\xef\xbb\xbf"  # the byte-order mark of UTF-8
LINE_ENDS = {"line feed": b"\n", "carriage return": b"\r", "both": b"\r\n"}
LAMP = "wavelength_nm,warm\n400,1\n500,3\n"


@pytest.mark.parametrize("ending", LINE_ENDS.values(), ids=LINE_ENDS)
@pytest.mark.parametrize("mark", [b"", MARK], ids=["no mark", "mark"])
def test_files_with_any_line_ends_and_a_byte_order_mark_are_the_same(tmp_path, mark, ending):
    lens = MATERIALS / "lenses" / "lensagon_cmfa0420nd_typical_distortion.toml"
    leaf = MATERIALS / "leaf" / "vrhel_leaf_reflectance.csv"
    copies = [tmp_path / shipped.name for shipped in (lens, leaf)]
    for copy, shipped in zip(copies, (lens, leaf), strict=True):
        copy.write_bytes(mark + shipped.read_bytes().replace(b"\n", ending))
    assert read_toml(copies[0]) == read_toml(lens)
    expected, read = read_spectra(leaf), read_spectra(copies[1])
    assert list(read) == list(expected)
    for name, spectrum in read.items():
        assert (spectrum.wavelength_nm == expected[name].wavelength_nm).all()
        assert (spectrum.values == expected[name].values).all()


def test_patches_and_recipes_with_a_byte_order_mark_are_read(tmp_path):
    patches = (
        '[[spectrum]]\r\nfile = "vrhel_fruit_vegetable_reflectance"\r\n'
        'column = "green_pepper_136"\r\nkind = "pepper.unripe"\r\n'
    )
    (tmp_path / "patches.toml").write_bytes(MARK + patches.encode())
    (spectrum,) = open_patches(tmp_path / "patches.toml").spectra
    assert spectrum.kind == "pepper.unripe"
    (tmp_path / "recipe.toml").write_bytes(MARK + b'extends = "demo"\r\nseed = 3\r\n')
    assert load_recipe(tmp_path / "recipe.toml").seed == 3


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-le", "utf-32-be"])
@pytest.mark.parametrize("name", ["lens.toml", "lamp.csv"])
def test_other_unicode_encodings_are_named(tmp_path, name, encoding):
    path = tmp_path / name
    text = LAMP if name.endswith("csv") else 'name = "lens"\n'
    path.write_bytes(text.encode(encoding))
    with pytest.raises(InputError, match=r"must be a text file in UTF-8, not UTF-\d\d; save it as UTF-8$"):
        (read_spectra if name.endswith("csv") else read_toml)(path)


@pytest.mark.parametrize("name", ["lens.toml", "lamp.csv"])
def test_the_line_that_is_not_utf_8_is_named(tmp_path, name):
    path = tmp_path / name
    path.write_bytes("# one\r\n# two\r\n# Düsseldorf\r\n".encode("latin-1"))
    with pytest.raises(InputError, match="must be a text file in UTF-8, but line 3 is not"):
        (read_spectra if name.endswith("csv") else read_toml)(path)


def test_text_is_read_with_line_feeds(tmp_path):
    path = tmp_path / "text"
    path.write_bytes(MARK + b"one\r\ntwo\rthree\n")
    assert read_text(path) == "one\ntwo\nthree\n"

"""Mesh files that are damaged, or saved by other programs: the message says what is wrong with the file."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pepperscene.errors import InputError
from pepperscene.geometry.fruit.scan import load_scan
from pepperscene.geometry.fruit.scan_file import read_triangles

BALL = trimesh.creation.icosphere(subdivisions=2, radius=30.0)
TEXTS = {
    "obj": BALL.export(file_type="obj").encode(),
    "ply": BALL.export(file_type="ply", encoding="ascii"),
    "stl": BALL.export(file_type="stl_ascii").encode(),
}
BINARY_STL, BINARY_PLY = BALL.export(file_type="stl"), BALL.export(file_type="ply")
MARK = b"\xef\xbb\xbf"


def error_of(folder, suffix, content):
    path = folder / f"fruit.{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_scan(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert "module" not in message.lower()
    return message


@pytest.mark.parametrize(("mark", "ending"), [(b"", b"\r"), (MARK, b"\r\n")])
@pytest.mark.parametrize("suffix", TEXTS)
def test_text_with_a_byte_order_mark_and_any_line_ends_is_read(tmp_path, suffix, mark, ending):
    path = tmp_path / f"fruit.{suffix}"
    path.write_bytes(mark + TEXTS[suffix].replace(b"\n", ending))
    read = read_triangles(path)
    assert len(read.faces) == len(BALL.faces)
    np.testing.assert_allclose(read.vertices[read.faces], BALL.triangles, atol=1e-5)


def test_truncated_binary_stl_names_both_lengths(tmp_path):
    message = error_of(tmp_path, "stl", BINARY_STL[:-7])
    assert f"announces {len(BALL.faces)} triangles in {len(BINARY_STL)} bytes" in message
    assert f"it has {len(BINARY_STL) - 7}" in message


def test_truncated_text_is_reported(tmp_path):
    assert "ends before `endsolid`" in error_of(tmp_path, "stl", TEXTS["stl"][:-200])
    assert "no line `end_header`" in error_of(tmp_path, "ply", TEXTS["ply"][:90])
    expected = f"announces {len(BALL.vertices) + len(BALL.faces)} lines, but"
    assert expected in error_of(tmp_path, "ply", TEXTS["ply"][:-3000])
    assert "PLY is unexpected length" in error_of(tmp_path, "ply", BINARY_PLY[:-5])


@pytest.mark.parametrize("suffix", ["obj", "stl"])
def test_line_that_is_no_text_is_named(tmp_path, suffix):
    lines = TEXTS[suffix].splitlines(keepends=True)
    lines[11] = b"\xff\xfe " + lines[11]
    assert "must be a text file in UTF-8, but line 12 is not" in error_of(tmp_path, suffix, b"".join(lines))


def test_utf_16_is_named(tmp_path):
    assert "not UTF-16" in error_of(tmp_path, "obj", TEXTS["obj"].decode().encode("utf-16"))


@pytest.mark.parametrize("corner", ["9999", "-9999"])
def test_corner_that_does_not_exist_is_reported(tmp_path, corner):
    text = TEXTS["obj"] + f"f 1 2 {corner}\n".encode()
    assert "cannot be read as a mesh" in error_of(tmp_path, "obj", text)
    text = TEXTS["ply"].splitlines(keepends=True)
    text[-1] = f"3 1 2 {corner}\n".encode()
    assert "corner" in error_of(tmp_path, "ply", b"".join(text))


@pytest.mark.parametrize(("number", "problem"), [("nan", "finite"), ("1e300", "beyond")])
def test_impossible_coordinates_are_reported(tmp_path, number, problem):
    lines = TEXTS["obj"].splitlines(keepends=True)
    row = next(row for row, line in enumerate(lines) if line.startswith(b"v "))
    lines[row] = f"v {number} 0 0\n".encode()
    assert problem in error_of(tmp_path, "obj", b"".join(lines))

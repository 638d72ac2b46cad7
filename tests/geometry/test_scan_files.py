"""Scans that are damaged, malformed or saved by other programs, and binary glTF as its specification says."""

import io
import json
import os
import struct
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from malformed_scans import contents, large_scan, special_files
from PIL import Image

from pepperscene.camera.image.colorimetry import srgb_decode
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


# --- binary glTF --------------------------------------------------------------------------------------------


SPHERE = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
HEIGHT = SPHERE.vertices[:, 2] / 0.08 + 0.5


def egg():
    """A body without symmetry from top to bottom, z up."""
    body = SPHERE.copy()
    body.vertices *= np.stack([*2 * [0.6 + 0.5 * HEIGHT], 0 * HEIGHT + 1.2], axis=1)
    return body


def y_up(body):
    return body.copy().apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2.0, [1, 0, 0]))


def chunks(content):
    """Structure and binary content of a file."""
    (size,) = struct.unpack("<I", content[12:16])
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def with_changes(content, change):
    """The file after a change of its structure."""
    tree, binary = chunks(content)
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def textured(image):
    """A ball whose texture covers it from top (row 0) to bottom."""
    uv = np.stack([np.full(len(HEIGHT), 0.5), HEIGHT], axis=1)
    picture = Image.fromarray(np.asarray(image, np.uint8))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(SPHERE.vertices, SPHERE.faces, visual=visual, process=False).export(
        file_type="glb"
    )


def read(folder, content):
    (path := folder / "fruit.glb").write_bytes(content)
    return read_triangles(path, colour=True)


def test_nodes_are_placed_as_trimesh_places_them(tmp_path):
    scene = trimesh.Scene()
    turn = trimesh.transformations.compose_matrix(
        scale=[1.0, 2.0, 0.5], angles=[0.3, -0.8, 1.1], translate=[1.0, -2.0, 3.0]
    )
    scene.add_geometry(egg(), node_name="first", transform=turn)
    scene.add_geometry(
        trimesh.creation.box(), parent_node_name="first", transform=trimesh.transformations.scale_matrix(0.1)
    )
    content = scene.export(file_type="glb")
    found = read(tmp_path, content)
    expected = trimesh.load(io.BytesIO(content), file_type="glb").to_geometry()
    order = [np.lexsort(np.round(body, 5).T) for body in (found.vertices, expected.vertices)]
    np.testing.assert_allclose(found.vertices[order[0]], expected.vertices[order[1]], atol=1e-6)
    assert len(found.faces) == len(expected.faces)
    assert found.colours is None


def test_node_with_scale_rotation_and_translation(tmp_path):
    def change(tree):
        node = next(node for node in tree["nodes"] if "mesh" in node)
        node.pop("matrix", None)
        node |= {
            "translation": [1.0, 0.0, 0.0],
            "rotation": [0.0, 0.0, 0.5**0.5, 0.5**0.5],
            "scale": [2.0, 1.0, 1.0],
        }

    found = read(tmp_path, with_changes(SPHERE.export(file_type="glb"), change))
    # First scaled along x, then turned by a quarter about z, then moved.
    x, y, z = SPHERE.vertices.T
    np.testing.assert_allclose(found.vertices, np.stack([1.0 - y, 2.0 * x, z], axis=1), atol=1e-6)


def test_glb_is_y_up(tmp_path):
    y_up(egg()).export(tmp_path / "fruit.glb")
    egg().export(tmp_path / "fruit.ply")
    glb, ply = load_scan(tmp_path / "fruit.glb"), load_scan(tmp_path / "fruit.ply")
    assert glb.diameter == pytest.approx(ply.diameter, rel=1e-5)
    turned = load_scan(tmp_path / "fruit.glb", "-y")
    # Far from the stalk the egg is slim, and the other way round if it is turned.
    slopes = [
        np.corrcoef(np.hypot(*scan.points.T[:2]), scan.points[:, 2])[0, 1] for scan in (ply, glb, turned)
    ]
    assert slopes[0] < -0.2
    assert slopes[1] == pytest.approx(slopes[0], abs=0.01)
    assert slopes[2] == pytest.approx(-slopes[0], abs=0.01)


def test_texture_is_read_from_top_to_bottom(tmp_path):
    # Dark at the top, and the coordinates of trimesh, whose v is upwards, put its bottom at the greatest z.
    rows = np.repeat(np.linspace(0, 250, 64).round()[:, None, None], 3, axis=2).repeat(4, axis=1)
    found = read(tmp_path, textured(rows))
    expected = srgb_decode(np.interp(1.0 - HEIGHT, (np.arange(64) + 0.5) / 64, rows[:, 0, 0]) / 255.0)
    # Where the image repeats, at both ends, and within half a texel elsewhere.
    inner = np.abs(HEIGHT - 0.5) < 0.45
    np.testing.assert_allclose(found.colours[inner, 0], expected[inner], atol=0.04)


def test_texture_and_colour_of_the_material_are_multiplied(tmp_path):
    def change(tree):
        tree["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = [0.5, 1.0, 0.25, 1.0]

    content = textured(np.full((2, 2, 3), 188))
    found = read(tmp_path, with_changes(content, change))
    np.testing.assert_allclose(
        found.colours,
        np.tile(srgb_decode(188 / 255.0) * np.array([0.5, 1.0, 0.25]), (len(SPHERE.vertices), 1)),
    )


def test_shades_of_a_fine_texture_are_averaged(tmp_path):
    # Rows of black and white, narrower than the triangles.
    rows = np.zeros((512, 4, 3))
    rows[::2] = 255
    found = read(tmp_path, textured(rows))
    assert found.colours.mean() == pytest.approx(0.5, abs=0.03)
    assert found.colours.std() < 0.25


# --- malformed scans, in a process with 2 GB of memory ------------------------------------------------------


MEMORY = 2 * 10**9

CHILD = f"""
import json, resource, sys, traceback, warnings
from pathlib import Path

resource.setrlimit(resource.RLIMIT_AS, ({MEMORY}, {MEMORY}))
import numpy as np

warnings.simplefilter("error")
from pepperscene.errors import InputError
from pepperscene.geometry.fruit.scan import load_scan

results = []
for path, colour in json.loads(Path(sys.argv[1]).read_text()):
    try:
        scan = load_scan(Path(path), colour=colour)
    except InputError as error:
        results.append(str(error))
        continue
    except Exception:
        results.append(traceback.format_exc())
        continue
    assert all(np.isfinite(values).all() for values in (scan.points, scan.normals, scan.uv))
    a, b, c = np.moveaxis(scan.points[scan.faces], 1, 0)
    # Closed, and its faces outwards: axes up, right and along are left-handed.
    results.append(float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0))
print(json.dumps(results))
"""


def read_all(usable, folder):
    """Usable or not, and the volume or the error, by path, from a process with little memory."""
    tasks = folder / "tasks.json"
    coloured = ("texture", "colour")
    tasks.write_text(
        json.dumps([(str(path), any(word in path.name for word in coloured)) for path in usable])
    )
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(tasks)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return {
        path: (usable[path], result) for path, result in zip(usable, json.loads(done.stdout), strict=True)
    }


@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.long)])
def test_each_is_refused_in_one_sentence_or_is_a_fruit(tmp_path, step):
    usable = {}
    for name, (content, can_be_used) in list(contents().items())[::step]:
        (path := tmp_path / name).write_bytes(content)
        usable[path] = can_be_used
    results = read_all(usable | dict.fromkeys(special_files(tmp_path), False), tmp_path)
    assert len(results) > 200 / step
    for path, (can_be_used, result) in results.items():
        assert can_be_used is None or can_be_used == isinstance(result, float), (path.name, result)
        if isinstance(result, float):
            # A body of length and diameter 1.
            assert 0.2 < abs(result) < 1.0, path.name
        else:
            assert result.startswith(f"{path}: "), path.name
            assert len(result.splitlines()) == 1, path.name
            assert len(result) < len(str(path)) + 600, path.name


@pytest.mark.long
def test_large_scan_is_read_with_little_memory(tmp_path):
    pytest.importorskip("fast_simplification")
    (path := tmp_path / "colour.ply").write_bytes(large_scan())
    _, volume = read_all({path: True}, tmp_path)[path]
    # A sphere of length and diameter 1.
    assert abs(volume) == pytest.approx(np.pi / 6.0, rel=0.03)

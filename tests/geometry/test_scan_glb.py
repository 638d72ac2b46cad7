"""Scans in binary glTF: geometry as trimesh reads it, and colours as the specification mixes them."""

from __future__ import annotations

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from pepperscene.camera.image.colorimetry import srgb_decode
from pepperscene.geometry.fruit.scan import load_scan
from pepperscene.geometry.fruit.scan_file import read_triangles

BALL = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
HEIGHT = BALL.vertices[:, 2] / 0.08 + 0.5


def egg():
    """A body without symmetry from top to bottom, z up."""
    body = BALL.copy()
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
    return trimesh.Trimesh(BALL.vertices, BALL.faces, visual=visual, process=False).export(file_type="glb")


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

    found = read(tmp_path, with_changes(BALL.export(file_type="glb"), change))
    # First scaled along x, then turned by a quarter about z, then moved.
    x, y, z = BALL.vertices.T
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
        found.colours, np.tile(srgb_decode(188 / 255.0) * np.array([0.5, 1.0, 0.25]), (len(BALL.vertices), 1))
    )


def test_shades_of_a_fine_texture_are_averaged(tmp_path):
    # Rows of black and white, narrower than the triangles.
    rows = np.zeros((512, 4, 3))
    rows[::2] = 255
    found = read(tmp_path, textured(rows))
    assert found.colours.mean() == pytest.approx(0.5, abs=0.03)
    assert found.colours.std() < 0.25

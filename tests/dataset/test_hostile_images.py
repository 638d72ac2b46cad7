"""Files that another program would have to read, under the suffixes of images: no process is started."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from data_sets import make_small_set
from PIL import Image

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 6\n%%EndComments\n0 0 8 6 rectfill\nshowpage\n%%EOF\n"
WMF = bytes.fromhex("d7cdc69a 0000 00000000 08000600 6000 00000000 0000 01000900") + bytes(200)
SVG = b'<svg xmlns="http://www.w3.org/2000/svg" width="8" height="6"><rect width="8" height="6"/></svg>'
PDF = b"%PDF-1.4\n1 0 obj<</Type/Catalog>>endobj\ntrailer<</Root 1 0 R>>\n%%EOF\n"
CONTENTS = {"eps": EPS, "wmf": WMF, "svg": SVG, "pdf": PDF}
SUFFIXES = (".png", ".PNG", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")

CHILD = """
import json, sys
from pathlib import Path

started = []
EVENTS = ("subprocess.Popen", "os.posix_spawn", "os.fork", "os.exec", "os.system", "os.startfile")
sys.addaudithook(lambda event, arguments: started.append(str(arguments)) if event in EVENTS else None)

from pepperscene.colour import open_patches
from pepperscene.dataset.readers import open_images
from pepperscene.errors import PepperError
from pepperscene.geometry.fruit.scan import load_scan

READERS = {
    "folder": lambda path: open_images(path)[0],
    "published": lambda path: open_images(path)[0],
    "rendered": lambda path: open_images(path)[0],
    "patches": open_patches,
    "scan": load_scan,
}
messages = []
for reader, path, file in json.loads(Path(sys.argv[1]).read_text()):
    started.clear()
    try:
        READERS[reader](Path(path))
        message = None
    except PepperError as error:
        message = str(error)
    messages.append((reader, file, message, list(started)))
print(json.dumps(messages))
"""
MATERIAL = "newmtl skin\nmap_Kd {}\n"
CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACES = "f 1/1 3/2 2/3\nf 1/1 2/2 4/3\nf 2/1 3/2 4/3\nf 3/1 1/2 4/3\n"


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile") / "set"
    make_small_set(folder)
    return folder


@pytest.fixture
def fake_programs(tmp_path, monkeypatch):
    """A folder, first in PATH, of programs that note in the file `started` that they were run."""
    folder = tmp_path / "programs"
    folder.mkdir()
    for name in ("gs", "gswin32c", "inkscape", "rsvg-convert", "pdftoppm", "convert", "magick"):
        program = folder / name
        program.write_text(f'#!/bin/sh\necho {name} >> "{folder / "started"}"\n')
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return folder


def photo(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (8, 6), (90, 120, 40)).save(path)


def hostile(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return str(path)


def folder_attempts(root, suffix, content):
    """A hostile photograph, and a hostile mask, of a folder and of a patches file."""
    image = hostile(root / "photo" / f"a{suffix}", content)
    yield "folder", root / "photo", image
    photo(root / "mask" / "images" / "a.png")
    mask = hostile(root / "mask" / "masks" / f"a{suffix}", content)
    yield "folder", root / "mask", mask
    yield "patches", root / "mask", mask
    patches = root / "photo" / "patches.toml"
    patches.write_text(f'[[patch]]\npicture = "a{suffix}"\nkind = "pepper"\nbox = [0, 0, 2, 2]\n')
    yield "patches", patches, image
    patches = root / "mask" / "patches.toml"
    picture = f'picture = "images/a.png"\nmask = {{ file = "masks/a{suffix}", value = 1 }}'
    patches.write_text(f'[[patch]]\n{picture}\nkind = "pepper"\n')
    yield "patches", patches, mask
    patches = root / "mask" / "chart.toml"
    patch = '[[patch]]\npicture = "images/a.png"\nkind = "pepper"\nbox = [0, 0, 2, 2]\n'
    patches.write_text(f'{patch}[[chart]]\npicture = "masks/a{suffix}"\ndetect = true\n')
    yield "patches", patches, mask


def png_attempts(root, content, rendered):
    """A hostile image of each kind in a published and in a rendered set, which hold PNG files only."""
    kinds = {
        "image_color": "color",
        "label_class_grayscale/synthetic_label_class_all_grayscale": "grey",
        "label_class_colorscale": "scale",
        "label_depth_grayscale": "depth",
    }
    for folder, name in kinds.items():
        published = root / f"published_{name}"
        photo(published / "synthetic_image_color" / "a_1.png")
        yield "published", published, hostile(published / f"synthetic_{folder}" / "a_1.png", content)
    for output in ("colour", "class", "instance", "distance"):
        copy = root / f"rendered_{output}"
        shutil.copytree(rendered, copy)
        file = next((copy / output).glob("000000.*"))
        yield "rendered", copy, hostile(file, content)


def scan_attempts(root, suffix, content):
    """A closed body with a hostile texture: it is read without the texture."""
    root.mkdir(parents=True, exist_ok=True)
    hostile(root / f"skin{suffix}", content)
    (root / "a.mtl").write_text(MATERIAL.format(f"skin{suffix}"))
    (root / "a.obj").write_text(f"mtllib a.mtl\n{CORNERS}usemtl skin\n{FACES}")
    yield "scan", root / "a.obj", ""
    vertices = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face 4\nproperty list uchar int vertex_indices\n"
    head = f"ply\nformat ascii 1.0\ncomment TextureFile skin{suffix}\n{vertices}{faces}end_header\n"
    body = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
    (root / "a.ply").write_text(head + body)
    yield "scan", root / "a.ply", ""


def test_no_reader_starts_a_process_whatever_an_image_file_holds(tmp_path, rendered, fake_programs):
    attempts = []
    for kind, content in CONTENTS.items():
        root = tmp_path / kind
        for suffix in SUFFIXES:
            attempts += folder_attempts(root / f"folder{suffix}", suffix, content)
            attempts += scan_attempts(root / f"scan{suffix}", suffix, content)
        attempts += png_attempts(root, content, rendered)
    listed = tmp_path / "attempts.json"
    listed.write_text(json.dumps([(reader, str(path), file) for reader, path, file in attempts]))
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(listed)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    messages = json.loads(done.stdout)
    assert len(messages) == len(attempts)
    for reader, file, message, started in messages:
        assert started == [], f"{reader} of {file}"
        if file:
            assert message is not None, f"{reader} reads {file}"
            assert Path(file).name in message, f"{reader} of {file}: {message}"
        else:
            assert message is None, f"{reader}: {message}"
    assert not (fake_programs / "started").exists()


def test_pillow_would_start_ghostscript_if_formats_were_not_named(tmp_path, fake_programs):
    # Otherwise the test above would show nothing.
    file = hostile(tmp_path / "a.png", EPS)
    code = f"from PIL import Image\nImage.open({file!r}).load()"
    subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert "gs" in (fake_programs / "started").read_text()

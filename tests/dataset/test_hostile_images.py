"""Files that another program would have to read, under the suffixes of images: no process is started."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from PIL import Image

from pepperscene.colour import open_patches
from pepperscene.dataset.readers import open_images
from pepperscene.errors import InputError
from pepperscene.geometry.fruit.scan import load_scan

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 6\n%%EndComments\n0 0 8 6 rectfill\nshowpage\n%%EOF\n"
WMF = bytes.fromhex("d7cdc69a 0000 00000000 08000600 6000 00000000 0000 01000900") + bytes(200)
CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACES = "f 1/1 3/2 2/3\nf 1/1 2/2 4/3\nf 2/1 3/2 4/3\nf 3/1 1/2 4/3\n"


@pytest.fixture
def started(tmp_path, monkeypatch):
    """A file that exists if a program that converts images was started."""
    folder = tmp_path / "programs"
    folder.mkdir()
    for name in ("gs", "gswin32c", "inkscape", "rsvg-convert", "pdftoppm", "convert", "magick"):
        program = folder / name
        program.write_text(f'#!/bin/sh\necho {name} >> "{folder / "started"}"\n')
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return folder / "started"


def photo(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (8, 6), (90, 120, 40)).save(path)


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(("content", "suffix"), [(EPS, ".png"), (EPS, ".tiff"), (WMF, ".jpg")])
def test_images_masks_and_charts_start_no_process(content, suffix, tmp_path, started):
    write(tmp_path / "photo" / f"a{suffix}", content)
    photo(tmp_path / "mask" / "images" / "a.png")
    write(tmp_path / "mask" / "masks" / f"a{suffix}", content)
    patch = '[[patch]]\npicture = "images/a.png"\nkind = "pepper"\nbox = [0, 0, 2, 2]\n'
    chart = tmp_path / "mask" / "chart.toml"
    chart.write_text(f'{patch}[[chart]]\npicture = "masks/a{suffix}"\ndetect = true\n')
    readers = [lambda name=name: open_images(tmp_path / name)[0] for name in ("photo", "mask")]
    for read in (*readers, lambda: open_patches(chart)):
        with pytest.raises(InputError, match=rf"a{suffix}: cannot be read as an image"):
            read()
    assert not started.exists()


def test_published_and_rendered_sets_start_no_process(copied, small, tmp_path, started):
    photo(tmp_path / "published" / "synthetic_image_color" / "a_1.png")
    name = "synthetic_label_class_grayscale/synthetic_label_class_all_grayscale"
    write(tmp_path / "published" / name / "a_1.png", EPS)
    folder = copied(small).folder
    write(folder / "class" / "000000.png", EPS)
    for path in (tmp_path / "published", folder):
        with pytest.raises(InputError, match="cannot be read as an image"):
            open_images(path)[0]
    assert not started.exists()


def test_textures_of_scans_start_no_process(tmp_path, started):
    """A closed body with such a texture is read without it."""
    write(tmp_path / "skin.png", EPS)
    (tmp_path / "a.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{CORNERS}usemtl skin\n{FACES}")
    load_scan(tmp_path / "a.obj")
    assert not started.exists()


def test_pillow_would_start_ghostscript_if_formats_were_not_named(tmp_path, started):
    # Otherwise the tests above would show nothing.
    file = str(write(tmp_path / "a.png", EPS))
    code = f"from PIL import Image\nImage.open({file!r}).load()"
    subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert "gs" in started.read_text()

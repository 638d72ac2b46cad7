"""Images with too many pixels are refused by their headers, before they are decoded."""

from __future__ import annotations

import json
import resource
import zlib

import numpy as np
import pytest
from PIL import Image

from pepperscene.dataset.readers import coco, open_images, pictures
from pepperscene.errors import InputError


def write_png(path, width, height, colour_type=2):
    """A valid PNG of one colour, whose pixels are never held."""

    def chunk(name, content):
        body = name + content
        return len(content).to_bytes(4, "big") + body + zlib.crc32(body).to_bytes(4, "big")

    channels = {0: 1, 2: 3}[colour_type]
    compressor = zlib.compressobj(1)
    row = bytes(1 + channels * width)
    data = b"".join(compressor.compress(row) for _ in range(height)) + compressor.flush()
    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes((8, colour_type, 0, 0, 0))
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    )
    return path


def test_images_above_the_limit_are_refused_by_their_header(tmp_path):
    bomb = write_png(tmp_path / "photo.png", 12_000, 12_000, 0)
    assert bomb.stat().st_size < 1_000_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for read in (pictures.read_photo, pictures.read_mask, pictures.photo_shape):
        with pytest.raises(InputError, match=r"has 12000 x 12000 pixels; at most 120 million are read"):
            read(bomb)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


def test_images_beyond_the_librarys_limit_are_refused(tmp_path):
    path = write_png(tmp_path / "photo.png", 20_000, 2)
    content = bytearray(path.read_bytes())
    content[20:24] = (20_000).to_bytes(4, "big")
    content[29:33] = zlib.crc32(content[12:29]).to_bytes(4, "big")
    path.write_bytes(content)
    with pytest.raises(InputError, match="more than 120 million pixels"):
        pictures.read_photo(path)


def test_a_large_photograph_of_a_tiny_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "_LARGE_PHOTO", 100_000)
    path = write_png(tmp_path / "photo.png", 1000, 1000)
    with pytest.raises(InputError, match=r"has 1000 x 1000 pixels in .* bytes, which no photograph has"):
        pictures.read_photo(path)
    # A mask of one class is as small, and valid.
    assert pictures.read_mask(path).shape == (1000, 1000)
    noise = np.random.default_rng(0).integers(0, 256, (400, 400, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.jpg")
    assert pictures.read_photo(tmp_path / "noise.jpg").shape == (400, 400, 3)


def test_photographs_of_the_largest_cameras_are_not_refused(tmp_path):
    # 102 million pixels, above the limit from which the library warns.
    path = write_png(tmp_path / "photo.png", 11_648, 8_736, 0)
    assert pictures.photo_shape(path) == (8_736, 11_648)


def test_a_mask_of_another_size_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    (tmp_path / "images").mkdir()
    (tmp_path / "masks").mkdir()
    Image.new("RGB", (40, 30), (9, 9, 9)).save(tmp_path / "images" / "a.png")
    write_png(tmp_path / "masks" / "a.png", 5000, 5000, 0)
    monkeypatch.setattr(pictures, "read_mask", lambda _: pytest.fail("the mask was decoded"))
    images = open_images(tmp_path, labels={"0": "background"}).select("classes")
    with pytest.raises(InputError, match=r"5000x5000 pixels, but its image a.png has 40x30"):
        images[0]


def test_masks_of_annotations_are_bounded(tmp_path, monkeypatch):
    size = 400
    Image.new("RGB", (size, size)).save(tmp_path / "a.png")
    whole = {"size": [size, size], "counts": [0, size * size]}
    annotation = {"image_id": 1, "category_id": 1, "iscrowd": 0, "area": 1, "bbox": [0, 0, size, size]}
    content = {
        "images": [{"id": 1, "file_name": "a.png", "width": size, "height": size}],
        "categories": [{"id": 1, "name": "pepper"}],
        "annotations": [{**annotation, "id": number, "segmentation": whole} for number in range(1, 30)],
    }
    (tmp_path / "annotations.json").write_text(json.dumps(content))
    image = open_images(tmp_path)[0]
    assert (image.classes == 2).all()
    assert (image.instances == 29).all()
    monkeypatch.setattr(coco, "_MOST_MASK_BYTES", 400_000)
    with pytest.raises(InputError, match=r"image a: has annotations whose masks take more than"):
        open_images(tmp_path)[0]

"""The output `photo`: JPEG files as Pillow makes them, with EXIF, in data sets."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import ExifTags, Image
from skimage.metrics import peak_signal_noise_ratio

from pepperscene import check_dataset, open_images
from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.execution.single_frame import render_frame
from pepperscene.camera import Camera, Developing, ImageProcessor, load_lens, load_processor, load_sensor
from pepperscene.camera.image.photo import jpeg_bytes, photo_description
from pepperscene.dataset.store.images import encode_image, read_image, write_image
from pepperscene.errors import InputError
from pepperscene.outputs import OUTPUTS
from pepperscene.recipe.resolve.load import load_recipe

SENSOR = replace(load_sensor("logitech_c920"), columns=64, rows=48)
SAMPLING = {"4:4:4": (1, 1), "4:2:2": (2, 1), "4:2:0": (2, 2)}


def camera(**values):
    return Camera(
        load_lens("logitech_c920"),
        SENSOR.with_settings(gain=2.0),
        exposure_s=1 / 250,
        developing=Developing(white_balance="daylight", isp=ImageProcessor(**values)),
    )


def image():
    rng = np.random.default_rng(0)
    blocks = rng.integers(0, 256, (6, 8, 3)).repeat(8, axis=0).repeat(8, axis=1)
    return np.clip(blocks + rng.normal(0, 8, blocks.shape), 0, 255).astype(np.uint8)


def opened(content):
    return Image.open(io.BytesIO(content), formats=["JPEG"])


@pytest.mark.parametrize("subsampling", SAMPLING)
@pytest.mark.parametrize("quality", [20, 95])
def test_bytes_decode_to_what_pillow_makes(quality, subsampling):
    described = photo_description(camera(jpeg_quality=quality, jpeg_subsampling=subsampling))
    content, stream = jpeg_bytes(image(), described), io.BytesIO()
    Image.fromarray(image()).save(stream, "JPEG", quality=quality, subsampling=subsampling)
    picture = opened(content)
    np.testing.assert_array_equal(np.asarray(picture), np.asarray(opened(stream.getvalue())))
    assert picture.layer[0][1:3] == SAMPLING[subsampling]  # of luma, chroma has 1 x 1
    assert jpeg_bytes(image(), described) == content


def test_higher_quality_is_closer_to_the_image():
    ratios = [
        peak_signal_noise_ratio(image(), np.asarray(opened(jpeg_bytes(image(), {"jpeg_quality": quality}))))
        for quality in (10, 50, 90)
    ]
    assert ratios == sorted(ratios)


def test_exif_says_how_the_photograph_was_taken():
    picture = opened(jpeg_bytes(image(), photo_description(camera())))
    first, shooting = picture.getexif(), picture.getexif().get_ifd(ExifTags.IFD.Exif)
    tags = ExifTags.Base
    assert (first[tags.Make], first[tags.Model]) == ("Logitech", "Logitech C920")
    assert shooting[tags.ExposureTime] == pytest.approx(1 / 250)
    assert shooting[tags.FNumber] == pytest.approx(load_lens("logitech_c920").f_number)
    assert shooting[tags.FocalLength] == pytest.approx(3.67)
    assert shooting[tags.ISOSpeedRatings] == 200
    # No time of day: a frame depends on its recipe alone.
    assert not {tags.DateTime, tags.DateTimeOriginal} & {*first, *shooting}


def test_file_is_read_back_as_it_decodes_and_damage_is_an_error(tmp_path):
    path = tmp_path / "photo.jpg"
    write_image(path, image(), "photo", photo=photo_description(camera(jpeg_subsampling="4:4:4")))
    assert OUTPUTS["photo"].suffix == ".jpg"
    assert peak_signal_noise_ratio(image(), read_image(path)) > 30
    content = path.read_bytes()
    for damaged in (b"", content[: len(content) // 2], encode_image(image(), "colour")):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="cannot be read"):
            read_image(path)


CHANGES = {
    "plan.frames": 2, "row.plants_front": 1, "row.plants_back": 0, "camera.sensor": "generic_rgb",
    "camera.width": 64, "camera.height": 48, "cultivar": "kaite_february", "camera.exposure_us": "auto",
    "developing.isp.preset": "webcam",
}  # fmt: skip


@pytest.fixture(scope="module")
def photo_set(tmp_path_factory):
    """Two frames of one small plant through the webcam's processing, at two qualities."""
    changes = {**CHANGES, "developing.isp.jpeg_quality": {"in_turn": [30, 90]}}
    folder = tmp_path_factory.mktemp("photos") / "set"
    outputs = ("colour", "photo", "class")
    build(load_recipe("demo", changes), folder, "0:2", outputs, BuildOptions(quality="draft"))
    return folder


def test_data_set_holds_the_image_before_and_after_the_jpeg(photo_set):
    assert check_dataset(photo_set).findings == ()
    ratios = []
    for index in range(2):
        colour = read_image(photo_set / "colour" / f"{index:06d}.png")
        photo = read_image(photo_set / "photo" / f"{index:06d}.jpg")
        ratios.append(peak_signal_noise_ratio(colour, photo))
        metadata = json.loads((photo_set / "frames" / f"{index:06d}.json").read_text())
        content = (photo_set / "photo" / f"{index:06d}.jpg").read_bytes()
        assert content == jpeg_bytes(colour, metadata["photo"])
        assert metadata["photo"]["jpeg_quality"] == (30, 90)[index]
        isp = metadata["camera"]["developing"]["isp"]
        assert isp["sharpening"] == load_processor("webcam").sharpening
    assert 20 < ratios[0] < ratios[1]


def test_readers_and_check_take_the_photograph_if_there_is_no_image_without_loss(photo_set, tmp_path):
    assert (open_images(photo_set)[0].colour == read_image(photo_set / "colour" / "000000.png")).all()
    folder = tmp_path / "set"
    build(load_recipe("demo", CHANGES), folder, "0:1", ("photo", "class"), BuildOptions(quality="draft"))
    assert not (folder / "colour").exists()
    assert (open_images(folder)[0].colour == read_image(folder / "photo" / "000000.jpg")).all()
    assert check_dataset(folder).findings == ()
    (folder / "photo" / "000000.jpg").write_bytes(b"\xff\xd8")
    assert {finding.kind for finding in check_dataset(folder).findings} == {"checksum"}


def test_single_frame_is_a_photograph_too(tmp_path):
    options = BuildOptions(quality="draft")
    render_frame(load_recipe("demo", CHANGES), tmp_path, outputs=["photo"], options=options)
    exif = opened((tmp_path / "photo.jpg").read_bytes()).getexif()
    assert exif[ExifTags.Base.Model] == load_sensor("generic_rgb").name

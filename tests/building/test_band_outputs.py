"""Outputs of a sensor with bands: their files, readers, checks, exports, and what refuses them."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from data_sets import set_without_plants
from stand_in import SIZE, StandIn

from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.execution.single_frame import render_frame
from pepperscene.camera import Motion
from pepperscene.classes import CLASS_COLOURS
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.readers import open_images
from pepperscene.errors import InputError
from pepperscene.export import export_dataset, run
from pepperscene.export.surface import recorded_camera
from pepperscene.frame import Frame
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import white_reference
from pepperscene.review.check import check_dataset
from pepperscene.review.report import write_report

MULTISPECTRAL = {
    "camera.sensor": "micasense_rededge_mx", "camera.lens": "micasense_rededge_mx", "camera.flash": "none",
    "camera.width": SIZE[1], "camera.height": SIZE[0], "camera.exposure_us": 500,
}  # fmt: skip
SCANNER = {
    **MULTISPECTRAL, "camera.sensor": "generic_line_scanner_vnir",
    "camera.lens": "generic_line_scanner_38deg", "views.speed_mm_s": 100,
}  # fmt: skip
OUTPUTS = ("bands", "radiance", "reflectance", "class", "distance", "position")
CHANNELS = ["B01.475nm", "B02.560nm", "B03.668nm", "B04.717nm", "B05.842nm"]


class BandStandIn(StandIn):
    """Renders noise in the bands of the camera's sensor, and labels of a plane."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        frame = super().render(camera, outputs, quality, seed, **others)
        rng = np.random.default_rng(seed)
        shape = (camera.height, camera.width, camera.sensor.channels)
        bands = rng.uniform(0.0, 1.0, shape).astype(np.float32)
        images = {**frame.images, **dict.fromkeys(("bands", "radiance", "reflectance", "electrons"), bands)}
        images["class"] = rng.integers(0, 8, shape[:2]).astype(np.uint8)
        images |= plane_labels(camera)
        return Frame({name: images[name] for name in outputs}, frame.metadata)


def plane_labels(camera):
    poses = camera.label_poses(np.arange(camera.height) + 0.5)
    distance = np.linspace(0.6, 0.8, camera.height * camera.width, dtype=np.float32)
    distance = distance.reshape(camera.height, camera.width)
    directions = np.einsum("rij,rcj->rci", poses[:, :3, :3], camera.pixel_directions())
    position = (poses[:, None, :3, 3] + distance[..., None] * directions).astype(np.float32)
    return {"distance": distance, "position": position}


class MovingStandIn(BandStandIn):
    """Moves the camera across its line."""

    def render(self, camera, *args, **others):
        moving = replace(camera, motion=Motion(0.3 * camera.pose[:3, 1]))
        return super().render(moving, *args, **others)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("bands") / "set"
    return set_without_plants(path, range(3), OUTPUTS, BandStandIn, MULTISPECTRAL)


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    path = tmp_path_factory.mktemp("lines") / "set"
    return set_without_plants(path, range(1), ("reflectance", "distance", "position"), MovingStandIn, SCANNER)


def test_channels_are_named_by_number_and_centre(dataset, scanned):
    path = dataset.path(1, "reflectance")
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert sorted(file.channels()) == CHANNELS
        header = file.header()
        assert header["wavelength_nm"] == "475, 560, 668, 717, 842"
        assert header["fwhm_nm"] == "32, 27, 14, 12, 57"
        assert header["band_names"] == "blue, green, red, red edge, near infrared"
        image = dataset.image(1, "reflectance")
        for number, name in enumerate(CHANNELS):
            np.testing.assert_array_equal(file.channels()[name].pixels, image[..., number])
    # Hundreds of bands keep their order.
    expected = np.random.default_rng(scanned.metadata(0)["seed"]).uniform(0, 1, (*SIZE, 224))
    np.testing.assert_array_equal(scanned.image(0, "reflectance"), expected.astype(np.float32))


def test_readers_have_the_bands(dataset):
    image = open_images(dataset.folder)[2]
    assert image.reflectance.shape == image.radiance.shape == image.bands.shape == (*SIZE, 5)
    assert [band["centre_nm"] for band in image.metadata["camera"]["bands"]] == [475, 560, 668, 717, 842]
    np.testing.assert_array_equal(image.reflectance, dataset.image(2, "reflectance"))


def test_report_shows_indices_with_their_scale(dataset):
    page = write_report(dataset.folder, limit=1).page.read_text(encoding="utf-8")
    shown = re.findall(r'alt="(Spectral index \w+) of frame 000000"', page)
    assert shown == ["Spectral index NDVI", "Spectral index NDRE"]


def test_check_finds_nothing_in_a_correct_set(dataset, scanned):
    for correct in (dataset, scanned):
        # These are noise, which has no edges.
        findings = check_dataset(correct.folder, workers=1).findings
        assert [finding for finding in findings if finding.kind not in ("edges", "drift")] == []


@pytest.mark.parametrize(
    ("output", "value", "problem"),
    [("reflectance", np.nan, "not finite"), ("radiance", -1.0, "below 0"), ("bands", 0.0, "no light at all")],
)
def test_check_finds_wrong_values(tmp_path, output, value, problem):
    class Faulty(BandStandIn):
        def render(self, *args, **kwargs):
            frame = super().render(*args, **kwargs)
            image = frame.images[output] = frame.images[output].copy()
            image[slice(None) if value == 0 else (2, 3)] = value
            return frame

    faulty = set_without_plants(tmp_path / "set", range(1), (output,), Faulty, MULTISPECTRAL)
    found = check_dataset(faulty.folder, workers=1).findings
    assert any(problem in finding.problem and output in finding.file for finding in found)


def read_envi(path):
    """Header fields and the array of an ENVI file, by the numbers of its header alone."""
    first, *lines = path.with_suffix(".hdr").read_text().splitlines()
    assert first == "ENVI"
    fields = dict(line.split(" = ", 1) for line in lines)
    assert (fields["interleave"], fields["byte order"]) == ("bsq", "0")
    dtype = {"1": "u1", "4": "<f4"}[fields["data type"]]
    shape = tuple(int(fields[key]) for key in ("bands", "lines", "samples"))
    values = np.memmap(path.with_suffix(".img"), dtype, "r", int(fields["header offset"]), shape)
    return fields, np.moveaxis(values, 0, 2)


def test_envi_files_hold_the_bands(dataset, tmp_path):
    out = export_dataset(dataset.folder, "envi", tmp_path / "out", "train=0:2,val=2:3").folder
    for index, split in ((0, "train"), (2, "val")):
        for output in ("bands", "radiance", "reflectance"):
            fields, image = read_envi(out / split / output / f"{index:06d}")
            np.testing.assert_array_equal(image, dataset.image(index, output))
            assert fields["wavelength"] == "{475, 560, 668, 717, 842}"
            assert fields["fwhm"] == "{32, 27, 14, 12, 57}"
            assert fields["wavelength units"] == "Nanometers"
    fields, image = read_envi(out / "val" / "class" / "000002")
    np.testing.assert_array_equal(image[..., 0], dataset.image(2, "class"))
    assert (fields["file type"], fields["classes"]) == ("ENVI Classification", "8")
    assert fields["class lookup"] == "{" + ", ".join(str(v) for rgb in CLASS_COLOURS for v in rgb) + "}"


def test_npy_files_hold_the_bands_and_labels(dataset, tmp_path):
    out = export_dataset(dataset.folder, "npy", tmp_path / "out").folder
    for output in ("reflectance", "class"):
        array = np.load(out / "train" / output / "000001.npy", allow_pickle=False)
        np.testing.assert_array_equal(array, dataset.image(1, output))
    table = json.loads((out / "bands.json").read_text())
    assert table["bands"][3] == {"number": 4, "name": "red edge", "centre_nm": 717.0, "width_nm": 12.0}
    assert table["units"]["radiance"] == "W m-2 sr-1 nm-1"


def test_sets_without_bands_are_refused(tmp_path):
    plain = set_without_plants(tmp_path / "set", range(1), ("colour",))
    with pytest.raises(InputError, match="has no output 'reflectance'"):
        export_dataset(plain.folder, "envi", tmp_path / "out")


@pytest.mark.parametrize("format_name", ["nerfstudio", "colmap", "rgbd", "bop"])
def test_formats_with_a_camera_model_refuse_line_scanners(scanned, format_name, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="line scanners"):
        recorded_camera(DatasetFrame(scanned, 0))
    needed = replace(run.FORMATS[format_name], required=())
    monkeypatch.setattr(run, "FORMATS", {format_name: needed})
    with pytest.raises(InputError, match=r"camera\.line_scan = True: must be false"):
        export_dataset(scanned.folder, format_name, tmp_path / "out")


def test_recorded_line_scanner_projects_the_positions_of_its_pixels(scanned):
    camera = recorded_camera(DatasetFrame(scanned, 0), allows_line_scan=True)
    found = camera.project(scanned.image(0, "position").reshape(-1, 3).astype(float)).reshape(*SIZE, 2)
    row, column = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    np.testing.assert_allclose(found, np.stack([column, row], axis=-1), atol=1e-3)


@pytest.mark.parametrize(
    ("changes", "output", "problem"),
    [
        (MULTISPECTRAL, "colour", "has bands: use 'electrons', 'bands', 'radiance', 'reflectance'"),
        ({}, "reflectance", "needs a sensor with bands"),
    ],
)
def test_outputs_that_the_sensor_does_not_have_are_refused_early(tmp_path, changes, output, problem):
    recipe = load_recipe("barth2018", changes)
    with pytest.raises(InputError, match=problem):
        render_frame(recipe, tmp_path / "out", outputs=(output,), options=BuildOptions(renderer=BandStandIn))
    assert not (tmp_path / "out").exists()


def test_white_reference_of_a_recipe():
    panel = white_reference(load_recipe("barth2018", MULTISPECTRAL))
    assert (panel.reflectance, panel.distance_m, panel.facing) == (0.99, 0.4, "camera")
    changes = {"white_reference.reflectance": 0.5, "white_reference.facing": "up"}
    recipe = load_recipe("multispectral", changes)
    panel = white_reference(recipe)
    assert (panel.reflectance, panel.distance_m, panel.facing) == (0.5, 0.7, "up")
    assert recipe.sha256() != load_recipe("multispectral").sha256()
    assert "white_reference" not in load_recipe("barth2018").identity()["recipe"]


@pytest.mark.parametrize(
    ("name", "changes", "key", "problem"),
    [
        (
            "barth2018",
            {**MULTISPECTRAL, "camera.filter": "bandpass_850nm"},
            "camera.filter",
            "detects no light",
        ),
        ("multispectral", {"white_reference.reflectance": 0}, "white_reference.reflectance", "equal to 0.01"),
        ("multispectral", {"white_reference.facing": "sun"}, "white_reference.facing", "'camera' or 'up'"),
    ],
)
def test_errors_of_bands_and_their_white_reference_name_their_key(name, changes, key, problem):
    with pytest.raises(InputError) as caught:
        load_recipe(name, changes)
    assert caught.value.key == key
    assert problem in caught.value.problem

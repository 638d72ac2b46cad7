"""The published layout: its file names and codes, read by other programs and by this package."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from painted_set import FRAMES, make_painted_set
from PIL import Image

from pepperscene.dataset.readers import open_images
from pepperscene.dataset.store.images import read_image
from pepperscene.export import export_dataset
from pepperscene.truth import class_from_colour


@pytest.fixture(scope="module")
def out(painted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "out"
    return export_dataset(painted.folder, "published", folder, "train=.6,val=.4").folder


def file_names(number):
    """The published names of the images of a number."""
    grey = "synthetic_label_class_grayscale"
    every = "synthetic_label_class_all_grayscale"
    binary = {k: f"synthetic_label_class_{k}_grayscale" for k in range(1, 8)}
    masks = {k: f"{grey}/{name}_binary/{name}_{number}.png" for k, name in binary.items()}
    return {
        "colour": f"synthetic_image_color/synthetic_image_color_{number}.png",
        "grey": f"{grey}/{every}/{every}_{number}.png",
        "class_colour": f"synthetic_label_class_colorscale/synthetic_label_class_colorscale_{number}.png",
        "distance_code": f"synthetic_label_depth_grayscale/synthetic_label_depth_grayscale_{number}.png",
        **masks,
    }


def test_file_names_are_the_published_ones(out):
    expected = {name for number in range(1, len(FRAMES) + 1) for name in file_names(number).values()}
    files = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert files == expected | {"frames.csv"}


def test_images_are_those_of_the_numbered_frame(painted, out):
    with (out / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["number"]) for row in rows] == list(range(1, len(FRAMES) + 1))
    assert [int(row["index"]) for row in rows] == list(FRAMES)
    assert {int(row["set"]): row["split"] for row in rows} == {0: "train", 1: "val"}
    for row in rows:
        index, names = int(row["index"]), file_names(row["number"])
        assert (int(row["set"]) * 3 + int(row["rotation"])) * 4 + int(row["step"]) == index
        classes = painted.image(index, "class")
        for output in ("colour", "class_colour", "distance_code"):
            assert (read_image(out / names[output]) == painted.image(index, output)).all()
        assert (read_image(out / names["grey"]) == classes).all()
        masks = [read_image(out / names[k]) for k in range(1, 8)]
        assert all(mask.dtype == np.uint8 and mask.max() <= 1 for mask in masks)
        assert (sum(k * mask for k, mask in enumerate(masks, start=1)) == classes).all()


def test_images_have_grey_values_not_a_palette(out):
    for name in ("grey", 1, "distance_code"):
        with Image.open(out / file_names(1)[name]) as image:
            assert image.mode == "L"
    with Image.open(out / file_names(1)["class_colour"]) as image:
        assert image.mode == "RGB"


def test_reader_of_the_published_set_reads_the_export(tmp_path):
    # Derived outputs are not required.
    painted = make_painted_set(tmp_path / "set", ("colour", "class", "distance"), FRAMES[:2])
    out = export_dataset(painted.folder, "published", tmp_path / "out").folder
    images = open_images(out)
    assert images.names() == ("1", "2")
    for image, index in zip(images, FRAMES[:2], strict=True):
        assert (image.colour == painted.image(index, "colour")).all()
        assert (image.classes == painted.image(index, "class")).all()
        colours = read_image(out / file_names(image.name)["class_colour"])
        assert (class_from_colour(colours) == painted.image(index, "class")).all()
        # To half a step of the code, .85 cm; pixels without a distance stay without.
        expected = painted.image(index, "distance")
        hit = np.isfinite(expected)
        np.testing.assert_array_equal(np.isfinite(image.distance_m), hit)
        assert np.abs(image.distance_m[hit] - expected[hit]).max() <= 0.00425 + 1e-6

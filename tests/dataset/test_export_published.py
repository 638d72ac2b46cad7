"""The published layout: its names, its codes, and what cannot be told apart from the original."""

from __future__ import annotations

import csv
import re

import numpy as np
import pytest
from painted_set import FRAMES, make_painted_set
from PIL import Image

from pepperscene.classes import OrganClass
from pepperscene.dataset import read_image
from pepperscene.dataset.export import export_dataset
from pepperscene.truth import class_from_colour, distance_from_code


@pytest.fixture(scope="module")
def made(painted):
    return painted


@pytest.fixture(scope="module")
def out(made, tmp_path_factory):
    return export_dataset(
        made.folder, "published", tmp_path_factory.mktemp("out") / "out", "train=.6,val=.4"
    ).folder


def names(number):
    """The published names of the pictures of a number."""
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


def test_the_names_are_the_published_ones_and_there_are_no_others(out):
    wanted = {name for number in range(1, len(FRAMES) + 1) for name in names(number).values()}
    found = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert found == wanted | {"frames.csv"}


def test_every_picture_is_the_frame_of_its_number(made, out):
    with (out / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["number"]) for row in rows] == list(range(1, len(FRAMES) + 1))
    assert [int(row["index"]) for row in rows] == list(FRAMES)
    assert {int(row["set"]): row["split"] for row in rows} == {0: "train", 1: "val"}
    for row in rows:
        index, name = int(row["index"]), names(row["number"])
        assert (int(row["set"]) * 3 + int(row["rotation"])) * 4 + int(row["step"]) == index
        classes = made.image(index, "class")
        for output in ("colour", "class_colour", "distance_code"):
            assert (read_image(out / name[output]) == made.image(index, output)).all()
        assert (read_image(out / name["grey"]) == classes).all()
        masks = [read_image(out / name[k]) for k in range(1, 8)]
        assert all(mask.dtype == np.uint8 and mask.max() <= 1 for mask in masks)
        assert (sum(k * mask for k, mask in enumerate(masks, start=1)) == classes).all()


def test_other_readers_see_grey_values_and_not_a_palette(out):
    for name in ("grey", 1, "distance_code"):
        with Image.open(out / names(1)[name]) as picture:
            assert picture.mode == "L"
    with Image.open(out / names(1)["class_colour"]) as picture:
        assert picture.mode == "RGB"


def test_what_can_be_made_from_other_outputs_is_not_asked_for(tmp_path):
    plain = make_painted_set(tmp_path / "set", ("colour", "class", "distance"), FRAMES[:2])
    export_dataset(plain.folder, "published", tmp_path / "out")
    for number, index in enumerate(FRAMES[:2], start=1):
        name = names(number)
        colours = read_image(tmp_path / "out" / name["class_colour"])
        assert (class_from_colour(colours) == plain.image(index, "class")).all()
        metres = distance_from_code(read_image(tmp_path / "out" / name["distance_code"]))
        exact = plain.image(index, "distance")
        assert (np.isinf(metres) == np.isinf(exact)).all()
        hit = np.isfinite(exact)
        # Half a grey value of .85 cm.
        assert np.abs(metres[hit] - exact[hit]).max() <= 0.00426


def test_our_reader_of_the_published_set_reads_it(made, out):
    readers = pytest.importorskip("pepperscene.dataset.readers")
    images = readers.open_images(out)
    assert len(images) == len(FRAMES)
    for picture, index in zip(images, FRAMES, strict=True):
        assert re.search(r"\d+", picture.name)
        assert (picture.colour == made.image(index, "colour")).all()
        assert (picture.classes == made.image(index, "class")).all()
    assert set(np.unique(images[0].classes)) <= set(OrganClass)

"""Semantic masks: values, class tables, and what `open_images` reads."""

from __future__ import annotations

import json

import numpy as np
import pytest
from label_set import FRAMES, MAPPING, expected_name, export, fruit_truth
from PIL import Image

from pepperscene.classes import CLASS_COLOURS, IGNORE_CLASS, OrganClass
from pepperscene.dataset.readers import open_images
from pepperscene.learning.class_table import ClassTable


def read_mask(folder, index, split="train"):
    """Values and mode of a mask, by another reader than that of the package."""
    with Image.open(folder / "masks" / split / f"{index:06d}.png") as image:
        assert image.mode == "L"
        return np.asarray(image)


def read_table(folder):
    table = json.loads((folder / "classes.json").read_text())
    assert table["ignore"] == 255
    assert [one["value"] for one in table["classes"]] == list(range(len(table["classes"])))
    return table["classes"]


def check_mapping(dataset, folder):
    """Each pixel has the class of its organ by `MAPPING`, 255 if that is unknown."""
    names = [one["name"] for one in read_table(folder)]
    assert names == ["background", "ripe", "green", "stalk", "leaf"]
    for index in FRAMES:
        instance, truth = dataset.image(index, "instance"), fruit_truth(dataset, index)
        expected = np.zeros(instance.shape, np.uint8)
        for key, entry in dataset.metadata(index)["instances"].items():
            name = expected_name(entry, truth.get(int(key)))
            if name is not None:
                expected[instance == int(key)] = IGNORE_CLASS if name == "?" else names.index(name)
        assert (read_mask(folder, index) == expected).all(), "a mask differs"
        assert {*np.unique(expected)} == {0, 1, 2, 3, 4, 255}


def test_masks_have_the_classes_of_the_mapping(labels, tmp_path):
    check_mapping(labels, export(labels, "semantic", tmp_path / "out", classes=MAPPING))


def test_default_masks_are_the_class_images(labels, tmp_path):
    folder = export(labels, "semantic", tmp_path / "out", split="train=0:5,val=14:15")
    for index, split in zip(FRAMES, ("train", "train", "val"), strict=True):
        assert (read_mask(folder, index, split) == labels.image(index, "class")).all()
    table = read_table(folder)
    assert [one["name"] for one in table] == [organ.name.lower() for organ in OrganClass]
    assert [tuple(one["colour"]) for one in table] == list(CLASS_COLOURS)
    images = open_images(folder)
    assert images.names() == ("train/000000", "train/000003", "val/000014")
    for index, image in zip(FRAMES, images, strict=True):
        assert (image.colour == labels.image(index, "colour")).all()
        assert (image.classes == labels.image(index, "class")).all()


def test_mapping_with_the_background_is_a_table_of_a_network(labels, tmp_path):
    """The same text gives the same class numbers; organs in no class are ignored."""
    text = "other=background+leaf+shoot,fruit=pepper,stalk=peduncle+stem"
    folder = export(labels, "semantic", tmp_path / "out", classes=text)
    table, images = ClassTable.parse(text), open_images(folder)
    for index, image in zip(FRAMES, images, strict=True):
        expected = table.indices(labels.image(index, "class"))
        assert (read_mask(folder, index) == expected).all()
        assert (expected == 255).any()
        # What the package reads from the folder has the same classes to this network.
        assert (table.indices(image.classes) == expected).all()
    assert [one["members"] for one in read_table(folder)] == [
        ["background", "leaf", "shoot"], ["pepper"], ["peduncle", "stem"],
    ]  # fmt: skip


def test_background_of_organs_that_are_not_selected_reads_as_void(labels, tmp_path):
    folder = export(labels, "semantic", tmp_path / "out", classes="fruit=pepper")
    for index, image in zip(FRAMES, open_images(folder), strict=True):
        is_fruit = labels.image(index, "class") == OrganClass.PEPPER
        assert (read_mask(folder, index) == is_fruit).all()
        assert (image.classes == np.where(is_fruit, OrganClass.PEPPER, 255)).all()


@pytest.mark.parametrize(
    ("options", "is_kept"),
    [
        ({"smallest_px": 200}, lambda entry, _fruit, _at_border: entry["pixels"] >= 200),
        ({"least_visible": 0.6}, lambda _entry, fruit, _at_border: fruit.get("visible_fraction", 1) >= 0.6),
        ({"truncated": "drop"}, lambda _entry, fruit, at_border: not fruit.get("truncated", at_border)),
    ],
)
def test_organs_that_are_not_kept_are_ignored(options, is_kept, labels, tmp_path):
    folder = export(labels, "semantic", tmp_path / "out", **options)
    for index in FRAMES:
        instance, truth = labels.image(index, "instance"), fruit_truth(labels, index)
        border = {*instance[[0, -1]].ravel().tolist(), *instance[:, [0, -1]].ravel().tolist()}
        expected = labels.image(index, "class").copy()
        for key, entry in labels.metadata(index)["instances"].items():
            value = int(key)
            kept = is_kept(entry, truth.get(value, {}), value in border)
            if entry["class"] and entry["plant"] >= 0 and not kept:
                expected[instance == value] = 255
        assert (read_mask(folder, index) == expected).all()
        assert (expected == 255).any()
        # What belongs to no plant, such as the crop wire, stays.
        assert (expected == OrganClass.WIRE).any()

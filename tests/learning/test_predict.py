"""Class images that `predict` writes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from memory_set import MemorySet
from PIL import Image
from toy_models import ORGANS, Constant, ReadsRed, image_set, random_masks

from pepperscene.classes import CLASS_COLOURS
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.errors import InputError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable
from pepperscene.learning.evaluation.predict import predict

FRUIT = ClassTable.parse(FRUIT_CLASSES)
MASKS = random_masks(3, void=False)


def values(path):
    return np.array(Image.open(path))


def write_pictures(folder, masks=MASKS):
    folder.mkdir(parents=True)
    paths = []
    for image in image_set(*masks):
        paths.append(folder / f"{image.name}.png")
        Image.fromarray(image.colour).save(paths[-1])
    return paths


def test_predicts_a_set_in_ids_of_the_eight_classes(tmp_path):
    done = []
    result = predict(ReadsRed(), image_set(*MASKS), tmp_path / "out", on_progress=lambda *k: done.append(k))
    assert result.names == ("image0", "image1", "image2")
    assert done == [(1, 3), (2, 3), (3, 3)]
    for name, mask in zip(result.names, MASKS, strict=True):
        ids = values(tmp_path / "out" / "class" / f"{name}.png")
        assert ids.dtype == np.uint8
        np.testing.assert_array_equal(ids, mask)
        colours = values(tmp_path / "out" / "class_colour" / f"{name}.png")
        np.testing.assert_array_equal(colours, np.array(CLASS_COLOURS)[mask])
    described = json.loads((tmp_path / "out" / "classes.json").read_text())["classes"]
    assert [entry["index"] for entry in described] == list(range(8))
    assert [entry["name"] for entry in described] == list(ORGANS.names)
    assert [tuple(entry["colour"]) for entry in described] == list(CLASS_COLOURS)


def test_ids_do_not_depend_on_the_order_of_the_eight_classes(tmp_path):
    table = ClassTable(ORGANS.names[::-1], ORGANS.members[::-1])
    predict(ReadsRed(table), image_set(MASKS[0]), tmp_path / "out")
    np.testing.assert_array_equal(values(tmp_path / "out" / "class" / "image0.png"), MASKS[0])


def test_other_classes_are_indices(tmp_path):
    predict(ReadsRed(), image_set(MASKS[0]), tmp_path / "out", classes=FRUIT)
    expected = FRUIT.indices(MASKS[0])
    np.testing.assert_array_equal(values(tmp_path / "out" / "class" / "image0.png"), expected)
    described = json.loads((tmp_path / "out" / "classes.json").read_text())["classes"]
    assert [(entry["index"], entry["name"]) for entry in described] == [
        (0, "other"), (1, "fruit"), (2, "peduncle"),
    ]  # fmt: skip
    assert described[0]["members"] == [0, 1, 4, 5, 6, 7]


def test_predicts_folders_and_pictures(tmp_path):
    first = write_pictures(tmp_path / "a")
    (tmp_path / "b" / "images").mkdir(parents=True)
    first[2].rename(tmp_path / "b" / "images" / "third.png")
    result = predict(ReadsRed(), [first[0], tmp_path / "b"], tmp_path / "out")
    assert result.names == ("image0", "third")
    np.testing.assert_array_equal(values(tmp_path / "out" / "class" / "third.png"), MASKS[2])
    # Earlier predictions are replaced.
    predict(Constant((1, 0, 0, 0, 0, 0, 0, 0)), first[0], tmp_path / "out")
    assert not values(tmp_path / "out" / "class" / "image0.png").any()


def test_rejects_what_cannot_be_predicted(tmp_path):
    path, out = write_pictures(tmp_path / "a")[0], tmp_path / "out"
    write_pictures(tmp_path / "b")
    content = path.read_bytes()
    blind = MemorySet(name="blind", items=(LabelledImage("a", None, MASKS[0]),))
    for images, message in (
        ([tmp_path / "a", tmp_path / "b"], "b: holds a second image with the name image0"),
        (tmp_path / "missing.png", "missing.png: must be a folder of images or a picture"),
        ([], "images: must hold at least one image"),
        (blind, "blind: a has no colours"),
    ):
        with pytest.raises(InputError, match=message):
            predict(ReadsRed(), images, out)
    assert not out.exists()
    for broken, source in ((content[: len(content) // 2], path), (b"no picture", tmp_path / "a")):
        path.write_bytes(broken)
        with pytest.raises(InputError, match=r"image0.png: cannot be read as an image"):
            predict(ReadsRed(), source, out)
    assert not (out / "classes.json").exists()

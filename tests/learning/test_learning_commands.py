"""The commands `evaluate` and `predict`, with a model that a test defines in place of a trained one."""

from __future__ import annotations

import importlib.util
import json

import numpy as np
import pytest
from commands import rejected, run
from PIL import Image
from toy_models import ReadsRed, image_set, random_masks

from pepperscene.errors import InputError
from pepperscene.learning.class_table import FRUIT_CLASSES

MASKS = random_masks(4)


@pytest.fixture
def command(monkeypatch):
    """Function that runs a command line; `load_model` gives a model that reads its file's name only."""

    def load_model(path, **_):
        if path.name != "model":
            raise InputError(path, "is not a trained model")
        return ReadsRed()

    monkeypatch.setattr("pepperscene.learning.models.trained_model.load_model", load_model)
    monkeypatch.setattr("pepperscene.cli.learning.require_torch", lambda: None)
    return run


def write_set(folder, masks=MASKS, offset=0):
    """A folder of images and masks, whose values are the class ids plus an offset."""
    folder.mkdir(parents=True)
    for image in image_set(*masks):
        Image.fromarray(image.colour).save(folder / f"{image.name}.png")
        if image.classes is not None:
            Image.fromarray(image.classes + np.uint8(offset)).save(folder / f"{image.name}_mask.png")
    return folder


@pytest.fixture
def photos(tmp_path):
    return write_set(tmp_path / "photos")


def test_evaluate_prints_tables_or_json_and_writes_files(command, photos, tmp_path):
    result = command("evaluate", "model", photos, "--labels", "published", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "IoU: photos, 4 of 4 images" in result.stdout
    assert "mean        100.0 [100.0, 100.0]" in result.stdout
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"evaluation.html", "evaluation.json"}
    options = ("--labels", "published", "--classes", FRUIT_CLASSES, "--limit", 2, "--json")
    result = command("evaluate", "model", photos, *options)
    content = json.loads(result.stdout)
    assert [entry["name"] for entry in content["classes"]] == ["other", "fruit", "peduncle"]
    assert content["sets"] == [{"name": "photos", "available": 4, "evaluated": 2, "unlabelled": 0}]


def test_labels_apply_to_the_sets_that_need_them(command, photos, tmp_path):
    other = write_set(tmp_path / "other", [np.minimum(mask, 3) for mask in MASKS[:2]], offset=10)
    table = {10: "background", 11: "leaf", 12: "pepper", 13: "peduncle"}
    (other / "classes.toml").write_text("\n".join(f'{value} = "{name}"' for value, name in table.items()))
    result = command("evaluate", "model", photos, other, "--labels", "published", "--json")
    assert result.exit_code == 0, result.output
    assert [item["name"] for item in json.loads(result.stdout)["sets"]] == ["photos", "other"]
    assert json.loads(result.stdout)["mean_iou"]["value"] == 1
    assert "has values" in rejected("evaluate", "model", photos)
    error = rejected("evaluate", "model", other, "--half", "empirical")
    assert "--half: applies only to the published" in error


def test_predict_writes_class_images(command, photos, tmp_path):
    result = command("predict", "model", photos, "--out", tmp_path / "out", "--classes", FRUIT_CLASSES)
    assert result.exit_code == 0, result.output
    assert result.stdout == f"4 images predicted: {tmp_path / 'out'}\n"
    assert len(list((tmp_path / "out" / "class").iterdir())) == 4


def test_rejects_wrong_input_in_one_sentence(command, photos, tmp_path):
    labels, out = ("--labels", "published"), ("--out", tmp_path / "out")
    (tmp_path / "file").write_text("")
    for message, *arguments in (
        ("weights: is not a trained model", "evaluate", "weights", photos, *labels),
        ("nowhere: must be a folder of images", "evaluate", "model", "nowhere"),
        ("--labels: must be a table or one of", "evaluate", "model", photos, "--labels", "voc"),
        ("'apple' is none of background", "evaluate", "model", photos, "--classes", "apple,leaf"),
        ("--classes: there must be two classes", "predict", "model", photos, *out, "--classes", "leaf"),
        ("file: is not a folder", "evaluate", "model", photos, *labels, "--out", tmp_path / "file"),
        ("photos: holds 'image0.png'", "predict", "model", photos, "--out", photos),
    ):
        assert message in rejected(*arguments)
    (photos / "image0.png").write_bytes(b"\x89PNG")
    assert "image0.png: cannot be read as an image" in rejected("evaluate", "model", photos, *labels)


def test_says_how_to_install_torch(monkeypatch, photos):
    find = importlib.util.find_spec
    without = lambda name, *a: None if name == "torch" else find(name, *a)  # noqa: E731
    monkeypatch.setattr(importlib.util, "find_spec", without)
    message = "error: torch is not installed; install it with `pip install 'pepperscene[learn]'`\n"
    assert rejected("evaluate", "model", photos, "--labels", "published") == message

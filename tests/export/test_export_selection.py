"""Choosing the objects of an export: classes, visibility, ripeness; and the name of the crop."""

from __future__ import annotations

import json

import numpy as np
import pytest
from painted_set import SIZE, make_painted_set

from pepperscene.classes import OrganClass
from pepperscene.dataset.selection import Selection, parse_categories
from pepperscene.dataset.store.crop import crop_name
from pepperscene.dataset.store.images import read_image
from pepperscene.errors import ArgumentError, InputError
from pepperscene.export import FORMATS, export_dataset
from pepperscene.export.run import _fruit_without_label

pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")
pytest.importorskip("cv2")


def coco_of(dataset, folder, **options):
    out = export_dataset(dataset.folder, "coco", folder, **options).folder
    return out, json.loads((out / "annotations" / "instances_train.json").read_text())


def yolo_of(dataset, folder, **options):
    """The lines of the label files by frame, and the names of the classes."""
    out = export_dataset(dataset.folder, "yolo", folder, **options).folder
    lines = {int(p.stem): p.read_text().splitlines() for p in (out / "labels" / "train").iterdir()}
    names = (out / "data.yaml").read_text().partition("names:\n")[2].splitlines()
    return lines, [name.partition(": ")[2] for name in names]


def organs(dataset, index, *classes):
    entries = dataset.metadata(index)["instances"].items()
    return {int(key): entry for key, entry in entries if entry["class"] in classes and entry["plant"] >= 0}


def test_yolo_numbers_follow_the_order_of_the_classes(painted, tmp_path):
    whole, all_names = yolo_of(painted, tmp_path / "all")
    assert all_names == [organ.name.lower() for organ in OrganClass if organ]
    lines, names = yolo_of(painted, tmp_path / "some", classes="stem,pepper")
    assert names == ["stem", "pepper"]
    number = {str(OrganClass.STEM - 1): "0", str(OrganClass.PEPPER - 1): "1"}
    for index, texts in whole.items():
        pairs = [line.partition(" ")[::2] for line in texts]
        assert lines[index] == [f"{number[key]} {rest}" for key, rest in pairs if key in number]
        assert lines[index]


def test_coco_holds_the_chosen_classes_only_and_panoptic_images_stay_complete(painted, tmp_path):
    out, content = coco_of(painted, tmp_path / "coco", classes="pepper,leaf")
    assert [(one["id"], one["name"]) for one in content["categories"]] == [(2, "pepper"), (1, "leaf")]
    assert {one["category_id"] for one in content["annotations"]} == {1, 2}
    panoptic = json.loads((out / "annotations" / "panoptic_train.json").read_text())
    for record in panoptic["annotations"]:
        image = read_image(out / "annotations" / "panoptic_train" / record["file_name"]).astype(np.uint32)
        ids = image @ np.array([1, 256, 65536], np.uint32)
        areas = {one["id"]: one["area"] for one in record["segments_info"]}
        assert areas == dict(
            zip(*(part.tolist() for part in np.unique(ids, return_counts=True)), strict=True)
        )
        assert sum(areas.values()) == SIZE[0] * SIZE[1]


def test_hidden_fruit_is_a_crowd_in_coco_and_left_out_in_yolo(painted, tmp_path):
    _, content = coco_of(painted, tmp_path / "coco", classes="pepper", least_visible=0.6)
    lines, _ = yolo_of(painted, tmp_path / "yolo", classes="pepper", least_visible=0.6, smallest_px=1)
    hidden_pixels = 0
    for index in painted.indices():
        truth = {one["instance"]: one for one in painted.image(index, "harvest")["fruit"]}
        expected = {value for value, one in truth.items() if one["visible_fraction"] >= 0.6}
        assert 0 < len(expected) < len(truth)
        records = [one for one in content["annotations"] if one["image_id"] == index]
        objects = {one["attributes"]["instance"] for one in records if not one["iscrowd"]}
        assert objects == expected
        hidden = organs(painted, index, OrganClass.PEPPER).keys() - expected
        area = sum(organs(painted, index, OrganClass.PEPPER)[value]["pixels"] for value in hidden)
        assert sum(one["area"] for one in records if one["iscrowd"]) == area
        hidden_pixels += area
        assert len(lines[index]) >= len(expected)
    assert hidden_pixels > 0


@pytest.mark.parametrize(
    ("format_name", "classes", "greenhouse", "is_warned"),
    [
        ("yolo_detect", "pepper.ripe", {"far_rows": 2, "far_rows_as": "labels"}, True),
        ("yolo", "pepper.ripe,leaf", {"far_rows": 1, "far_rows_as": "labels"}, True),
        ("yolo_detect", "pepper", {"far_rows": 2, "far_rows_as": "labels"}, False),
        ("yolo_detect", "pepper.ripe", {"far_rows": 2, "far_rows_as": "background"}, False),
        ("yolo_detect", "pepper.ripe", {"far_rows": 0, "far_rows_as": "labels"}, False),
        ("yolo_detect", "pepper.ripe", None, False),
        ("coco", "pepper.ripe", {"far_rows": 2, "far_rows_as": "labels"}, False),
    ],
)
def test_yolo_warns_of_far_fruit_of_unknown_ripeness(format_name, classes, greenhouse, is_warned):
    info = {"recipe": {"greenhouse": greenhouse}}
    warning = _fruit_without_label(FORMATS[format_name], Selection(parse_categories(classes)), info)
    assert ("ripeness is not known" in warning) == is_warned


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"classes": "fruit"}, "'fruit' is none of leaf, pepper"),
        ({"least_visible": 1.5}, "least_visible: 1.5 must be 0 to 1"),
        ({"ripe_from": -0.1}, "ripe_from: -0.1 must be 0 to 1"),
    ],
)
def test_wrong_choices_are_refused_and_write_nothing(painted, tmp_path, options, message):
    with pytest.raises(ArgumentError, match=message):
        export_dataset(painted.folder, "coco", tmp_path / "out", **options)
    assert list(tmp_path.iterdir()) == []


def test_ripeness_needs_the_harvest_truth(tmp_path):
    dataset = make_painted_set(tmp_path / "set", ("colour", "instance"), (0,))
    with pytest.raises(InputError, match="no output 'harvest'"):
        export_dataset(dataset.folder, "coco", tmp_path / "out", ripe_from=0.5)


@pytest.mark.parametrize(
    ("cultivar", "name"),
    [
        ("kaite", "sweet pepper"),
        ("red_blocky", "sweet pepper"),
        ("tomato", "Solanum lycopersicum"),
        ("cucumber", "Cucumis sativus"),
        ("cucumber_of_mine", "cucumber_of_mine"),
        ("../plants/tomato", "../plants/tomato"),
    ],
)
def test_the_crop_has_the_name_of_its_species(cultivar, name):
    assert crop_name({"recipe": {"cultivar": cultivar}}) == name


@pytest.mark.parametrize(
    ("recipe", "name"),
    [
        (
            {"variation": {"cultivar": {"in_turn": ["kaite", "tomato"]}}},
            "sweet pepper and Solanum lycopersicum",
        ),
        ({"variation": {"cultivar": {"outcomes": [["kaite", 0.5], ["red_blocky", 0.5]]}}}, "sweet pepper"),
        ({"twins": {"cultivar": ["tomato", "kaite"]}}, "Solanum lycopersicum and sweet pepper"),
    ],
)
def test_varied_cultivars_name_all_crops(recipe, name):
    assert crop_name({"recipe": {"cultivar": "kaite", **recipe}}) == name

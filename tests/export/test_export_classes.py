"""Classes of an export: chosen, merged, renamed, divided by ripeness; organs at the image border; crops."""

from __future__ import annotations

import numpy as np
import pytest
from label_set import (
    FRAMES,
    MAPPING,
    NAMES,
    edit_json,
    expected_name,
    expected_objects,
    export,
    fruit_truth,
    load_coco,
    read_yolo,
)
from typer.testing import CliRunner

from pepperscene.classes import OrganClass, parse_class_mapping
from pepperscene.cli import app
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.selection import Selection, parse_categories
from pepperscene.dataset.store.recorded_values import crop_name, fruit_name
from pepperscene.errors import ArgumentError, InputError
from pepperscene.export import FORMATS
from pepperscene.export.run import _fruit_without_label
from pepperscene.learning.class_table import ClassTable

mask_tools = pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def test_coco_has_the_classes_of_the_mapping(labels, tmp_path):
    content = load_coco(export(labels, "coco", tmp_path / "out", classes=MAPPING))
    names = {one["id"]: one["name"] for one in content["categories"]}
    assert list(names.items()) == list(zip((2, 8, 3, 1), NAMES, strict=True))
    for index in labels.indices():
        records = [one for one in content["annotations"] if one["image_id"] == index]
        objects = {one["attributes"]["instance"]: one for one in records if not one["iscrowd"]}
        expected = expected_objects(labels, index)
        assert objects.keys() == expected.keys()
        for value, (name, mask) in expected.items():
            found = mask_tools.decode(objects[value]["segmentation"]).astype(bool)
            assert (found == mask).all(), f"the mask of {value}"
            assert names[objects[value]["category_id"]] == name, f"the class of {value}"


def test_fruit_of_unknown_ripeness_is_a_crowd_and_void(labels, tmp_path):
    folder = export(labels, "coco", tmp_path / "out", classes="ripe=pepper.ripe")
    content = load_coco(folder)
    panoptic = load_coco(folder, "panoptic")
    for index, record in zip(FRAMES, panoptic["annotations"], strict=True):
        instance, truth = labels.image(index, "instance"), fruit_truth(labels, index)
        entries = {int(key): one for key, one in labels.metadata(index)["instances"].items()}
        names = {value: expected_name(one, truth.get(value)) for value, one in entries.items()}
        unknown = np.isin(instance, [value for value, name in names.items() if name == "?"])
        assert unknown.any()
        (crowd,) = [one for one in content["annotations"] if one["image_id"] == index and one["iscrowd"]]
        assert (mask_tools.decode(crowd["segmentation"]).astype(bool) == unknown).all()
        # Unripe fruit is known to be none of the class: background.
        ids = {one["id"] for one in record["segments_info"]}
        assert ids - {65536} == {value for value, name in names.items() if name == "ripe"}
        assert sum(one["area"] for one in record["segments_info"]) == np.count_nonzero(~unknown)


def test_rests_of_a_merged_class_are_one_segment(labels, tmp_path):
    """A reader of panoptic segments keeps one crowd of each category."""
    folder = export(labels, "coco", tmp_path / "out", classes="stalk=peduncle+stem", smallest_px=10_000)
    panoptic = load_coco(folder, "panoptic")
    for record in panoptic["annotations"]:
        assert [(one["id"], one["category_id"]) for one in record["segments_info"]] == [
            (65536, 0),
            (65536 + OrganClass.PEDUNCLE, 3),
        ]


@pytest.mark.parametrize(
    ("classes", "fruit", "organs"),
    [
        ("a=pepper.unripe+peduncle,b=pepper.ripe+leaf", {"ripe", "green", "?"}, {"a": 3, "b": 1}),
        ("a=pepper.ripe+peduncle,b=leaf", {"ripe", "?"}, {"a": 3, "b": 1}),
    ],
)
def test_crowds_of_merged_and_divided_classes(classes, fruit, organs, labels, tmp_path):
    """Without objects, a crowd of each category covers all that may be of it; ids are unique."""
    content = load_coco(export(labels, "coco", tmp_path / "out", classes=classes, smallest_px=10_000))
    ids = [one["id"] for one in content["annotations"]]
    assert len(set(ids)) == len(ids) > 0
    names = {one["id"]: one["name"] for one in content["categories"]}
    for index in FRAMES:
        instance, truth = labels.image(index, "instance"), fruit_truth(labels, index)
        entries = {int(key): one for key, one in labels.metadata(index)["instances"].items()}
        for name, organ in organs.items():
            # Fruit of a category that has none is left out: b in the second mapping.
            is_fruity = f"{name}=pepper" in classes
            expected = [
                value
                for value, one in entries.items()
                if one["class"] == organ
                or (is_fruity and one["class"] == 2 and expected_name(one, truth.get(value)) in fruit)
            ]
            masks = [
                mask_tools.decode(one["segmentation"]).astype(bool)
                for one in content["annotations"]
                if one["image_id"] == index and names[one["category_id"]] == name
            ]
            assert (np.any(masks, axis=0) == np.isin(instance, expected)).all()


def test_ripeness_divides_at_the_given_value(labels, tmp_path):
    content = load_coco(export(labels, "coco", tmp_path / "out", classes=MAPPING, ripe_from=0.9))
    names = {one["id"]: one["name"] for one in content["categories"]}
    for index in FRAMES:
        expected = {k: name for k, (name, _) in expected_objects(labels, index, ripe_from=0.9).items()}
        found = {
            one["attributes"]["instance"]: names[one["category_id"]]
            for one in content["annotations"]
            if one["image_id"] == index and not one["iscrowd"]
        }
        assert found == expected


def test_hidden_fruit_is_a_crowd_in_coco_and_left_out_in_yolo(painted, tmp_path):
    options = {"classes": "pepper", "least_visible": 0.6, "smallest_px": 1}
    content = load_coco(export(painted, "coco", tmp_path / "coco", **options))
    yolo = export(painted, "yolo_detect", tmp_path / "yolo", **options)
    hidden_pixels = 0
    for index in painted.indices():
        truth = {one["instance"]: one for one in painted.image(index, "harvest")["fruit"]}
        expected = {value for value, one in truth.items() if one["visible_fraction"] >= 0.6}
        assert 0 < len(expected) < len(truth)
        records = [one for one in content["annotations"] if one["image_id"] == index]
        objects = {one["attributes"]["instance"] for one in records if not one["iscrowd"]}
        assert objects == expected
        fruit = {
            int(key): entry["pixels"]
            for key, entry in painted.metadata(index)["instances"].items()
            if entry["class"] == OrganClass.PEPPER
        }
        area = sum(pixels for value, pixels in fruit.items() if value not in expected)
        assert sum(one["area"] for one in records if one["iscrowd"]) == area
        hidden_pixels += area
        assert len(read_yolo(yolo / f"labels/train/{index:06d}.txt")) == len(expected)
    assert hidden_pixels > 0


def test_dropped_organs_are_those_that_the_border_may_cut(labels, tmp_path):
    content = load_coco(export(labels, "coco", tmp_path / "out", truncated="drop", smallest_px=1))
    truncated = 0
    for index in FRAMES:
        instance, truth = labels.image(index, "instance"), fruit_truth(labels, index)
        border = {*instance[[0, -1]].ravel().tolist(), *instance[:, [0, -1]].ravel().tolist()}
        kept = set()
        for key, entry in labels.metadata(index)["instances"].items():
            value = int(key)
            cut = truth[value]["truncated"] if value in truth else value in border
            if entry["class"] and entry["plant"] >= 0 and not cut:
                kept.add(value)
        assert len(kept) > 100
        records = [one for one in content["annotations"] if one["image_id"] == index]
        assert {one["attributes"]["instance"] for one in records if not one["iscrowd"]} == kept
        truncated += sum(one["truncated"] for one in truth.values())
    assert truncated


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


def test_ripeness_needs_the_harvest_truth(labels, copied, tmp_path):
    dataset = copied(labels)
    (dataset.folder / "harvest" / f"{FRAMES[1]:06d}.json").unlink()
    with pytest.raises(InputError, match="no output 'harvest'"):
        export(dataset, "coco", tmp_path / "out", ripe_from=0.5)


# Names of the crop and its fruit.


def test_fruit_has_the_name_of_its_crop(labels, copied, tmp_path):
    dataset = copied(labels)
    edit_json(dataset.folder / "dataset.json", lambda info: info["recipe"].update(cultivar="tomato"))
    content = load_coco(export(dataset, "coco", tmp_path / "whole"))
    names = [one["name"] for one in content["categories"]]
    assert names == ["leaf", "tomato", "peduncle", "stem", "shoot", "wire", "cut"]
    assert {one["supercategory"] for one in content["categories"]} == {"Solanum lycopersicum"}
    options = {"classes": "pepper,mine=leaf", "ripe_from": 0.5}
    content = load_coco(export(dataset, "coco", tmp_path / "divided", **options))
    assert [one["name"] for one in content["categories"]] == ["ripe tomato", "unripe tomato", "mine"]
    # The reader knows these names.
    images = open_images(tmp_path / "whole")
    assert (images[0].classes == dataset.image(FRAMES[0], "class")).all()


@pytest.mark.parametrize(
    ("recipe", "crop", "fruit"),
    [
        ({}, "sweet pepper", "pepper"),
        ({"cultivar": "red_blocky"}, "sweet pepper", "pepper"),
        ({"cultivar": "tomato"}, "Solanum lycopersicum", "tomato"),
        ({"cultivar": "cucumber"}, "Cucumis sativus", "cucumber"),
        ({"cultivar": "eggplant"}, "Solanum melongena", "eggplant"),
        ({"cultivar": "cucumber_of_mine"}, "cucumber_of_mine", "fruit"),
        ({"cultivar": "../plants/tomato"}, "../plants/tomato", "fruit"),
        ({"twins": {"cultivar": ["tomato", "kaite"]}}, "Solanum lycopersicum and sweet pepper", "fruit"),
        ({"twins": {"cultivar": ["red_blocky"]}}, "sweet pepper", "pepper"),
        (
            {"variation": {"cultivar": {"in_turn": ["kaite", "tomato"]}}},
            "sweet pepper and Solanum lycopersicum",
            "fruit",
        ),
        (
            {"variation": {"cultivar": {"outcomes": [["kaite", 0.5], ["red_blocky", 0.5]]}}},
            "sweet pepper",
            "pepper",
        ),
    ],
)
def test_crops_are_named_by_their_cultivars(recipe, crop, fruit):
    info = {"recipe": {"cultivar": "kaite", **recipe}}
    assert (crop_name(info), fruit_name(info)) == (crop, fruit)


# The notation of classes.


def test_one_notation_for_classes_of_exports_and_networks():
    text = "other=background+leaf,fruit=pepper,peduncle"
    table = ClassTable.parse(text)
    categories = parse_categories(text, background=True)
    assert tuple(one.name for one in categories) == table.names == ("other", "fruit", "peduncle")
    assert [{part for part in one.parts if part < 8} for one in categories] == [
        set(ids) for ids in table.members
    ]
    assert parse_class_mapping(" a = x + y ,z", ("x", "y", "z")) == (("a", ("x", "y")), ("", ("z",)))


WRONG = [
    ("fruit=apple", "'apple' is none of leaf, pepper, peduncle, stem, shoot, wire, cut, pepper.ripe"),
    ("fruit", "'fruit' is none of leaf"),
    ("", "a class is named in lower-case letters, digits and _, not ''"),
    ("Fruit=pepper", "a class is named in lower-case letters, digits and _, not 'Fruit'"),
    ("a=leaf,b=leaf", "leaf is named twice"),
    ("a=leaf+leaf", "leaf is named twice"),
    ("a=leaf,a=stem", "the class a is named twice"),
    ("pepper,green=pepper.unripe", "pepper is named twice, as a whole and divided by ripeness"),
    ("a=pepper.ripe,b=pepper.ripe", "pepper.ripe is named twice"),
    ("other=background+leaf", "'background' is none of leaf"),
    ("background=leaf", "background is the name of all that is in no class; choose another"),
    ("ripe=leaf,a=stem,ripe=cut", "the class ripe is named twice"),
    ("a=leaf=stem", "'leaf=stem' is none of leaf"),
    ("a=leaf+", "'' is none of leaf"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_wrong_mappings_are_refused_in_one_sentence(text, message):
    with pytest.raises(ArgumentError) as caught:
        parse_categories(text)
    assert str(caught.value).startswith(f"classes: {message}")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--truncated", "cut"), "--truncated: 'cut' must be keep or drop"),
        (("--ripe", ".5", "--classes", "leaf"), "--ripe: needs pepper as a class of its own"),
        (("--ripe", ".5", "--classes", "a=pepper+leaf"), "--ripe: needs pepper as a class of its own"),
    ],
)
def test_wrong_options_give_one_sentence_and_exit_code_2(options, message, labels, tmp_path):
    done = CliRunner().invoke(
        app, ["export", str(labels.folder), "--format", "yolo", "--out", str(tmp_path / "out"), *options]
    )
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"error: {message}")

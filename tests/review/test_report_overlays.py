"""Labels that a report draws over its photographs: they are those of the frames, and the page stays small."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib import resources

import numpy as np
import pytest
from data_sets import RandomImages
from report_page import Page
from scipy import ndimage

from pepperscene.classes import CLASS_COLOURS, IGNORE_CLASS, OrganClass
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.review.report import write_report
from pepperscene.review.report.colours import instance_colours
from pepperscene.review.report.image_view import image_view, make_card, max_image_length
from pepperscene.review.report.label_regions import pack, packed_labels, unpack

SCRIPTS = ("overlays.js", "page.js", "scene.js")
LARGEST_PAGE = 15_000_000


@pytest.fixture(scope="module")
def page(painted, tmp_path_factory):
    folder = shutil.copytree(painted.folder, tmp_path_factory.mktemp("overlays") / "set")
    return Page(write_report(folder).page)


@pytest.fixture(scope="module")
def labels(page):
    """The labels of each card by the index of its frame."""
    return {int(card["id"][2:]): unpack(card["data-labels"]) for card in page.of("article")}


def region_image(labels):
    """`(h, w)` number of the region at each pixel."""
    shape = [-(-labels[side] // labels["step"]) for side in ("height", "width")]
    return np.repeat(labels["regions"], labels["lengths"]).reshape(shape)


def blobs(height=600, width=800, organs=500):
    """A photograph of noise with compact organs and a harvest, as hard to compress as a frame."""
    rng = np.random.default_rng(7)
    seeds = np.zeros((height, width), np.uint16)
    seeds[rng.integers(height, size=organs), rng.integers(width, size=organs)] = 1 + np.arange(organs)
    nearest = ndimage.distance_transform_edt(seeds == 0, return_distances=False, return_indices=True)
    instances = seeds[tuple(nearest)]
    colour = rng.normal(60, 25, (height, width, 3)).clip(0, 255).astype(np.uint8)
    distance = (0.3 + instances / organs + rng.normal(0, 0.02, seeds.shape)).astype(np.float32)
    return LabelledImage("blobs", colour, (instances % 8).astype(np.uint8), instances, distance)


def test_labels_and_boxes_are_those_of_the_frames(painted, labels):
    assert sorted(labels) == list(painted.indices())
    for index, content in labels.items():
        region, instance = region_image(content), painted.image(index, "instance")
        np.testing.assert_array_equal(np.array(content["classes"])[region], painted.image(index, "class"))
        np.testing.assert_array_equal(np.array(content["instances"])[region], instance)
        assert content["step"] == 1
        assert sum(box is not None for box in content["boxes"]) == np.count_nonzero(np.unique(instance))
        for number, box in zip(content["instances"], content["boxes"], strict=True):
            rows, columns = np.nonzero(instance == number)
            visible = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            assert box == (visible if number else None)


def test_keypoints_are_those_of_the_harvest(painted, labels):
    for index, content in labels.items():
        expected = []
        for fruit in painted.image(index, "harvest")["fruit"]:
            cut = fruit["peduncle"] and fruit["peduncle"]["cut"]
            points = [
                [0, 0, 0] if point is None or point["px"] is None else [*point["px"], 1 + point["visible"]]
                for point in (cut, fruit["stalk_end"], fruit["blossom_end"])
            ]
            expected += [points] if np.any(points) else []
        assert len(content["keypoints"]) == len(expected) > 5
        np.testing.assert_allclose(content["keypoints"], expected, atol=0.051)


def test_colours_are_those_of_the_contact_sheet(painted, labels):
    index, content = next(iter(labels.items()))
    codes = np.array(content["colours"])[region_image(content)]
    rgb = np.stack([codes >> 16, codes >> 8 & 0xFF, codes & 0xFF], axis=-1)
    np.testing.assert_array_equal(rgb, instance_colours(painted.image(index, "instance")))


def test_switches_name_every_class_in_its_colour(page):
    switches = page.of("input", name="class")
    assert [(int(one["value"]), one["data-name"]) for one in switches] == [
        (int(organ), organ.name.lower()) for organ in OrganClass
    ]
    for switch, colour in zip(switches, CLASS_COLOURS, strict=True):
        assert tuple(int(switch["data-colour"]).to_bytes(3, "big")) == colour
    keys = [attrs["aria-keyshortcuts"] for _, attrs in page.elements if "aria-keyshortcuts" in attrs]
    assert len(keys) == len(set(keys)) == 4 + len(OrganClass) + 1


def test_photographs_have_overlays_and_other_images_none(page):
    assert len(page.of("canvas", **{"class": "overlay"})) == len(page.of("img", **{"class": "colour"})) + 1


def test_images_without_labels_have_neither_data_nor_switches(painted, tmp_path):
    folder = shutil.copytree(painted.folder, tmp_path / "set")
    photographs = RandomImages(name="photographs", items=(1,)).select("colour")
    both = Page(write_report(folder, 1, photographs).page)
    assert ["data-labels" in card for card in both.of("article")] == [True, False]
    for path in folder.glob("frames/*.json"):
        content = json.loads(path.read_text(encoding="utf-8"))
        content["outputs"] = {"colour": content["outputs"]["colour"]}
        path.write_text(json.dumps(content), encoding="utf-8")
    bare = Page(write_report(folder, 1).page)
    assert not bare.of("div", id="overlays")
    assert not [attrs for attrs in bare.of("article") if "data-labels" in attrs]


@pytest.mark.parametrize("missing", ["classes", "instances"])
def test_one_kind_of_labels_is_enough(missing):
    image = next(iter(RandomImages(name="random", items=(0,))))
    instances = image.classes.astype(np.uint16)
    labels = {"classes": image.classes, "instances": instances, missing: None}
    content = unpack(packed_labels(LabelledImage("one", image.colour, **labels)))
    if missing == "classes":
        assert set(content["classes"]) == {IGNORE_CLASS}
        assert content["boxes"] == [[0, 0, 40, 15], [0, 15, 40, 30]]
    else:
        assert content["classes"] == [2, IGNORE_CLASS]
        assert content["boxes"] == [None, None]
    assert packed_labels(image.__class__("none", image.colour, None)) is None


def test_short_labels_leave_out_rows_and_columns_but_not_boxes():
    image = blobs()
    whole = packed_labels(image)
    part = packed_labels(image, len(whole) // 2)
    content, complete = unpack(part), unpack(whole)
    assert len(part) <= len(whole) // 2
    assert content["step"] > 1
    assert content["boxes"] == complete["boxes"]
    step = content["step"]
    np.testing.assert_array_equal(region_image(content), region_image(complete)[::step, ::step])


@pytest.mark.parametrize("images", [100, 200])
def test_cards_of_a_page_fit_into_it(images):
    limit = max_image_length(images)
    card = make_card(image_view(blobs(), 0.3, 1.3, limit), "a")
    # The rest is statistics and the 3D view.
    length = len(card.labels) + sum(len(picture.uri) for picture in card.pictures)
    assert images * (length + 3000) < LARGEST_PAGE - 2_500_000
    if images == 100:
        assert unpack(card.labels)["step"] == 1


def test_packed_values_are_read_again_or_refused():
    for value in ([], {"a": [1, 2.5, None, "é"], "b": {"c": True}}):
        assert unpack(pack(value)) == value
    with pytest.raises(ValueError, match="JSON"):
        pack([float("nan")])


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no Node.js on this machine")
def test_scripts_are_valid_javascript(tmp_path):
    folder = resources.files("pepperscene.review.report") / "templates"
    script = tmp_path / "all.js"
    script.write_text("\n".join(folder.joinpath(name).read_text("utf-8") for name in SCRIPTS), "utf-8")
    done = subprocess.run(["node", "--check", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

"""Amodal masks of all organs in a data set: readers, checks, and exports."""

from __future__ import annotations

import hashlib
import json
import shutil

import numpy as np
import pytest
from painted_set import ALL, Painter, make_painted_set

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.store.frame_json import checksum_of
from pepperscene.errors import InputError
from pepperscene.export import export_dataset
from pepperscene.review.check import check_dataset
from pepperscene.truth.encodings import decode_rle

mask_tools = pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
FRAMES = (0, 3)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "set"
    return make_painted_set(folder, (*ALL, "amodal"), FRAMES, Painter)


def organs_of(dataset, index):
    return {entry["instance"]: entry for entry in dataset.image(index, "amodal")["organs"]}


def change(folder, edit, output="amodal", index=0):
    """Edit a JSON output of a frame, and its entry in the frame's JSON."""
    path, frame_path = folder / output / f"{index:06d}.json", folder / "frames" / f"{index:06d}.json"
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))
    frame = json.loads(frame_path.read_text())
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    frame["outputs"][output] |= {"bytes": path.stat().st_size, "sha256": digest}
    frame_path.write_text(json.dumps({**frame, "checksum": checksum_of(frame)}))


# Readers.


def test_images_have_them_in_their_metadata(dataset):
    assert not [file for _, file in findings_of(dataset.folder) if file.startswith("amodal")]
    for index, image in zip(FRAMES, open_images(dataset.folder), strict=True):
        organs = image.metadata["amodal"]["organs"]
        assert len(organs) > 200
        for entry in organs[::20]:
            mask = decode_rle(entry["amodal"])
            assert mask[image.instances == entry["instance"]].all()
            assert mask.sum() == entry["amodal_pixels"]
        assert image.metadata["amodal"] == dataset.image(index, "amodal")


@pytest.mark.parametrize(
    ("edit", "problem"),
    [
        (lambda content: content["organs"][3].pop("amodal"), r"organs\.3\.amodal"),
        (lambda content: content["organs"][1]["amodal"]["counts"].append(1), "must have counts that sum to"),
        (lambda content: content["organs"][0].update(instance=0), r"organs\.0\.instance"),
        (lambda content: content.pop("organs"), "organs"),
    ],
)
def test_damaged_ones_are_input_errors(edit, problem, dataset, tmp_path):
    folder = shutil.copytree(dataset.folder, tmp_path / "set")
    change(folder, edit)
    with pytest.raises(InputError, match=problem):
        open_images(folder)[0]


# Checks.


def findings_of(folder):
    return {(one.kind, one.file): one.problem for one in check_dataset(folder).findings}


@pytest.mark.parametrize(
    ("edit", "kind", "problem"),
    [
        (lambda content: content["organs"][0].update(visible_pixels=1), "contradiction", "the JSON says 1"),
        (lambda content: content["organs"][0].update(amodal_pixels=1), "contradiction", "the JSON says 1"),
        (lambda content: content["organs"][5].pop("amodal"), "damaged", "5.amodal: is required but missing"),
    ],
)
def test_contradictions_are_found(edit, kind, problem, dataset, tmp_path):
    folder = shutil.copytree(dataset.folder, tmp_path / "set")
    change(folder, edit)
    assert problem in findings_of(folder)[kind, "amodal/000000.json"]


def test_masks_that_differ_from_those_of_harvest_are_found(dataset, tmp_path):
    folder = shutil.copytree(dataset.folder, tmp_path / "set")

    def swap(content):
        # A mask of the same size elsewhere.
        entry = next(one for one in content["organs"] if one["class"] == OrganClass.PEPPER)
        counts = entry["amodal"]["counts"]
        counts[0], counts[-1] = counts[0] - 1, counts[-1] + 1

    change(folder, swap)
    assert "another mask than that of harvest" in findings_of(folder)["contradiction", "amodal/000000.json"]


# Exports.


def coco_of(folder, out, **options):
    export_dataset(folder, "coco", out, **options)
    content = json.loads((out / "annotations" / "instances_train.json").read_text())
    return {index: [one for one in content["annotations"] if one["image_id"] == index] for index in FRAMES}


@pytest.fixture(scope="module")
def records(dataset, tmp_path_factory):
    return coco_of(dataset.folder, tmp_path_factory.mktemp("coco") / "out")


def test_coco_has_the_amodal_mask_of_every_organ(dataset, records):
    for index, found in records.items():
        organs = organs_of(dataset, index)
        things = [one for one in found if not one["iscrowd"]]
        assert sorted(one["attributes"]["instance"] for one in things) == sorted(organs)
        for one in things:
            attributes = one["attributes"]
            entry = organs[attributes["instance"]]
            mask = mask_tools.decode(attributes["amodal"]["segmentation"]).astype(bool)
            np.testing.assert_array_equal(mask, decode_rle(entry["amodal"]))
            x0, y0, x1, y1 = entry["amodal_box"]
            assert attributes["amodal"]["bbox"] == [x0, y0, x1 - x0, y1 - y0]
            assert attributes["amodal"]["area"] == entry["amodal_pixels"]
            assert (mask_tools.decode(one["segmentation"]) <= mask).all()
            assert attributes["visible_fraction"] == pytest.approx(one["area"] / mask.sum())
            # Fruit keep what the harvest truth adds.
            assert ("pose" in attributes) == (one["category_id"] == OrganClass.PEPPER)
        assert not any("attributes" in one for one in found if one["iscrowd"])


def test_coco_without_them_in_all_frames_has_them_of_fruit_only(dataset, records, tmp_path):
    folder = shutil.copytree(dataset.folder, tmp_path / "set")
    (folder / "amodal" / "000003.json").unlink()
    for found in coco_of(folder, tmp_path / "out").values():
        things = [one for one in found if not one["iscrowd"]]
        assert {one["category_id"] for one in things if "amodal" in one["attributes"]} == {2}
    # Without harvest, those of fruit are here.
    folder = shutil.copytree(dataset.folder, tmp_path / "other")
    shutil.rmtree(folder / "harvest")
    for index, found in coco_of(folder, tmp_path / "out2").items():
        known = {one["id"]: one.get("attributes") for one in records[index]}
        for one in found:
            if not one["iscrowd"]:
                for name in ("amodal", "visible_fraction"):
                    assert one["attributes"][name] == known[one["id"]][name]


def test_organs_whose_hidden_part_is_at_the_border_can_be_left_out(dataset, tmp_path):
    folder = shutil.copytree(dataset.folder, tmp_path / "set")
    border = {}
    for index in FRAMES:
        instance = dataset.image(index, "instance")
        border[index] = {*instance[[0, -1]].ravel().tolist(), *instance[:, [0, -1]].ravel().tolist()}
    inside = next(value for value in organs_of(dataset, 0) if value not in border[0])

    def edit(content):
        next(one for one in content["organs"] if one["instance"] == inside).update(truncated=True)

    change(folder, edit)
    for index, found in coco_of(folder, tmp_path / "out", truncated="drop").items():
        kept = {one["attributes"]["instance"] for one in found if not one["iscrowd"]}
        # The painted harvest truth has no fruit that is truncated.
        fruit = {one["instance"] for one in dataset.image(index, "harvest")["fruit"]}
        truncated = {value for value, one in organs_of(dataset, index).items() if one["truncated"]} - fruit
        assert truncated
        truncated |= {inside} if index == 0 else set()
        assert kept == organs_of(dataset, index).keys() - truncated

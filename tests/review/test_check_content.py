"""The check finds images and labels that contradict each other, and frames that are not like the others."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from disc_set import HEIGHT, WIDTH, change_expectations, change_image, find, find_in_frame, kinds_of, sign

from pepperscene.atomic import write_json
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.images import read_image
from pepperscene.outputs import OUTPUTS
from pepperscene.recipe.tables import ExpectTable
from pepperscene.review.check import check_dataset
from pepperscene.review.check.one_frame import FrameTraits
from pepperscene.review.check.run import outlier_scenes
from pepperscene.review.check.whole_set import check_expectations
from pepperscene.truth.encodings import encode_rle


def put(value, position=(slice(0, 3), slice(0, 3))):
    def change(image):
        image[position] = value
        return image

    return change


def test_finds_instance_that_the_json_does_not_list(folder):
    instance = read_image(folder / "instance/000002.png")
    largest = np.bincount(instance[instance > 0]).argmax()
    change_image(folder, 2, "instance", lambda image: np.where(image == largest, 5000, image).astype("u2"))
    findings = find_in_frame(folder, 2)
    assert ("instance", 2, "instance/000002.png") in findings
    assert kinds_of(findings) == {"instance", "contradiction"}


def test_finds_pixel_of_another_class_than_its_instance_and_an_unknown_class(folder):
    row, column = np.argwhere(read_image(folder / "instance/000002.png") > 0)[0]

    def change(image):
        image[row, column] = 1 + image[row, column] % 7
        return image

    change_image(folder, 2, "class", change, False)
    expected = {("instance", 2, "class/000002.png"), ("encoding", 2, "class_colour/000002.png")}
    assert expected <= find_in_frame(folder, 2)
    change_image(folder, 2, "class", put(9), False)
    assert ("label", 2, "class/000002.png") in find_in_frame(folder, 2)


@pytest.mark.parametrize("output", ["instance", "distance"])
def test_finds_pixel_without_a_label_or_a_distance(folder, output):
    position = tuple(np.argwhere(read_image(folder / "instance/000002.png") > 0)[0])
    change_image(folder, 2, output, put(0 if output == "instance" else np.inf, position))
    assert ("unlabelled", 2, f"{output}/000002{OUTPUTS[output].suffix}") in find_in_frame(folder, 2)


def test_finds_encodings_that_do_not_match(folder):
    change_image(folder, 2, "distance_code", lambda image: image + 1)
    change_image(folder, 3, "class_colour", put(17, (0, 0, 0)))
    assert find(folder) == {
        ("encoding", 2, "distance_code/000002.png"),
        ("encoding", 3, "class_colour/000003.png"),
    }


IMPOSSIBLE = {
    "distance": (np.nan, -1.0), "depth_z": (np.nan, 50.0, 0.0), "normal": (np.nan, 1.0, 0.0),
    "electrons": (-1.0, np.nan, np.inf), "albedo": (np.nan, np.inf), "position": (np.nan, 0.0),
    "uv": (1.5, -1.0, np.nan), "coverage": (0.5, -1.0, np.nan), "raw": (1024,), "flow": (1.0,),
    "stereo": (np.nan,), "chlorophyll": (-1.0,), "carotenoids": (np.inf,), "water": (-0.1,),
    "ripeness": (1.1,), "leaf_age": (1.1,),
}  # fmt: skip


def test_finds_impossible_values(full_folder, all_outputs):
    rows, columns = np.nonzero(read_image(full_folder / "instance/000002.png"))
    rightmost = np.argsort(columns)[-1]
    position = rows[rightmost], columns[rightmost]
    frame = full_folder / "frames/000002.json"
    for output, values in IMPOSSIBLE.items():
        file = f"{output}/000002{OUTPUTS[output].suffix}"
        for value in values:
            change_image(full_folder, 2, output, put(value, position), False)
            assert ("value", 2, file) in find_in_frame(full_folder, 2), (output, value)
            for name in (file, frame.relative_to(full_folder)):
                shutil.copyfile(all_outputs / name, full_folder / name)


def test_finds_position_at_another_distance(full_folder):
    change_image(full_folder, 2, "position", lambda image: image + np.float32(0.01), False)
    assert find_in_frame(full_folder, 2) == {("value", 2, "position/000002.exr")}


def test_finds_harvest_that_contradicts_the_labels(full_folder):
    instance = read_image(full_folder / "instance/000002.png")
    number = int(instance[instance > 0][0])
    pixels = int((instance == number).sum())
    mask = encode_rle(instance == number)
    fruit = {
        "instance": number, "kind": "fruit", "plant": 0, "phytomer": 1, "visible_fraction": 1.0,
        "visible_pixels": pixels, "amodal_pixels": pixels, "amodal": mask, "truncated": False,
        "occluders": [], "box": None, "amodal_box": None, "pose": np.eye(4).tolist(), "peduncle": None,
        "approach": None,
    }  # fmt: skip
    path = full_folder / "harvest/000002.json"
    harvest = json.loads(path.read_text())
    for changes, kind in (
        ({}, ""),
        ({"visible_pixels": pixels - 1}, "contradiction"),
        ({"amodal_pixels": pixels + 1}, "contradiction"),
        ({"visible_pixels": "many"}, "damaged"),
    ):
        write_json(path, {**harvest, "fruit": [{**fruit, **changes}]})
        sign(full_folder, 2, tables=False)
        assert find_in_frame(full_folder, 2) == ({(kind, 2, "harvest/000002.json")} if kind else set())


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("black", lambda image: image * 0 + np.eye(HEIGHT, WIDTH, dtype=np.uint8)[..., None]),
        ("dark", lambda image: image // 12),
        ("saturated", lambda image: np.where(np.arange(HEIGHT)[:, None, None] < 90, 255, image).astype("u1")),
        ("constant", lambda image: np.full_like(image, 90)),
    ],
)
def test_finds_photograph_without_content(folder, kind, change):
    change_image(folder, 1, "colour", change, False)
    assert find_in_frame(folder, 1) == {(kind, 1, "colour/000001.png")}


@pytest.mark.parametrize(("right", "down"), [(2, 0), (-4, 3)])
def test_reports_the_shift_of_labels(folder, right, down):
    change_image(folder, 1, "colour", lambda image: np.roll(image, (-down, -right), (0, 1)))
    (finding,) = check_dataset(folder, workers=1).findings
    assert (finding.kind, finding.file) == ("edges", "instance/000001.png")
    assert f"{right:+d} px to the right" in finding.problem
    assert f"{down:+d} px below" in finding.problem


def test_finds_labels_of_a_mirrored_or_another_photograph(folder):
    change_image(folder, 1, "colour", lambda image: image[:, ::-1])
    other = read_image(folder / "colour/000002.png")
    change_image(folder, 3, "colour", lambda image: other // 2 + 60)
    findings = check_dataset(folder, workers=1).findings
    assert [(finding.kind, finding.index) for finding in findings] == [("edges", 1), ("edges", 3)]
    assert all("no shift" in finding.problem for finding in findings)


def test_finds_equal_photographs(folder):
    # Both frames have the same pose.
    shutil.copyfile(folder / "colour/000002.png", folder / "colour/000005.png")
    sign(folder, 5)
    assert find(folder) == {("duplicate", 5, "frames/000005.json")}


def test_finds_equal_labels(folder):
    data = open_dataset(folder)
    for index in data.indices():
        sign(folder, index, {"outputs": {"class": data.metadata(index)["outputs"]["class"]}})
    shutil.rmtree(folder / "colour")
    assert {finding for finding in find(folder) if finding[0] != "extra"} == {
        ("duplicate", index, f"frames/{index:06d}.json") for index in (3, 4, 5)
    }


def test_finds_equal_pose_and_seed(folder):
    first = open_dataset(folder).metadata(3)
    sign(folder, 4, {"camera": first["camera"], "seed": first["seed"]})
    file = "frames/000004.json"
    assert find(folder) == {("duplicate", 4, file), ("contradiction", 4, file)}


@pytest.mark.parametrize(
    ("changes", "text", "frames"),
    [
        ({"intensity": [0, 50]}, "mean grey value", 0),
        ({"share": {"pepper": [0.5, 1]}}, "fraction of pepper", 0),
        ({"frame_intensity": [0, 50]}, "mean grey value", 6),
        ({"frame_intensity": [0, 50], "share": {"wire": [0, 0.001]}}, "fraction of wire", 6),
    ],
)
def test_finds_statistics_out_of_range(folder, changes, text, frames):
    change_expectations(folder, **changes)
    findings = check_dataset(folder, workers=1).findings
    assert {finding.kind for finding in findings} == {"drift"}
    assert any(text in finding.problem for finding in findings)
    assert len([finding for finding in findings if finding.index is not None]) == frames


def test_finds_invalid_expectation(folder):
    change_expectations(folder, intensity="bright")
    assert find(folder) == {("damaged", None, "dataset.json")}


def frames_of(values):
    """Traits of frames given by their scene and their fraction of leaf pixels."""
    return [
        FrameTraits(index, scene, fractions=(1 - leaf, leaf, *[0.0] * 6))
        for index, (scene, leaf) in enumerate(values)
    ]


@pytest.mark.parametrize(
    ("scenes", "mean", "drifts"), [(3, 0.9, False), (6, 0.65, False), (6, 0.8, True), (400, 0.65, True)]
)
def test_part_of_a_plan_drifts_only_beyond_chance(scenes, mean, drifts):
    rng = np.random.default_rng(4)
    frames = frames_of([(scene, mean + rng.normal(0, 0.07)) for scene in range(scenes)])
    expect = ExpectTable(share={"leaf": (0.4, 0.6)})
    assert bool(list(check_expectations(frames, expect, whole=False))) == drifts
    # For the whole plan there is no tolerance.
    assert list(check_expectations(frames, expect, whole=True))


def test_outlier_scene_is_a_note():
    rng = np.random.default_rng(5)
    scenes = [1000 * (index // 30) + index % 10 for index in range(60)]
    notes = list(
        outlier_scenes(
            frames_of([(scene, 0.9 if scene == 1004 else rng.normal(0.5, 0.02)) for scene in scenes])
        )
    )
    assert notes
    assert all(note.startswith("set 1, rotation 4 is an outlier") for note in notes)

"""A correct data set passes the check; missing, damaged and contradicting files are found."""

from __future__ import annotations

import json
import os
import shutil

import numpy as np
import pytest
from disc_set import change_image, find, find_in_frame, kinds_of, rewrite_manifest, sign

from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.images import read_image, write_image
from pepperscene.errors import InputError
from pepperscene.outputs import DEFAULT_OUTPUTS, OUTPUTS
from pepperscene.review.check import KINDS, check_dataset


def test_correct_data_set_has_no_findings_and_is_not_changed(all_outputs):
    before = {path: path.stat().st_mtime_ns for path in all_outputs.rglob("*")}
    result = check_dataset(all_outputs, workers=1)
    assert result.findings == ()
    assert (result.passed, result.frames, result.counts()) == (True, 6, {})
    assert {path: path.stat().st_mtime_ns for path in all_outputs.rglob("*")} == before


def test_workers_give_the_same_result_in_the_same_order(folder):
    for index in (3, 5):
        (folder / f"distance/{index:06d}.exr").write_bytes(b"no image")
    progress = []
    result = check_dataset(folder, workers=2, on_frame=lambda done, total: progress.append((done, total)))
    assert result == check_dataset(folder, workers=1)
    assert progress == [(done, 6) for done in range(1, 7)]
    assert result.counts() == {"checksum": 2}


def flip_bit(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    ("file", "damage", "signed", "kind"),
    [
        ("class/000004.png", None, False, "missing"),
        ("distance/000004.exr", flip_bit, False, "checksum"),
        ("colour/000004.png", lambda content: content[:-900], False, "checksum"),
        ("colour/000004.png", lambda _: b"no picture", True, "unreadable"),
        ("distance/000004.exr", lambda _: b"", True, "unreadable"),
    ],
)
def test_finds_damaged_image(folder, file, damage, signed, kind):
    path = folder / file
    if damage is None:
        path.unlink()
    else:
        path.write_bytes(damage(path.read_bytes()))
    if signed:
        sign(folder, 4)
    assert find(folder) == {(kind, 4, file)}


def test_finds_missing_frame_by_the_manifest_and_its_leftover_images(folder):
    (folder / "frames/000004.json").unlink()
    findings = find(folder)
    leftover = {f"{name}/000004{OUTPUTS[name].suffix}" for name in (*DEFAULT_OUTPUTS, "class_colour")}
    assert findings == {("incomplete", 4, "manifest.parquet"), *(("extra", 4, file) for file in leftover)}


def test_required_frames(folder):
    for path in folder.glob("*/000005.*"):
        path.unlink()
    rewrite_manifest(folder)
    assert find(folder) == set()
    assert find(folder, frames="0:6") == {("incomplete", 5, "frames/000005.json")}
    assert find(folder, frames=[2, 3]) == set()
    with pytest.raises(InputError, match="A:B"):
        check_dataset(folder, frames="7:3")


def test_finds_stray_files_but_not_those_of_file_managers_and_reports(folder):
    for name in ("index.html", "contact_sheet.png", ".DS_Store", "class/Thumbs.db"):
        (folder / name).write_bytes(b"")
    assert find(folder) == set()
    (folder / "masks").mkdir()
    names = ["notes.txt", "class/copy.png", "frames/.000003.json.here.7.1.tmp", "frames/5.json"]
    expected = {"masks", "class/\\udcff.png", *names}
    for name in (b"masks/1.png", b"class/\xff.png", *map(os.fsencode, names)):
        (folder / os.fsdecode(name)).write_bytes(b"")
    assert find(folder) == {("extra", None, name) for name in expected}


def test_finds_images_of_another_size_or_type(folder):
    change_image(folder, 1, "distance_code", lambda image: image[:, :-1])
    path = folder / "instance/000002.png"
    write_image(path, read_image(path).astype(np.uint8), "distance_code")
    sign(folder, 2)
    assert find(folder) == {("shape", 1, "distance_code/000001.png"), ("shape", 2, "instance/000002.png")}


def test_finds_damaged_frame_json(folder):
    for content in (b"", b"{", b"[1, 2]", b"\xff\xfe", b'{"index": 3}', b'{"outputs": {"class": 1}}'):
        (folder / "frames/000003.json").write_bytes(content)
        assert ("damaged", 3, "frames/000003.json") in find_in_frame(folder, 3)


def test_edited_frame_json_is_one_finding(folder):
    path = folder / "frames/000003.json"
    metadata = json.loads(path.read_text())
    metadata["camera"]["exposure_s"] *= 2
    path.write_text(json.dumps(metadata))
    assert find(folder) == {("damaged", 3, "frames/000003.json")}


def test_finds_damaged_edited_or_missing_dataset_json(folder):
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    info["recipe"]["views"]["distance_mm"] += 1
    for content in ("", "{", '{"format": "another"}', json.dumps(info), None):
        path.unlink() if content is None else path.write_text(content)
        assert find(folder) == {("damaged", None, "dataset.json")}
    shutil.rmtree(folder / "frames")
    with pytest.raises(InputError, match="no data set"):
        check_dataset(folder)


def test_data_set_without_frames_is_incomplete(tmp_path):
    (tmp_path / "dataset.json").write_text("{}")
    assert ("incomplete", None, "") in find(tmp_path)


@pytest.mark.parametrize("changes", [{"step": 2}, {"seed": 1}, {"recipe_seed": 5}, {"set": 0}, {"index": 4}])
def test_finds_frame_that_contradicts_the_plan(folder, changes):
    sign(folder, 3, changes)
    findings = find(folder)
    assert ("contradiction", 3, "frames/000003.json") in findings
    assert kinds_of(findings) <= {"contradiction", "incomplete"}


def test_finds_json_that_contradicts_its_images(folder):
    metadata = open_dataset(folder).metadata(3)
    metadata["class_pixels"]["leaf"] += 1
    first, second, third = list(metadata["instances"])[:3]
    metadata["instances"][first]["pixels"] += 1
    metadata["instances"][second]["box"][0] += 1
    metadata["instances"]["999"] = metadata["instances"][third]
    sign(folder, 3, metadata)
    findings = check_dataset(folder, workers=1).findings
    assert {finding.kind for finding in findings} == {"contradiction"}
    text = " ".join(finding.problem for finding in findings)
    assert all(words in text for words in ("leaf", "box", "lists instance 999", f"have instance {first}"))


def test_finds_contradicting_damaged_and_missing_manifest(folder):
    path = folder / "manifest.parquet"
    content = path.read_bytes()
    camera = open_dataset(folder).metadata(3)["camera"]
    sign(folder, 3, {"camera": {**camera, "exposure_s": 1.0}})
    path.write_bytes(content)
    assert find(folder) == {("contradiction", 3, "manifest.parquet")}
    path.write_bytes(content[:-20])
    assert find(folder) == {("damaged", None, "manifest.parquet")}
    path.unlink()
    assert find(folder) == {("missing", None, "manifest.parquet")}


def test_finds_missing_table_of_fruit(full_folder):
    (full_folder / "fruit.parquet").unlink()
    assert find(full_folder) == {("missing", None, "fruit.parquet")}


def test_findings_are_sorted_by_severity(folder):
    (folder / "notes.txt").write_bytes(b"")
    (folder / "class/000004.png").unlink()
    (folder / "distance/000002.exr").unlink()
    (folder / "frames/000001.json").write_bytes(b"")
    result = check_dataset(folder, workers=1)
    ranks = [list(KINDS).index(finding.kind) for finding in result.findings]
    assert ranks == sorted(ranks)
    missing = [finding.index for finding in result.findings if finding.kind == "missing"]
    assert missing == [2, 4]
    content = json.loads(json.dumps(result.to_json()))
    assert content["counts"] == result.counts()
    assert content["passed"] is False
    assert set(content["findings"][0]) == {"kind", "index", "file", "problem"}


@pytest.mark.parametrize("workers", [0, -1, 100_000])
def test_rejects_invalid_number_of_workers(all_outputs, workers):
    with pytest.raises(InputError, match="workers"):
        check_dataset(all_outputs, workers=workers)

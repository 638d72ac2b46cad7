"""A correct data set passes; each problem, made on purpose, is found with its kind and no other."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from data_sets import set_without_plants

from pepperscene.classes import OrganClass
from pepperscene.dataset import check_dataset, read_image, write_image
from pepperscene.dataset.check import run
from pepperscene.dataset.check.findings import KINDS, Finding
from pepperscene.dataset.check.one_frame import FrameTraits
from pepperscene.dataset.check.whole_set import CrossFrameChecks
from pepperscene.dataset.recipe.tables import ExpectTable
from pepperscene.dataset.store.atomic import digest, write_json
from pepperscene.dataset.store.dataset import checksum_of, open_dataset
from pepperscene.errors import InputError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, Frame
from pepperscene.truth import class_colour, distance_code

HEIGHT, WIDTH = 150, 200
FAR_M = 3.0


class DiscRenderer:
    """Renders discs in front of each other, with all outputs consistent."""

    def __init__(self, scene):
        self.scene = scene

    def render(self, camera, outputs=(), quality="standard", seed=0, others=None):
        rng = np.random.default_rng([int(abs(camera.pose[0, 3]) * 1e9), int(camera.pose[2, 3] * 1e9)])
        noise = np.random.default_rng(seed)
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        instance = np.zeros((HEIGHT, WIDTH), np.uint16)
        distance = np.full((HEIGHT, WIDTH), np.inf, np.float32)
        classes = np.zeros((HEIGHT, WIDTH), np.uint8)
        grey = np.full((HEIGHT, WIDTH, 3), 30.0)
        for number in range(1, 90):
            x, y, radius = rng.uniform(0, WIDTH), rng.uniform(0, HEIGHT), rng.uniform(4, 22)
            inside = (columns - x) ** 2 + (rows - y) ** 2 < radius**2
            instance[inside], classes[inside] = number, 1 + number % 7
            distance[inside] = FAR_M - 0.03 * number + 0.0005 * columns[inside]
            grey[inside] = rng.uniform(40, 200, 3)
        grey += noise.normal(0, 6, grey.shape)
        hit = instance > 0

        direction = np.stack([columns - WIDTH / 2, rows - HEIGHT / 2, np.full_like(rows, 120)], -1)
        direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        world = direction @ camera.pose[:3, :3].T
        with np.errstate(invalid="ignore"):
            position = camera.pose[:3, 3] + distance[..., None] * world
        images = {
            "colour": np.clip(grey, 0, 255).astype(np.uint8),
            "colour_stereo": np.clip(np.roll(grey, 5, 1), 0, 255).astype(np.uint8),
            "raw": noise.integers(0, 1024, (2 * HEIGHT, 2 * WIDTH)).astype(np.uint16),
            "electrons": np.maximum(grey, 0).astype(np.float32),
            "class": classes,
            "class_colour": class_colour(classes),
            "instance": instance,
            "distance": distance,
            "distance_code": distance_code(distance),
            "depth_z": (distance * direction[..., 2]).astype(np.float32),
            "normal": np.where(hit[..., None], -world, 0).astype(np.float32),
            "position": np.where(hit[..., None], position, np.inf).astype(np.float32),
            "uv": np.where(hit[..., None], 0.5, -1.0).repeat(2, -1).astype(np.float32),
            "coverage": (classes[..., None] == np.arange(len(OrganClass))).astype(np.float16),
            "flow": np.stack([np.full(hit.shape, np.nan)] * 2 + [np.zeros(hit.shape)], -1).astype(np.float32),
            "stereo": np.stack([hit * 0 + 5, hit * 0, columns < WIDTH - 5], -1).astype(np.float32),
            "harvest": {"format": "pepperscene harvest 1", "fruit": [], "graph": {"nodes": [], "edges": []}},
        }  # fmt: skip
        metadata = {
            "camera": {**camera.metadata(), "width": WIDTH, "height": HEIGHT, "binning": 2, "bits": 10},
            "instances": instance_entries(instance, classes),
        }
        return Frame({name: images[name] for name in outputs}, metadata)


def instance_entries(instance, classes):
    entries = {}
    for number in np.unique(instance[instance > 0]).tolist():
        rows, columns = np.nonzero(instance == number)
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        entries[str(number)] = {
            "class": int(classes[rows[0], columns[0]]),
            "kind": "disc",
            "parent": 0,
            "pixels": len(rows),
            "box": [int(edge) for edge in box],
        }
    return entries


def make_disc_set(folder, outputs):
    """A correct data set of 6 frames."""
    changes = {"plan.rotations": 1, "plan.frames": 3, "camera.baseline_mm": 60.0}
    set_without_plants(folder, range(6), outputs, DiscRenderer, changes)
    expected = {"intensity": [60, 140], "frame_intensity": [50, 150], "share": {"leaf": [0.05, 0.25]}}
    change_expectations(folder, **expected, saturated=0.01)
    return folder


def change_expectations(folder, **changes):
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    path.write_text(json.dumps({**info, "expect": {**info.get("expect", {}), **changes}}))


@pytest.fixture(scope="module")
def all_outputs(tmp_path_factory):
    return make_disc_set(tmp_path_factory.mktemp("check") / "all", tuple(OUTPUTS))


@pytest.fixture(scope="module")
def default_outputs(tmp_path_factory):
    return make_disc_set(tmp_path_factory.mktemp("check") / "default", (*DEFAULT_OUTPUTS, "class_colour"))


@pytest.fixture
def folder(default_outputs, tmp_path):
    return shutil.copytree(default_outputs, tmp_path / "set")


@pytest.fixture
def full_folder(all_outputs, tmp_path):
    return shutil.copytree(all_outputs, tmp_path / "set")


def sign(folder, index, changes=None, tables=True):
    """Make a frame's JSON consistent with its files, as only an error of the renderer could."""
    data = open_dataset(folder)
    metadata = {**data.metadata(index), **(changes or {})}
    for name, entry in metadata["outputs"].items():
        path = folder / entry["file"]
        if path.is_file():
            metadata["outputs"][name] = {**entry, "bytes": path.stat().st_size, "sha256": digest(path)}
    metadata["checksum"] = checksum_of(metadata)
    write_json(data.frame_path(index), metadata)
    if tables:
        rewrite_manifest(folder)


def rewrite_manifest(folder):
    (folder / "journal.jsonl").unlink(missing_ok=True)
    open_dataset(folder).write_tables()


def change_image(folder, index, output, change):
    """Replace an image of a frame, with a consistent JSON."""
    path = folder / open_dataset(folder).metadata(index)["outputs"][output]["file"]
    write_image(path, change(read_image(path).copy()), output)
    sign(folder, index)


def find(folder, **arguments):
    """Kind, frame and file of each finding."""
    findings = check_dataset(folder, workers=1, **arguments).findings
    return {(finding.kind, finding.index, finding.file) for finding in findings}


def kinds_of(findings):
    return {kind for kind, *_ in findings}


def put(value, position=(slice(0, 3), slice(0, 3))):
    def change(image):
        image[position] = value
        return image

    return change


# --- a correct data set -------------------------------------------------------------------------------------


def test_correct_data_set_has_no_findings_and_is_not_changed(all_outputs):
    before = {path: path.stat().st_mtime_ns for path in all_outputs.rglob("*")}
    result = check_dataset(all_outputs, workers=1)
    assert result.findings == ()
    assert (result.passed, result.frames, result.counts()) == (True, 6, {})
    assert {path: path.stat().st_mtime_ns for path in all_outputs.rglob("*")} == before


def test_workers_give_the_same_result_in_the_same_order(folder, monkeypatch):
    for index in (3, 5):
        (folder / f"distance/{index:06d}.exr").write_bytes(b"no image")
    monkeypatch.setattr(run, "_FRAMES_PER_WORKER", 2)
    monkeypatch.setattr(run, "_CHUNK", 2)
    progress = []
    result = check_dataset(folder, workers=2, on_frame=lambda done, total: progress.append((done, total)))
    assert result == check_dataset(folder, workers=1)
    assert progress == [(done, 6) for done in range(1, 7)]
    assert result.counts() == {"checksum": 2}


# --- files --------------------------------------------------------------------------------------------------


def test_finds_missing_image(folder):
    (folder / "class/000004.png").unlink()
    assert find(folder) == {("missing", 4, "class/000004.png")}


@pytest.mark.parametrize(
    ("lost", "source"), [("manifest.parquet", "frames/000004.json"), ("journal.jsonl", "manifest.parquet")]
)
def test_finds_missing_frame_by_either_table_and_its_leftover_images(folder, lost, source):
    (folder / "frames/000004.json").unlink()
    (folder / lost).unlink()
    findings = {finding for finding in find(folder) if finding[0] != "missing"}
    leftover = {f"{name}/000004{OUTPUTS[name].suffix}" for name in (*DEFAULT_OUTPUTS, "class_colour")}
    assert findings == {("incomplete", 4, source), *(("extra", 4, file) for file in leftover)}


def test_required_frames(folder):
    for path in folder.glob("*/000005.*"):
        path.unlink()
    rewrite_manifest(folder)
    assert find(folder) == set()
    assert find(folder, frames="0:6") == {("incomplete", 5, "frames/000005.json")}
    assert find(folder, frames=[2, 3]) == set()
    with pytest.raises(InputError, match="A:B"):
        check_dataset(folder, frames="7:3")


@pytest.mark.parametrize(
    "name",
    ["notes.txt", "class/copy.png", "frames/.000003.json.here.7.1.tmp", "frames/5.json", "masks/1.png"],
)
def test_finds_stray_files(folder, name):
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_bytes(b"")
    expected = name if name != "masks/1.png" else "masks"
    assert find(folder) == {("extra", None, expected)}


def test_finds_file_name_that_is_not_text(folder):
    with open(bytes(folder / "class") + b"/\xff.png", "wb"):
        pass
    assert find(folder) == {("extra", None, "class/\\udcff.png")}


def test_files_of_file_managers_and_reports_are_allowed(folder):
    for name in ("index.html", "contact_sheet.png", ".DS_Store", "class/Thumbs.db"):
        (folder / name).write_bytes(b"")
    assert find(folder) == set()


def test_finds_flipped_bit_and_truncated_file(folder):
    path = folder / "distance/000005.exr"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    path = folder / "colour/000004.png"
    path.write_bytes(path.read_bytes()[:-900])
    assert find(folder) == {("checksum", 5, "distance/000005.exr"), ("checksum", 4, "colour/000004.png")}


def test_finds_undecodable_images(folder):
    (folder / "colour/000005.png").write_bytes(b"no picture")
    (folder / "distance/000004.exr").write_bytes(b"")
    for index in (4, 5):
        sign(folder, index)
    assert find(folder) == {("unreadable", 5, "colour/000005.png"), ("unreadable", 4, "distance/000004.exr")}


def test_finds_images_of_another_size_or_type(folder):
    change_image(folder, 1, "distance_code", lambda image: image[:, :-1])
    path = folder / "instance/000002.png"
    write_image(path, read_image(path).astype(np.uint8), "distance_code")
    sign(folder, 2)
    assert find(folder) == {("shape", 1, "distance_code/000001.png"), ("shape", 2, "instance/000002.png")}


# --- JSON and tables ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[1, 2]", b"\xff\xfe", b'{"index": 3}', b'{"outputs": {"class": 1}}']
)
def test_finds_damaged_frame_json(folder, content):
    (folder / "frames/000003.json").write_bytes(content)
    assert ("damaged", 3, "frames/000003.json") in find(folder)


def test_finds_edited_frame_json(folder):
    path = folder / "frames/000003.json"
    metadata = json.loads(path.read_text())
    metadata["camera"]["exposure_s"] *= 2
    path.write_text(json.dumps(metadata))
    assert find(folder) == {("damaged", 3, "frames/000003.json")}


@pytest.mark.parametrize("content", [b"", b"{", b'{"format": "another"}'])
def test_finds_damaged_dataset_json(folder, content):
    (folder / "dataset.json").write_bytes(content)
    assert find(folder) == {("damaged", None, "dataset.json")}


def test_finds_edited_or_missing_dataset_json(folder):
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    info["recipe"]["path"]["distance_mm"] += 1
    path.write_text(json.dumps(info))
    assert find(folder) == {("damaged", None, "dataset.json")}
    path.unlink()
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


# --- labels -------------------------------------------------------------------------------------------------


def test_finds_unknown_class(folder):
    change_image(folder, 2, "class", put(9))
    assert ("label", 2, "class/000002.png") in find(folder)


def test_finds_instance_that_the_json_does_not_list(folder):
    instance = read_image(folder / "instance/000002.png")
    largest = np.bincount(instance[instance > 0]).argmax()
    change_image(folder, 2, "instance", lambda image: np.where(image == largest, 5000, image).astype("u2"))
    findings = find(folder)
    assert ("instance", 2, "instance/000002.png") in findings
    assert kinds_of(findings) == {"instance", "contradiction"}


def test_finds_pixel_of_another_class_than_its_instance(folder):
    row, column = np.argwhere(read_image(folder / "instance/000002.png") > 0)[0]

    def change(image):
        image[row, column] = 1 + image[row, column] % 7
        return image

    change_image(folder, 2, "class", change)
    expected = {("instance", 2, "class/000002.png"), ("encoding", 2, "class_colour/000002.png")}
    assert expected <= find(folder)


@pytest.mark.parametrize("output", ["instance", "distance"])
def test_finds_pixel_without_a_label_or_a_distance(folder, output):
    position = tuple(np.argwhere(read_image(folder / "instance/000002.png") > 0)[0])
    change_image(folder, 2, output, put(0 if output == "instance" else np.inf, position))
    assert ("unlabelled", 2, f"{output}/000002{OUTPUTS[output].suffix}") in find(folder)


def test_finds_encodings_that_do_not_match(folder):
    change_image(folder, 2, "distance_code", lambda image: image + 1)
    change_image(folder, 3, "class_colour", put(17, (0, 0, 0)))
    assert find(folder) == {
        ("encoding", 2, "distance_code/000002.png"),
        ("encoding", 3, "class_colour/000003.png"),
    }


# --- measured values ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("output", "value"),
    [
        ("distance", np.nan), ("distance", -1.0), ("depth_z", np.nan), ("depth_z", 50.0), ("depth_z", 0.0),
        ("normal", np.nan), ("normal", 1.0), ("normal", 0.0), ("electrons", -1.0), ("electrons", np.nan),
        ("electrons", np.inf), ("position", np.nan), ("position", 0.0), ("uv", 1.5), ("uv", -1.0),
        ("uv", np.nan), ("coverage", 0.5), ("coverage", -1.0), ("coverage", np.nan), ("raw", 1024),
        ("flow", 1.0), ("stereo", np.nan),
    ],
)  # fmt: skip
def test_finds_impossible_value(full_folder, output, value):
    rows, columns = np.nonzero(read_image(full_folder / "instance/000002.png"))
    rightmost = np.argsort(columns)[-1]
    change_image(full_folder, 2, output, put(value, (rows[rightmost], columns[rightmost])))
    assert ("value", 2, f"{output}/000002{OUTPUTS[output].suffix}") in find(full_folder)


def test_finds_position_at_another_distance(full_folder):
    change_image(full_folder, 2, "position", lambda image: image + np.float32(0.01))
    assert find(full_folder) == {("value", 2, "position/000002.exr")}


def test_finds_harvest_that_contradicts_the_labels(full_folder):
    instance = read_image(full_folder / "instance/000002.png")
    number = int(instance[instance > 0][0])
    pixels = int((instance == number).sum())
    fruit = {
        "instance": number,
        "visible_pixels": pixels,
        "amodal_pixels": pixels,
        "amodal": {"size": [HEIGHT, WIDTH], "counts": [0, pixels, HEIGHT * WIDTH - pixels]},
    }
    path = full_folder / "harvest/000002.json"
    harvest = json.loads(path.read_text())
    for changes, good in (({}, True), ({"visible_pixels": pixels + 1}, False), ({"amodal_pixels": 0}, False)):
        write_json(path, {**harvest, "fruit": [{**fruit, **changes}]})
        # The table of fruit needs more values of a fruit than these.
        sign(full_folder, 2, tables=False)
        findings = {finding for finding in find(full_folder) if finding[2] == "harvest/000002.json"}
        assert findings == (set() if good else {("contradiction", 2, "harvest/000002.json")})


# --- photographs --------------------------------------------------------------------------------------------


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
    change_image(folder, 1, "colour", change)
    expected = {(kind, 1, "colour/000001.png")}
    assert expected <= find(folder) <= expected | {("drift", 1, "colour/000001.png")}


@pytest.mark.parametrize(("right", "down"), [(2, 0), (0, -2), (-4, 3), (8, 8)])
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


# --- all frames together ------------------------------------------------------------------------------------


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


def accumulate(values, expect=None):
    """Checks of frames given by their scene and their fraction of leaf pixels."""
    checks = CrossFrameChecks(expect)
    for index, (scene, leaf) in enumerate(values):
        assert list(checks.add(FrameTraits(index, scene, fractions=(1 - leaf, leaf, *[0.0] * 6)))) == []
    return checks


@pytest.mark.parametrize(
    ("scenes", "mean", "drifts"), [(3, 0.9, False), (6, 0.65, False), (6, 0.8, True), (400, 0.65, True)]
)
def test_part_of_a_plan_drifts_only_beyond_chance(scenes, mean, drifts):
    rng = np.random.default_rng(4)
    values = [(scene, mean + rng.normal(0, 0.07)) for scene in range(scenes)]
    checks = accumulate(values, ExpectTable(share={"leaf": (0.4, 0.6)}))
    assert bool(list(checks.drift(whole=False))) == drifts
    # For the whole plan there is no tolerance.
    assert list(checks.drift(whole=True))


def test_outlier_scene_is_a_note():
    rng = np.random.default_rng(5)
    scenes = [1000 * (index // 30) + index % 10 for index in range(60)]
    checks = accumulate([(scene, 0.9 if scene == 1004 else rng.normal(0.5, 0.02)) for scene in scenes])
    assert list(checks.drift(whole=True)) == []
    notes = list(checks.outlier_scenes())
    assert notes
    assert all(note.startswith("set 1, rotation 4 is an outlier") for note in notes)


# --- the result ---------------------------------------------------------------------------------------------


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
    assert content["good"] is False
    assert set(content["findings"][0]) == {"kind", "index", "file", "what"}


def test_rejects_unknown_kind_of_finding():
    with pytest.raises(ValueError, match="'odd' is not a kind"):
        Finding("odd", None, "", "")


@pytest.mark.parametrize("workers", [0, -1, 100_000])
def test_rejects_invalid_number_of_workers(all_outputs, workers):
    with pytest.raises(InputError, match="workers"):
        check_dataset(all_outputs, workers=workers)

"""A whole data set passes; each fault, made on purpose, is found by its kind and by no other."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from pepperscene.classes import OrganClass
from pepperscene.dataset import build, check_dataset, load_recipe, read_image, write_image
from pepperscene.dataset.check import run as crew
from pepperscene.dataset.check.cross_frame import CrossFrameChecks
from pepperscene.dataset.check.findings import KINDS, Finding
from pepperscene.dataset.check.one_frame import FrameTraits
from pepperscene.dataset.recipe.tables import ExpectTable
from pepperscene.dataset.scenes.frame_renderer import FrameRenderer
from pepperscene.dataset.store.atomic import digest, write_json
from pepperscene.dataset.store.dataset import checksum_of, open_dataset
from pepperscene.dataset.store.manifest import write_manifest
from pepperscene.errors import InputError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, Frame
from pepperscene.geometry import rectangle
from pepperscene.scene import assemble_scene
from pepperscene.truth import class_colour, distance_code

HEIGHT, WIDTH = 150, 200
FAR_M = 3.0


class Discs:
    """Discs before each other, as a renderer would show them: every output belongs to every other."""

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

        towards = np.stack([columns - WIDTH / 2, rows - HEIGHT / 2, np.full_like(rows, 120)], -1)
        towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
        world = towards @ camera.pose[:3, :3].T
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
            "depth_z": (distance * towards[..., 2]).astype(np.float32),
            "normal": np.where(hit[..., None], -world, 0).astype(np.float32),
            "position": np.where(hit[..., None], position, np.inf).astype(np.float32),
            "uv": np.where(hit[..., None], 0.5, -1.0).repeat(2, -1).astype(np.float32),
            "coverage": (classes[..., None] == np.arange(len(OrganClass))).astype(np.float16),
            "flow": np.stack([np.full(hit.shape, np.nan)] * 2 + [np.zeros(hit.shape)], -1).astype(np.float32),
            "stereo": np.stack([hit * 0 + 5, hit * 0, columns < WIDTH - 5], -1).astype(np.float32),
            "harvest": {"format": "pepperscene harvest 1", "fruit": [], "graph": {"nodes": [], "edges": []}},
        }  # fmt: skip
        facts = {
            "camera": {**camera.metadata(), "width": WIDTH, "height": HEIGHT, "binning": 2, "bits": 10},
            "instances": listed(instance, classes),
        }
        return Frame({name: images[name] for name in outputs}, facts)


def listed(instance, classes):
    """What the JSON says of an instance image."""
    told = {}
    for number in np.unique(instance[instance > 0]).tolist():
        rows, columns = np.nonzero(instance == number)
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        told[str(number)] = {
            "class": int(classes[rows[0], columns[0]]),
            "kind": "disc",
            "parent": 0,
            "pixels": len(rows),
            "box": [int(edge) for edge in box],
        }
    return told


def made(folder, outputs):
    """A whole data set of 6 frames."""
    shipped = load_recipe("barth2018")
    plan = shipped.plan.model_copy(update={"sets": 2, "rotations": 1, "frames": 3})
    row = shipped.row.model_copy(update={"plants_front": 1, "plants_back": 0})
    camera = shipped.camera.model_copy(update={"baseline_mm": 60.0})
    expect = ExpectTable(
        intensity=(60, 140), frame_intensity=(50, 150), saturated=0.01, share={"leaf": (0.05, 0.25)}
    )
    recipe = shipped.model_copy(
        update={"plan": plan, "row": row, "camera": camera, "expect": expect, "cultivar": "kaite_february"}
    )
    with pytest.MonkeyPatch.context() as patch:
        scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
        patch.setattr(FrameRenderer, "scene", lambda *_args, **_kwargs: scene)
        build(recipe, folder, outputs=outputs, renderer=Discs)
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return made(tmp_path_factory.mktemp("check") / "whole", tuple(OUTPUTS))


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    return made(tmp_path_factory.mktemp("check") / "usual", (*DEFAULT_OUTPUTS, "class_colour"))


@pytest.fixture
def folder(usual, tmp_path):
    return shutil.copytree(usual, tmp_path / "set")


@pytest.fixture
def rich(whole, tmp_path):
    """With every output that there is."""
    return shutil.copytree(whole, tmp_path / "set")


def sign(folder, index, changes=None):
    """Write a frame's JSON so that it holds with its files, as only a fault of the renderer could."""
    data = open_dataset(folder)
    facts = {**data.metadata(index), **(changes or {})}
    for name, entry in facts["outputs"].items():
        path = folder / entry["file"]
        if path.is_file():
            facts["outputs"][name] = {**entry, "bytes": path.stat().st_size, "sha256": digest(path)}
    facts["checksum"] = checksum_of(facts)
    write_json(data.frame_path(index), facts)
    write_manifest_of(folder)


def write_manifest_of(folder):
    (folder / "journal.jsonl").unlink(missing_ok=True)
    write_manifest(open_dataset(folder))


def change(folder, index, output, to):
    """Another image in place of a frame's, with all that its JSON says of the file."""
    path = folder / open_dataset(folder).metadata(index)["outputs"][output]["file"]
    image = read_image(path)
    write_image(path, to(image.copy()) if image.__class__ is np.ndarray else to(image), output)
    sign(folder, index)


def found(folder, **arguments):
    """Kind, frame and file of each finding."""
    return {(one.kind, one.index, one.file) for one in check_dataset(folder, workers=1, **arguments).findings}


def put(value, place=(slice(0, 3), slice(0, 3))):
    def to(image):
        image[place] = value
        return image

    return to


# --- a whole data set ---------------------------------------------------------------------------------------


def test_a_whole_data_set_has_no_fault_and_stays_as_it_is(whole):
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("*")}
    verdict = check_dataset(whole, workers=1)
    assert verdict.findings == ()
    assert (verdict.good, verdict.frames, verdict.counts()) == (True, 6, {})
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("*")} == before


def test_processes_find_the_same_in_the_same_order(folder, monkeypatch):
    for index in (3, 5):
        (folder / f"distance/{index:06d}.exr").write_bytes(b"no image")
    monkeypatch.setattr(crew, "_WORTH", 2)
    monkeypatch.setattr(crew, "_AT_A_TIME", 2)
    told = []
    many = check_dataset(folder, workers=2, on_frame=lambda done, total: told.append((done, total)))
    assert many == check_dataset(folder, workers=1)
    assert told == [(done, 6) for done in range(1, 7)]
    assert many.counts() == {"checksum": 2}


# --- files --------------------------------------------------------------------------------------------------


def test_a_missing_image(folder):
    (folder / "class/000004.png").unlink()
    assert found(folder) == {("missing", 4, "class/000004.png")}


@pytest.mark.parametrize(
    ("lost", "known_by"), [("manifest.parquet", "frames/000004.json"), ("journal.jsonl", "manifest.parquet")]
)
def test_a_missing_frame_is_known_by_the_tables_and_its_images_are_left_over(folder, lost, known_by):
    (folder / "frames/000004.json").unlink()
    (folder / lost).unlink()
    kinds = {one for one in found(folder) if one[0] != "missing"}
    assert ("incomplete", 4, known_by) in kinds
    assert {kind for kind in kinds if kind[0] == "extra"} == {
        ("extra", 4, f"{name}/000004{OUTPUTS[name].suffix}") for name in (*DEFAULT_OUTPUTS, "class_colour")
    }
    assert len(kinds) == 1 + 6


def test_frames_that_were_asked_for(folder):
    for path in folder.glob("*/000005.*"):
        path.unlink()
    (folder / "journal.jsonl").unlink()
    write_manifest_of(folder)
    assert found(folder) == set()
    assert found(folder, frames="0:6") == {("incomplete", 5, "frames/000005.json")}
    assert found(folder, frames=[2, 3]) == set()
    with pytest.raises(InputError, match="A:B"):
        check_dataset(folder, frames="7:3")


@pytest.mark.parametrize(
    "name",
    ["notes.txt", "class/copy.png", "frames/.000003.json.here.7.1.tmp", "frames/5.json", "masks/1.png"],
)
def test_files_that_do_not_belong(folder, name):
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_bytes(b"")
    expected = name if name != "masks/1.png" else "masks"
    assert found(folder) == {("extra", None, expected)}


def test_a_name_that_is_no_text(folder):
    with open(bytes(folder / "class") + b"/\xff.png", "wb"):
        pass
    assert found(folder) == {("extra", None, "class/\\udcff.png")}


def test_what_file_managers_and_reports_leave_is_no_fault(folder):
    for name in ("index.html", "contact_sheet.png", ".DS_Store", "class/Thumbs.db"):
        (folder / name).write_bytes(b"")
    assert found(folder) == set()


def test_a_flipped_bit(folder):
    path = folder / "distance/000005.exr"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert found(folder) == {("checksum", 5, "distance/000005.exr")}


def test_a_file_cut_short(folder):
    path = folder / "colour/000005.png"
    path.write_bytes(path.read_bytes()[:-900])
    assert found(folder) == {("checksum", 5, "colour/000005.png")}


def test_what_cannot_be_decoded(folder):
    (folder / "colour/000005.png").write_bytes(b"no picture")
    (folder / "distance/000004.exr").write_bytes(b"")
    for index in (4, 5):
        sign(folder, index)
    assert found(folder) == {("unreadable", 5, "colour/000005.png"), ("unreadable", 4, "distance/000004.exr")}


def test_an_image_of_another_size_or_type(folder):
    change(folder, 1, "distance_code", lambda image: image[:, :-1])
    path = folder / "instance/000002.png"
    write_image(path, read_image(path).astype(np.uint8), "distance_code")
    sign(folder, 2)
    assert found(folder) == {("shape", 1, "distance_code/000001.png"), ("shape", 2, "instance/000002.png")}


# --- JSON and tables ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[1, 2]", b"\xff\xfe", b'{"index": 3}', b'{"outputs": {"class": 1}}']
)
def test_a_damaged_frame_json(folder, content):
    (folder / "frames/000003.json").write_bytes(content)
    assert ("damaged", 3, "frames/000003.json") in found(folder)


def test_a_frame_json_that_was_edited(folder):
    path = folder / "frames/000003.json"
    facts = json.loads(path.read_text())
    facts["camera"]["exposure_s"] *= 2
    path.write_text(json.dumps(facts))
    assert found(folder) == {("damaged", 3, "frames/000003.json")}


@pytest.mark.parametrize("content", [b"", b"{", b'{"format": "another"}'])
def test_a_damaged_dataset_json(folder, content):
    (folder / "dataset.json").write_bytes(content)
    assert found(folder) == {("damaged", None, "dataset.json")}


def test_a_dataset_json_that_is_gone_or_was_edited(folder):
    path = folder / "dataset.json"
    about = json.loads(path.read_text())
    about["recipe"]["path"]["distance_mm"] += 1
    path.write_text(json.dumps(about))
    assert found(folder) == {("damaged", None, "dataset.json")}
    path.unlink()
    assert found(folder) == {("damaged", None, "dataset.json")}
    shutil.rmtree(folder / "frames")
    with pytest.raises(InputError, match="no data set"):
        check_dataset(folder)


def test_no_frames_are_incomplete(folder):
    shutil.rmtree(folder)
    folder.mkdir()
    (folder / "dataset.json").write_text("{}")
    assert ("incomplete", None, "") in found(folder)


@pytest.mark.parametrize("changes", [{"step": 2}, {"seed": 1}, {"recipe_seed": 5}, {"set": 0}, {"index": 4}])
def test_a_frame_that_is_not_where_the_plan_has_it(folder, changes):
    sign(folder, 3, changes)
    kinds = found(folder)
    assert ("contradiction", 3, "frames/000003.json") in kinds
    assert {kind for kind, *_ in kinds} <= {"contradiction", "incomplete"}


def test_json_that_contradicts_its_images(folder):
    facts = open_dataset(folder).metadata(3)
    facts["class_pixels"]["leaf"] += 1
    first, second, third = list(facts["instances"])[:3]
    facts["instances"][first]["pixels"] += 1
    facts["instances"][second]["box"][0] += 1
    facts["instances"]["999"] = facts["instances"][third]
    sign(folder, 3, facts)
    told = check_dataset(folder, workers=1).findings
    assert {one.kind for one in told} == {"contradiction"}
    texts = " ".join(one.what for one in told)
    assert all(word in texts for word in ("leaf", "box", "lists instance 999", f"have instance {first}"))


def test_the_manifest(folder):
    path = folder / "manifest.parquet"
    kept = path.read_bytes()
    sign(folder, 3, {"camera": {**open_dataset(folder).metadata(3)["camera"], "exposure_s": 1.0}})
    path.write_bytes(kept)
    assert found(folder) == {("contradiction", 3, "manifest.parquet")}
    path.write_bytes(kept[:-20])
    assert found(folder) == {("damaged", None, "manifest.parquet")}
    path.unlink()
    assert found(folder) == {("missing", None, "manifest.parquet")}


def test_the_table_of_fruit(rich):
    (rich / "fruit.parquet").unlink()
    assert found(rich) == {("missing", None, "fruit.parquet")}


# --- labels -------------------------------------------------------------------------------------------------


def test_a_class_that_there_is_not(folder):
    change(folder, 2, "class", put(9))
    assert ("label", 2, "class/000002.png") in found(folder)


def test_an_instance_that_the_json_does_not_know(folder):
    instance = read_image(folder / "instance/000002.png")
    largest = np.bincount(instance[instance > 0]).argmax()
    change(folder, 2, "instance", lambda image: np.where(image == largest, 5000, image).astype(np.uint16))
    kinds = found(folder)
    assert ("instance", 2, "instance/000002.png") in kinds
    assert {kind for kind, *_ in kinds} == {"instance", "contradiction"}


def test_a_pixel_of_another_class_than_its_instance(folder):
    instance = read_image(folder / "instance/000002.png")
    row, column = np.argwhere(instance > 0)[0]

    def swap(image):
        image[row, column] = 1 + image[row, column] % 7
        return image

    change(folder, 2, "class", swap)
    kinds = found(folder)
    assert ("instance", 2, "class/000002.png") in kinds
    assert ("encoding", 2, "class_colour/000002.png") in kinds


@pytest.mark.parametrize("lost", ["instance", "distance"])
def test_a_pixel_without_a_label_or_a_distance(folder, lost):
    place = tuple(np.argwhere(read_image(folder / "instance/000002.png") > 0)[0])
    change(folder, 2, lost, put(0 if lost == "instance" else np.inf, place))
    kinds = found(folder)
    suffix = OUTPUTS[lost].suffix
    assert ("unlabelled", 2, f"{lost}/000002{suffix}") in kinds


def test_codes_that_do_not_belong_to_what_they_encode(folder):
    change(folder, 2, "distance_code", lambda image: image + 1)
    change(folder, 3, "class_colour", put(17, (0, 0, 0)))
    assert found(folder) == {
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
def test_a_value_that_cannot_be(rich, output, value):
    rows, columns = np.nonzero(read_image(rich / "instance/000002.png"))
    right = np.argsort(columns)[-1]
    change(rich, 2, output, put(value, (rows[right], columns[right])))
    assert ("value", 2, f"{output}/000002{OUTPUTS[output].suffix}") in found(rich)


def test_a_position_beside_where_its_pixel_looks_is_told_by_its_distance(rich):
    change(rich, 2, "position", lambda image: image + np.float32(0.01))
    assert found(rich) == {("value", 2, "position/000002.exr")}


def test_harvest_truth_that_contradicts_the_labels(rich):
    instance = read_image(rich / "instance/000002.png")
    number = int(instance[instance > 0][0])
    pixels = int((instance == number).sum())
    fruit = {
        "instance": number,
        "visible_pixels": pixels,
        "amodal_pixels": pixels,
        "amodal": {"size": [HEIGHT, WIDTH], "counts": [0, pixels, HEIGHT * WIDTH - pixels]},
    }
    path = rich / "harvest/000002.json"
    told = json.loads(path.read_text())
    for changes, good in (({}, True), ({"visible_pixels": pixels + 1}, False), ({"amodal_pixels": 0}, False)):
        write_json(path, {**told, "fruit": [{**fruit, **changes}]})
        sign_without_tables(rich, 2)
        kinds = {kind for kind in found(rich) if kind[2] == "harvest/000002.json"}
        assert kinds == (set() if good else {("contradiction", 2, "harvest/000002.json")})


def sign_without_tables(folder, index):
    """As `sign`, but fruit without all its values has no place in the table of fruit."""
    kept = (folder / "fruit.parquet").read_bytes()
    path = folder / f"harvest/{index:06d}.json"
    shown = path.read_bytes()
    facts = open_dataset(folder).metadata(index)
    facts["outputs"]["harvest"] |= {"bytes": len(shown), "sha256": digest(path)}
    facts["checksum"] = checksum_of(facts)
    write_json(folder / f"frames/{index:06d}.json", facts)
    (folder / "fruit.parquet").write_bytes(kept)


# --- pictures -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "picture"),
    [
        ("black", lambda image: image * 0 + np.eye(HEIGHT, WIDTH, dtype=np.uint8)[..., None]),
        ("dark", lambda image: image // 12),
        (
            "saturated",
            lambda image: np.where(np.arange(HEIGHT)[:, None, None] < 90, 255, image).astype(np.uint8),
        ),
        ("constant", lambda image: np.full_like(image, 90)),
    ],
)
def test_a_picture_that_shows_nothing(folder, kind, picture):
    change(folder, 1, "colour", picture)
    kinds = found(folder)
    assert {one for one in kinds if one[0] != "drift"} == {(kind, 1, "colour/000001.png")}
    assert kinds - {(kind, 1, "colour/000001.png")} <= {("drift", 1, "colour/000001.png")}


@pytest.mark.parametrize(("right", "down"), [(2, 0), (0, -2), (-4, 3), (8, 8)])
def test_labels_that_are_off_are_told_with_their_shift(folder, right, down):
    change(folder, 1, "colour", lambda image: np.roll(image, (-down, -right), (0, 1)))
    (one,) = check_dataset(folder, workers=1).findings
    assert (one.kind, one.file) == ("edges", "instance/000001.png")
    assert f"{right:+d} px to the right" in one.what
    assert f"{down:+d} px below" in one.what


def test_labels_of_a_mirrored_or_another_picture_fit_nowhere(folder):
    change(folder, 1, "colour", lambda image: image[:, ::-1])
    other = read_image(folder / "colour/000002.png")
    change(folder, 3, "colour", lambda image: other // 2 + 60)
    verdict = check_dataset(folder, workers=1)
    assert [(one.kind, one.index) for one in verdict.findings] == [("edges", 1), ("edges", 3)]
    assert all("no shift" in one.what for one in verdict.findings)


# --- all together -------------------------------------------------------------------------------------------


def test_the_same_photograph_twice(folder):
    shutil.copyfile(folder / "colour/000002.png", folder / "colour/000005.png")
    sign(folder, 5)
    # Both look from the same place.
    assert found(folder) == {("duplicate", 5, "frames/000005.json")}


def test_the_same_ground_truth_twice(folder):
    data = open_dataset(folder)
    for index in data.indices():
        facts = data.metadata(index)
        sign(folder, index, {"outputs": {"class": facts["outputs"]["class"]}})
    shutil.rmtree(folder / "colour")
    kinds = found(folder)
    assert {one for one in kinds if one[0] != "extra"} == {
        ("duplicate", index, f"frames/{index:06d}.json") for index in (3, 4, 5)
    }


def test_the_same_pose_and_seed_twice(folder):
    first = open_dataset(folder).metadata(3)
    sign(folder, 4, {"camera": first["camera"], "seed": first["seed"]})
    assert found(folder) == {
        ("duplicate", 4, "frames/000004.json"),
        ("contradiction", 4, "frames/000004.json"),
    }


def expecting(folder, **changes):
    path = folder / "dataset.json"
    about = json.loads(path.read_text())
    path.write_text(json.dumps({**about, "expect": {**about["expect"], **changes}}))


@pytest.mark.parametrize(
    ("changes", "word", "frames"),
    [
        ({"intensity": [0, 50]}, "mean grey value", 0),
        ({"share": {"pepper": [0.5, 1]}}, "share of pepper", 0),
        ({"frame_intensity": [0, 50]}, "mean grey value", 6),
        ({"frame_intensity": [0, 50], "share": {"wire": [0, 0.001]}}, "share of wire", 6),
    ],
)
def test_statistics_beside_what_is_expected(folder, changes, word, frames):
    expecting(folder, **changes)
    told = check_dataset(folder, workers=1).findings
    assert {one.kind for one in told} == {"drift"}
    assert any(word in one.what for one in told)
    assert len([one for one in told if one.index is not None]) == frames


def test_an_expectation_that_is_none(folder):
    expecting(folder, intensity="bright")
    assert found(folder) == {("damaged", None, "dataset.json")}


def traits(index, scene, leaf):
    shares = (1 - leaf, leaf, *[0.0] * 6)
    return FrameTraits(index, scene=scene, shares=shares)


def test_a_part_of_a_plan_drifts_only_beyond_chance():
    expect = ExpectTable(share={"leaf": (0.4, 0.6)})
    rng = np.random.default_rng(4)
    for scenes, middle, drifts in ((3, 0.9, False), (6, 0.65, False), (6, 0.8, True), (400, 0.65, True)):
        comparison = CrossFrameChecks(expect)
        for index in range(scenes):
            list(comparison.add(traits(index, index, middle + rng.normal(0, 0.07))))
        assert bool(list(comparison.drift(whole=False))) == drifts
        # Of the whole plan chance is no excuse.
        assert bool(list(comparison.drift(whole=True)))


def test_a_scene_that_stands_apart_is_a_note():
    comparison = CrossFrameChecks(None)
    rng = np.random.default_rng(5)
    for index in range(60):
        scene = 1000 * (index // 30) + index % 10
        list(comparison.add(traits(index, scene, 0.9 if scene == 1004 else rng.normal(0.5, 0.02))))
    assert list(comparison.drift(whole=True)) == []
    notes = list(comparison.apart())
    assert notes
    assert all(note.startswith("set 1, rotation 4 stands apart") for note in notes)


# --- the verdict --------------------------------------------------------------------------------------------


def test_findings_come_the_most_serious_first(folder):
    (folder / "notes.txt").write_bytes(b"")
    (folder / "class/000004.png").unlink()
    (folder / "distance/000002.exr").unlink()
    (folder / "frames/000001.json").write_bytes(b"")
    verdict = check_dataset(folder, workers=1)
    ranks = [list(KINDS).index(one.kind) for one in verdict.findings]
    assert ranks == sorted(ranks)
    assert verdict.as_json()["counts"] == verdict.counts()
    missing = [one.index for one in verdict.findings if one.kind == "missing"]
    assert missing == sorted(missing)
    assert json.loads(json.dumps(verdict.as_json()))["good"] is False


def test_a_kind_that_there_is_not_is_a_fault_of_the_program():
    with pytest.raises(ValueError, match="no kind"):
        Finding("odd", None, "", "")
    assert replace(Finding("extra", None, "a", "b"), file="c").file == "c"


@pytest.mark.parametrize("workers", [0, -1, 100_000])
def test_workers_are_a_positive_number(whole, workers):
    with pytest.raises(InputError, match="workers"):
        check_dataset(whole, workers=workers)

"""Data sets from anywhere: whatever their JSON holds, readers, exports and reports raise `PepperError`."""

from __future__ import annotations

import io
import json
import os
import shutil

import numpy as np
import pytest
from data_sets import CUT, D435, FRUIT, set_without_plants
from pyarrow import parquet
from stand_in import SceneStandIn

from pepperscene.atomic import digest
from pepperscene.colour import open_patches
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.torch_images import torch_images
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.frame_json import checksum_of
from pepperscene.dataset.store.images import encode_image
from pepperscene.errors import PepperError
from pepperscene.export import FORMATS, export_dataset
from pepperscene.frame import Frame
from pepperscene.review.report import write_report
from pepperscene.review.report.data import frame_records
from pepperscene.truth import distance_code
from pepperscene.truth.encodings import encode_rle

SIZE = (12, 16)
OUTPUTS = ("colour", "class", "instance", "distance", "distance_code", "depth_sensor", "harvest")
LEFT_OUT = ("bop", "envi", "npy", "rerun")  # these need plants, bands, and a large package
PAINTED = [name for name in FORMATS if name not in LEFT_OUT]
FILES = ("dataset.json", "frames/000000.json", "harvest/000000.json")
REMOVED = object()
DEEP = [[]]
for _ in range(400):
    DEEP = [DEEP]
VALUES = {
    "removed": REMOVED, "null": None, "text": "text", "empty": "", "lines": "a\nb", "surrogate": "\ud800",
    "list": [], "numbers": [1, 2], "texts": ["a", "b", "c", "d"], "object": {}, "other_object": {"1": None},
    "zero": 0, "negative": -1, "fraction": 0.5, "huge": 1e300, "integer": 10**30, "nan": float("nan"),
    "inf": float("inf"), "true": True, "deep": DEEP,
}  # fmt: skip
SAMPLE = 12  # chosen: they take a second


class TwoFruit(SceneStandIn):
    """Renders two fruit of a plant, one of them in front of the other."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        instance = np.zeros(SIZE, np.uint16)
        instance[2:8, 3:9] = 7
        hidden = np.zeros(SIZE, bool)
        hidden[4:10, 6:14] = True
        instance[hidden & (instance == 0)] = 9
        distance = np.where(instance > 0, np.float32(0.5), np.float32(np.inf))
        entry = {"class": 2, "kind": "fruit", "plant": 0, "phytomer": 3, "parent": 9, "box": [3, 2, 9, 8]}
        images = {
            "colour": np.random.default_rng(seed).integers(0, 256, (*SIZE, 3)).astype(np.uint8),
            "class": np.where(instance > 0, 2, 0).astype(np.uint8),
            "instance": instance,
            "distance": distance,
            "distance_code": distance_code(distance),
            "depth_sensor": np.where(instance > 0, distance, np.float32(np.nan)),
            "harvest": {
                "format": "pepperscene harvest 1",
                "fruit": [self.fruit(7, instance == 7, 0.8), self.fruit(9, hidden, 0.2)],
            },
        }
        metadata = {
            "camera": {**camera.to_metadata(), "width": SIZE[1], "height": SIZE[0]},
            "instances": {
                str(value): {**entry, "pixels": int((instance == value).sum())} for value in (7, 9)
            },
            "class_pixels": {"pepper": int((instance > 0).sum())},
            "sampling": {"samples_per_pixel": 4.0, "error_codes": 0.5, "noise_codes": 0.6},
            "contacts": {"fruit_touching": 1, "blades_touching": 2},
        }
        return Frame({name: images[name] for name in outputs}, metadata)

    def fruit(self, value, mask, ripeness):
        return {
            **FRUIT, "instance": value, "plant": 0, "ripeness": ripeness, "amodal": encode_rle(mask),
            "amodal_pixels": int(mask.sum()), "occluders": [{"instance": 7, "pixels": 8}],
            "box_3d": {"centre": [0.0, 0.0, 0.4], "size": [0.1, 0.1, 0.1]}, "stalk_end": CUT,
            "blossom_end": {**CUT, "px": None},
        }  # fmt: skip


def read_all(images):
    for position in range(len(images)):
        images[position]


def actions(folder, tmp_path):
    """Everything that reads a data set, by name."""
    yield "images", lambda: read_all(open_images(folder))
    yield "patches", lambda: open_patches(folder)
    keys = ("image", "mask", "instances", "distance")
    yield "torch", lambda: read_all(torch_images(folder, keys))
    yield "report", lambda: write_report(folder, limit=2)
    for format_name in PAINTED:
        out = tmp_path / format_name
        shutil.rmtree(out, ignore_errors=True)
        yield (
            format_name,
            lambda format_name=format_name, out=out: export_dataset(folder, format_name, out, "train=0:1"),
        )


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    pytest.importorskip("torch", reason="the extra `torch`")
    pytest.importorskip("pycocotools", reason="the extra `export`")
    pytest.importorskip("cv2", reason="the extra `export`")
    folder = tmp_path_factory.mktemp("malformed") / "set"
    set_without_plants(folder, range(2), OUTPUTS, TwoFruit, D435)
    return folder


def keys_of(content, key=()):
    """All keys below a content, those of the first two entries only of lists."""
    items = content.items() if isinstance(content, dict) else enumerate(content[:2])
    for name, value in items:
        yield (*key, name)
        if isinstance(value, dict | list):
            yield from keys_of(value, (*key, name))


def all_cases(original):
    """File, key and name of the value for every way to change one value."""
    return [
        (file, key, value)
        for file in FILES
        for key in keys_of(json.loads((original / file).read_text()))
        for value in VALUES
    ]


def change(folder, file, key, value):
    """Change one value of a JSON file, and let all checksums be right for the result."""
    content = json.loads((folder / file).read_text())
    parent = content
    for name in key[:-1]:
        parent = parent[name]
    if VALUES[value] is REMOVED:
        del parent[key[-1]]
    else:
        parent[key[-1]] = VALUES[value]
    write(folder / file, content, is_signed=file.startswith("frames") and key[0] != "checksum")
    if file.startswith("harvest"):
        path = folder / "frames" / (folder / file).name
        frame = json.loads(path.read_text())
        frame["outputs"]["harvest"] |= {
            "bytes": (folder / file).stat().st_size, "sha256": digest(folder / file),
        }  # fmt: skip
        write(path, frame, is_signed=True)


def write(path, content, is_signed):
    if is_signed:
        try:
            content["checksum"] = checksum_of(content)
        except ValueError:
            assert "nan" in str(content) or "inf" in str(content) or "\ud800" in str(content)
    path.write_text(json.dumps(content))


def try_actions(folder, tmp_path, case, only=None):
    """Messages of the actions that are refused, and those with any other error."""
    messages, other_errors = [], []
    for name, action in actions(folder, tmp_path):
        if only is not None and name not in only:
            continue
        try:
            action()
        except PepperError as error:
            messages.append(str(error))
        except Exception as error:
            other_errors.append(f"{name} of {case}: {type(error).__name__}: {error}")
    return messages, other_errors + [f"{case}: {message}" for message in messages if "\n" in message]


def check_cases(original, tmp_path, cases):
    """Try all actions on copies of the data set with one changed value each; most of them are refused."""
    folder = tmp_path / "set"
    refused, other_errors = 0, []
    for case in cases:
        shutil.copytree(original, folder)
        change(folder, *case)
        messages, errors = try_actions(folder, tmp_path, case)
        refused, other_errors = refused + bool(messages), other_errors + errors
        shutil.rmtree(folder)
    assert other_errors == []
    assert refused > len(cases) / 4


def test_every_action_reads_the_unchanged_set(original, tmp_path):
    folder = shutil.copytree(original, tmp_path / "set")
    for _, action in actions(folder, tmp_path):
        action()
    assert (folder / "index.html").is_file()
    assert all(any((tmp_path / name).iterdir()) for name in PAINTED)


@pytest.mark.parametrize(
    ("file", "key", "value", "action", "message"),
    [
        (0, "recipe", "removed", "report", "dataset.json: recipe: is required but missing"),
        (0, "recipe.plan.sets", "zero", "coco", "dataset.json: recipe.plan.sets = 0: must be"),
        (0, "recipe.name", "lines", "huggingface", r"dataset.json: recipe.name = 'a\\nb': "),
        (1, "camera", "null", "patches", "frames/000000.json: camera: must be a table"),
        (1, "instances.7.class", "text", "yolo", "000000.json: instances.7.class = 'text': "),
        (1, "set", "huge", "report", "frames/000000.json: set = 1e\\+300: must be a valid integer"),
        (2, "fruit.0.ripeness", "text", "patches", "harvest/000000.json: fruit.0.ripeness = "),
        (2, "fruit.0.pose", "numbers", "huggingface", "harvest/000000.json: fruit.0.pose"),
        (2, "fruit.0.amodal.counts", "numbers", "coco", "must have counts that sum to 12 x 16"),
    ],
)
def test_the_message_names_file_and_key(file, key, value, action, message, original, tmp_path):
    folder = shutil.copytree(original, tmp_path / "set")
    change(folder, FILES[file], [0 if part == "0" else part for part in key.split(".")], value)
    run = dict(actions(folder, tmp_path))[action]
    with pytest.raises(PepperError, match=message):
        run()


def test_a_frame_under_the_name_of_another_is_refused(original, tmp_path):
    folder = shutil.copytree(original, tmp_path / "set")
    shutil.copy(folder / "frames" / "000001.json", folder / "frames" / "000000.json")
    with pytest.raises(PepperError, match=r"frames/000000.json: index = 1: must be 0, as in the name"):
        read_all(open_images(folder))


def test_a_set_without_anything_to_show_has_no_report(original, tmp_path):
    folder = shutil.copytree(original, tmp_path / "set")
    for index in (0, 1):
        path = folder / "frames" / f"00000{index}.json"
        frame = json.loads(path.read_text())
        frame["outputs"] = {"harvest": frame["outputs"]["harvest"]}
        write(path, frame, is_signed=True)
    with pytest.raises(
        PepperError, match="000000 has no photograph, classes, instances or distances to show"
    ):
        write_report(folder)


def test_fruit_of_unknown_ripeness_are_neither_ripe_nor_unripe(original, tmp_path):
    folder = shutil.copytree(original, tmp_path / "set")
    assert {patch.kind for patch in open_patches(folder).patches} == {"pepper.ripe", "pepper.unripe"}
    change(folder, FILES[2], ("fruit", 1, "ripeness"), "null")
    kinds = {patch.kind for patch in open_patches(open_images(folder)[:1]).patches}
    assert kinds == {"pepper.ripe", "pepper"}


def test_a_foreign_key_named_harvest_is_no_harvest(original, tmp_path):
    folder = shutil.copytree(original, tmp_path / "set")
    path = folder / "frames" / "000000.json"
    frame = json.loads(path.read_text())
    del frame["outputs"]["harvest"]
    write(path, {**frame, "harvest": "text"}, is_signed=True)
    assert {patch.kind for patch in open_patches(open_images(folder)[:1]).patches} == {"pepper"}


@pytest.fixture
def without_charts(monkeypatch):
    """Leave out the charts of reports, which take most of the time."""
    for chart in ("line_chart", "value_chart"):
        monkeypatch.setattr(f"pepperscene.review.report.sections.{chart}", lambda *_args, **_kwargs: "")


def test_a_sample_of_malformed_values_raises_errors_for_users(original, tmp_path, without_charts):
    cases = all_cases(original)
    chosen = np.random.default_rng(12).permutation(len(cases))[:SAMPLE]
    check_cases(original, tmp_path, [cases[number] for number in chosen])


@pytest.mark.long
@pytest.mark.parametrize("file", FILES)
def test_every_seventh_malformed_value_raises_an_error_for_users(file, original, tmp_path, without_charts):
    check_cases(original, tmp_path, [case for case in all_cases(original) if case[0] == file][::7])


@pytest.mark.parametrize("key", [("ripeness",), ("plant",), ("peduncle", "cut", "px")])
def test_malformed_fruit_of_a_frame_that_is_not_shown_does_not_end_a_report(
    key, original, tmp_path, without_charts
):
    for value in ("text", "integer"):
        folder = shutil.copytree(original, tmp_path / value)
        change(folder, "harvest/000001.json", ("fruit", 0, *key), value)
        assert write_report(folder, limit=1).frames == 2


@pytest.mark.long
def test_charts_of_extreme_numbers_are_drawn_or_refused(original, tmp_path):
    keys = [("sampling", "error_codes"), ("class_pixels", "pepper"), ("outputs", "colour", "bytes")]
    values = ("huge", "negative", "zero")
    check_cases(original, tmp_path, [(FILES[1], key, value) for key in keys for value in values])


def replace_image(folder, output, content):
    """Replace an image of the first frame, and let all checksums be right for the result."""
    path = next((folder / output).glob("000000.*"))
    path.write_bytes(content)
    frame_file = folder / "frames" / "000000.json"
    frame = json.loads(frame_file.read_text())
    frame["outputs"][output] |= {"bytes": len(content), "sha256": digest(path)}
    write(frame_file, frame, is_signed=True)


def other_images(output, image, folder):
    """Contents that no build writes for an output, by name."""
    yield "empty", b""
    yield "text", b"text"
    yield "one_pixel", encode_image(image[:1, :1], output)
    yield "half", encode_image(np.ascontiguousarray(image[: len(image) // 2]), output)
    for other in OUTPUTS[:-1]:
        yield other, next((folder / other).glob("000001.*")).read_bytes()
    for value in {"class": (9, 255), "instance": (8, 65535), "distance": (-1, np.nan)}.get(output, ()):
        yield f"of {value}", encode_image(np.full_like(image, value), output)


@pytest.mark.parametrize("output", OUTPUTS[:-1])
def test_images_of_another_kind_raise_errors_for_users(output, original, tmp_path):
    folder = tmp_path / "set"
    image = open_dataset(original).image(0, output)
    other_errors = []
    for name, content in other_images(output, image, original):
        shutil.copytree(original, folder)
        replace_image(folder, output, content)
        only = ("images", "published", "coco", "huggingface")
        _, errors = try_actions(folder, tmp_path, f"{output} {name}", only)
        other_errors += errors
        shutil.rmtree(folder)
    assert other_errors == []


READ_COLUMNS = ("index", "checksum", "worker", "render_s", "bytes", "pixels_pepper", "instance", "ripeness")


def other_tables(path):
    """Contents that no build writes for a table, by name."""
    yield "empty", b""
    yield "text", b"text"
    table = parquet.read_table(path)
    for number, name in enumerate(table.column_names):
        if name not in READ_COLUMNS:
            continue
        for kind in ("texts", "nulls", "lists"):
            values = {"texts": ["a"], "nulls": [None], "lists": [[1]]}[kind] * len(table)
            stream = io.BytesIO()
            parquet.write_table(table.set_column(number, name, [values]), stream)
            yield f"{name} {kind}", stream.getvalue()


@pytest.mark.parametrize("name", ["manifest.parquet", "fruit.parquet"])
def test_tables_of_other_columns_raise_errors_for_users(name, original, tmp_path):
    folder = shutil.copytree(original, tmp_path / "set")
    other_errors = []
    for case, content in other_tables(original / name):
        (folder / name).write_bytes(content)
        # The report takes a table that is newer than the frames as it is.
        os.utime(folder / "manifest.parquet", (2e9, 2e9))
        try:
            frame_records(open_dataset(folder))
            open_dataset(folder).fruit()
        except PepperError:
            pass
        except Exception as error:
            other_errors.append(f"{case}: {type(error).__name__}: {error}")
    assert other_errors == []
